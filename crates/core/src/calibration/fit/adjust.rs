//! Bundle adjustment: lenses, camera poses, the board's placements, its back's pose and its shape, all at once, by
//! Levenberg and Marquardt with the Schur complement over the placements (Triggs et al., "Bundle adjustment – a modern
//! synthesis", 1999, sections 6.1 and 3.3 for the robust loss). It only solves; other files judge the result.

use super::lens::{Lens, PARAMETERS};
use super::sheet::{PRIOR_VARIANCE, Sheet, TERMS};
use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix2x3, Matrix3, Matrix6, Point2, Point3, SMatrix, SVector,
    Translation3, UnitQuaternion, Vector2, Vector3, Vector6,
};
use rayon::prelude::*;

/// Columns of a view apart from its placement's: the lens, the camera's pose, the back face's pose, the board's shape.
const SHARED: usize = PARAMETERS + 12 + TERMS;
/// First of these that is the shape's.
const SHAPE: usize = PARAMETERS + 12;
/// Columns of a camera: lens and pose.
pub(super) const CAMERA: usize = PARAMETERS + 6;

/// A camera's state.
#[derive(Clone, Debug)]
pub(super) struct CameraState {
    pub lens: Lens,
    /// Which of the lens' parameters are fitted.
    pub free: [bool; PARAMETERS],
    pub camera_from_rig: Isometry3<f64>,
    pub pose_free: bool,
    /// What the lens is believed to be without any picture, and how little that weighs.
    pub prior: [Option<Prior>; PARAMETERS],
}

/// A value with its standard deviation.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prior {
    pub value: f64,
    pub deviation: f64,
}

/// A placement of the board.
#[derive(Clone, Debug)]
pub(super) struct PlacementState {
    pub rig_from_board: Isometry3<f64>,
    pub free: bool,
}

/// What one camera saw of one placement.
#[derive(Clone, Debug)]
pub(super) struct Observation {
    pub camera: usize,
    pub placement: usize,
    /// Whether it is the back of the board.
    pub back: bool,
    /// How much its squared residuals count.
    pub weight: f64,
    /// Points in the face's frame and their pixels.
    pub points: Vec<(Point3<f64>, Point2<f64>)>,
}

/// The parameters to adjust, and the observations that they are adjusted to.
#[derive(Clone, Debug)]
pub(super) struct Bundle {
    pub cameras: Vec<CameraState>,
    pub placements: Vec<PlacementState>,
    pub board_from_back: Isometry3<f64>,
    pub back_free: bool,
    pub sheet: Sheet,
    pub views: Vec<Observation>,
}

/// The loss of residuals: Cauchy's, with this scale in pixels; squared if it is infinite.
#[derive(Clone, Copy, Debug)]
pub(super) struct Loss {
    pub scale_px: f64,
}

impl Loss {
    pub(super) const SQUARED: Self = Self {
        scale_px: f64::INFINITY,
    };

    /// Loss and weight of a squared residual.
    #[inline]
    fn of(self, squared: f64) -> (f64, f64) {
        if self.scale_px.is_infinite() {
            return (squared, 1.0);
        }
        let c2 = self.scale_px * self.scale_px;
        (c2 * (squared / c2).ln_1p(), 1.0 / (1.0 + squared / c2))
    }
}

/// Squared residual, in px², of a point that is behind its camera.
const BEHIND: f64 = 1e8;

/// A view's share of the normal equations.
struct Share {
    aa: SMatrix<f64, SHARED, SHARED>,
    ap: SMatrix<f64, SHARED, 6>,
    pp: Matrix6<f64>,
    a: SVector<f64, SHARED>,
    p: Vector6<f64>,
    cost: f64,
}

/// The normal equations with the placements eliminated or about to be.
pub(super) struct NormalEquations {
    /// Of the cameras (and the back and the shape), all columns, those that are not free with ones on the diagonal.
    shared: DMatrix<f64>,
    gradient: DVector<f64>,
    placements: Vec<Matrix6<f64>>,
    placement_gradients: Vec<Vector6<f64>>,
    /// Per view, its share that couples the two.
    coupling: Vec<SMatrix<f64, SHARED, 6>>,
    pub(super) cost: f64,
}

impl Bundle {
    /// Columns of the cameras, the back and the shape.
    fn columns(&self) -> usize {
        self.shape_column() + TERMS
    }

    /// The first of the shape's columns.
    pub(super) fn shape_column(&self) -> usize {
        self.cameras.len() * CAMERA + 6
    }

    /// Where a view's shared columns are.
    fn column(&self, view: &Observation, local: usize) -> usize {
        if local < CAMERA {
            view.camera * CAMERA + local
        } else {
            self.cameras.len() * CAMERA + local - CAMERA
        }
    }

    fn is_free(&self, column: usize) -> bool {
        let (camera, local) = (column / CAMERA, column % CAMERA);
        match self.cameras.get(camera) {
            Some(state) if local < PARAMETERS => state.free[local],
            Some(state) => state.pose_free,
            None => match column.checked_sub(self.shape_column()) {
                Some(term) => self.sheet.free[term],
                None => self.back_free,
            },
        }
    }

    /// How many parameters are fitted.
    pub(super) fn free_parameters(&self) -> usize {
        let shared = (0..self.columns()).filter(|&c| self.is_free(c)).count();
        shared + 6 * self.placements.iter().filter(|p| p.free).count()
    }

    /// The true position, in the board's frame, of a stated point of a view's face.
    pub(super) fn on_board(&self, view: &Observation, p: &Point3<f64>) -> Point3<f64> {
        let on_face = self.sheet.point(view.back, p);
        if view.back {
            self.board_from_back * on_face
        } else {
            on_face
        }
    }

    /// Residuals (pixel predicted less pixel seen) of a view; `None` for a point behind the camera.
    pub(super) fn residuals(&self, view: &Observation) -> Vec<Option<Vector2<f64>>> {
        let camera = &self.cameras[view.camera];
        let pose = camera.camera_from_rig * self.placements[view.placement].rig_from_board;
        let residual = |(p, pixel): &(Point3<f64>, Point2<f64>)| {
            let in_camera = pose * self.on_board(view, p);
            camera
                .lens
                .project(in_camera.coords)
                .map(|seen| seen - pixel)
        };
        view.points.iter().map(residual).collect()
    }

    fn cost(&self, loss: Loss) -> f64 {
        let of_view = |view: &Observation| -> f64 {
            let residuals = self.residuals(view).into_iter();
            let losses = residuals.map(|r| loss.of(r.map_or(BEHIND, |r| r.norm_squared())).0);
            view.weight * losses.sum::<f64>()
        };
        let costs: Vec<f64> = self.views.par_iter().map(of_view).collect();
        costs.iter().sum::<f64>() + self.belief_cost()
    }

    fn priors(&self) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
        let of_cameras = self.cameras.iter().enumerate().flat_map(|(c, camera)| {
            let believed = camera.prior.iter().enumerate();
            believed.filter_map(move |(i, prior)| {
                let prior = (*prior)?;
                let weight = PRIOR_VARIANCE / prior.deviation.powi(2);
                let error = camera.lens.values[i] - prior.value;
                camera.free[i].then_some((c * CAMERA + i, weight, error))
            })
        });
        let first = self.shape_column();
        let of_shape = self.sheet.priors().map(move |(i, w, e)| (first + i, w, e));
        of_cameras.chain(of_shape)
    }

    fn belief_cost(&self) -> f64 {
        self.priors().map(|(_, w, e)| w * e * e).sum()
    }

    /// A view's share, at the present state.
    fn share(&self, view: &Observation, loss: Loss) -> Share {
        let camera = &self.cameras[view.camera];
        let placement = &self.placements[view.placement].rig_from_board;
        let rig_rotation = camera.camera_from_rig.rotation.to_rotation_matrix();
        let board_rotation = rig_rotation * placement.rotation.to_rotation_matrix();
        let back_rotation = self.board_from_back.rotation.to_rotation_matrix();
        let is_shaped = self.sheet.free.contains(&true);
        let mut share = Share {
            aa: SMatrix::zeros(),
            ap: SMatrix::zeros(),
            pp: Matrix6::zeros(),
            a: SVector::zeros(),
            p: Vector6::zeros(),
            cost: 0.0,
        };
        let mut sums = NormalSums::new(self.fitted_columns(view));
        for (p, pixel) in &view.points {
            let on_board = self.on_board(view, p);
            let rotated = placement.rotation * on_board.coords;
            let in_rig = rotated + placement.translation.vector;
            let turned = camera.camera_from_rig.rotation * in_rig;
            let in_camera = turned + camera.camera_from_rig.translation.vector;
            let Some((predicted, by_lens, by_point)) = camera.lens.derive(in_camera) else {
                share.cost += view.weight * loss.of(BEHIND).0;
                continue;
            };
            let residual = predicted - pixel;
            let (cost, weight) = loss.of(residual.norm_squared());
            let weight = view.weight * weight;
            share.cost += view.weight * cost;
            let by_rig = by_point * rig_rotation.matrix();
            let mut by_shared = SMatrix::<f64, 2, SHARED>::zeros();
            by_shared
                .fixed_view_mut::<2, PARAMETERS>(0, 0)
                .copy_from(&by_lens);
            set_pose(&mut by_shared, PARAMETERS, &by_point, turned);
            let by_board = by_point * board_rotation.matrix();
            let by_face = match view.back {
                true => by_board * back_rotation.matrix(),
                false => by_board,
            };
            if view.back {
                let from_face = on_board.coords - self.board_from_back.translation.vector;
                set_pose(&mut by_shared, CAMERA, &by_board, from_face);
            }
            if is_shaped {
                let by_terms = by_face * self.sheet.by_terms(view.back, p);
                by_shared
                    .fixed_view_mut::<2, TERMS>(0, SHAPE)
                    .copy_from(&by_terms);
            }
            let mut by_placement = SMatrix::<f64, 2, 6>::zeros();
            set_pose(&mut by_placement, 0, &by_rig, rotated);
            sums.add(&by_shared, &by_placement, residual, weight);
        }
        sums.spread(&mut share);
        share
    }

    /// A view's shared columns that are fitted: nothing is computed for the others, which are half of them.
    fn fitted_columns(&self, view: &Observation) -> Vec<usize> {
        let is_fitted = |&local: &usize| {
            let is_of_back = (CAMERA..SHAPE).contains(&local);
            (view.back || !is_of_back) && self.is_free(self.column(view, local))
        };
        (0..SHARED).filter(is_fitted).collect()
    }

    /// The normal equations at the present state.
    pub(super) fn normal(&self, loss: Loss) -> NormalEquations {
        let shares: Vec<Share> = self
            .views
            .par_iter()
            .map(|view| self.share(view, loss))
            .collect();
        let n = self.columns();
        let mut normal = NormalEquations {
            shared: DMatrix::zeros(n, n),
            gradient: DVector::zeros(n),
            placements: vec![Matrix6::zeros(); self.placements.len()],
            placement_gradients: vec![Vector6::zeros(); self.placements.len()],
            coupling: Vec::with_capacity(self.views.len()),
            cost: self.belief_cost(),
        };
        for (view, share) in self.views.iter().zip(shares) {
            self.add_share(&mut normal, view, share);
        }
        for (column, weight, error) in self.priors() {
            normal.shared[(column, column)] += weight;
            normal.gradient[column] += weight * error;
        }
        for column in (0..n).filter(|&c| !self.is_free(c)) {
            normal.shared.row_mut(column).fill(0.0);
            normal.shared.column_mut(column).fill(0.0);
            normal.gradient[column] = 0.0;
        }
        normal
    }

    fn add_share(&self, normal: &mut NormalEquations, view: &Observation, mut share: Share) {
        normal.cost += share.cost;
        let columns: [usize; SHARED] = std::array::from_fn(|i| self.column(view, i));
        for (i, &row) in columns.iter().enumerate() {
            normal.gradient[row] += share.a[i];
            for (j, &column) in columns.iter().enumerate() {
                normal.shared[(row, column)] += share.aa[(i, j)];
            }
            if !self.is_free(row) {
                share.ap.row_mut(i).fill(0.0);
            }
        }
        if self.placements[view.placement].free {
            normal.placements[view.placement] += share.pp;
            normal.placement_gradients[view.placement] += share.p;
        } else {
            share.ap.fill(0.0);
        }
        normal.coupling.push(share.ap);
    }

    /// The cameras' system with the placements eliminated, damped by `lambda`; with each placement's inverse.
    pub(super) fn reduced(
        &self,
        normal: &NormalEquations,
        lambda: f64,
    ) -> (DMatrix<f64>, DVector<f64>, Vec<Matrix6<f64>>) {
        let damped = |h: f64| h * (1.0 + lambda) + 1e-12;
        let inverse = |(block, placement): (&Matrix6<f64>, &PlacementState)| {
            let mut block = *block;
            for i in 0..6 {
                block[(i, i)] = damped(block[(i, i)]);
            }
            let inverse = placement
                .free
                .then(|| block.cholesky().map(|c| c.inverse()));
            inverse.flatten().unwrap_or_else(Matrix6::zeros)
        };
        let inverses: Vec<_> = normal
            .placements
            .iter()
            .zip(&self.placements)
            .map(inverse)
            .collect();
        let mut matrix = normal.shared.clone();
        let mut gradient = normal.gradient.clone();
        for column in 0..matrix.nrows() {
            let diagonal = matrix[(column, column)];
            // Parameters that are fixed, or that nothing speaks of, stay where they are.
            matrix[(column, column)] = if diagonal > 0.0 {
                damped(diagonal)
            } else {
                1.0
            };
        }
        for (placement, inverse) in inverses.iter().enumerate() {
            let of_placement = self.views.iter().zip(&normal.coupling);
            let of_placement: Vec<_> = of_placement
                .filter(|(view, _)| view.placement == placement)
                .collect();
            // Rows of columns that are not fitted are 0.
            let of_placement: Vec<_> = of_placement
                .into_iter()
                .map(|(view, coupling)| (view, coupling.transpose(), self.fitted_columns(view)))
                .collect();
            for (view, coupling, columns) in &of_placement {
                let weighted = inverse * coupling;
                let pulled = weighted.transpose() * normal.placement_gradients[placement];
                for &i in columns {
                    gradient[self.column(view, i)] -= pulled[i];
                }
                for (other, other_coupling, other_columns) in &of_placement {
                    for &j in other_columns {
                        let (pull, column) = (other_coupling.column(j), self.column(other, j));
                        for &i in columns {
                            matrix[(self.column(view, i), column)] -= weighted.column(i).dot(&pull);
                        }
                    }
                }
            }
        }
        (matrix, gradient, inverses)
    }

    /// The state after a step of the damped equations.
    fn stepped(&self, normal: &NormalEquations, lambda: f64) -> Option<Self> {
        let (matrix, gradient, inverses) = self.reduced(normal, lambda);
        let step = -matrix.cholesky()?.solve(&gradient);
        let mut pulls = normal.placement_gradients.clone();
        for (view, coupling) in self.views.iter().zip(&normal.coupling) {
            let of_view = SVector::<f64, SHARED>::from_fn(|i, _| step[self.column(view, i)]);
            pulls[view.placement] += coupling.transpose() * of_view;
        }
        let mut next = self.clone();
        for (c, camera) in next.cameras.iter_mut().enumerate() {
            let start = c * CAMERA;
            for i in 0..PARAMETERS {
                if camera.free[i] {
                    camera.lens.values[i] += step[start + i];
                }
            }
            if camera.pose_free {
                let pose = step.fixed_rows::<6>(start + PARAMETERS).into_owned();
                camera.camera_from_rig = moved(&camera.camera_from_rig, &pose);
            }
        }
        for (placement, (inverse, pull)) in
            next.placements.iter_mut().zip(inverses.iter().zip(&pulls))
        {
            if placement.free {
                placement.rig_from_board = moved(&placement.rig_from_board, &-(inverse * pull));
            }
        }
        if self.back_free {
            let pose = step
                .fixed_rows::<6>(self.cameras.len() * CAMERA)
                .into_owned();
            next.board_from_back = moved(&self.board_from_back, &pose);
        }
        let mut terms = self.sheet.terms();
        for (i, term) in terms.iter_mut().enumerate() {
            if self.sheet.free[i] {
                *term += step[self.shape_column() + i];
            }
        }
        next.sheet.set_terms(terms);
        let sound = step.iter().all(|v| v.is_finite()) && next.is_sane();
        sound.then_some(next)
    }

    fn is_sane(&self) -> bool {
        let focal = |c: &CameraState| c.lens.values[..2].iter().all(|f| (1.0..1e6).contains(f));
        self.cameras.iter().all(focal)
    }

    /// Adjusts until a step gains nothing that matters, at most `most` steps; returns the cost in px².
    pub(super) fn adjust(&mut self, loss: Loss, most: usize) -> f64 {
        let mut lambda = 1e-4;
        let mut normal = self.normal(loss);
        for _ in 0..most {
            let mut gained = None;
            while lambda < 1e12 {
                let next = self.stepped(&normal, lambda);
                let better = next
                    .map(|next| (next.cost(loss), next))
                    .filter(|(cost, _)| cost.is_finite() && *cost < normal.cost);
                if let Some((cost, next)) = better {
                    gained = Some((normal.cost - cost) / normal.cost.max(1e-300));
                    *self = next;
                    lambda = (lambda * 0.1).max(1e-12);
                    break;
                }
                lambda *= 8.0;
            }
            let Some(gained) = gained else { break };
            normal = self.normal(loss);
            if gained < 1e-9 {
                break;
            }
        }
        normal.cost
    }

    /// What one placement says of the shape's terms, the cameras being as they are: its part of the normal equations,
    /// with the placement eliminated. `None` where they cannot be solved.
    pub(super) fn speaks_of_shape(&self, placement: usize) -> Option<(Matrix3<f64>, Vector3<f64>)> {
        let mut alone = self.clone();
        for camera in &mut alone.cameras {
            camera.pose_free = false;
            camera.free.fill(false);
        }
        alone.back_free = false;
        alone.sheet.free.fill(true);
        alone.sheet.deviation.fill(f64::INFINITY);
        alone.views.retain(|v| v.placement == placement);
        alone.placements[placement].free = true;
        let (matrix, gradient, _) = alone.reduced(&alone.normal(Loss::SQUARED), 0.0);
        let first = alone.shape_column();
        let (block, pull) = (
            matrix.fixed_view::<TERMS, TERMS>(first, first).into_owned(),
            gradient.fixed_rows::<TERMS>(first).into_owned(),
        );
        block.iter().all(|v| v.is_finite()).then_some((block, pull))
    }

    /// Covariance, in px⁻² units of unit noise, of the columns of all cameras, the back and the shape: the inverse of
    /// the reduced normal equations. Fixed parameters have none. `None` where they cannot be inverted.
    pub(super) fn covariance(&self, loss: Loss) -> Option<DMatrix<f64>> {
        let normal = self.normal(loss);
        let (mut matrix, _, _) = self.reduced(&normal, 0.0);
        // Scaled to a unit diagonal first: focal lengths and distortion differ by many powers of ten.
        let scale = DVector::from_fn(matrix.nrows(), |i, _| {
            matrix[(i, i)].max(1e-300).sqrt().recip()
        });
        for i in 0..matrix.nrows() {
            for j in 0..matrix.ncols() {
                matrix[(i, j)] *= scale[i] * scale[j];
            }
        }
        let mut inverse = matrix.cholesky()?.inverse();
        for i in 0..inverse.nrows() {
            for j in 0..inverse.ncols() {
                let free = self.is_free(i) && self.is_free(j);
                inverse[(i, j)] *= if free { scale[i] * scale[j] } else { 0.0 };
            }
        }
        Some(inverse)
    }
}

/// Sums over a view's corners of the products of derivatives: of its fitted columns, its placement's, and the residual,
/// one behind the other, on and above the diagonal.
struct NormalSums {
    columns: Vec<usize>,
    products: [[f64; ALL]; ALL],
}

/// Columns of a view with its placement's and the residual.
const ALL: usize = SHARED + 7;

impl NormalSums {
    fn new(columns: Vec<usize>) -> Self {
        Self {
            columns,
            products: [[0.0; ALL]; ALL],
        }
    }

    #[inline]
    fn add(
        &mut self,
        by_shared: &SMatrix<f64, 2, SHARED>,
        by_placement: &SMatrix<f64, 2, 6>,
        residual: Vector2<f64>,
        weight: f64,
    ) {
        let fitted = self.columns.len();
        let count = fitted + 7;
        let mut rows = [[0.0; ALL]; 2];
        for (axis, row) in rows.iter_mut().enumerate() {
            for (place, &column) in row.iter_mut().zip(&self.columns) {
                *place = by_shared[(axis, column)];
            }
            for k in 0..6 {
                row[fitted + k] = by_placement[(axis, k)];
            }
            row[fitted + 6] = residual[axis];
        }
        let [x, y] = rows;
        for (i, sums) in self.products[..count].iter_mut().enumerate() {
            let (a, b) = (weight * x[i], weight * y[i]);
            for ((sum, x), y) in sums[i..count].iter_mut().zip(&x[i..]).zip(&y[i..]) {
                *sum += a * x + b * y;
            }
        }
    }

    /// Puts the sums to where the normal equations have them.
    fn spread(&self, share: &mut Share) {
        let fitted = self.columns.len();
        for (i, &row) in self.columns.iter().enumerate() {
            for (k, &column) in self.columns.iter().enumerate().skip(i) {
                share.aa[(row, column)] = self.products[i][k];
                share.aa[(column, row)] = self.products[i][k];
            }
            for k in 0..6 {
                share.ap[(row, k)] = self.products[i][fitted + k];
            }
            share.a[row] = self.products[i][fitted + 6];
        }
        for i in 0..6 {
            for k in i..6 {
                share.pp[(i, k)] = self.products[fitted + i][fitted + k];
                share.pp[(k, i)] = share.pp[(i, k)];
            }
            share.p[i] = self.products[fitted + i][fitted + 6];
        }
    }
}

/// Writes the derivative by a pose, whose rotation turns `rotated` and whose translation shifts it.
#[inline]
fn set_pose<const N: usize>(
    to: &mut SMatrix<f64, 2, N>,
    column: usize,
    by_point: &Matrix2x3<f64>,
    rotated: Vector3<f64>,
) {
    let by_rotation: Matrix2x3<f64> = by_point * -cross(rotated);
    to.fixed_view_mut::<2, 3>(0, column).copy_from(&by_rotation);
    to.fixed_view_mut::<2, 3>(0, column + 3).copy_from(by_point);
}

fn cross(v: Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

/// A pose turned and shifted by a step: rotation vector, then translation.
pub(super) fn moved(pose: &Isometry3<f64>, step: &Vector6<f64>) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
    let shift = Vector3::new(step[3], step[4], step[5]);
    let mut rotation = turn * pose.rotation;
    rotation.renormalize_fast();
    Isometry3::from_parts(
        Translation3::from(pose.translation.vector + shift),
        rotation,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{Board, BoardShape};
    use proptest::prelude::*;

    fn pose(v: [f64; 6]) -> Isometry3<f64> {
        let step = Vector6::from(v);
        moved(&Isometry3::translation(0.0, 0.0, 1.0), &(step * 0.2))
    }

    /// Two cameras and a placement of a board of so many columns; one sees its front, the other its back.
    fn bundle(poses: [[f64; 6]; 4], noise: f64, columns: usize) -> Bundle {
        let lens = Lens {
            values: [
                700.0, 705.0, 320.0, 240.0, -0.1, 0.05, 1e-3, -1e-3, 0.01, 0.0, 0.0, 0.0,
            ],
            size: [640, 480],
        };
        let camera = |v| CameraState {
            lens,
            free: [true; PARAMETERS],
            camera_from_rig: pose(v),
            pose_free: true,
            prior: [None; PARAMETERS],
        };
        let placement = PlacementState {
            rig_from_board: pose(poses[2]),
            free: true,
        };
        let point = |i: usize| {
            let p = Point3::new((i % 3) as f64 * 0.05, (i / 3) as f64 * 0.05, 0.0);
            (
                p,
                Point2::new(300.0 + noise * i as f64, 200.0 - noise * i as f64),
            )
        };
        let view = |camera, back| Observation {
            camera,
            placement: 0,
            back,
            weight: 0.5 + 1.5 * f64::from(u8::from(back)),
            points: (0..6).map(point).collect(),
        };
        let board = Board::checkerboard(columns, 4, 0.05).unwrap();
        let shape = BoardShape::of_terms([poses[3][0], poses[3][1], poses[3][2]].map(|v| v * 0.01));
        let mut sheet = Sheet::of(&board, shape);
        sheet.free = [true; TERMS];
        sheet.deviation = [0.01; TERMS];
        Bundle {
            cameras: vec![camera(poses[0]), camera(poses[1])],
            placements: vec![placement],
            board_from_back: moved(&Isometry3::identity(), &(Vector6::from(poses[3]) * 0.1)),
            back_free: true,
            sheet,
            views: vec![view(0, false), view(1, true)],
        }
    }

    /// The bundle with one shared column, or one of the placement's behind them, moved.
    fn perturbed(bundle: &Bundle, column: usize, by: f64) -> Bundle {
        let mut bundle = bundle.clone();
        let step = |local: usize| {
            let mut step = Vector6::zeros();
            step[local] = by;
            step
        };
        let (camera, local) = (column / CAMERA, column % CAMERA);
        match (camera, local) {
            (0 | 1, l) if l < PARAMETERS => bundle.cameras[camera].lens.values[l] += by,
            (0 | 1, l) => {
                let pose = &mut bundle.cameras[camera].camera_from_rig;
                *pose = moved(pose, &step(l - PARAMETERS));
            }
            (_, l) if l < 6 => bundle.board_from_back = moved(&bundle.board_from_back, &step(l)),
            (_, l) if l < 6 + TERMS => {
                let mut terms = bundle.sheet.terms();
                terms[l - 6] += by;
                bundle.sheet.set_terms(terms);
            }
            (_, l) => {
                let pose = &mut bundle.placements[0].rig_from_board;
                *pose = moved(pose, &step(l - 6 - TERMS));
            }
        }
        bundle
    }

    proptest! {
        #[test]
        fn gradients_are_those_of_finite_differences(
            poses in proptest::array::uniform4(proptest::array::uniform6(-0.5..0.5f64)), noise in 0.0..10.0f64,
            columns in 4..6_usize,
        ) {
            let bundle = bundle(poses, noise, columns);
            let normal = bundle.normal(Loss::SQUARED);
            prop_assert!((normal.cost - bundle.cost(Loss::SQUARED)).abs() < 1e-6 * normal.cost);
            for column in 0..2 * CAMERA + 12 + TERMS {
                let shared = 2 * CAMERA + 6 + TERMS;
                let analytic = match column.checked_sub(shared) {
                    None => normal.gradient[column],
                    Some(local) => normal.placement_gradients[0][local],
                };
                let lens = column < 2 * CAMERA && column % CAMERA < 4;
                let step = if lens { 1e-3 } else { 1e-6 };
                let cost = |by| perturbed(&bundle, column, by).cost(Loss::SQUARED);
                let numeric = (cost(step) - cost(-step)) / (4.0 * step);
                let error = (analytic - numeric).abs();
                prop_assert!(error < 1e-4 * (analytic.abs() + 1.0 + 1e-4 * normal.cost), "{column}: {analytic} {numeric}");
            }
        }
    }
}

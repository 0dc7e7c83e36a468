//! Computes how far the cameras' lines of sight may be off where objects stand, from the uncertainties of lenses and
//! poses together. Motions of the whole rig are left out, because they do not affect what is measured in it.

use super::adjust::{CAMERA, CameraState};
use super::lens::PARAMETERS;
use nalgebra::{
    DMatrix, Matrix2x3, Matrix2x6, Matrix6, Matrix6xX, MatrixXx6, Point2, Point3, SMatrix, SVector,
    Vector2, Vector3,
};

/// Points along each side of the box for which it is computed.
const ALONG: usize = 5;

/// Standard deviations with which a camera sees points of the volume, both coordinates together.
#[derive(serde::Serialize, Clone, Debug, Default, PartialEq)]
pub struct Projection {
    /// Root mean square over the points of the volume that it sees, in pixels.
    pub rms_px: f64,
    /// The same in metres at the object, across the line of sight.
    pub at_object: f64,
    /// The largest one, in metres at the object.
    pub largest_at_object: f64,
    /// Over its picture, in pixels, at the distance of the volume's middle: 8 columns, 6 rows, one after the other.
    pub map_px: Vec<Option<f64>>,
}

impl Projection {
    /// Columns and rows of its map.
    pub const MAP: [usize; 2] = [8, 6];
}

/// Derivatives of where a camera sees a point, in metres at the point across the line of sight.
struct ProjectionDerivatives {
    camera: usize,
    /// By its lens and pose.
    by_camera: SMatrix<f64, 2, CAMERA>,
    /// By a motion of the whole rig against the point: rotation, then translation.
    by_motion: Matrix2x6<f64>,
    metres_a_pixel: f64,
}

impl ProjectionDerivatives {
    /// `None` for a point that the camera does not see.
    fn of(camera: usize, state: &CameraState, p: Point3<f64>) -> Option<Self> {
        let turned = state.camera_from_rig.rotation * p.coords;
        let in_camera = turned + state.camera_from_rig.translation.vector;
        let (pixel, by_lens, by_point) = state.lens.derive(in_camera)?;
        let inside = |a: usize| (-0.5..state.lens.size[a] as f64 - 0.5).contains(&pixel[a]);
        if !(inside(0) && inside(1)) {
            return None;
        }
        let metres_a_pixel = in_camera.z / state.lens.focal_px();
        let mut by_camera = SMatrix::<f64, 2, CAMERA>::zeros();
        by_camera
            .fixed_view_mut::<2, PARAMETERS>(0, 0)
            .copy_from(&by_lens);
        by_camera
            .fixed_view_mut::<2, 6>(0, PARAMETERS)
            .copy_from(&by_moving(&by_point, turned));
        let rotation = state.camera_from_rig.rotation.to_rotation_matrix();
        let by_rig = by_point * rotation.matrix();
        Some(Self {
            camera,
            by_camera: by_camera * metres_a_pixel,
            by_motion: by_moving(&by_rig, p.coords) * metres_a_pixel,
            metres_a_pixel,
        })
    }
}

/// Derivative by a rotation of `rotated` about the origin, and by a translation.
fn by_moving(by_point: &Matrix2x3<f64>, rotated: Vector3<f64>) -> Matrix2x6<f64> {
    let mut by = Matrix2x6::zeros();
    let by_rotation: Matrix2x3<f64> = by_point * -rotated.cross_matrix();
    by.fixed_view_mut::<2, 3>(0, 0).copy_from(&by_rotation);
    by.fixed_view_mut::<2, 3>(0, 3).copy_from(by_point);
    by
}

/// The rigid motion of the whole rig that absorbs most of the cameras' errors (a gauge freedom).
struct Motion {
    /// Covariance of the cameras' columns with it: six columns.
    with_cameras: MatrixXx6<f64>,
    own: Matrix6<f64>,
}

impl Motion {
    fn of(
        sights: &[ProjectionDerivatives],
        covariance: &DMatrix<f64>,
        columns: usize,
    ) -> Option<Self> {
        let normal: Matrix6<f64> = sights
            .iter()
            .map(|s| s.by_motion.transpose() * s.by_motion)
            .sum();
        let inverse = normal.cholesky()?.inverse();
        let mut by_cameras = Matrix6xX::zeros(columns);
        for sight in sights {
            let mut own = by_cameras.columns_mut(sight.camera * CAMERA, CAMERA);
            own += sight.by_motion.transpose() * sight.by_camera;
        }
        let by_cameras = inverse * by_cameras;
        let with_cameras = covariance.view((0, 0), (columns, columns)) * by_cameras.transpose();
        Some(Self {
            own: &by_cameras * &with_cameras,
            with_cameras,
        })
    }

    /// Variance of the point across the line of sight, summed over both coordinates, in m², after this motion is
    /// removed.
    fn left(&self, sight: &ProjectionDerivatives, covariance: &DMatrix<f64>) -> f64 {
        let start = sight.camera * CAMERA;
        let own = covariance.fixed_view::<CAMERA, CAMERA>(start, start);
        let shared = self.with_cameras.fixed_view::<CAMERA, 6>(start, 0);
        let row = |i: usize| {
            let by_camera: SVector<f64, CAMERA> = sight.by_camera.row(i).transpose();
            let by_motion: SVector<f64, 6> = sight.by_motion.row(i).transpose();
            by_camera.dot(&(own * by_camera)) - 2.0 * by_camera.dot(&(shared * by_motion))
                + by_motion.dot(&(self.own * by_motion))
        };
        (row(0) + row(1)).max(0.0)
    }
}

/// What each camera's uncertainty amounts to in a box from `low` to `high`; `None` for one that sees nothing of it.
/// `covariance` has the cameras' columns first.
pub(super) fn projections(
    cameras: &[CameraState],
    covariance: &DMatrix<f64>,
    [low, high]: [Point3<f64>; 2],
) -> Vec<Option<Projection>> {
    let columns = cameras.len() * CAMERA;
    let at = |k: usize, a: usize| low[a] + (high[a] - low[a]) * (k as f64 + 0.5) / ALONG as f64;
    let places = (0..ALONG.pow(3)).map(|k| {
        Point3::new(
            at(k % ALONG, 0),
            at(k / ALONG % ALONG, 1),
            at(k / ALONG.pow(2), 2),
        )
    });
    let places: Vec<Point3<f64>> = places.collect();
    let sights: Vec<ProjectionDerivatives> = cameras
        .iter()
        .enumerate()
        .flat_map(|(camera, state)| {
            places
                .iter()
                .filter_map(move |&p| ProjectionDerivatives::of(camera, state, p))
        })
        .collect();
    let Some(motion) = Motion::of(&sights, covariance, columns) else {
        return vec![None; cameras.len()];
    };
    let middle = nalgebra::center(&low, &high);
    let of = |(camera, state): (usize, &CameraState)| {
        let own = sights.iter().filter(|s| s.camera == camera);
        let variances: Vec<[f64; 2]> = own
            .map(|s| (motion.left(s, covariance), s.metres_a_pixel))
            .map(|(variance, scale)| [variance, variance / (scale * scale)])
            .collect();
        let count = variances.len() as f64;
        let rms = |k: usize| (variances.iter().map(|v| v[k]).sum::<f64>() / count).sqrt();
        let largest = variances.iter().map(|v| v[0]).fold(0.0, f64::max);
        (!variances.is_empty()).then(|| Projection {
            rms_px: rms(1),
            at_object: rms(0),
            largest_at_object: largest.sqrt(),
            map_px: map(camera, state, middle, |s| motion.left(s, covariance)),
        })
    };
    cameras.iter().enumerate().map(of).collect()
}

/// Deviations in pixels over a camera's picture, of points as far as `middle` is.
fn map(
    camera: usize,
    state: &CameraState,
    middle: Point3<f64>,
    variance: impl Fn(&ProjectionDerivatives) -> f64,
) -> Vec<Option<f64>> {
    let away = (state.camera_from_rig * middle).z.max(1e-3);
    let [columns, rows] = Projection::MAP;
    let pixels = (0..columns * rows).map(|k| {
        let part = [
            (k % columns) as f64 / columns as f64,
            (k / columns) as f64 / rows as f64,
        ];
        let half = [0.5 / columns as f64, 0.5 / rows as f64];
        let at = |a: usize| (part[a] + half[a]) * state.lens.size[a] as f64 - 0.5;
        Point2::new(at(0), at(1))
    });
    let rig_from_camera = state.camera_from_rig.inverse();
    let directions = state.lens.unproject(pixels).into_iter();
    let deviation = |direction: Vector2<f64>| {
        let p = rig_from_camera * Point3::new(direction.x * away, direction.y * away, away);
        let sight = ProjectionDerivatives::of(camera, state, p)?;
        Some(variance(&sight).sqrt() / sight.metres_a_pixel)
    };
    directions.map(deviation).collect()
}

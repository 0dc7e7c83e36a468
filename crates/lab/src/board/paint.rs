//! Paints a board into a camera's picture. Every pixel gets the exact share of its square that is black, so that
//! edges and corners are right to a thousandth of a pixel; the lens' blur is applied after that.

use super::super::render::{Light3, Rendered};
use super::plate::{Plate, corners, outline};
use nalgebra::{Isometry3, Point2, Point3, Vector3};
use scand_core::calibration::{Board, Camera, Face, Intrinsics, Rectangle, Surface};
use scand_core::image::Grid;

/// Linear light that paper and ink throw back, and the plate's unprinted back.
const PAPER: f32 = 0.78;
const INK: f32 = 0.035;
const PLAIN: f32 = 0.35;
/// Where the light comes from, and the part of it that comes from everywhere.
const LAMP: [f64; 3] = [0.45, -0.35, 1.0];
const AMBIENT: f32 = 0.6;
/// Pixels around the board that blur may reach.
const REACH: f64 = 16.0;

/// Normalised directions of a lens' pixel corners. They are exact at every few pixels and linear in between, which is
/// good to 2e-4 pixels for lenses as they are: a hundred times faster than inverting the lens for every pixel.
pub(super) struct Directions {
    step: usize,
    nodes: Grid<[f64; 2]>,
}

impl Directions {
    pub(super) fn new(lens: &Intrinsics) -> Self {
        let step = (lens.width / 320).clamp(2, 8);
        let nodes = Grid::from_fn(lens.width / step + 2, lens.height / step + 2, |i, j| {
            let at = |k: usize| (k * step) as f64 - 0.5;
            let direction = lens.unproject(Point2::new(at(i), at(j)));
            direction.map_or([f64::NAN; 2], |n| [n.x, n.y])
        });
        Self { step, nodes }
    }

    /// Directions of the corners above row `y`, from the left one of column `x0` on.
    fn fill(&self, y: usize, x0: usize, row: &mut [[f64; 2]]) {
        let step = self.step as f64;
        let (j, v) = (y / self.step, (y % self.step) as f64 / step);
        let (above, below) = (self.nodes.row(j), self.nodes.row(j + 1));
        let at = |i: usize, a: usize| above[i][a] + (below[i][a] - above[i][a]) * v;
        for (k, direction) in row.iter_mut().enumerate() {
            let (i, u) = ((x0 + k) / self.step, ((x0 + k) % self.step) as f64 / step);
            *direction = [0, 1].map(|a| at(i, a) + (at(i + 1, a) - at(i, a)) * u);
        }
    }
}

/// Light on a camera's sensor from the rig with a board in it, through a lens of a point spread of `blur_px`.
pub(super) fn rendered(
    camera: &Camera,
    directions: &Directions,
    plate: &Plate,
    rig_from_board: &Isometry3<f64>,
    blur_px: f64,
) -> Rendered {
    let background = Rendered::background(camera);
    let eye = rig_from_board.inverse() * camera.center();
    let (face, front_from_face, is_printed) = plate.seen_from(eye);
    let rig_from_face = rig_from_board * front_from_face;
    let eye = rig_from_face.inverse() * camera.center();
    let surface = plate.surface(face);
    let Some(window) = window(camera, &plate.board, &surface, &rig_from_face) else {
        return background;
    };
    let painter = Painter {
        face_from_camera: rig_from_face.inverse() * camera.rig_from_camera,
        surface,
        plate: outline(&plate.board),
        pattern: is_printed.then(|| Pattern::new(&plate.board, face)),
        light: light(&rig_from_face, eye.z),
    };
    background.with_window(window.0, window.1, blur_px, |origin, grid| {
        painter.paint(directions, origin, grid);
    })
}

/// Light on paper that lies as the face does.
fn light(rig_from_face: &Isometry3<f64>, eye_z: f64) -> f32 {
    let outward = rig_from_face.rotation * Vector3::z() * eye_z.signum();
    let cosine = outward.dot(&Vector3::from(LAMP).normalize()).max(0.0);
    AMBIENT + (1.0 - AMBIENT) * cosine as f32
}

/// First column and row, width and height of the part of the picture that the plate may touch.
fn window(
    camera: &Camera,
    board: &Board,
    surface: &Surface,
    rig_from_face: &Isometry3<f64>,
) -> Option<([usize; 2], [usize; 2])> {
    const SAMPLES: usize = 16;
    let rim = corners(board);
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for side in 0..4 {
        let (from, to) = (rim[side], rim[(side + 1) % 4]);
        for k in 0..SAMPLES {
            let t = k as f64 / SAMPLES as f64;
            let [x, y] = [0, 1].map(|a| from[a] + (to[a] - from[a]) * t);
            let (pixel, _) = camera.project(rig_from_face * surface.point([x, y]))?;
            low = [0, 1].map(|a| low[a].min(pixel[a]));
            high = [0, 1].map(|a| high[a].max(pixel[a]));
        }
    }
    let size = [camera.intrinsics.width, camera.intrinsics.height];
    let from = [0, 1].map(|a| (low[a] - REACH).clamp(0.0, size[a] as f64) as usize);
    let to = [0, 1].map(|a| (high[a] + REACH).clamp(0.0, size[a] as f64) as usize);
    let fits = from[0] < to[0] && from[1] < to[1];
    fits.then(|| (from, [to[0] - from[0], to[1] - from[1]]))
}

struct Painter {
    face_from_camera: Isometry3<f64>,
    surface: Surface,
    plate: Rectangle,
    pattern: Option<Pattern>,
    light: f32,
}

impl Painter {
    /// Paints over the part of the picture that begins at `origin`.
    fn paint(&self, directions: &Directions, origin: [usize; 2], picture: &mut Grid<Light3>) {
        let corners = picture.width() + 1;
        let mut row = vec![[0.0; 2]; corners];
        let (mut above, mut below) = (vec![[0.0; 2]; corners], vec![[0.0; 2]; corners]);
        for y in 0..=picture.height() {
            std::mem::swap(&mut above, &mut below);
            directions.fill(origin[1] + y, origin[0], &mut row);
            for (place, &direction) in below.iter_mut().zip(&row) {
                *place = self.on_face(direction);
            }
            if y == 0 {
                continue;
            }
            for (x, pixel) in picture.row_mut(y - 1).iter_mut().enumerate() {
                let quad = [above[x], above[x + 1], below[x + 1], below[x]];
                self.paint_pixel(&quad, pixel);
            }
        }
    }

    /// Where a direction of the camera meets the face, as a place of the board as it is described; NaN where it does
    /// not.
    #[inline]
    fn on_face(&self, direction: [f64; 2]) -> [f64; 2] {
        let ray = self.face_from_camera.rotation * Vector3::new(direction[0], direction[1], 1.0);
        let eye = Point3::from(self.face_from_camera.translation.vector);
        self.surface.intersect(eye, ray).unwrap_or([f64::NAN; 2])
    }

    #[inline]
    fn paint_pixel(&self, quad: &Quad, pixel: &mut Light3) {
        let bounds = bounds(quad);
        let on_plate = part_within(quad, &bounds, &self.plate);
        if on_plate <= 0.0 {
            return;
        }
        let reflected = match &self.pattern {
            None => PLAIN * on_plate,
            Some(pattern) => PAPER * on_plate - (PAPER - INK) * pattern.black_part(quad, &bounds),
        };
        let light = reflected * self.light;
        // Paper throws the light's own colour back, the cloth shines through where the plate ends.
        *pixel = pixel.map(|cloth| cloth * (1.0 - on_plate) + light);
    }
}

/// A face's black rectangles, by the square that they lie in.
struct Pattern {
    square: f64,
    columns: usize,
    rows: usize,
    squares: Vec<Vec<Rectangle>>,
}

impl Pattern {
    fn new(board: &Board, face: Face) -> Self {
        Self {
            square: board.square,
            columns: board.columns + 1,
            rows: board.rows + 1,
            squares: board.black_by_square(face),
        }
    }

    /// The part of a quad that is black.
    #[inline]
    fn black_part(&self, quad: &Quad, bounds: &Rectangle) -> f32 {
        let cell = |v: f64, count: usize| {
            let k = (v / self.square + 1.0).floor();
            k.clamp(-1.0, count as f64) as isize
        };
        let columns = cell(bounds.min[0], self.columns)..=cell(bounds.max[0], self.columns);
        let rows = cell(bounds.min[1], self.rows)..=cell(bounds.max[1], self.rows);
        let mut part = 0.0;
        for j in rows {
            for i in columns.clone() {
                let inside =
                    (0..self.columns as isize).contains(&i) && (0..self.rows as isize).contains(&j);
                if inside {
                    let square = &self.squares[j as usize * self.columns + i as usize];
                    part += square
                        .iter()
                        .map(|black| part_within(quad, bounds, black))
                        .sum::<f32>();
                }
            }
        }
        part.min(1.0)
    }
}

/// A pixel's corners in the plane of a face.
type Quad = [[f64; 2]; 4];

fn bounds(quad: &Quad) -> Rectangle {
    let all = |pick: fn(f64, f64) -> f64| {
        [0, 1].map(|a| pick(pick(quad[0][a], quad[1][a]), pick(quad[2][a], quad[3][a])))
    };
    Rectangle {
        min: all(f64::min),
        max: all(f64::max),
    }
}

/// The part of a quad's area that lies within a rectangle.
#[inline]
fn part_within(quad: &Quad, bounds: &Rectangle, rectangle: &Rectangle) -> f32 {
    let Rectangle { min, max } = rectangle;
    let touches = |a: usize| bounds.min[a] < max[a] && bounds.max[a] > min[a];
    if !(touches(0) && touches(1)) {
        return 0.0;
    }
    let within = |a: usize| bounds.min[a] >= min[a] && bounds.max[a] <= max[a];
    if within(0) && within(1) {
        return 1.0;
    }
    let whole = area(quad);
    if whole == 0.0 || whole.is_nan() {
        return 0.0;
    }
    let mut polygon = Polygon::of(quad);
    polygon.keep(0, min[0], 1.0);
    polygon.keep(0, max[0], -1.0);
    polygon.keep(1, min[1], 1.0);
    polygon.keep(1, max[1], -1.0);
    (area(polygon.corners()) / whole) as f32
}

/// Twice the signed area of a polygon.
fn area(corners: &[[f64; 2]]) -> f64 {
    let Some(&origin) = corners.first() else {
        return 0.0;
    };
    // From the first corner, so that small areas far from the origin lose no digits.
    let from = |p: [f64; 2]| [p[0] - origin[0], p[1] - origin[1]];
    let edges = corners.windows(2).map(|edge| {
        let (a, b) = (from(edge[0]), from(edge[1]));
        a[0] * b[1] - a[1] * b[0]
    });
    edges.sum()
}

/// A convex polygon of at most 8 corners: four, and one more for each line that cuts it.
struct Polygon {
    places: [[f64; 2]; 8],
    count: usize,
}

impl Polygon {
    fn of(quad: &Quad) -> Self {
        let mut places = [[0.0; 2]; 8];
        places[..4].copy_from_slice(quad);
        Self { places, count: 4 }
    }

    fn corners(&self) -> &[[f64; 2]] {
        &self.places[..self.count]
    }

    /// Keeps what lies at or beyond `bound` along an axis, on the side that `sign` says (Sutherland and Hodgman 1974).
    fn keep(&mut self, axis: usize, bound: f64, sign: f64) {
        let (mut kept, mut count) = ([[0.0; 2]; 8], 0);
        let beyond = |p: [f64; 2]| (p[axis] - bound) * sign;
        for k in 0..self.count {
            let (p, q) = (self.places[k], self.places[(k + 1) % self.count]);
            let (from, to) = (beyond(p), beyond(q));
            if from >= 0.0 && count < 8 {
                kept[count] = p;
                count += 1;
            }
            if (from < 0.0) != (to < 0.0) && count < 8 {
                let t = from / (from - to);
                kept[count] = [0, 1].map(|a| p[a] + (q[a] - p[a]) * t);
                count += 1;
            }
        }
        (self.places, self.count) = (kept, count);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn parts_of_a_quad_add_up(
            cx in -1.0..1.0_f64, cy in -1.0..1.0_f64, angle in 0.0..6.3_f64,
            shear in -0.5..0.5_f64, cut in -1.0..1.0_f64,
        ) {
            let (sin, cos) = angle.sin_cos();
            let quad = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]].map(|[x, y]| {
                let x = x + shear * y;
                [cx + cos * x - sin * y, cy + sin * x + cos * y]
            });
            let all = bounds(&quad);
            let rectangle = |from: f64, to: f64| Rectangle { min: [from, -9.0], max: [to, 9.0] };
            let left = part_within(&quad, &all, &rectangle(-9.0, cut));
            let right = part_within(&quad, &all, &rectangle(cut, 9.0));
            prop_assert!((left + right - 1.0).abs() < 1e-6, "{left} + {right}");
            prop_assert!((0.0..=1.000_001).contains(&left));
            // A quad is cut through its middle into halves.
            let half = part_within(&quad, &all, &rectangle(-9.0, cx));
            prop_assert!((half - 0.5).abs() < 1e-6, "{half}");
        }
    }

    #[test]
    fn a_quad_at_a_corner_of_squares_is_black_by_half() {
        let board = Board::checkerboard(3, 3, 1.0).unwrap();
        let pattern = Pattern::new(&board, Face::Front);
        let quad = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]];
        assert!((pattern.black_part(&quad, &bounds(&quad)) - 0.5).abs() < 1e-6);
        let inside = quad.map(|[x, y]| [x - 0.5, y - 0.5]);
        assert_eq!(pattern.black_part(&inside, &bounds(&inside)), 1.0);
        let outside = quad.map(|[x, y]| [x - 5.0, y - 0.5]);
        assert_eq!(pattern.black_part(&outside, &bounds(&outside)), 0.0);
    }
}

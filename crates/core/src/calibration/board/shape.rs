//! How a printed board differs from its description: its sheet is bent, and its squares are longer along the rows than
//! down the columns, or shorter. Computes where a corner then lies, and where a line of sight meets the sheet.

use super::{Board, Face};
use nalgebra::{Matrix3, Point3, Vector3};

/// The shape of a board's sheet: two terms of bend, as mrcal has them, and one of unequal squares.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BoardShape {
    /// Metres by which the middle of each edge lies farther from the front's viewer than the middle of the board, for a
    /// parabola along the rows and one down the columns. The edges are those of the squares.
    pub bend: [f64; 2],
    /// Share by which squares are longer along the rows, and shorter down the columns; their mean is the stated length.
    pub stretch: f64,
}

impl BoardShape {
    /// Number of terms.
    pub const TERMS: usize = 3;

    /// Bends and stretch, in this order.
    pub fn terms(&self) -> [f64; Self::TERMS] {
        [self.bend[0], self.bend[1], self.stretch]
    }

    /// The shape of these terms.
    pub fn of_terms([along_rows, down_columns, stretch]: [f64; Self::TERMS]) -> Self {
        Self {
            bend: [along_rows, down_columns],
            stretch,
        }
    }

    /// Metres between the nearest and the farthest part of the sheet.
    pub fn depth(&self) -> f64 {
        self.bend[0].abs() + self.bend[1].abs()
    }
}

/// One face of a board of some shape, in the frame of the face.
///
/// The plane of the frame is the one in the middle of the corners, so that a bend does not move the board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    shape: BoardShape,
    /// 1 on the front; on the back, where z runs the other way, -1.
    sign: f64,
    middle: [f64; 2],
    /// Half of what the squares cover.
    half: [f64; 2],
    /// Mean of the corners' squared distances from the middle, in halves.
    mean: [f64; 2],
}

impl Surface {
    /// The face of a board.
    pub fn new(board: &Board, face: Face, shape: BoardShape) -> Self {
        let counts = [board.columns, board.rows];
        let half = counts.map(|n| 0.5 * (n + 1) as f64 * board.square);
        let middle = counts.map(|n| 0.5 * (n - 1) as f64 * board.square);
        let mean = [0, 1].map(|a| {
            let places = (0..counts[a]).map(|k| (k as f64 * board.square - middle[a]) / half[a]);
            places.map(|at| at * at).sum::<f64>() / counts[a] as f64
        });
        Self {
            shape,
            sign: match face {
                Face::Front => 1.0,
                Face::Back => -1.0,
            },
            middle,
            half,
            mean,
        }
    }

    /// The same face of another shape.
    pub fn with(&self, shape: BoardShape) -> Self {
        Self { shape, ..*self }
    }

    /// The other face of the same sheet.
    pub fn other_side(&self) -> Self {
        Self {
            sign: -self.sign,
            ..*self
        }
    }

    /// Its shape.
    pub fn shape(&self) -> BoardShape {
        self.shape
    }

    /// The true position of a point of the stated board, which is given in metres in the face's plane.
    #[inline]
    pub fn point(&self, p: [f64; 2]) -> Point3<f64> {
        let [x, y] = self.off_middle(p);
        let [along_rows, down_columns] = self.squared(p);
        let stretch = self.shape.stretch;
        let [bend_x, bend_y] = self.shape.bend;
        let height = bend_x * along_rows + bend_y * down_columns;
        Point3::new(p[0] + stretch * x, p[1] - stretch * y, self.sign * height)
    }

    /// Derivatives of [`Self::point`] by the shape's terms, a column each.
    #[inline]
    pub fn by_terms(&self, p: [f64; 2]) -> Matrix3<f64> {
        let [x, y] = self.off_middle(p);
        let [along_rows, down_columns] = self.squared(p).map(|v| self.sign * v);
        Matrix3::new(0.0, 0.0, x, 0.0, 0.0, -y, along_rows, down_columns, 0.0)
    }

    /// The point of the board's description that a line of sight meets: `eye` and `ray` in the face's frame.
    /// `None` for a line that does not meet the sheet in front of the eye.
    #[inline]
    pub fn intersect(&self, eye: Point3<f64>, ray: Vector3<f64>) -> Option<[f64; 2]> {
        let mut t = -eye.z / ray.z;
        if self.shape == BoardShape::default() {
            return (t > 0.0).then(|| [eye.x + t * ray.x, eye.y + t * ray.y]);
        }
        let [bend_x, bend_y] = self.shape.bend.map(|b| self.sign * b);
        let mut nominal = [0.0; 2];
        // A sheet is nearly flat: five steps of Newton's method are exact even for rays that graze it.
        for _ in 0..5 {
            nominal = self.nominal([eye.x + t * ray.x, eye.y + t * ray.y]);
            let [u, v] = self.squared(nominal);
            let [x, y] = self.off_middle(nominal);
            let off = eye.z + t * ray.z - bend_x * u - bend_y * v;
            let slope = [
                2.0 * bend_x * x / self.half[0].powi(2),
                2.0 * bend_y * y / self.half[1].powi(2),
            ];
            t -= off / (ray.z - slope[0] * ray.x - slope[1] * ray.y);
        }
        (t > 0.0).then_some(nominal)
    }

    /// The stated position of a point on the stretched sheet.
    fn nominal(&self, p: [f64; 2]) -> [f64; 2] {
        let stretch = [1.0 + self.shape.stretch, 1.0 - self.shape.stretch];
        [0, 1].map(|a| self.middle[a] + (p[a] - self.middle[a]) / stretch[a])
    }

    #[inline]
    fn off_middle(&self, p: [f64; 2]) -> [f64; 2] {
        [p[0] - self.middle[0], p[1] - self.middle[1]]
    }

    /// Squared distances from the middle in halves, less those of the corners' mean.
    #[inline]
    fn squared(&self, p: [f64; 2]) -> [f64; 2] {
        let from = self.off_middle(p);
        [0, 1].map(|a| (from[a] / self.half[a]).powi(2) - self.mean[a])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn board() -> Board {
        Board::checkerboard(9, 6, 0.025).unwrap()
    }

    #[test]
    fn a_bend_is_what_its_edges_lie_off_and_moves_no_board() {
        let shape = BoardShape::of_terms([5e-4, 0.0, 1e-3]);
        let surface = Surface::new(&board(), Face::Front, shape);
        // The squares reach from -25 to 225 mm along the rows.
        let [edge, middle] = [-0.025, 0.1].map(|x| surface.point([x, 0.0625]));
        assert!((edge.z - middle.z - 5e-4).abs() < 1e-12);
        assert!((edge.x - (-0.025 - 1.25e-4)).abs() < 1e-12);
        let corners = board().corner_positions();
        let heights = corners.iter().map(|p| surface.point([p.x, p.y]).z);
        assert!(heights.sum::<f64>().abs() < 1e-12);
        let back = surface.other_side().point([-0.025, 0.0625]);
        assert_eq!((back.z, back.x), (-edge.z, edge.x));
        assert_eq!(BoardShape::of_terms([3e-4, -4e-4, 0.0]).depth(), 7e-4);
    }

    proptest! {
        #[test]
        fn a_line_of_sight_meets_what_it_is_drawn_to(
            x in -0.03..0.23_f64, y in -0.03..0.16_f64, ex in -0.5..0.7_f64, ey in -0.5..0.6_f64, ez in 0.3..1.5_f64,
            bend_x in -0.003..0.003_f64, bend_y in -0.003..0.003_f64, stretch in -0.01..0.01_f64, back: bool,
        ) {
            let face = if back { Face::Back } else { Face::Front };
            let surface = Surface::new(&board(), face, BoardShape::of_terms([bend_x, bend_y, stretch]));
            let (eye, on_sheet) = (Point3::new(ex, ey, -ez), surface.point([x, y]));
            let met = surface.intersect(eye, 0.3 * (on_sheet - eye)).unwrap();
            prop_assert!((met[0] - x).abs() < 1e-9 && (met[1] - y).abs() < 1e-9, "{met:?}");
            prop_assert!(surface.intersect(eye, eye - on_sheet).is_none());
        }

        #[test]
        fn derivatives_are_those_of_finite_differences(
            x in -0.03..0.23_f64, y in -0.03..0.16_f64, terms in proptest::array::uniform3(-1e-3..1e-3_f64), back: bool,
        ) {
            let face = if back { Face::Back } else { Face::Front };
            let at = |terms| Surface::new(&board(), face, BoardShape::of_terms(terms)).point([x, y]);
            let by_terms = Surface::new(&board(), face, BoardShape::of_terms(terms)).by_terms([x, y]);
            for k in 0..BoardShape::TERMS {
                let moved = |by: f64| {
                    let mut terms = terms;
                    terms[k] += by;
                    at(terms)
                };
                let numeric = (moved(1e-4) - moved(-1e-4)) / 2e-4;
                prop_assert!((by_terms.column(k) - numeric).norm() < 1e-9);
            }
        }
    }
}

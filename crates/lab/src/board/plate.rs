//! The plate on which a board is printed: its size, where its faces lie, and its surface as a depth camera sees it.

use nalgebra::{Isometry3, Point3};
use scand_core::calibration::{Board, BoardShape, Face, Rectangle, Surface};
use scand_core::mesh::Mesh;

/// The white border around the pattern as a share of a square, and the thickness of a plate if none is given.
const MARGIN: f64 = 0.5;
const THICKNESS: f64 = 0.003;
/// Cells of a face's mesh along each side: small enough for depth between vertices to be exact.
const CELLS: u32 = 24;

/// A board as a thing: where its faces really lie on each other.
#[derive(Clone, Debug)]
pub(super) struct Plate {
    pub board: Board,
    /// The back's frame in the front's.
    pub front_from_back: Isometry3<f64>,
    /// How its sheet is bent and stretched.
    pub shape: BoardShape,
}

impl Plate {
    /// What a camera at a point of the front's frame sees: a face with its pose in the front's frame, and whether it
    /// is printed.
    pub(super) fn seen_from(&self, eye: Point3<f64>) -> (Face, Isometry3<f64>, bool) {
        match (eye.z < 0.0, self.board.two_sided) {
            (true, _) => (Face::Front, Isometry3::identity(), true),
            (false, true) => (Face::Back, self.front_from_back, true),
            (false, false) => (Face::Front, Isometry3::identity(), false),
        }
    }

    /// A face of it.
    pub(super) fn surface(&self, face: Face) -> Surface {
        Surface::new(&self.board, face, self.shape)
    }

    /// The plate's surface in the rig's frame: a thin closed box, bent as its sheet is.
    pub(super) fn mesh(&self, rig_from_board: &Isometry3<f64>) -> Mesh {
        let thickness = match self.board.two_sided {
            true => self.front_from_back.translation.z.max(1e-3),
            false => self.board.thickness.max(THICKNESS),
        };
        let mut mesh = Mesh::default();
        for (z, back) in [(0.0, false), (thickness, true)] {
            self.add_face(&mut mesh, rig_from_board, z, back);
        }
        join_faces(&mut mesh);
        mesh
    }

    fn add_face(&self, mesh: &mut Mesh, rig_from_board: &Isometry3<f64>, z: f64, back: bool) {
        let Rectangle { min, max } = outline(&self.board);
        let first = mesh.vertices.len() as u32;
        let surface = self.surface(Face::Front);
        let between = |a: usize, k: u32| {
            let t = f64::from(k) / f64::from(CELLS);
            min[a] + (max[a] - min[a]) * t
        };
        for j in 0..=CELLS {
            for i in 0..=CELLS {
                let mut p = surface.point([between(0, i), between(1, j)]);
                p.z += z;
                mesh.vertices.push((rig_from_board * p).cast());
            }
        }
        for j in 0..CELLS {
            for i in 0..CELLS {
                let at = |i: u32, j: u32| first + j * (CELLS + 1) + i;
                let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                // x, y and z into the board are right-handed: turning from y to x faces the observer.
                let two = match back {
                    false => [[a, c, b], [a, d, c]],
                    true => [[a, b, c], [a, c, d]],
                };
                mesh.triangles.extend(two);
            }
        }
    }
}

/// The narrow sides of the box, between the rims of its faces.
fn join_faces(mesh: &mut Mesh) {
    let back = (CELLS + 1) * (CELLS + 1);
    let at = |i: u32, j: u32| j * (CELLS + 1) + i;
    let rim = (0..CELLS)
        .map(|i| at(i, 0))
        .chain((0..CELLS).map(|j| at(CELLS, j)))
        .chain((0..CELLS).map(|i| at(CELLS - i, CELLS)))
        .chain((0..CELLS).map(|j| at(0, CELLS - j)));
    let rim: Vec<u32> = rim.collect();
    for (k, &a) in rim.iter().enumerate() {
        let b = rim[(k + 1) % rim.len()];
        mesh.triangles
            .extend([[a, b, b + back], [a, b + back, a + back]]);
    }
}

/// What the plate covers, in the frame of either face.
pub(super) fn outline(board: &Board) -> Rectangle {
    let Rectangle { min, max } = board.outline();
    let margin = MARGIN * board.square;
    Rectangle {
        min: min.map(|v| v - margin),
        max: max.map(|v| v + margin),
    }
}

/// The plate's corners in the plane of its face.
pub(super) fn corners(board: &Board) -> [[f64; 2]; 4] {
    let Rectangle { min, max } = outline(board);
    [min, [max[0], min[1]], max, [min[0], max[1]]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use scand_core::mesh::check;

    #[test]
    fn a_plate_is_a_solid_whose_front_faces_the_one_who_looks() {
        let plate = Plate {
            board: Board::checkerboard(5, 4, 0.03).unwrap(),
            front_from_back: Isometry3::identity(),
            shape: BoardShape::of_terms([2e-3, -1e-3, 1e-3]),
        };
        let mesh = plate.mesh(&Isometry3::identity());
        let report = check(&mesh);
        assert!(report.is_watertight() && report.is_oriented(), "{report:?}");
        let corners = mesh.corners(0);
        let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
        assert!(normal.z < 0.0, "{normal}");
        assert!(!plate.seen_from(Point3::new(0.0, 0.0, 1.0)).2);
    }
}

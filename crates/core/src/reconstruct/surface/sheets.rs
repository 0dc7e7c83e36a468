//! Decides how the surface runs through a cell: which of the cell's cut edges belong to one sheet.
//!
//! Within each face of a cell the surface runs from cut edge to cut edge; followed around the cell these
//! runs close into loops, one a sheet. A face with four cut edges can be joined in two ways, and the solid's
//! value in its middle decides. Where two cells would then share two runs between the same two sheets, four
//! triangles would meet in an edge; joining that face the other way splits the sheets and mends it (Wenger,
//! "Isosurfaces", 2013, section 3.4).

use super::cells::Cells;
use super::edges::{CutEdges, EDGE_START};
use super::{Lattice, Solid};
use nalgebra::Vector3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// The sheets of a cell.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sheets {
    /// For each edge the number of its sheet; 255 for an edge that is not cut.
    pub(super) of_edge: [u8; 12],
    /// How many sheets.
    pub(super) count: u8,
}

/// The corners of each face, counter-clockwise seen from outside the cell: -x, +x, -y, +y, -z, +z.
const FACE_CORNERS: [[usize; 4]; 6] = [
    [0, 4, 6, 2],
    [1, 3, 7, 5],
    [0, 1, 5, 4],
    [2, 6, 7, 3],
    [0, 2, 3, 1],
    [4, 5, 7, 6],
];

/// A face of the lattice: the cell on its positive side and its axis.
type FaceKey = ([u32; 3], usize);

/// Ambiguous faces and whether their middle is inside.
type FaceCenters = BTreeMap<FaceKey, bool>;

/// The sheets of every cell.
pub(super) fn trace(
    solid: &impl Solid,
    lattice: &Lattice,
    cells: &Cells,
    cut: &CutEdges,
) -> Vec<Sheets> {
    let mut middles: FaceCenters = (0..cells.len())
        .into_par_iter()
        .flat_map_iter(|cell| ambiguous_faces(cells, cut, cell))
        .map(|(face, cell)| {
            (
                face,
                solid.value(middle(lattice, face), cells.undecided(cell)) > 0.0,
            )
        })
        .collect();
    let of_cell = |cell: usize, middles: &FaceCenters| {
        loops(cut.inside(cell), |face| {
            middles[&face_key(cells.position(cell), face)]
        })
    };
    let mut sheets: Vec<Sheets> = (0..cells.len())
        .into_par_iter()
        .map(|cell| of_cell(cell, &middles))
        .collect();
    let faces: Vec<FaceKey> = middles.keys().copied().collect();
    for face in faces {
        let (at, axis) = face;
        let mut before = at;
        before[axis] -= 1;
        let (Some(after), Some(before)) = (cells.find(at), cells.find(before)) else {
            continue;
        };
        if joined(&sheets[after], 2 * axis) && joined(&sheets[before], 2 * axis + 1) {
            middles.entry(face).and_modify(|inside| *inside = !*inside);
            for cell in [after, before] {
                sheets[cell] = of_cell(cell, &middles);
            }
        }
    }
    sheets
}

fn face_key(mut at: [u32; 3], face: usize) -> FaceKey {
    at[face / 2] += face as u32 % 2;
    (at, face / 2)
}

fn middle(lattice: &Lattice, (at, axis): FaceKey) -> nalgebra::Point3<f64> {
    let mut half = Vector3::repeat(0.5 * lattice.cell_size);
    half[axis] = 0.0;
    lattice.corner(at) + half
}

/// The faces of a cell with four cut edges.
fn ambiguous_faces(
    cells: &Cells,
    cut: &CutEdges,
    cell: usize,
) -> impl Iterator<Item = (FaceKey, usize)> {
    let (inside, at) = (cut.inside(cell), cells.position(cell));
    (0..6)
        .filter(move |&face| {
            let [i, j, k, l] = FACE_CORNERS[face];
            let (a, b) = (inside >> i & 1, inside >> j & 1);
            let (c, d) = (inside >> k & 1, inside >> l & 1);
            a == c && b == d && a != b
        })
        .map(move |face| (face_key(at, face), cell))
}

/// Whether all four edges of an ambiguous face lie on one sheet.
fn joined(sheets: &Sheets, face: usize) -> bool {
    let first = sheets.of_edge[face_edge(face, 0)];
    (1..4).all(|i| sheets.of_edge[face_edge(face, i)] == first)
}

/// The edge from corner i of a face to the next.
fn face_edge(face: usize, i: usize) -> usize {
    let (a, b) = (FACE_CORNERS[face][i], FACE_CORNERS[face][(i + 1) % 4]);
    let axis = (a ^ b).trailing_zeros() as usize;
    let start = a.min(b);
    (4 * axis..4 * axis + 4)
        .find(|&e| EDGE_START[e] == start)
        .expect("an edge of the cube")
}

/// Follows the runs through the faces until they close.
fn loops(inside: u8, middle_is_inside: impl Fn(usize) -> bool) -> Sheets {
    let mut next = [u8::MAX; 12];
    for face in 0..6 {
        let corner = |i: usize| inside >> FACE_CORNERS[face][i % 4] & 1 == 1;
        let leaves = |i: usize| corner(i) && !corner(i + 1);
        let enters = |i: usize| !corner(i) && corner(i + 1);
        let ambiguous = (0..4).filter(|&i| leaves(i)).count() == 2;
        // Around a lone inside corner the run goes back to the edge before it; around a lone outside corner
        // on to the edge after it. With only two cut edges both searches find the same one.
        let backwards = !ambiguous || !middle_is_inside(face);
        for i in (0..4).filter(|&i| leaves(i)) {
            let step = if backwards { 3 } else { 1 };
            let other = (1..4)
                .map(|k| (i + k * step) % 4)
                .find(|&j| enters(j))
                .expect("runs pair up");
            next[face_edge(face, i)] = face_edge(face, other) as u8;
        }
    }
    let mut sheets = Sheets {
        of_edge: [u8::MAX; 12],
        count: 0,
    };
    for first in 0..12 {
        if next[first] == u8::MAX || sheets.of_edge[first] != u8::MAX {
            continue;
        }
        let mut edge = first;
        while sheets.of_edge[edge] == u8::MAX {
            sheets.of_edge[edge] = sheets.count;
            edge = next[edge] as usize;
        }
        sheets.count += 1;
    }
    sheets
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_way_through_a_cell_closes_and_uses_every_cut_edge_once() {
        for inside in 0..=255u8 {
            for middles in 0..64u8 {
                let sheets = loops(inside, |face| middles >> face & 1 == 1);
                for (e, start) in EDGE_START.into_iter().enumerate() {
                    let cut = (inside >> start ^ inside >> super::super::edges::edge_end(e)) & 1;
                    assert_eq!(
                        cut == 1,
                        sheets.of_edge[e] < sheets.count,
                        "{inside:08b} edge {e}"
                    );
                }
                for sheet in 0..sheets.count {
                    let edges = sheets.of_edge.iter().filter(|&&s| s == sheet).count();
                    assert!(edges >= 3, "{inside:08b}: a sheet of {edges} edges");
                }
            }
        }
    }

    #[test]
    fn faces_are_wound_outwards() {
        let at = |i: usize| Vector3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2) as f64);
        for (face, corners) in FACE_CORNERS.iter().enumerate() {
            let normal =
                (at(corners[1]) - at(corners[0])).cross(&(at(corners[2]) - at(corners[1])));
            let mut expected = Vector3::zeros();
            expected[face / 2] = if face % 2 == 0 { -1.0 } else { 1.0 };
            assert_eq!(normal, expected, "face {face}");
        }
    }
}

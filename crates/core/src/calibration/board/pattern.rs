//! How a face of a board looks: its black parts as rectangles in the face's frame, for code that prints or renders
//! it.

use super::{Board, BoardKind, Face};

/// A black rectangle of a face, in metres of the face's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rectangle {
    /// Smallest x and y.
    pub min: [f64; 2],
    /// Largest x and y.
    pub max: [f64; 2],
}

impl Board {
    /// Whether the square in column `i` and row `j` is black; the first one is.
    pub fn is_black(i: usize, j: usize) -> bool {
        (i + j).is_multiple_of(2)
    }

    /// What the squares of a face cover, in its frame.
    pub fn outline(&self) -> Rectangle {
        Rectangle {
            min: [-self.square; 2],
            max: [self.columns, self.rows].map(|n| n as f64 * self.square),
        }
    }

    /// All that is black on a face: squares, and cells of markers, where neighbours in a row are one rectangle. None
    /// overlap.
    pub fn black_rectangles(&self, face: Face) -> Vec<Rectangle> {
        let squares = (0..=self.rows).flat_map(|j| (0..=self.columns).map(move |i| (i, j)));
        let mut rectangles = Vec::new();
        let mut ids = self.marker_ids(face);
        for (i, j) in squares {
            let corner = [i, j].map(|n| (n as f64 - 1.0) * self.square);
            if Self::is_black(i, j) {
                rectangles.push(Rectangle {
                    min: corner,
                    max: corner.map(|c| c + self.square),
                });
            } else if let Some(id) = ids.next() {
                rectangles.extend(self.marker(id, corner));
            }
        }
        rectangles
    }

    /// The black rectangles of a face by the squares that they lie in, these in the order of reading: `columns + 1` to
    /// a row.
    pub fn black_by_square(&self, face: Face) -> Vec<Vec<Rectangle>> {
        let columns = self.columns + 1;
        let mut squares = vec![Vec::new(); columns * (self.rows + 1)];
        for black in self.black_rectangles(face) {
            let middle = [0, 1].map(|a| 0.5 * (black.min[a] + black.max[a]));
            let [i, j] = middle.map(|v| (v / self.square + 1.0).floor() as usize);
            squares[j * columns + i].push(black);
        }
        squares
    }

    /// The black runs of a marker in the white square whose first corner is given.
    fn marker(&self, id: usize, corner: [f64; 2]) -> Vec<Rectangle> {
        let BoardKind::Charuco(markers) = self.kind else {
            return Vec::new();
        };
        let Some(bits) = marker_bits(markers.dictionary, id) else {
            return Vec::new();
        };
        let origin = corner.map(|c| c + 0.5 * (self.square - markers.side));
        let cell = markers.side / bits.len() as f64;
        let mut rectangles = Vec::new();
        for (v, row) in bits.iter().enumerate() {
            let mut u = 0;
            for run in row.chunk_by(|a, b| a == b) {
                if run[0] {
                    let at = |u: usize, v: usize| [u, v].map(|n| n as f64 * cell);
                    let (min, max) = (at(u, v), at(u + run.len(), v + 1));
                    rectangles.push(Rectangle {
                        min: [0, 1].map(|a| origin[a] + min[a]),
                        max: [0, 1].map(|a| origin[a] + max[a]),
                    });
                }
                u += run.len();
            }
        }
        rectangles
    }
}

/// Rows of a marker's cells, its black rim one cell wide around them; true is black.
fn marker_bits(dictionary: &str, id: usize) -> Option<Vec<Vec<bool>>> {
    let dictionary = calib_targets_aruco::builtins::builtin_dictionary(dictionary)?;
    let code = *dictionary.codes().get(id)?;
    let inner = dictionary.marker_size();
    let is_black = |u: usize, v: usize| {
        let rim = u == 0 || v == 0 || u > inner || v > inner;
        rim || code >> ((v - 1) * inner + u - 1) & 1 == 1
    };
    let row = |v| (0..inner + 2).map(|u| is_black(u, v)).collect();
    Some((0..inner + 2).map(row).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use calib_targets_aruco::{GrayImageView, Matcher, ScanDecodeConfig, scan_decode_markers};

    #[test]
    fn a_checkerboard_has_its_black_squares() {
        let board = Board::checkerboard(3, 2, 0.03).unwrap();
        let black = board.black_rectangles(Face::Front);
        assert_eq!(black.len(), 6);
        assert_eq!(black[0].min, [-0.03, -0.03]);
        assert_eq!(black[0].max, [0.0, 0.0]);
        assert_eq!(board.outline().max, [0.09, 0.06]);
    }

    /// A face drawn upright with `pixels` a square.
    fn drawn(board: &Board, face: Face, pixels: usize) -> (Vec<u8>, usize, usize) {
        let (width, height) = ((board.columns + 1) * pixels, (board.rows + 1) * pixels);
        let mut picture = vec![255_u8; width * height];
        let at = |v: f64| ((v / board.square + 1.0) * pixels as f64).round() as usize;
        for black in board.black_rectangles(face) {
            for y in at(black.min[1])..at(black.max[1]) {
                picture[y * width..][at(black.min[0])..at(black.max[0])].fill(20);
            }
        }
        (picture, width, height)
    }

    #[test]
    fn the_detector_reads_every_marker_of_each_face_where_it_expects_it() {
        let board = Board::charuco(6, 5, 0.03, true).unwrap();
        for &face in board.faces() {
            let (picture, width, height) = drawn(&board, face, 48);
            let view = GrayImageView {
                width,
                height,
                data: &picture,
            };
            let matcher = Matcher::new(board.dictionary(face).unwrap(), 0);
            let mut config = ScanDecodeConfig::default();
            config.marker_size_rel = 0.75;
            config.inset_frac = 0.0;
            let (columns, rows) = (board.columns + 1, board.rows + 1);
            let found = scan_decode_markers(&view, columns, rows, 48.0, &config, &matcher);
            assert_eq!(found.len(), board.marker_ids(face).len(), "{face:?}");
            let white = (0..columns * rows).filter(|k| !Board::is_black(k % columns, k / columns));
            for (id, k) in white.enumerate() {
                let marker = found.iter().find(|m| m.id == id as u32).unwrap();
                let cell = (marker.gc.u as usize, marker.gc.v as usize);
                assert_eq!(cell, (k % columns, k / columns));
                assert_eq!(marker.rotation, 0);
            }
        }
    }
}

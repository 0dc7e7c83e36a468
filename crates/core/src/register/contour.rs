//! The contour of a silhouette as chains of points, to a fraction of a pixel: where the level set crosses the lines
//! between pixel centres. Knows no lens.

use crate::image::{Mask, PixelRect};
use nalgebra::Point2;

/// The value of a silhouette's contour.
pub(super) const CONTOUR: f32 = 127.5;
/// Chains with fewer points are specks, and left out.
const LEAST_POINTS: usize = 20;

/// A connected piece of a contour.
#[derive(Clone, Debug, Default)]
pub(super) struct Chain {
    /// Its points in pixels, one after the other.
    pub(super) points: Vec<Point2<f64>>,
    /// Whether its last point is followed by its first.
    pub(super) is_closed: bool,
}

impl Chain {
    /// Its length in pixels.
    pub(super) fn length(&self) -> f64 {
        let closing = self.is_closed.then(|| self.points.first()).flatten();
        let next = self.points.iter().skip(1).chain(closing);
        self.points
            .iter()
            .zip(next)
            .map(|(a, b)| (b - a).norm())
            .sum()
    }
}

/// A crossing: the number of the line between two pixels that it lies on, which is unique in a picture.
type Key = u64;

/// One step of the contour through the square between four pixel centres.
struct Piece {
    ends: [(Key, Point2<f64>); 2],
}

/// The chains of a level set's contour, but where `unknown` is 128 or more. An object that the frame cuts has open
/// ones, and so has one of which something is unknown.
pub(super) fn chains(level: &Mask, unknown: Option<&Mask>, bounds: PixelRect) -> Vec<Chain> {
    let is_unknown = |x: usize, y: usize| unknown.is_some_and(|mask| mask[(x, y)] >= 128);
    let part = bounds.grown(2, level.width(), level.height());
    let mut pieces = Vec::new();
    for y in part.y0..part.y1.saturating_sub(1) {
        for x in part.x0..part.x1.saturating_sub(1) {
            let around = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)];
            if !around.iter().any(|&(x, y)| is_unknown(x, y)) {
                add_pieces(level, x, y, &mut pieces);
            }
        }
    }
    let links = Links::new(&pieces);
    let mut done = vec![false; pieces.len()];
    let mut chains = Vec::new();
    // Open chains first, from their ends, so that none is begun in its middle.
    for from_ends in [true, false] {
        for first in 0..pieces.len() {
            let free = (0..2).find(|&e| links.across(&pieces, first, e).is_none());
            if done[first] || (from_ends && free.is_none()) {
                continue;
            }
            let chain = walk(&pieces, &links, &mut done, first, free.unwrap_or(0));
            if chain.points.len() >= LEAST_POINTS {
                chains.push(chain);
            }
        }
    }
    chains
}

/// Follows a chain from the end `entry` of a piece.
fn walk(pieces: &[Piece], links: &Links, done: &mut [bool], first: usize, entry: usize) -> Chain {
    let mut chain = Chain::default();
    let (mut piece, mut entry) = (first, entry);
    chain.points.push(pieces[piece].ends[entry].1);
    loop {
        done[piece] = true;
        let exit = 1 - entry;
        let Some((next, end)) = links.across(pieces, piece, exit) else {
            chain.points.push(pieces[piece].ends[exit].1);
            return chain;
        };
        if done[next] {
            chain.is_closed = true;
            return chain;
        }
        chain.points.push(pieces[piece].ends[exit].1);
        (piece, entry) = (next, end);
    }
}

/// Which piece's end lies at which crossing.
struct Links(Vec<(Key, usize, usize)>);

impl Links {
    fn new(pieces: &[Piece]) -> Self {
        let ends = |(i, piece): (usize, &Piece)| [0, 1].map(|e| (piece.ends[e].0, i, e));
        let mut ends: Vec<_> = pieces.iter().enumerate().flat_map(ends).collect();
        ends.sort_unstable();
        Self(ends)
    }

    /// The other piece, and its end, at the end of a piece.
    fn across(&self, pieces: &[Piece], piece: usize, end: usize) -> Option<(usize, usize)> {
        let key = pieces[piece].ends[end].0;
        let start = self.0.partition_point(|&(k, ..)| k < key);
        let same = self.0[start..].iter().take_while(|&&(k, ..)| k == key);
        same.map(|&(_, i, e)| (i, e)).find(|&(i, _)| i != piece)
    }
}

fn add_pieces(level: &Mask, x: usize, y: usize, pieces: &mut Vec<Piece>) {
    let at = |dx: usize, dy: usize| f32::from(level[(x + dx, y + dy)]) - CONTOUR;
    let corners = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
    let inside = corners.map(|c| c > 0.0);
    if inside == [true; 4] || inside == [false; 4] {
        return;
    }
    let places = [(0, 0), (1, 0), (1, 1), (0, 1)];
    let mut ends = Vec::with_capacity(4);
    for i in 0..4 {
        let j = (i + 1) % 4;
        if inside[i] != inside[j] {
            ends.push(crossing(
                (x, y),
                places[i],
                places[j],
                corners[i],
                corners[j],
                level,
            ));
        }
    }
    match ends[..] {
        [a, b] => pieces.push(Piece { ends: [a, b] }),
        [a, b, c, d] => {
            // A saddle: the middle decides which corners belong together.
            let joined = (corners.iter().sum::<f32>() > 0.0) == inside[0];
            let pairs = if joined {
                [[a, b], [c, d]]
            } else {
                [[d, a], [b, c]]
            };
            pieces.extend(pairs.map(|ends| Piece { ends }));
        }
        _ => {}
    }
}

fn crossing(
    (x, y): (usize, usize),
    (px, py): (usize, usize),
    (qx, qy): (usize, usize),
    p: f32,
    q: f32,
    level: &Mask,
) -> (Key, Point2<f64>) {
    let along = f64::from(p / (p - q));
    let mix = |from: usize, to: usize| from as f64 + (to as f64 - from as f64) * along;
    let at = Point2::new(x as f64 + mix(px, qx), y as f64 + mix(py, qy));
    let (left, top) = (x + px.min(qx), y + py.min(qy));
    let key = 2 * (top * level.width() + left) + usize::from(px == qx);
    (key as Key, at)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Grid;

    fn disk(radius: f64, center: (f64, f64)) -> Mask {
        Grid::from_fn(80, 60, |x, y| {
            let d = radius - (x as f64 - center.0).hypot(y as f64 - center.1);
            (127.5 + 80.0 * d).clamp(0.0, 255.0) as u8
        })
    }

    #[test]
    fn a_disk_has_one_closed_chain_that_lies_on_its_circle() {
        let found = chains(&disk(20.3, (40.2, 29.7)), None, PixelRect::whole(80, 60));
        assert_eq!(found.len(), 1);
        assert!(found[0].is_closed);
        for p in &found[0].points {
            let radius = (p.x - 40.2).hypot(p.y - 29.7);
            assert!((radius - 20.3).abs() < 0.05, "{radius}");
        }
    }

    #[test]
    fn a_disk_that_the_frame_cuts_has_an_open_chain() {
        let found = chains(&disk(20.0, (70.0, 30.0)), None, PixelRect::whole(80, 60));
        assert_eq!(found.len(), 1);
        assert!(!found[0].is_closed);
        let ends = [found[0].points[0], *found[0].points.last().unwrap()];
        assert!(ends.iter().all(|p| p.x > 78.0), "{ends:?}");
    }

    #[test]
    fn the_border_of_what_is_unknown_is_no_contour() {
        let unknown = Grid::from_fn(80, 60, |x, _| if x < 30 { 255 } else { 0 });
        let mut level = disk(20.0, (40.0, 30.0));
        for y in 0..60 {
            level.row_mut(y)[..30].fill(0);
        }
        let found = chains(&level, Some(&unknown), PixelRect::whole(80, 60));
        assert_eq!(found.len(), 1);
        assert!(!found[0].is_closed);
        for p in &found[0].points {
            let radius = (p.x - 40.0).hypot(p.y - 30.0);
            assert!((radius - 20.0).abs() < 0.05, "{radius}");
        }
    }
}

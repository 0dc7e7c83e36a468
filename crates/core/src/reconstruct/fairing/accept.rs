//! Keeps the hull where the faired surface's outlines do not agree with the contours: where they are farther from
//! them than the hull's own outlines are, or where too little of a thin part would be left.

use super::contour::{Contour, REACH_PX};
use super::rounds::rims;
use super::shape::{Role, Shape};
use super::{Facts, Refusal};
use crate::mesh::{Bvh, Mesh};
use nalgebra::{Point2, Point3};
use rayon::prelude::*;

/// How much farther than the hull's outlines those of a patch may be from the contours, in pixels (root mean square);
/// where pixels are put together, in those. `design/surface.md` has what smaller limits did.
const LIMIT_PX: f64 = 0.3;
/// An outline is looked for this many pixels along the contour.
const WINDOW_PX: i64 = 4;
/// The hull touches a contour where it is at most this many pixels farther from it than where it is nearest.
const TOUCHING_PX: f64 = 0.5;
/// Rings of neighbours that make a patch.
const PATCH: usize = 5;
/// Rings around what is kept on which the surface passes over into the hull.
const PASSAGE: usize = 6;
/// An outline of the surface lies on a contour if it is at most this many pixels from it.
const LYING_PX: f64 = 1.0;
/// Share of a part's thickness that it may lose on one side.
const THICKNESS: f64 = 1.0 / 3.0;
/// Share of the surface that has to stay the hull from which on all of it does.
pub(super) const TOO_MUCH: f64 = 0.7;

/// A piece of contour: how far outlines are from it in pixels, and the vertices that answer for it.
struct Piece {
    faired: f64,
    hull: f64,
    length: f64,
    vertices: [u32; 2],
}

/// Decides for each place between the faired positions of `shape` and the hull's, `before`, and measures; refuses where
/// most of it has to stay the hull. A pixel of `contours` is `times` pixels of the pictures. Also returns the vertices
/// at which an outline of the faired surface lies on a contour, in ascending order, each with that contour's number.
pub(super) fn keep_hull(
    shape: &mut Shape,
    before: &[Point3<f64>],
    contours: &[Contour],
    times: f64,
) -> Result<(Facts, Vec<(u32, usize)>), Refusal> {
    let of_contour = |c: &Contour| pieces(shape, before, c);
    let of_contours: Vec<Vec<Piece>> = contours.par_iter().map(of_contour).collect();
    let touching = touching(&of_contours);
    let pieces: Vec<Piece> = of_contours.into_iter().flatten().collect();
    let (disagreeing, thin) = (disagreeing(shape, &pieces), too_thin(shape, before));
    let either: Vec<bool> = disagreeing.iter().zip(&thin).map(|(d, t)| d | t).collect();
    let areas = shape.areas();
    let area: f64 = areas.iter().sum();
    let keep = passage(shape, &either);
    let share =
        |of: &dyn Fn(usize) -> f64| (0..shape.len()).map(|v| of(v) * areas[v]).sum::<f64>() / area;
    let kept = share(&|v| keep[v]);
    if kept.is_nan() || kept > TOO_MUCH {
        return Err(Refusal::TooMuchKept {
            kept,
            disagreeing: share(&|v| f64::from(disagreeing[v])),
            thin: share(&|v| f64::from(thin[v])),
        });
    }
    return_to_hull(shape, before, keep);
    let (rms, p99) = statistics(&pieces);
    let facts = Facts {
        contour_rms_px: times * rms,
        contour_p99_px: times * p99,
        kept,
        held_by_depth_area: None,
        moved_area: moved_area(shape, before, &areas),
        area,
    };
    Ok((facts, touching))
}

/// The vertices at which an outline of the faired surface lies on a contour, in ascending order, each with that
/// contour's number.
fn touching(of_contours: &[Vec<Piece>]) -> Vec<(u32, usize)> {
    let of_contour = |(contour, pieces): (usize, &Vec<Piece>)| {
        let lying = pieces.iter().filter(|piece| piece.faired < LYING_PX);
        lying.map(|piece| (piece.vertices[0], contour)).collect()
    };
    let each: Vec<Vec<(u32, usize)>> = of_contours.iter().enumerate().map(of_contour).collect();
    let mut vertices = each.concat();
    vertices.sort_unstable();
    vertices.dedup();
    vertices
}

/// Moves each vertex back until it has gone as much of its way to the hull, `before`, as `keep` says, 0 (faired) to 1
/// (the hull); none may have gone more of it already.
pub(super) fn return_to_hull(shape: &mut Shape, before: &[Point3<f64>], keep: Vec<f64>) {
    for v in 0..shape.len() {
        let (was_left, left) = (1.0 - shape.kept[v], 1.0 - keep[v]);
        if was_left > 0.0 {
            let way = shape.positions[v] - before[v];
            shape.positions[v] = before[v] + way * (left / was_left);
        }
        if keep[v] > 0.0 && matches!(shape.roles[v], Role::Side(_)) {
            shape.roles[v] = Role::Edge;
        }
    }
    shape.kept = keep;
}

/// Of the `areas` around the vertices those that lie more than half a millimetre from the hull, `before`; in square
/// metres.
pub(super) fn moved_area(shape: &Shape, before: &[Point3<f64>], areas: &[f64]) -> f64 {
    let moved = |v: &usize| (shape.positions[*v] - before[*v]).norm() > 0.5e-3;
    (0..shape.len()).filter(moved).map(|v| areas[v]).sum()
}

/// Points of an outline in a picture by pixel, each with its distance to the contour and its vertices.
struct Outline {
    sorted: Vec<([i64; 2], f64, [u32; 2])>,
}

impl Outline {
    fn new(points: impl Iterator<Item = (Point2<f64>, f64, [u32; 2])>) -> Self {
        let points = points.map(|(p, d, ends)| (place(p), d.abs(), ends));
        let mut sorted: Vec<_> = points.collect();
        sorted.sort_by(|a, b| a.0.cmp(&b.0).then(a.2.cmp(&b.2)).then(a.1.total_cmp(&b.1)));
        Self { sorted }
    }

    /// The points around a place.
    fn around(&self, p: Point2<f64>) -> impl Iterator<Item = &([i64; 2], f64, [u32; 2])> {
        let [y, x] = place(p);
        let rows = y - WINDOW_PX..=y + WINDOW_PX;
        rows.flat_map(move |row| {
            let first = self.sorted.partition_point(|s| s.0 < [row, x - WINDOW_PX]);
            let list = self.sorted[first..].iter();
            list.take_while(move |s| s.0 <= [row, x + WINDOW_PX])
        })
    }

    /// The point nearest to the contour of those around a place.
    fn nearest(&self, p: Point2<f64>) -> Option<(f64, [u32; 2])> {
        let near = self.around(p).min_by(|a, b| a.1.total_cmp(&b.1));
        near.map(|s| (s.1, s.2))
    }
}

fn place(p: Point2<f64>) -> [i64; 2] {
    [p.y.floor() as i64, p.x.floor() as i64]
}

fn pieces(shape: &Shape, before: &[Point3<f64>], contour: &Contour) -> Vec<Piece> {
    let rims = rims(shape, contour);
    let of_rims = rims
        .iter()
        .map(|r| (r.offset.pixel, r.offset.inside_px, r.ends));
    let edges = (0..shape.len()).filter(|&v| matches!(shape.roles[v], Role::Edge | Role::Side(_)));
    let at = |v: usize, p: Point3<f64>| {
        let offset = contour.offset(p)?;
        Some((offset.pixel, offset.inside_px, [v as u32; 2]))
    };
    let of_edges = edges.filter_map(|v| at(v, shape.positions[v]));
    let faired = Outline::new(of_rims.chain(of_edges));
    let hull = Outline::new((0..before.len()).filter_map(|v| at(v, before[v])));
    let moved = |v: u32| (shape.positions[v as usize] - before[v as usize]).norm();
    let of_point = |&(p, length): &(Point2<f64>, f64)| {
        let (faired, of_hull) = (faired.nearest(p), hull.nearest(p));
        let vertices = match faired {
            Some((_, vertices)) => vertices,
            None => answering(&hull, p, of_hull?.0, &moved)?,
        };
        Some(Piece {
            faired: faired.map_or(REACH_PX, |f| f.0),
            hull: of_hull.map_or(REACH_PX, |h| h.0),
            length,
            vertices,
        })
    };
    contour.points.iter().filter_map(of_point).collect()
}

/// The vertices of the hull that are to stay for a place of the contour that the faired surface left: of those that
/// touch it, the ones that went the shortest way. Ridges of the hull before a side touch it, too, but far from there.
fn answering(
    hull: &Outline,
    p: Point2<f64>,
    nearest_px: f64,
    moved: &impl Fn(u32) -> f64,
) -> Option<[u32; 2]> {
    let touching = hull.around(p).filter(|s| s.1 <= nearest_px + TOUCHING_PX);
    let least = touching.min_by(|a, b| moved(a.2[0]).total_cmp(&moved(b.2[0])));
    least.map(|s| s.2)
}

/// Around which vertices the outlines became worse than the hull's by more than is allowed.
fn disagreeing(shape: &Shape, pieces: &[Piece]) -> Vec<bool> {
    let mut sums = vec![[0.0; 2]; shape.len()];
    for piece in pieces {
        let excess = (piece.faired - piece.hull).max(0.0);
        for v in piece.vertices {
            sums[v as usize][0] += piece.length * excess * excess;
            sums[v as usize][1] += piece.length;
        }
    }
    for _ in 0..PATCH {
        let spread = |v: usize| {
            let around = shape.around(v).iter().map(|&j| sums[j as usize]);
            around.fold(sums[v], |[a, b], [c, d]| [a + c, b + d])
        };
        sums = (0..shape.len()).map(spread).collect();
    }
    let beyond = |[squares, length]: &[f64; 2]| *squares > LIMIT_PX * LIMIT_PX * length;
    sums.iter().map(beyond).collect()
}

/// Which vertices went in by more than their part of the object allows.
fn too_thin(shape: &Shape, before: &[Point3<f64>]) -> Vec<bool> {
    let mesh = Mesh {
        vertices: before.iter().map(|p| p.cast()).collect(),
        triangles: shape.triangles.clone(),
    };
    let hull = Bvh::new(&mesh);
    let thin = |v: usize| {
        let normal = shape.normals[v];
        let inwards = (before[v] - shape.positions[v]).dot(&normal);
        let far = inwards / THICKNESS;
        let start = before[v] - normal * (0.01 * far);
        inwards > 0.0 && hull.is_occluded(start, -normal, 0.99 * far)
    };
    (0..shape.len()).into_par_iter().map(thin).collect()
}

/// For each vertex how much of it is the hull: 1 where it is `bad`, falling to 0 some rings away.
pub(super) fn passage(shape: &Shape, bad: &[bool]) -> Vec<f64> {
    let mut rings = vec![usize::MAX; shape.len()];
    let mut front: Vec<usize> = (0..shape.len()).filter(|&v| bad[v]).collect();
    front.iter().for_each(|&v| rings[v] = 0);
    for ring in 1..=PASSAGE {
        let mut next = Vec::new();
        for &v in &front {
            for &j in shape.around(v) {
                if rings[j as usize] == usize::MAX {
                    rings[j as usize] = ring;
                    next.push(j as usize);
                }
            }
        }
        front = next;
    }
    let share = |ring: &usize| match *ring {
        usize::MAX => 0.0,
        ring => {
            let t = 1.0 - ring as f64 / (PASSAGE + 1) as f64;
            t * t * (3.0 - 2.0 * t)
        }
    };
    rings.iter().map(share).collect()
}

/// Root mean square of the faired outlines' distances, and what 99 % of the contour's length is below.
fn statistics(pieces: &[Piece]) -> (f64, f64) {
    let mut distances: Vec<(f64, f64)> = pieces.iter().map(|p| (p.faired, p.length)).collect();
    distances.sort_by(|a, b| a.0.total_cmp(&b.0));
    let length: f64 = distances.iter().map(|d| d.1).sum();
    let squares: f64 = distances.iter().map(|d| d.0 * d.0 * d.1).sum();
    let mut below = 0.0;
    let p99 = distances.iter().find(|d| {
        below += d.1;
        below >= 0.99 * length
    });
    (
        (squares / length.max(1e-12)).sqrt(),
        p99.map_or(0.0, |d| d.0),
    )
}

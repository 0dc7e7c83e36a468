//! Finds the vertices of a hull that lie on an edge that the silhouettes show: many cones meet there, their normals
//! differ, and nothing else touches their contours. There the surface stays in place, and may bend.

use super::contour::Contour;
use super::shape::{Role, Shape};
use crate::reconstruct::hull::Directions;
use nalgebra::{Matrix3, Point2, Point3, Vector3};
use rayon::prelude::*;

/// A cone is tight where its contour is within this many pixels.
const TIGHT_PX: f64 = 0.5;
/// Cones that must be tight.
const CONES: usize = 4;
/// Cones that must be tight beside two vertices that are certain.
const CONES_BESIDE: usize = 3;
/// Of them, those whose contour nothing else touches that more cones meet at.
const OWN_CONES: usize = 3;
/// What touches the same contour is something else if it is this many of the mesh's edges away.
const ELSEWHERE_EDGES: f64 = 4.0;
/// Angle between normals above which the surface bends, in degrees.
const LEAST_ANGLE_DEG: f64 = 25.0;
/// How often gaps between certain vertices are closed.
const CLOSINGS: usize = 3;
/// A connected group of certain vertices must be at least this long, in pixels and in edges of the mesh; a shorter
/// group is the rounding of something small.
const CHAIN_PX: f64 = 8.0;
const CHAIN_EDGES: f64 = 3.0;

/// What the cones say of one vertex.
struct Tight {
    /// The views whose cones are tight.
    views: Vec<TightView>,
    /// How many directions they see it from.
    directions: usize,
    /// Largest angle between normals of tight cones, in radians; of those in the table's plane where it is on it.
    angle: f64,
}

/// A view whose cone is tight at a vertex.
struct TightView {
    /// Which one it is.
    view: usize,
    /// The vertex' picture in it.
    pixel: [i64; 2],
    /// Which of the directions it sees the vertex from.
    direction: usize,
}

/// Gives the vertices of a hull's mesh that lie on certain edges their role. `pixel` is the size of a pixel in metres.
pub(super) fn mark(shape: &mut Shape, contours: &[Contour], pixel: f64) {
    let vertices = (0..shape.len()).into_par_iter();
    let found: Vec<Tight> = vertices
        .map(|v| tight(shape.positions[v], shape.roles[v], contours))
        .collect();
    let bends = |v: usize| {
        shape.moves(v)
            && found[v].directions >= CONES_BESIDE
            && found[v].angle > LEAST_ANGLE_DEG.to_radians()
    };
    let candidates: Vec<usize> = (0..shape.len()).filter(|&v| bends(v)).collect();
    let edge = shape.mean_edge();
    let own = own_cones(
        shape,
        contours.len(),
        &candidates,
        &found,
        ELSEWHERE_EDGES * edge,
    );
    let mut certain = vec![false; shape.len()];
    let shown: Vec<usize> = candidates
        .into_iter()
        .filter(|&v| own[v] >= OWN_CONES)
        .collect();
    for &v in &shown {
        certain[v] = found[v].directions >= CONES;
    }
    for _ in 0..CLOSINGS {
        let beside = |v: &usize| {
            let around = shape.around(*v).iter();
            around.filter(|&&j| certain[j as usize]).count() >= 2
        };
        let gaps: Vec<usize> = shown.iter().copied().filter(beside).collect();
        gaps.into_iter().for_each(|v| certain[v] = true);
    }
    drop_short(
        shape,
        &mut certain,
        (CHAIN_PX * pixel).max(CHAIN_EDGES * edge),
    );
    for v in (0..shape.len()).filter(|&v| certain[v]) {
        shape.positions[v] = on_contours(shape.positions[v], shape.roles[v], contours, pixel);
        shape.roles[v] = Role::Edge;
    }
}

/// The point near a point of an edge that lies on the contours of all tight cones at once, as well as it can: the hull
/// itself has the innermost of them, contour by contour.
fn on_contours(p: Point3<f64>, role: Role, contours: &[Contour], pixel: f64) -> Point3<f64> {
    /// Share of the largest term that holds the point along the edge, of which contours say nothing.
    const HELD: f64 = 0.02;
    let (mut squares, mut sum) = (Matrix3::zeros(), Vector3::zeros());
    for offset in contours.iter().filter_map(|c| c.offset(p)) {
        if offset.inside_px < TIGHT_PX {
            let mut gradient = offset.gradient;
            if role == Role::Foot {
                gradient.z = 0.0;
            }
            squares += gradient * gradient.transpose();
            sum -= gradient * offset.inside_px;
        }
    }
    let held = squares + Matrix3::identity() * (HELD * squares.trace());
    let way = held.cholesky().map(|c| c.solve(&sum));
    way.filter(|way| way.norm() < pixel)
        .map_or(p, |way| p + way)
}

/// Takes back the role of edges of coarser shapes that no edge of the finer one is near: over longer cells more cones
/// seem to meet by chance. The shapes are of one hull, from coarse to fine.
pub(super) fn confirm(shapes: &mut [Shape]) {
    let Some((finest, coarser)) = shapes.split_last_mut() else {
        return;
    };
    let fine = finest.edges();
    for shape in coarser {
        let near = shape.mean_edge();
        for v in 0..shape.len() {
            let p = shape.positions[v];
            if shape.roles[v] == Role::Edge && fine.iter().all(|q| (p - q).norm() > near) {
                shape.roles[v] = shape.role_without_edges(v);
            }
        }
    }
}

fn tight(p: Point3<f64>, role: Role, contours: &[Contour]) -> Tight {
    let mut normals: Vec<Vector3<f64>> = Vec::new();
    let mut directions = Directions::default();
    let mut views = Vec::new();
    for (i, contour) in contours.iter().enumerate() {
        let Some(offset) = contour.offset(p).filter(|o| o.inside_px < TIGHT_PX) else {
            continue;
        };
        let mut outwards = -offset.gradient;
        if role == Role::Foot {
            outwards.z = 0.0;
        }
        if let Some(normal) = outwards.try_normalize(1e-9) {
            normals.push(normal);
            views.push(TightView {
                view: i,
                pixel: whole(offset.pixel),
                direction: directions.number(p, contour.camera),
            });
        }
    }
    let mut angle = 0.0_f64;
    for (i, a) in normals.iter().enumerate() {
        for b in &normals[..i] {
            angle = angle.max(a.dot(b).clamp(-1.0, 1.0).acos());
        }
    }
    Tight {
        views,
        directions: directions.count(),
        angle,
    }
}

fn whole(pixel: Point2<f64>) -> [i64; 2] {
    [pixel.x.round() as i64, pixel.y.round() as i64]
}

/// For each vertex the number of its tight cones whose contour nothing else explains. If cones of neighbouring views
/// meet in front of a side by chance, the edges beside that side, where more cones meet, touch each of their contours.
fn own_cones(
    shape: &Shape,
    views: usize,
    candidates: &[usize],
    found: &[Tight],
    elsewhere: f64,
) -> Vec<usize> {
    // For each view the vertices that touch its contour, by pixel.
    let mut touching = vec![Vec::new(); views];
    for &v in candidates {
        for tight in &found[v].views {
            let [x, y] = tight.pixel;
            touching[tight.view].push(([y, x], v));
        }
    }
    touching
        .par_iter_mut()
        .for_each(|list| list.sort_unstable());
    let explained = |v: usize, view: usize, [x, y]: [i64; 2]| {
        let list = &touching[view];
        (y - 1..=y + 1).any(|row| {
            let first = list.partition_point(|(at, _)| *at < [row, x - 1]);
            let mut near = list[first..]
                .iter()
                .take_while(|(at, _)| *at <= [row, x + 1]);
            near.any(|&(_, other)| {
                found[other].directions > found[v].directions
                    && (shape.positions[other] - shape.positions[v]).norm() > elsewhere
            })
        })
    };
    let mut own = vec![0; shape.len()];
    for &v in candidates {
        let mut is_own = vec![true; found[v].directions];
        for tight in &found[v].views {
            is_own[tight.direction] &= !explained(v, tight.view, tight.pixel);
        }
        own[v] = is_own.into_iter().filter(|&is_own| is_own).count();
    }
    own
}

/// Leaves out groups of certain vertices that do not reach far enough, in metres, to be an edge.
fn drop_short(shape: &Shape, certain: &mut [bool], least: f64) {
    let mut seen = vec![false; certain.len()];
    for start in 0..certain.len() {
        if !certain[start] || seen[start] {
            continue;
        }
        let mut group = vec![start];
        seen[start] = true;
        let mut next = 0;
        while let Some(&v) = group.get(next) {
            next += 1;
            for &j in shape.around(v) {
                let j = j as usize;
                if certain[j] && !std::mem::replace(&mut seen[j], true) {
                    group.push(j);
                }
            }
        }
        let first = shape.positions[start];
        let (low, high) = group.iter().fold((first, first), |(low, high), &v| {
            let p = shape.positions[v];
            (low.inf(&p), high.sup(&p))
        });
        if (high - low).norm() < least {
            group.iter().for_each(|&v| certain[v] = false);
        }
    }
}

//! One estimate: how far each vertex moves, so that the surface bends least and its rims lie on the contours.

use super::bending::{self, Bending};
use super::contour::{Contour, Offset, REACH_PX};
use super::profile::Profiles;
use super::shape::{Role, Shape};
use super::solve::Rows;
use crate::array::three;
use nalgebra::{Point2, Point3, Vector3};
use rayon::prelude::*;

/// Share of its own weight that holds each vertex where it is.
const DAMPING: f64 = 1e-7;

/// A vertex may lie outside a cone by so many pixels: contours have noise.
const OUTSIDE_PX: f64 = 0.5;
/// How often a vertex is pulled back into all cones by turns.
const PULLS: usize = 3;

/// How a round goes.
#[derive(Clone, Copy)]
pub(super) struct Round {
    /// Most steps of the solver.
    pub(super) steps: usize,
    /// The farthest that a vertex may move, in metres.
    pub(super) farthest: f64,
    /// What bends within a smaller radius resists less, the sharper it bends: edges that no cone is certain of. In
    /// metres; at 0, all vertices resist bending equally.
    pub(super) sharpest: f64,
    /// Which bends cost.
    pub(super) bending: Bending,
}

/// A point of a rim, with the vertices that it lies between.
pub(super) struct RimPoint {
    pub(super) ends: [u32; 2],
    /// Share of the second.
    pub(super) share: f64,
    pub(super) offset: Offset,
    /// Length of rim that it stands for, in pixels.
    pub(super) length_px: f64,
}

/// Moves the vertices once. Returns the share of those that would have gone farther than they may.
pub(super) fn fair_once(
    shape: &mut Shape,
    contours: &[Contour],
    profiles: &Profiles,
    round: Round,
) -> f64 {
    let mut numbers = vec![u32::MAX; shape.len()];
    let mut unknowns = 0;
    for (v, number) in numbers.iter_mut().enumerate() {
        if shape.moves(v) {
            *number = unknowns;
            unknowns += 1;
        }
    }
    let mut rows = Rows::default();
    let wanted = profiles.heights(shape, contours);
    let resistance = (round.bending, round.sharpest);
    bending::resist(&mut rows, shape, &wanted, &numbers, resistance);
    let rims: Vec<Vec<RimPoint>> = contours.par_iter().map(|c| rims(shape, c)).collect();
    for point in rims.iter().flatten() {
        let [i, j] = point.ends.map(|v| v as usize);
        let along = |v: usize| point.offset.gradient.dot(&shape.directions[v]);
        let entries = [
            (numbers[i], (1.0 - point.share) * along(i)),
            (numbers[j], point.share * along(j)),
        ];
        let entries = entries
            .into_iter()
            .filter(|(n, a)| *n != u32::MAX && *a != 0.0);
        rows.push(point.length_px.sqrt(), point.offset.inside_px, entries);
    }
    let x = rows.solve(unknowns as usize, DAMPING, round.steps);
    let moved: Vec<Point3<f64>> = (0..shape.len())
        .into_par_iter()
        .map(|v| {
            let before = shape.positions[v];
            if numbers[v] == u32::MAX {
                return before;
            }
            let step = x[numbers[v] as usize].clamp(-round.farthest, round.farthest);
            let foot = shape.roles[v] == Role::Foot;
            within_cones(before, before + shape.directions[v] * step, foot, contours)
        })
        .collect();
    shape.positions = moved;
    let held_back = x.iter().filter(|step| step.abs() > round.farthest).count();
    held_back as f64 / x.len().max(1) as f64
}

/// The point that is within every cone, but for a fraction of a pixel, nearest to where a vertex was to go; where that
/// is far outside one, the vertex stays.
fn within_cones(
    before: Point3<f64>,
    to: Point3<f64>,
    foot: bool,
    contours: &[Contour],
) -> Point3<f64> {
    let mut p = to;
    for _ in 0..PULLS {
        let mut is_within = true;
        for contour in contours {
            match contour.inside_px(p) {
                Some(inside) if inside <= -REACH_PX => return before,
                Some(inside) if inside < -OUTSIDE_PX => {}
                _ => continue,
            }
            let Some(Offset {
                inside_px,
                mut gradient,
                ..
            }) = contour.offset(p)
            else {
                continue;
            };
            if foot {
                gradient.z = 0.0;
            }
            is_within = false;
            p -= gradient * ((inside_px + OUTSIDE_PX) / gradient.norm_squared().max(1e-12));
        }
        if is_within {
            break;
        }
    }
    p
}

/// The points where the surface turns away from a camera and that lie near its contour.
pub(super) fn rims(shape: &Shape, contour: &Contour) -> Vec<RimPoint> {
    let eye = contour.camera.center();
    let facing: Vec<f64> = shape
        .positions
        .iter()
        .zip(&shape.normals)
        .map(|(p, n)| n.dot(&(eye - p)))
        .collect();
    let mut points = Vec::new();
    for t in &shape.triangles {
        let mixed = {
            let f = three(|i| facing[t[i] as usize] > 0.0);
            f[0] != f[1] || f[1] != f[2]
        };
        if mixed && t.iter().all(|&v| shape.moves(v as usize)) && !shape.is_on_table(t) {
            rim_of_triangle(shape, contour, t, &facing, &mut points);
        }
        // The foot's outline, seen from above: below it there is the table.
        for i in 0..3 {
            let (a, b) = (t[i], t[(i + 1) % 3]);
            let is_foot = |v: u32| matches!(shape.roles[v as usize], Role::Foot);
            if is_foot(a)
                && is_foot(b)
                && !shape.is_on_table(t)
                && facing[a as usize] > 0.0
                && facing[b as usize] > 0.0
            {
                foot_of_edge(shape, contour, [a, b], &mut points);
            }
        }
    }
    points
}

/// Where a rim crosses an edge: its ends, the share of the second, the point, and its pixel.
type Crossing = ([u32; 2], f64, Point3<f64>, Point2<f64>);

fn rim_of_triangle(
    shape: &Shape,
    contour: &Contour,
    t: &[u32; 3],
    facing: &[f64],
    points: &mut Vec<RimPoint>,
) {
    let mut found: [Option<Crossing>; 3] = [None; 3];
    for i in 0..3 {
        let ends = [t[i], t[(i + 1) % 3]];
        let [a, b] = ends.map(|v| facing[v as usize]);
        if (a > 0.0) != (b > 0.0) {
            let share = a / (a - b);
            let p = between(shape, ends, share);
            found[i] = contour
                .camera
                .project(p)
                .map(|(pixel, _)| (ends, share, p, pixel));
        }
    }
    let pair: Vec<_> = found.into_iter().flatten().collect();
    if let [first, second] = pair[..] {
        let length = (first.3 - second.3).norm();
        for (ends, share, p, _) in [first, second] {
            points.extend(contour.offset(p).map(|offset| RimPoint {
                ends,
                share,
                offset,
                length_px: 0.5 * length,
            }));
        }
    }
}

fn foot_of_edge(shape: &Shape, contour: &Contour, ends: [u32; 2], points: &mut Vec<RimPoint>) {
    let [a, b] = ends.map(|v| shape.positions[v as usize]);
    let (Some((p, _)), Some((q, _))) = (contour.camera.project(a), contour.camera.project(b))
    else {
        return;
    };
    for (share, at) in [(0.0, a), (1.0, b)] {
        points.extend(contour.offset(at).map(|offset| RimPoint {
            ends,
            share,
            offset,
            length_px: 0.5 * (p - q).norm(),
        }));
    }
}

/// A point of the curve between two vertices that is perpendicular to both normals.
fn between(shape: &Shape, ends: [u32; 2], share: f64) -> Point3<f64> {
    let [i, j] = ends.map(|v| v as usize);
    let (p, q) = (shape.positions[i], shape.positions[j]);
    let along: Vector3<f64> = q - p;
    let (n, m) = (shape.normals[i], shape.normals[j]);
    let bulge = (n * n.dot(&along) - m * m.dot(&along)) * (0.5 * share * (1.0 - share));
    p + along * share - bulge
}

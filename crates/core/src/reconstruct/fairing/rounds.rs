//! One estimate: how far each vertex moves, so that the surface bends least and its rims lie on the contours.

use super::contour::{Contour, Offset};
use super::shape::{Role, Shape};
use super::solve::Rows;
use crate::array::three;
use nalgebra::{Point2, Point3, Vector3};
use rayon::prelude::*;

/// Length in pixels over which a contour's noise is averaged: how much bending weighs against distances.
const STIFFNESS_PX: f64 = 6.0;
/// Share of its own weight that holds each vertex where it is.
const DAMPING: f64 = 1e-7;

/// How a round goes.
#[derive(Clone, Copy)]
pub(super) struct Round {
    /// Most steps of the solver.
    pub(super) steps: usize,
    /// The farthest that a vertex may move, in metres.
    pub(super) farthest: f64,
    /// What bends within less than this radius resists ever less: edges that no cone is certain of. In metres; 0 lets
    /// everything resist alike.
    pub(super) sharpest: f64,
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

/// Moves the vertices once.
pub(super) fn fair_once(shape: &mut Shape, contours: &[Contour], round: Round) {
    let mut numbers = vec![u32::MAX; shape.len()];
    let mut unknowns = 0;
    for (v, number) in numbers.iter_mut().enumerate() {
        if shape.moves(v) {
            *number = unknowns;
            unknowns += 1;
        }
    }
    let mut rows = Rows::default();
    let stiffness = STIFFNESS_PX.powi(3).sqrt();
    let areas = shape.areas();
    for (v, area) in areas.iter().enumerate() {
        bend(
            &mut rows,
            shape,
            v,
            (stiffness * area.sqrt(), round.sharpest),
            &numbers,
        );
    }
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
    for v in 0..shape.len() {
        if numbers[v] != u32::MAX {
            let step = x[numbers[v] as usize].clamp(-round.farthest, round.farthest);
            let direction = shape.directions[v];
            shape.positions[v] += direction * step;
        }
    }
}

/// The mean curvature at a vertex as a row: the part along the normal of the sum over neighbours, divided by half the
/// sum of their squared distances. Along the outline on the table, the curvature of the outline.
fn bend(rows: &mut Rows, shape: &Shape, v: usize, (weight, sharpest): (f64, f64), numbers: &[u32]) {
    let foot = shape.roles[v] == Role::Foot;
    if !shape.moves(v) {
        return;
    }
    let counts = |j: &&u32| !foot || matches!(shape.roles[**j as usize], Role::Foot | Role::Edge);
    let around = || shape.around(v).iter().filter(counts).map(|&j| j as usize);
    let count = around().count();
    if count < 2 || foot && count != 2 {
        return;
    }
    let (p, normal) = (shape.positions[v], shape.directions[v]);
    let (mut sum, mut squares) = (0.0, 0.0);
    for j in around() {
        let way = shape.positions[j] - p;
        sum += normal.dot(&way);
        squares += way.norm_squared();
    }
    if squares == 0.0 {
        return;
    }
    let scale = 2.0 / squares;
    let weight = weight / (1.0 + (scale * sum * sharpest).powi(2));
    let own = (numbers[v], -scale * count as f64 * normal.norm_squared());
    let others = around()
        .filter(|&j| numbers[j] != u32::MAX)
        .map(|j| (numbers[j], scale * normal.dot(&shape.directions[j])));
    rows.push(weight, scale * sum, others.chain([own]));
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

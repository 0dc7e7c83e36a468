//! Searches all rotations: each is refined on the hulls' distance grids, and the best ones are kept. No random numbers
//! are used.

use super::body::{Body, REACH};
use super::motion::{Twist, displacement, moved, rotations};
use nalgebra::{Isometry3, Matrix6, Translation3, Vector3};
use rayon::prelude::*;

/// Rotations that are tried: 20 degrees apart.
const ROTATIONS: usize = 1500;
/// How many go on to the next round, and how many steps they are refined by in it.
const ROUNDS: [(usize, usize); 3] = [(1200, 2), (600, 4), (160, 8)];
/// How many are left.
const SURVIVORS: usize = 48;
/// The most that a step may turn by, in radians.
const MOST_TURN: f64 = 0.35;

/// A pose that the hulls do not rule out.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    /// Maps a point of the first body's rig into the second's.
    pub(super) pose: Isometry3<f64>,
    /// Mean distance between the hulls' surfaces, each beyond the reach counted as that, in metres.
    pub(super) cost: f64,
}

/// The best poses, each of them once, the best first.
pub(super) fn candidates(a: &Body, b: &Body) -> Vec<Candidate> {
    let starts: Vec<_> = rotations(ROTATIONS).collect();
    let start = |rotation: &nalgebra::UnitQuaternion<f64>| {
        let shift = b.center.coords - rotation * a.center.coords;
        let pose = Isometry3::from_parts(Translation3::from(shift), *rotation);
        rated(a, b, pose)
    };
    let mut found: Vec<Candidate> = starts.par_iter().map(start).collect();
    for (count, steps) in ROUNDS {
        best_first(&mut found);
        found.truncate(count);
        let refine = |c: &Candidate| rated(a, b, refined(a, b, c.pose, steps));
        found = found.par_iter().map(refine).collect();
    }
    best_first(&mut found);
    distinct(found, a)
}

fn best_first(candidates: &mut [Candidate]) {
    candidates.sort_by(|a, b| a.cost.total_cmp(&b.cost));
}

/// Candidates that do not lie within a few millimetres of a better one.
fn distinct(candidates: Vec<Candidate>, a: &Body) -> Vec<Candidate> {
    let apart = REACH * a.radius;
    let mut kept: Vec<Candidate> = Vec::new();
    for candidate in candidates {
        let is_known = |k: &Candidate| displacement(&k.pose, &candidate.pose, &a.surface) < apart;
        if !kept.iter().any(is_known) {
            kept.push(candidate);
        }
        if kept.len() == SURVIVORS {
            break;
        }
    }
    kept
}

fn rated(a: &Body, b: &Body, pose: Isometry3<f64>) -> Candidate {
    let reach = reach(a, b);
    let back = pose.inverse();
    let in_b = a.surface.iter().map(|p| b.field.at(pose * p).0);
    let in_a = b.surface.iter().map(|p| a.field.at(back * p).0);
    let sum: f64 = in_b.chain(in_a).map(|r| r.abs().min(reach)).sum();
    let cost = sum / (a.surface.len() + b.surface.len()).max(1) as f64;
    Candidate { pose, cost }
}

fn reach(a: &Body, b: &Body) -> f64 {
    REACH * a.radius.min(b.radius)
}

/// A pose after steps of robust Gauss–Newton.
fn refined(a: &Body, b: &Body, mut pose: Isometry3<f64>, steps: usize) -> Isometry3<f64> {
    let half = 0.5 * reach(a, b);
    let lever = 0.7 * b.radius;
    for _ in 0..steps {
        let mut normal = Matrix6::zeros();
        let mut right = Twist::zeros();
        let mut add = |r: f64, row: Twist| {
            let weight = 1.0 / (1.0 + (r / half).powi(2)).powi(2);
            normal.syger(weight, &row, &row, 1.0);
            right += row * (weight * r);
        };
        let row = |g: Vector3<f64>, arm: Vector3<f64>| {
            let turn = arm.cross(&g);
            Twist::new(g.x, g.y, g.z, turn.x, turn.y, turn.z)
        };
        let back = pose.inverse();
        for p in &a.surface {
            let x = pose * p;
            let (r, g) = b.field.at(x);
            add(r, row(g, x - b.center));
        }
        for p in &b.surface {
            let (r, g) = a.field.at(back * p);
            add(r, -row(pose.rotation * g, p - b.center));
        }
        normal.fill_upper_triangle_with_lower_triangle();
        let damping = 1e-3 * (0..3).map(|i| normal[(i, i)]).sum::<f64>() / 3.0;
        for i in 0..6 {
            normal[(i, i)] += damping * if i < 3 { 1.0 } else { lever * lever };
        }
        let Some(cholesky) = normal.cholesky() else {
            return pose;
        };
        let mut step = -cholesky.solve(&right);
        let turn = step.fixed_rows::<3>(3).norm();
        if turn > MOST_TURN {
            let shorter = step.fixed_rows::<3>(3) * (MOST_TURN / turn);
            step.fixed_rows_mut::<3>(3).copy_from(&shorter);
        }
        pose = moved(&pose, b.center, &step);
    }
    pose
}

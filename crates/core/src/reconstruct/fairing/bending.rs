//! How the surface bends at each vertex, and the equations that resist it. Knows no camera.

use super::shape::{Role, Shape};
use super::solve::Rows;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use std::f64::consts::SQRT_2;

/// Length in pixels over which a contour's noise is averaged: how much bending weighs against distances.
const STIFFNESS_PX: f64 = 6.0;
/// Share of the terms of a paraboloid's fit that holds it flat: four neighbours on a cross do not show the twist.
const HELD_FLAT: f64 = 0.2;
/// Where the surface bends within so many times the radius of sharp bends, along any line, its bends count together.
const TUBES: f64 = 2.0;
/// A vertex has no row for what would have less than this share of its weight.
const LEAST_SHARE: f64 = 0.05;

/// Which bends of the surface cost.
#[derive(Clone, Copy)]
pub(super) enum Bending {
    /// Their mean: what bends one way and as much the other way across costs nothing, and what bends one way in both
    /// directions most, so that the hull's roofs over flat sides go down.
    Mean,
    /// Each of them, so that the surface does not ripple beside its edges.
    Each,
}

/// Adds the rows that resist bending, less where the surface bends within the radius `sharpest`, in metres. For each
/// vertex `wanted` has the heights of its neighbours over its tangent plane, in metres, that cost nothing; where it has
/// none, that is the plane.
pub(super) fn resist(
    rows: &mut Rows,
    shape: &Shape,
    wanted: &[Vec<f64>],
    numbers: &[u32],
    (bending, sharpest): (Bending, f64),
) {
    let stiffness = STIFFNESS_PX.powi(3).sqrt();
    let vertices = || (0..shape.len()).into_par_iter();
    let bends: Vec<f64> = vertices()
        .map(|v| curvature(shape, v, &wanted[v]).map_or(0.0, |c| c.mean))
        .collect();
    let paraboloids: Vec<Option<Paraboloid>> = match bending {
        Bending::Mean => Vec::new(),
        Bending::Each => vertices().map(|v| Paraboloid::at(shape, v)).collect(),
    };
    for (v, area) in shape.areas().iter().enumerate() {
        let sharp = (along_a_line(shape, v, &bends) * sharpest).powi(2);
        let weight = stiffness * area.sqrt() / (1.0 + sharp).powi(2);
        let paraboloid = paraboloids.get(v).and_then(Option::as_ref);
        let apart = paraboloid.map_or(0.0, |p| p.share_apart(sharpest));
        if let Some(paraboloid) = paraboloid.filter(|_| apart > LEAST_SHARE) {
            let weight = weight * apart.sqrt();
            paraboloid.resist(rows, shape, v, weight, (&wanted[v], numbers));
        }
        if 1.0 - apart > LEAST_SHARE {
            let weight = weight * (1.0 - apart).sqrt();
            resist_mean(rows, shape, v, weight, (&wanted[v], numbers));
        }
    }
}

/// The mean curvature at a vertex, from the neighbours that count.
struct Curvature {
    /// Signed, in 1/m, less what is wanted: negative where the surface is convex.
    mean: f64,
    /// What the part along the normal of the sum over neighbours is multiplied by.
    scale: f64,
    /// Neighbours that count.
    count: usize,
}

/// Neighbours that count at a vertex: along the outline on the table, only those on it.
fn around(shape: &Shape, v: usize) -> impl Iterator<Item = usize> + '_ {
    let foot = shape.roles[v] == Role::Foot;
    let counts = move |j: &usize| !foot || shape.ends_at_foot(*j);
    shape.around(v).iter().map(|&j| j as usize).filter(counts)
}

/// The part along the normal of the sum over neighbours, divided by half the sum of their squared distances.
fn curvature(shape: &Shape, v: usize, wanted: &[f64]) -> Option<Curvature> {
    if !shape.moves(v) {
        return None;
    }
    let (p, normal) = (shape.positions[v], shape.directions[v]);
    let (mut sum, mut squares, mut count) = (0.0, 0.0, 0);
    for j in around(shape, v) {
        let way = shape.positions[j] - p;
        sum += normal.dot(&way);
        squares += way.norm_squared();
        count += 1;
    }
    let foot = shape.roles[v] == Role::Foot;
    if squares == 0.0 || count < 2 || foot && count != 2 {
        return None;
    }
    let scale = 2.0 / squares;
    Some(Curvature {
        mean: scale * (sum - wanted.iter().sum::<f64>()),
        scale,
        count,
    })
}

/// How strongly the surface bends at a vertex as part of an edge, in 1/m: no more than on both sides of it along some
/// line. A spike is sharper than any edge, but alone.
fn along_a_line(shape: &Shape, v: usize, bends: &[f64]) -> f64 {
    const OPPOSITE_COSINE: f64 = -0.7;
    let strength = |j: usize| match shape.roles[j] {
        Role::Edge => f64::INFINITY,
        _ => bends[j] * bends[v].signum(),
    };
    let p = shape.positions[v];
    let ways: Vec<(Vector3<f64>, f64)> = around(shape, v)
        .filter_map(|j| {
            let way = (shape.positions[j] - p).try_normalize(1e-12)?;
            Some((way, strength(j))).filter(|(_, strength)| *strength > 0.0)
        })
        .collect();
    let mut most = 0.0_f64;
    for (i, (way, strength)) in ways.iter().enumerate() {
        for (other, beyond) in &ways[..i] {
            if way.dot(other) < OPPOSITE_COSINE {
                most = most.max(strength.min(*beyond));
            }
        }
    }
    most.min(bends[v].abs())
}

/// The mean curvature at a vertex as a row. Along the outline on the table, the curvature of the outline.
fn resist_mean(
    rows: &mut Rows,
    shape: &Shape,
    v: usize,
    weight: f64,
    (wanted, numbers): (&[f64], &[u32]),
) {
    let Some(Curvature { mean, scale, count }) = curvature(shape, v, wanted) else {
        return;
    };
    let normal = shape.directions[v];
    let own = (numbers[v], -scale * count as f64 * normal.norm_squared());
    let others = around(shape, v)
        .filter(|&j| numbers[j] != u32::MAX)
        .map(|j| (numbers[j], scale * normal.dot(&shape.directions[j])));
    rows.push(weight, mean, others.chain([own]));
}

/// The paraboloid through a vertex that fits the heights of its neighbours over its tangent plane best.
struct Paraboloid {
    /// How much the height of each neighbour counts in the two bends and in the twist between them, in 1/m².
    shares: Vec<[f64; 3]>,
    /// The two bends, and the twist, in 1/m.
    bends: [f64; 3],
}

impl Paraboloid {
    /// Weights of the two bends and of the twist in the energy of plates, a quarter of the sum of the squared principal
    /// curvatures. Over a surface without a border that is the squared mean curvature, but for a constant.
    const WEIGHTS: [f64; 3] = [0.5, 0.5, 0.5 * SQRT_2];

    /// At a vertex that moves along the surface's normal.
    fn at(shape: &Shape, v: usize) -> Option<Self> {
        if !shape.moves(v) || shape.roles[v] == Role::Foot {
            return None;
        }
        let (p, normal) = (shape.positions[v], shape.directions[v]);
        let axis = Vector3::ith(normal.iamin(), 1.0);
        let first = normal.cross(&axis).normalize();
        let second = normal.cross(&first);
        let ways = || {
            let around = shape.around(v).iter();
            around.map(|&j| shape.positions[j as usize] - p)
        };
        let terms = ways().map(|way| {
            let (a, b) = (way.dot(&first), way.dot(&second));
            Vector3::new(0.5 * a * a, 0.5 * b * b, a * b)
        });
        let terms: Vec<Vector3<f64>> = terms.collect();
        let squares: Matrix3<f64> = terms.iter().map(|t| t * t.transpose()).sum();
        let held = Matrix3::identity() * (HELD_FLAT * squares.trace() / 3.0);
        let inverse = (squares + held).try_inverse()?;
        let shares: Vec<[f64; 3]> = terms.iter().map(|t| (inverse * t).into()).collect();
        let mut bends = [0.0; 3];
        for (way, share) in ways().zip(&shares) {
            let height = normal.dot(&way);
            bends
                .iter_mut()
                .zip(share)
                .for_each(|(b, s)| *b += s * height);
        }
        Some(Self { shares, bends })
    }

    /// The share in which the bends resist apart: not where the surface bends as sharply as a handle or a stem does,
    /// which are bent the other way along themselves.
    fn share_apart(&self, sharpest: f64) -> f64 {
        let [a, b, twist] = self.bends;
        let strongest = 0.5 * (a + b).abs() + (0.5 * (a - b)).hypot(twist);
        1.0 / (1.0 + (TUBES * sharpest * strongest).powi(4))
    }

    /// The bends and the twist as rows.
    fn resist(
        &self,
        rows: &mut Rows,
        shape: &Shape,
        v: usize,
        weight: f64,
        (wanted, numbers): (&[f64], &[u32]),
    ) {
        let normal = shape.directions[v];
        for (k, share) in Self::WEIGHTS.into_iter().enumerate() {
            let pairs = wanted.iter().zip(&self.shares);
            let wanted: f64 = pairs.map(|(height, shares)| height * shares[k]).sum();
            let own: f64 = -self.shares.iter().map(|shares| shares[k]).sum::<f64>();
            let around = shape.around(v).iter().zip(&self.shares);
            let others = around
                .map(|(&j, shares)| (j as usize, shares[k]))
                .filter(|(j, _)| numbers[*j] != u32::MAX)
                .map(|(j, share)| (numbers[j], share * normal.dot(&shape.directions[j])));
            let residual = self.bends[k] - wanted;
            rows.push(weight * share, residual, others.chain([(numbers[v], own)]));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;
    use nalgebra::Point3;
    use std::f64::consts::TAU;

    /// The radius of a ring's middle line, and of its tube.
    const RING: f64 = 0.08;
    const TUBE: f64 = 0.015;
    const AROUND: usize = 296;
    const ACROSS: usize = 48;

    /// A ring that floats over the table, of triangles whose sides are about equal.
    fn ring() -> Shape {
        let point = |i: usize| {
            let (row, column) = (i / ACROSS, i % ACROSS);
            let turn = TAU * row as f64 / AROUND as f64;
            let lift = TAU * (column as f64 + 0.5 * (row % 2) as f64) / ACROSS as f64;
            let radius = RING + TUBE * lift.cos();
            let z = 0.05 + TUBE * lift.sin();
            Point3::new(radius * turn.cos(), radius * turn.sin(), z).cast::<f32>()
        };
        let quad = |i: usize| {
            let (turn, lift) = (i / ACROSS, i % ACROSS);
            let at = |turn: usize, lift: usize| (turn % AROUND * ACROSS + lift % ACROSS) as u32;
            let [a, b] = [at(turn, lift), at(turn + 1, lift)];
            let [c, d] = [at(turn + 1, lift + 1), at(turn, lift + 1)];
            match turn % 2 {
                0 => [[a, b, d], [b, c, d]],
                _ => [[a, b, c], [a, c, d]],
            }
        };
        let mesh = Mesh {
            vertices: (0..AROUND * ACROSS).map(point).collect(),
            triangles: (0..AROUND * ACROSS).flat_map(quad).collect(),
        };
        Shape::new(&mesh, 0.0, 1e-4)
    }

    /// A vertex where the ring bends both ways, and one where it bends one way.
    const INNERMOST: usize = ACROSS / 2;
    const OUTERMOST: usize = 0;

    #[test]
    fn the_two_bends_of_a_ring_are_told_apart() {
        let shape = ring();
        for (v, along) in [
            (INNERMOST, 1.0 / (RING - TUBE)),
            (OUTERMOST, -1.0 / (RING + TUBE)),
        ] {
            let [a, b, twist] = Paraboloid::at(&shape, v).unwrap().bends;
            let (middle, apart) = (0.5 * (a + b), (0.5 * (a - b)).hypot(twist));
            // What holds the fit flat takes some of each.
            let is_most_of = |found: f64, bend: f64| (0.6..=1.0).contains(&(found / bend));
            let across = -1.0 / TUBE;
            assert!(is_most_of(middle, 0.5 * (across + along)), "{middle}");
            assert!(is_most_of(apart, 0.5 * (along - across)), "{apart}");
        }
    }

    /// The sum of the squares of a problem's rows where nothing moves.
    fn cost(shape: &Shape, wanted: &[Vec<f64>], bending: Bending) -> f64 {
        let mut rows = Rows::default();
        let numbers: Vec<u32> = (0..shape.len() as u32).collect();
        resist(&mut rows, shape, wanted, &numbers, (bending, 0.0));
        rows.cost()
    }

    #[test]
    fn what_bends_both_ways_costs_more_where_bends_cost_apart() {
        let shape = ring();
        let flat = vec![Vec::new(); shape.len()];
        let mean = cost(&shape, &flat, Bending::Mean);
        let each = cost(&shape, &flat, Bending::Each);
        // Over a closed ring the two are the same, but for what holds the fits flat.
        assert!((0.5..1.0).contains(&(each / mean)), "{each} {mean}");
        let at = |v: usize| {
            let [a, b, twist] = Paraboloid::at(&shape, v).unwrap().bends;
            0.25 * (a * a + b * b + 2.0 * twist * twist) / (0.25 * (a + b).powi(2))
        };
        assert!(at(INNERMOST) > 1.1, "{}", at(INNERMOST));
        assert!(at(OUTERMOST) < 0.9, "{}", at(OUTERMOST));
    }

    #[test]
    fn the_form_that_is_wanted_costs_nothing() {
        let shape = ring();
        let heights = |v: usize| {
            let (p, normal) = (shape.positions[v], shape.directions[v]);
            let around = shape.around(v).iter();
            let height = |&j: &u32| normal.dot(&(shape.positions[j as usize] - p));
            around.map(height).collect()
        };
        let wanted: Vec<Vec<f64>> = (0..shape.len()).map(heights).collect();
        for bending in [Bending::Mean, Bending::Each] {
            let flat = cost(&shape, &vec![Vec::new(); shape.len()], bending);
            let left = cost(&shape, &wanted, bending);
            assert!(left < 1e-12 * flat, "{left} of {flat}");
        }
    }

    #[test]
    fn on_a_thin_tube_bends_count_together() {
        let paraboloid = Paraboloid::at(&ring(), INNERMOST).unwrap();
        assert!(paraboloid.share_apart(0.2 * TUBE) > 0.9);
        assert!(paraboloid.share_apart(2.0 * TUBE) < 0.1);
    }
}

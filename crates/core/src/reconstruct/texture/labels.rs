//! Decides which camera paints which triangle: the one that sees it best, balanced against borders between cameras
//! (Lempitsky and Ivanov 2007, equation 1, solved by iterated conditional modes); then merges small regions.

use super::visibility::{Visibility, facing};
use super::{Parameters, Surface};
use crate::array::three;
use crate::mesh::NO_TRIANGLE;
use nalgebra::Point3;
use rayon::prelude::*;

/// The label of a triangle that no camera sees.
pub(super) const UNSEEN: u16 = u16::MAX;

/// Weight of a view that is marginal at a corner, relative to a safe one.
const MARGINAL: f32 = 0.02;
/// Weight of a depth camera's colour relative to a colour camera's.
pub(super) const DEPTH_COLOR: f32 = 0.1;
/// Cost of a border between views of two captures, in that between two of one: light is fixed to the rig, so that the
/// shading changes there, and poses err.
const BETWEEN_CAPTURES: f32 = 2.0;
/// Sweeps over all triangles at most; labels settle sooner.
const SWEEPS: usize = 10;
/// Rounds of merging small regions.
const MERGES: usize = 3;

/// For each triangle the view that paints it, or [`UNSEEN`].
pub(super) fn choose(surface: &Surface, parameters: &Parameters) -> Vec<u16> {
    let scores = Scores::new(surface);
    let across = &surface.across;
    let mut labels = scores.best();
    let captures: Vec<u16> = surface.views.iter().map(|view| view.capture).collect();
    let borders = Borders {
        smoothness: parameters.smoothness,
        captures: &captures,
    };
    for _ in 0..SWEEPS {
        if !sweep(&mut labels, &scores, across, &borders) {
            break;
        }
    }
    for _ in 0..MERGES {
        if !merge_small(
            &mut labels,
            &scores,
            across,
            parameters.smallest_chart_faces,
        ) {
            break;
        }
    }
    labels
}

/// How well each view sees each triangle, as a share of the best: 0 is not at all.
struct Scores {
    views: usize,
    triangles: usize,
    values: Vec<f32>,
}

impl Scores {
    fn new(surface: &Surface) -> Self {
        let views = surface.views.len().min(usize::from(UNSEEN));
        let triangles = surface.mesh.triangles.len();
        let mut values = vec![0.0; views * triangles];
        if views > 0 {
            let rows = values.par_chunks_mut(views).enumerate();
            rows.for_each(|(triangle, row)| fill_row(surface, triangle, row));
        }
        Self {
            views,
            triangles,
            values,
        }
    }

    fn row(&self, triangle: usize) -> &[f32] {
        &self.values[triangle * self.views..(triangle + 1) * self.views]
    }

    /// What painting a triangle from a view loses, 0 to 1; infinite where the view does not see it.
    fn cost(&self, triangle: usize, label: u16) -> f32 {
        match self.row(triangle).get(usize::from(label)) {
            Some(&score) if score > 0.0 => 1.0 - score,
            _ => f32::INFINITY,
        }
    }

    fn best(&self) -> Vec<u16> {
        let best_of = |row: &[f32]| {
            let mut best = (0.0, UNSEEN);
            for (label, &score) in row.iter().enumerate() {
                if score > best.0 {
                    best = (score, label as u16);
                }
            }
            best.1
        };
        (0..self.triangles).map(|t| best_of(self.row(t))).collect()
    }
}

/// Scores one triangle: the cosine of the viewing angle times the area it covers in the picture.
fn fill_row(surface: &Surface, triangle: usize, row: &mut [f32]) {
    let t = surface.mesh.triangles[triangle];
    let corners = surface.mesh.corners(triangle);
    let plane = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
    let normal = t.map(|v| surface.normals[v as usize]).iter().sum();
    let middle = Point3::from((corners[0].coords + corners[1].coords + corners[2].coords) / 3.0);
    for (view, score) in row.iter_mut().enumerate() {
        let sights = three(|i| surface.sights[view][t[i] as usize]);
        let worst = sights.into_iter().min().unwrap_or(Visibility::Hidden);
        let view = &surface.views[view];
        let cosine = facing(view.center, middle, normal) / normal.norm().max(1e-6);
        if worst == Visibility::Hidden || plane.dot(&(view.center - middle)) <= 0.0 || cosine <= 0.0
        {
            continue;
        }
        let depth = t.map(|v| view.projected[v as usize][2]).iter().sum::<f32>() / 3.0;
        let resolution = view.focal_px / depth;
        let trust = if worst == Visibility::Safe {
            1.0
        } else {
            MARGINAL
        };
        let kind = if view.is_depth { DEPTH_COLOR } else { 1.0 };
        *score = resolution * resolution * cosine * cosine * trust * kind;
    }
    let ranks = row
        .iter()
        .zip(&surface.views)
        .filter(|(score, _)| **score > 0.0);
    let first = ranks.map(|(_, view)| view.rank).min().unwrap_or(0);
    for (score, view) in row.iter_mut().zip(&surface.views) {
        if view.rank > first {
            *score = 0.0;
        }
    }
    let best = row.iter().copied().fold(0.0, f32::max);
    if best > 0.0 {
        row.iter_mut().for_each(|score| *score /= best);
    }
}

/// What borders between views cost.
struct Borders<'a> {
    smoothness: f32,
    /// For each view its capture.
    captures: &'a [u16],
}

impl Borders<'_> {
    /// The cost of a label among those of the triangles around.
    fn cost(&self, label: u16, around: &[u16; 3]) -> f32 {
        let capture = |label: u16| self.captures.get(usize::from(label));
        let others = around.iter().filter(|&&l| l != UNSEEN && l != label);
        let each = others.map(|&other| {
            if capture(other) == capture(label) {
                1.0
            } else {
                BETWEEN_CAPTURES
            }
        });
        self.smoothness / 3.0 * each.sum::<f32>()
    }
}

/// Gives each triangle the cheapest label among its own and its neighbours'; tells whether anything changed.
fn sweep(labels: &mut [u16], scores: &Scores, across: &[[u32; 3]], borders: &Borders) -> bool {
    let mut changed = false;
    for triangle in 0..labels.len() {
        let own = labels[triangle];
        if own == UNSEEN {
            continue;
        }
        let around = three(|i| {
            let neighbour = across[triangle][i] as usize;
            labels.get(neighbour).copied().unwrap_or(UNSEEN)
        });
        if around.iter().all(|&label| label == own) {
            continue;
        }
        let cost = |label: u16| scores.cost(triangle, label) + borders.cost(label, &around);
        let mut best = (cost(own), own);
        for label in around {
            let cost = cost(label);
            if cost < best.0 {
                best = (cost, label);
            }
        }
        labels[triangle] = best.1;
        changed |= best.1 != own;
    }
    changed
}

/// Connected regions of one label, in the order of their first triangles.
pub(super) fn regions(labels: &[u16], across: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let mut done = vec![false; labels.len()];
    let mut regions = Vec::new();
    for first in 0..labels.len() {
        if done[first] {
            continue;
        }
        done[first] = true;
        let mut region = vec![first as u32];
        let mut next = 0;
        while let Some(&triangle) = region.get(next) {
            next += 1;
            for n in across[triangle as usize] {
                if n != NO_TRIANGLE && !done[n as usize] && labels[n as usize] == labels[first] {
                    done[n as usize] = true;
                    region.push(n);
                }
            }
        }
        regions.push(region);
    }
    regions
}

/// Gives each small region to the neighbour with the longest common border that sees all of it.
fn merge_small(labels: &mut [u16], scores: &Scores, across: &[[u32; 3]], smallest: usize) -> bool {
    let mut changed = false;
    for region in regions(labels, across) {
        let own = labels[region[0] as usize];
        if own == UNSEEN || region.len() >= smallest {
            continue;
        }
        let sees_all = |label: u16| {
            let mut cost = region.iter().map(|&t| scores.cost(t as usize, label));
            cost.all(f32::is_finite)
        };
        let candidates = borders(&region, own, labels, across);
        let fit = candidates
            .into_iter()
            .map(|(label, _)| label)
            .find(|&l| sees_all(l));
        if let Some(label) = fit {
            region.iter().for_each(|&t| labels[t as usize] = label);
            changed = true;
        }
    }
    changed
}

/// The labels around a region with the lengths of their borders in triangles, the longest first.
fn borders(region: &[u32], own: u16, labels: &[u16], across: &[[u32; 3]]) -> Vec<(u16, usize)> {
    let mut lengths: Vec<(u16, usize)> = Vec::new();
    for &triangle in region {
        for n in across[triangle as usize] {
            let Some(&label) = labels.get(n as usize) else {
                continue;
            };
            if label == own || label == UNSEEN {
                continue;
            }
            match lengths.iter_mut().find(|(l, _)| *l == label) {
                Some((_, length)) => *length += 1,
                None => lengths.push((label, 1)),
            }
        }
    }
    lengths.sort_by_key(|&(label, length)| (std::cmp::Reverse(length), label));
    lengths
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_border_between_captures_costs_twice_one_between_cameras() {
        // The third view is another capture's.
        let borders = Borders {
            smoothness: 0.3,
            captures: &[0, 0, 1],
        };
        let cost = |around: [u16; 3]| borders.cost(0, &around);
        let between_cameras = cost([1, 1, UNSEEN]);
        assert!((between_cameras - 0.2).abs() < 1e-6, "{between_cameras}");
        let between_captures = cost([2, 2, UNSEEN]);
        assert!((between_captures - 0.4).abs() < 1e-6, "{between_captures}");
        assert_eq!(cost([0, UNSEEN, 0]), 0.0);
    }
}

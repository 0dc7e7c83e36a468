//! Colours of vertices. Where no camera looks they are grey, or spread from what is seen: ring by ring, then smoothed
//! until they span the gap like a membrane.

use super::blend::Blend;
use super::{Surface, Unseen};
use nalgebra::Vector3;

/// Colour of what nobody saw.
pub(super) const NEUTRAL: Vector3<f32> = Vector3::new(128.0, 128.0, 128.0);
/// Smoothing passes over unseen vertices.
const PASSES: usize = 30;

/// The colour of each vertex, sRGB-encoded, 0 to 255.
pub(super) fn vertex_colors(
    surface: &Surface,
    blend: &Blend,
    samples: &[Vec<Vector3<f32>>],
    unseen: Unseen,
) -> Vec<Vector3<f32>> {
    let count = surface.mesh.vertices.len();
    let mut colors = Vec::with_capacity(count);
    let mut known = Vec::with_capacity(count);
    for v in 0..count {
        let mut color = Vector3::zeros();
        for share in blend.of(v) {
            let sample = samples[usize::from(share.label)][v];
            color += (sample + share.known_offset()) * share.weight;
        }
        known.push(blend.of(v).next().is_some());
        let is_grey = !known[v] && unseen == Unseen::Neutral;
        colors.push(if is_grey {
            NEUTRAL
        } else {
            color.map(|c| c.clamp(0.0, 255.0))
        });
    }
    if unseen == Unseen::Continued {
        spread(surface, &mut colors, &mut known);
    }
    colors
}

/// Fills unknown colours from known ones.
fn spread(surface: &Surface, colors: &mut [Vector3<f32>], known: &mut [bool]) {
    let unknown: Vec<usize> = (0..known.len()).filter(|&v| !known[v]).collect();
    let mut front: Vec<usize> = unknown
        .iter()
        .copied()
        .filter(|&v| surface.rings.neighbors(v).any(|n| known[n]))
        .collect();
    while !front.is_empty() {
        // The whole ring is computed from the one before it, so that no direction is favoured.
        let ring: Vec<_> = front
            .iter()
            .map(|&v| mean(surface, colors, v, |n| known[n]))
            .collect();
        for (&v, color) in front.iter().zip(ring) {
            colors[v] = color;
            known[v] = true;
        }
        let around = front.iter().flat_map(|&v| surface.rings.neighbors(v));
        let mut next: Vec<usize> = around.filter(|&n| !known[n]).collect();
        next.sort_unstable();
        next.dedup();
        front = next;
    }
    let fallback = mean_of_known(colors, known);
    for &v in unknown.iter().filter(|&&v| !known[v]) {
        colors[v] = fallback;
    }
    for _ in 0..PASSES {
        let smooth: Vec<_> = unknown
            .iter()
            .map(|&v| mean(surface, colors, v, |_| true))
            .collect();
        for (&v, color) in unknown.iter().zip(smooth) {
            colors[v] = color;
        }
    }
}

fn mean_of_known(colors: &[Vector3<f32>], known: &[bool]) -> Vector3<f32> {
    let count = known.iter().filter(|&&k| k).count();
    if count == 0 {
        return NEUTRAL;
    }
    let sum: Vector3<f32> = colors
        .iter()
        .zip(known)
        .filter(|(_, k)| **k)
        .map(|(c, _)| c)
        .sum();
    sum / count as f32
}

/// Mean colour of the neighbours that `counts` lets pass; the vertex' own where there is none.
fn mean(
    surface: &Surface,
    colors: &[Vector3<f32>],
    vertex: usize,
    counts: impl Fn(usize) -> bool,
) -> Vector3<f32> {
    let (mut sum, mut count) = (Vector3::zeros(), 0.0);
    for n in surface.rings.neighbors(vertex).filter(|&n| counts(n)) {
        sum += colors[n];
        count += 1.0;
    }
    if count > 0.0 {
        sum / count
    } else {
        colors[vertex]
    }
}

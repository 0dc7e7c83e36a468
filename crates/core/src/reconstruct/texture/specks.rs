//! Charts of a few texels. Their gutters would cost more of the atlas than they show, so each takes the colour at one
//! place of a chart beside it. This file decides which ones and where; `charts` makes no chart of them.

use super::Surface;
use super::labels::{UNSEEN, regions};
use crate::mesh::NO_TRIANGLE;

/// Texels below which a region is no chart of its own, at the pictures' resolution.
const SPECK_TEXELS: f32 = 16.0;

/// A triangle's corner: the triangle's index, and which of its corners.
pub(super) type Corner = (u32, usize);

/// Small regions, each with the corner whose colour its triangles take.
pub(super) type Specks = Vec<(Vec<u32>, Corner)>;

/// Finds the regions that are too small for a chart. Those without a chart beside them, not even one behind other
/// specks, become [`UNSEEN`].
pub(super) fn find(surface: &Surface, labels: &mut [u16]) -> Specks {
    let is_speck = |region: &Vec<u32>| {
        let label = labels[region[0] as usize];
        label != UNSEEN && texels(surface, label, region) < SPECK_TEXELS
    };
    let mut waiting: Vec<Vec<u32>> = regions(labels, &surface.across);
    waiting.retain(is_speck);
    // For each triangle the corner whose colour it takes: that of a chart is its own.
    let mut lent: Vec<Option<Corner>> = vec![None; labels.len()];
    let mut has_chart: Vec<bool> = labels.iter().map(|&label| label != UNSEEN).collect();
    for &triangle in waiting.iter().flatten() {
        has_chart[triangle as usize] = false;
    }
    let mut specks = Specks::new();
    loop {
        let known = specks.len();
        waiting.retain(|region| {
            let Some(corner) = beside(surface, region, &has_chart, &lent) else {
                return true;
            };
            region.iter().for_each(|&t| lent[t as usize] = Some(corner));
            specks.push((region.clone(), corner));
            false
        });
        if specks.len() == known {
            break;
        }
    }
    for &triangle in waiting.iter().flatten() {
        labels[triangle as usize] = UNSEEN;
    }
    specks
}

/// Texels that a region covers in the picture of its view.
fn texels(surface: &Surface, label: u16, region: &[u32]) -> f32 {
    let projected = &surface.views[usize::from(label)].projected;
    let area = |&triangle: &u32| {
        let corners = surface.mesh.triangles[triangle as usize];
        let [a, b, c] = corners.map(|v| projected[v as usize]);
        0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])).abs()
    };
    region.iter().map(area).sum()
}

/// A corner that a region has in common with a chart beside it, or that another speck took.
fn beside(
    surface: &Surface,
    region: &[u32],
    has_chart: &[bool],
    lent: &[Option<Corner>],
) -> Option<Corner> {
    let mut sides = region.iter().flat_map(|&triangle| {
        let across = surface.across[triangle as usize].into_iter();
        across
            .filter(|&n| n != NO_TRIANGLE)
            .map(move |n| (triangle, n))
    });
    sides.find_map(|(own, other)| {
        if !has_chart[other as usize] {
            return lent[other as usize];
        }
        let corners = surface.mesh.triangles[own as usize];
        let others = surface.mesh.triangles[other as usize];
        let shared = others.iter().position(|v| corners.contains(v))?;
        Some((other, shared))
    })
}

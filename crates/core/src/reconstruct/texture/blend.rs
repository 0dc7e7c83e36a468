//! Hides the borders between cameras, in two bands (Burt and Adelson 1983; on surfaces Baumberg 2002). The smooth
//! part comes from the mean of all cameras, so that it has no borders; the sharp part comes from the best camera,
//! mixed with its neighbour in a narrow band.

use super::labels::{DEPTH_COLOR, UNSEEN};
use super::view::View;
use super::visibility::{Visibility, facing};
use super::{Parameters, Surface};
use nalgebra::Vector3;
use rayon::prelude::*;

/// Views that are mixed at one vertex, at most.
const MOST: usize = 4;

/// Weight of a view in the mean of all, relative to one of the next lower rank. It is not nothing, so that the mean has
/// no step where the views of the lower rank fade.
const HIGHER_RANK: f32 = 0.01;

/// What one view gives to a vertex' colour.
#[derive(Clone, Copy, Debug)]
pub(super) struct Share {
    /// The view, or [`UNSEEN`] for none.
    pub label: u16,
    /// Its weight; a vertex' weights add up to 1.
    pub weight: f32,
    /// The correction that is added to its evened out colour.
    pub offset: Vector3<f32>,
}

const NO_SHARE: Share = Share {
    label: UNSEEN,
    weight: 0.0,
    offset: Vector3::new(0.0, 0.0, 0.0),
};

/// For each vertex the views that it is painted from.
pub(super) struct Blend {
    shares: Vec<[Share; MOST]>,
}

impl Blend {
    /// Spreads the triangles' labels over vertices, widens borders into bands, and levels what is smooth.
    pub(super) fn new(
        surface: &Surface,
        labels: &[u16],
        samples: &[Vec<Vector3<f32>>],
        parameters: &Parameters,
    ) -> Self {
        let vertices = 0..surface.mesh.vertices.len();
        let own: Vec<_> = vertices
            .into_par_iter()
            .map(|v| own_shares(surface, labels, v))
            .collect();
        let mut blend = Self { shares: own };
        for _ in 0..parameters.feather_rings {
            blend.shares = blend.feathered(surface);
        }
        if parameters.level_rings > 0 {
            blend.set_offsets(surface, samples);
            for _ in 0..parameters.level_rings {
                blend.smooth_offsets(surface);
            }
        }
        blend
    }

    /// The views that a vertex is painted from; none if nothing around it is seen.
    pub(super) fn of(&self, vertex: usize) -> impl Iterator<Item = &Share> {
        self.shares[vertex].iter().take_while(|s| s.label != UNSEEN)
    }

    /// One more ring of mixing: each vertex takes the mean of the weights around it, of views that see it.
    fn feathered(&self, surface: &Surface) -> Vec<[Share; MOST]> {
        let mixed = |v: usize| {
            let own = self.shares[v];
            let alone = |s: &[Share; MOST]| s[1].label == UNSEEN && s[0].label == own[0].label;
            let calm = alone(&own) && surface.rings.neighbors(v).all(|n| alone(&self.shares[n]));
            if calm || own[0].label == UNSEEN {
                return own;
            }
            let mut mix = LabelWeights::default();
            for share in self.of(v) {
                mix.add(share.label, share.weight);
            }
            for share in surface.rings.neighbors(v).flat_map(|n| self.of(n)) {
                let known = own.iter().any(|s| s.label == share.label);
                if known || surface.sights[usize::from(share.label)][v] == Visibility::Safe {
                    mix.add(share.label, share.weight);
                }
            }
            mix.into_shares()
        };
        let vertices = 0..self.shares.len();
        vertices.into_par_iter().map(mixed).collect()
    }

    /// What lies between each view's colour and the mean of all views that see the vertex well.
    fn set_offsets(&mut self, surface: &Surface, samples: &[Vec<Vector3<f32>>]) {
        self.shares
            .par_iter_mut()
            .enumerate()
            .for_each(|(v, shares)| {
                if shares[0].label == UNSEEN {
                    return;
                }
                let mean = mean_color(surface, samples, v);
                for share in shares.iter_mut().take_while(|s| s.label != UNSEEN) {
                    let view = usize::from(share.label);
                    let safe = surface.sights[view][v] == Visibility::Safe;
                    // Unknown colours are filled in from neighbours later.
                    let offset = mean.filter(|_| safe).map(|m| m - samples[view][v]);
                    share.offset = offset.unwrap_or(UNKNOWN);
                }
            });
    }

    /// The mean of the known offsets of the same view around each vertex.
    fn smooth_offsets(&mut self, surface: &Surface) {
        let smoothed = |v: usize| {
            let mut shares = self.shares[v];
            for share in shares.iter_mut().take_while(|s| s.label != UNSEEN) {
                let same = |n: usize| self.of(n).find(|s| s.label == share.label);
                let around = surface.rings.neighbors(v).filter_map(same);
                let (mut sum, mut count) = (Vector3::zeros(), 0.0);
                for offset in around.map(|s| s.offset).chain([share.offset]) {
                    if offset.x.is_finite() {
                        sum += offset;
                        count += 1.0;
                    }
                }
                if count > 0.0 {
                    share.offset = sum / count;
                }
            }
            shares
        };
        let vertices = 0..self.shares.len();
        self.shares = vertices.into_par_iter().map(smoothed).collect();
    }
}

/// An offset that nothing is known of.
const UNKNOWN: Vector3<f32> = Vector3::new(f32::NAN, f32::NAN, f32::NAN);

impl Share {
    /// The offset, nothing where it is unknown.
    pub(super) fn known_offset(&self) -> Vector3<f32> {
        if self.offset.x.is_finite() {
            self.offset
        } else {
            Vector3::zeros()
        }
    }
}

/// The labels around a vertex, by the number of triangles that have them.
fn own_shares(surface: &Surface, labels: &[u16], vertex: usize) -> [Share; MOST] {
    let mut mix = LabelWeights::default();
    for triangle in surface.rings.triangles(vertex) {
        if labels[triangle] != UNSEEN {
            mix.add(labels[triangle], 1.0);
        }
    }
    mix.into_shares()
}

/// The mean of all evened out colours of a vertex by views that see it well, weighted towards those that see
/// it head-on and near, fading to nothing where a view begins to be marginal. What may not paint there hardly counts.
fn mean_color(
    surface: &Surface,
    samples: &[Vec<Vector3<f32>>],
    vertex: usize,
) -> Option<Vector3<f32>> {
    let is_safe = |view: &usize| surface.sights[*view][vertex] == Visibility::Safe;
    let safe = || (0..surface.views.len()).filter(is_safe);
    let first = safe().map(|view| surface.views[view].rank).min()?;
    let (mut sum, mut weights) = (Vector3::zeros(), 0.0);
    for view in safe() {
        let sample = samples[view][vertex];
        let view = &surface.views[view];
        let p = surface.mesh.vertices[vertex];
        let cosine = facing(view.center, p, surface.normals[vertex]);
        let resolution = view.focal_px / view.projected[vertex][2];
        let weight = ((cosine - super::visibility::MARGINAL_BELOW).max(1e-3) * resolution).powi(2);
        let weight = weight * precedence(view, first);
        sum += sample * weight;
        weights += weight;
    }
    (weights > 0.0).then(|| sum / weights)
}

/// How much a view counts by its kind and its rank, where `first` is the least rank of those that see the same.
fn precedence(view: &View, first: u8) -> f32 {
    let kind = if view.is_depth { DEPTH_COLOR } else { 1.0 };
    kind * HIGHER_RANK.powi(i32::from(view.rank - first))
}

/// Sums up the weight of each label. Labels beyond twice [`MOST`] are ignored, whatever their weight.
#[derive(Default)]
struct LabelWeights {
    entries: [(u16, f32); 2 * MOST],
    length: usize,
}

impl LabelWeights {
    fn add(&mut self, label: u16, weight: f32) {
        let known = &mut self.entries[..self.length];
        if let Some(entry) = known.iter_mut().find(|e| e.0 == label) {
            entry.1 += weight;
        } else if self.length < self.entries.len() {
            self.entries[self.length] = (label, weight);
            self.length += 1;
        }
    }

    /// The heaviest labels, their weights made to add up to 1.
    fn into_shares(mut self) -> [Share; MOST] {
        let entries = &mut self.entries[..self.length];
        entries.sort_unstable_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        let kept = &entries[..entries.len().min(MOST)];
        let sum: f32 = kept.iter().map(|e| e.1).sum();
        let mut shares = [NO_SHARE; MOST];
        for (share, &(label, weight)) in shares.iter_mut().zip(kept) {
            *share = Share {
                label,
                weight: weight / sum,
                ..NO_SHARE
            };
        }
        shares
    }
}

//! Measures what a depth camera contributed: how much of the concave regions it read, and how well the model agrees
//! with its readings there.

use crate::frame::CameraId;
use crate::image::Grid;
use crate::mesh::{Fragment, Mesh, rasterize_closed};
use crate::reconstruct::depth::{DepthKind, Facts};
use crate::reconstruct::region::{BesideRegions, Bias, InFrontOfHull, OutlineOffset};
use crate::reconstruct::{DepthResult, DepthView};
use crate::statistics::{nearest_rank_quantile, upper_median};
use serde::Serialize;

/// The figures of one depth camera.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DepthMeasures {
    /// The camera.
    pub camera: CameraId,
    /// What the enhancement found.
    pub facts: Facts,
    /// Pixels of the hull's front with a reading that counts, over all of the hull's front.
    pub coverage: f64,
    /// What its depth is off by.
    pub bias: Bias,
    /// The bias that the calibration leaves possible, in metres; `None` where the recording does not say.
    pub stated_uncertainty: Option<f64>,
    /// Standard deviation of the difference between depth and hull, in metres: the paper's sigma F.
    pub sigma_difference: f64,
    /// How far the object's outline, as it was read, is from that of the colour cameras' hull; `None` where that cannot
    /// be told.
    pub outline: Option<OutlineOffset>,
    /// How far its readings lie from the hull where the model stays the hull; `None` where that cannot be told.
    pub beside_regions: Option<BesideRegions>,
    /// What it read in front of the hull; `None` where that cannot be told.
    pub in_front_of_hull: Option<InFrontOfHull>,
    /// Its concave regions and the free space that it sees; `None` where it has neither.
    pub regions: Option<RegionMeasures>,
}

/// All regions of one depth camera: the hollows, and the free space that it sees through what the hull claims.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RegionMeasures {
    /// How many.
    pub count: usize,
    /// How many of them are free space and not a hollow.
    pub free_space_count: usize,
    /// The pixels of these.
    pub free_space_pixels: usize,
    /// Their pixels.
    pub pixels: usize,
    /// Their share of the hull's front.
    pub share: f64,
    /// Share of their pixels with a reading that counts.
    pub coverage: f64,
    /// Share of their pixels whose depth was carried over from around.
    pub filled: f64,
    /// Share of their pixels without any depth.
    pub empty: f64,
    /// Depth behind the hull in metres: the median of the regions, …
    pub median_depth: f64,
    /// … and what one pixel in 50 exceeds.
    pub greatest_depth: f64,
    /// Model behind measured depth (less its bias) in metres: the median, …
    pub model_behind_depth: f64,
    /// … and what nine of ten pixels are within of zero; both 0 where nothing was measured.
    pub disagreement: f64,
}

impl DepthMeasures {
    /// Measures one depth camera.
    pub fn of(view: &DepthView, result: &DepthResult, model: &Mesh) -> Self {
        let DepthResult {
            enhanced,
            regions,
            outline,
            beside_regions,
            in_front_of_hull,
        } = result;
        let kinds = enhanced.kind.pixels();
        let front = regions.front.is_front.pixels();
        let front_pixels = front.iter().filter(|&&f| f).count();
        let read = front
            .iter()
            .zip(kinds)
            .filter(|&(&front, &kind)| front && kind == DepthKind::Measured)
            .count();
        let stated = view.camera.response.uncertainty;
        Self {
            camera: view.camera.camera.id.clone(),
            facts: enhanced.facts,
            coverage: share(read, front_pixels),
            bias: regions.bias,
            stated_uncertainty: (stated > 0.0).then_some(stated),
            sigma_difference: f64::from(regions.sigma_difference),
            outline: *outline,
            beside_regions: *beside_regions,
            in_front_of_hull: *in_front_of_hull,
            regions: (regions.count > 0)
                .then(|| RegionMeasures::of(view, result, model, front_pixels)),
        }
    }
}

#[cfg(test)]
impl DepthMeasures {
    /// Of a depth camera without a reading.
    pub(in crate::report) fn nothing(camera: CameraId) -> Self {
        use crate::reconstruct::region::BiasSource;
        Self {
            camera,
            facts: Facts::default(),
            coverage: 0.0,
            bias: Bias {
                metres: 0.0,
                found: 0.0,
                remaining: 0.0,
                source: BiasSource::None,
                table: 0.0,
            },
            stated_uncertainty: None,
            sigma_difference: 0.0,
            outline: None,
            beside_regions: None,
            in_front_of_hull: None,
            regions: None,
        }
    }
}

impl RegionMeasures {
    fn of(view: &DepthView, result: &DepthResult, model: &Mesh, front_pixels: usize) -> Self {
        let DepthResult {
            enhanced, regions, ..
        } = result;
        let inside: Vec<usize> = (0..regions.labels.pixels().len())
            .filter(|&i| regions.labels.pixels()[i] != 0)
            .collect();
        let kind = |wanted: DepthKind| {
            let of_kind = |&&i: &&usize| enhanced.kind.pixels()[i] == wanted;
            inside.iter().filter(of_kind).count()
        };
        let mut behind_hull: Vec<f32> = inside
            .iter()
            .map(|&i| regions.difference.pixels()[i])
            .filter(|f| f.is_finite())
            .collect();
        let mut off = differences(view, result, model, &inside);
        let middle = upper_median(&mut off).unwrap_or(0.0);
        off.iter_mut().for_each(|d| *d = d.abs());
        let free_space = regions.free_space();
        Self {
            count: regions.count,
            free_space_count: free_space.len(),
            free_space_pixels: free_space.iter().sum(),
            pixels: inside.len(),
            // Free space may lie where the hull faces away, beyond its front.
            share: share(inside.len(), front_pixels).min(1.0),
            coverage: share(kind(DepthKind::Measured), inside.len()),
            filled: share(kind(DepthKind::Filled), inside.len()),
            empty: share(kind(DepthKind::None), inside.len()),
            median_depth: f64::from(upper_median(&mut behind_hull).unwrap_or(0.0)),
            greatest_depth: f64::from(nearest_rank_quantile(&mut behind_hull, 0.98).unwrap_or(0.0)),
            model_behind_depth: f64::from(middle),
            disagreement: f64::from(nearest_rank_quantile(&mut off, 0.9).unwrap_or(0.0)),
        }
    }
}

/// Depth of the model less what was measured there, in metres.
fn differences(view: &DepthView, result: &DepthResult, model: &Mesh, inside: &[usize]) -> Vec<f32> {
    let drawn = draw(view, model);
    let bias = result.regions.bias.metres as f32;
    let depth = |&i: &usize| {
        let measured = result.enhanced.kind.pixels()[i] == DepthKind::Measured;
        let Fragment { depth, triangle: _ } = drawn.pixels()[i];
        let off = depth - (result.enhanced.depth.pixels()[i] - bias);
        (measured && off.is_finite()).then_some(off)
    };
    inside.iter().filter_map(depth).collect()
}

fn draw(view: &DepthView, model: &Mesh) -> Grid<Fragment> {
    let lens = &view.camera.camera.intrinsics;
    let project = |&v| view.camera.project_for_raster(v);
    let projected: Vec<_> = model.vertices.iter().map(project).collect();
    rasterize_closed(&projected, &model.triangles, lens.width, lens.height)
}

fn share(part: usize, whole: usize) -> f64 {
    part as f64 / whole.max(1) as f64
}

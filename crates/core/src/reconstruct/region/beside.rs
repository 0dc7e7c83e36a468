//! How far the depth that was read lies behind the hull where the model stays the hull. The hull contains the object,
//! so that no reading is in front of it, and where it is the model, none is far behind: if readings are, then the
//! calibration of the depth camera or of the colour cameras is wrong, or the hull is. Rims are left out. Nothing here
//! carves.

use super::Regions;
use super::bias::{BiasSource, spread_between_places};
use crate::calibration::Volume;
use crate::image::Mask;
use crate::reconstruct::DepthView;
use crate::reconstruct::depth::{DepthKind, EnhancedDepth};
use crate::statistics::{upper_median, upper_quantile};

/// How far the depth that was read is behind the hull where the model stays the hull, less the bias.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct BesideRegions {
    /// Pixels of the hull's front off its outline and off regions, with a reading that counts.
    pub pixels: usize,
    /// Metres that a fifth of them is below.
    pub low: f64,
    /// Metres that half of them are below.
    pub median: f64,
    /// Metres by which the bias at the object may differ from the one around it: what may remain of it, and at least
    /// twice its standard deviation from place to place, in places of as many pixels.
    pub bias_error: f64,
}

/// Share of the pixels that `low` is of: single readings are in front of the hull by their noise.
const LOW: f64 = 0.2;
/// Fewest pixels by which this is told.
const FEWEST_PIXELS: usize = 200;
/// Standard deviations of the bias that its error is.
const SIGMAS: f64 = 2.0;

impl BesideRegions {
    /// Metres by which the readings contradict the hull beyond the error of the bias, positive behind it.
    pub fn contradiction(&self) -> f64 {
        let behind = (self.median - self.bias_error).max(0.0);
        let in_front = (-self.low - self.bias_error).max(0.0);
        if behind > in_front { behind } else { -in_front }
    }
}

/// Compares depth and hull outside of regions; `None` where too little was read, or the table does not show the bias.
/// `object` are the pixels that [`super::HullRenderings::object_pixels`] gave.
pub fn beside_regions(
    view: &DepthView,
    depth: &EnhancedDepth,
    regions: &Regions,
    volume: &Volume,
    object: &Mask,
) -> Option<BesideRegions> {
    if regions.bias.source != BiasSource::Table {
        return None;
    }
    let front = &regions.front;
    let counts = |x, y| {
        front.is_front[(x, y)]
            && depth.kind[(x, y)] == DepthKind::Measured
            && !front.is_near_outline(x, y)
            && !regions.is_near(x, y)
    };
    let (width, height) = (front.is_front.width(), front.is_front.height());
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let mut behind: Vec<f32> = pixels
        .filter(|&(x, y)| counts(x, y))
        .map(|at| regions.difference[at])
        .filter(|difference| difference.is_finite())
        .collect();
    let pixels = behind.len();
    if pixels < FEWEST_PIXELS {
        return None;
    }
    let side = (pixels as f64).sqrt() as usize;
    let spread = spread_between_places(view, volume, object, &regions.bias, side);
    Some(BesideRegions {
        pixels,
        low: upper_quantile(&mut behind, LOW)?.into(),
        median: upper_median(&mut behind)?.into(),
        bias_error: regions.bias.remaining.max(SIGMAS * spread),
    })
}

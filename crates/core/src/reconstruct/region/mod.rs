//! Where the object is concave (the paper's section 2.E): the depth that a depth camera measured is compared
//! with the depth of the plain hull, and the pixels where the object lies significantly behind the hull and
//! is itself hollow make the regions of interest. Nothing is carved or moved here.
//!
//! - `front` renders the hull's front surface (equations 3 and 4) and its first way out;
//! - `bias` estimates the error that the depth camera's calibration left;
//! - `hollow` measures how far the measured surface itself lies behind its own rims;
//! - `support` decides which holes of the depth lie between a hollow's readings;
//! - `segment` is the paper's segmentation (equation 5) of the difference;
//! - `free_space` adds what a depth camera sees through although the hull claims it;
//! - `in_front_of_faired` tells where a depth camera reads the object in front of a hull that was faired;
//! - `beside` compares depth and hull where the model stays the hull;
//! - `in_front_of_hull` finds readings that no object within the hull can cause;
//! - `outline` compares the object's outline in the depth with the hull's.

mod beside;
mod bias;
mod free_space;
mod front;
mod hollow;
mod in_front_of_faired;
mod in_front_of_hull;
mod outline;
mod segment;
mod support;

pub use beside::{BesideRegions, beside_regions};
pub use bias::{Bias, BiasSource, stated_bias};
pub use free_space::{DepthPixel, Doubt, add_free_space};
pub use front::{HullRenderings, front_vertices};
pub use in_front_of_faired::{FairedHullView, read_in_front};
pub use in_front_of_hull::{InFrontOfHull, in_front_of_hull};
pub use outline::{OutlineOffset, outline_offset};

use crate::calibration::Volume;
use crate::image::{Grid, Mask};
use crate::reconstruct::DepthView;
use crate::reconstruct::depth::{DepthKind, EnhancedDepth};

/// How regions are found. Lengths in millimetres where the name says so.
#[derive(Clone, Debug, PartialEq, serde::Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// T of equation 4: a vertex belongs to the front if the median of n·d over it and its neighbours is larger.
    /// Default 0.5, range -1 to 1.
    #[serde(deserialize_with = "crate::range::within::<_, f32, -1, 1>")]
    pub front_threshold: f32,
    /// α of equation 5: there is a region only if the standard deviation of the difference is larger.
    /// Default 2, range 0 to 1000000.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 1000000>")]
    pub alpha_mm: f32,
    /// Half the window of the adaptive threshold, as a share of the object's extent in the picture. The paper gives no
    /// value; with a small window, flat floors would be missing.
    /// Default 0.5, range 0 to 10.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 10>")]
    pub window: f32,
    /// How many times erosion and then dilation are applied.
    /// Default 1, range 0 to 100.
    #[serde(deserialize_with = "crate::range::count::<_, usize, 0, 100>")]
    pub morphology_iterations: usize,
    /// A region begins at pixels whose difference exceeds this many standard errors …
    /// Default 3, range 0 to 1000.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 1000>")]
    pub significance: f32,
    /// … and grows over pixels whose difference exceeds this many: on a wall that is known only from filled depth, the
    /// best estimate is better than none.
    /// Default 1, range 0 to 1000.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 1000>")]
    pub growing_significance: f32,
    /// Smallest difference in millimetres that counts anywhere.
    /// Default 1, range 0 to 1000000.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 1000000>")]
    pub least_difference_mm: f32,
    /// A region needs pixels that lie this far behind the measured surface's own rims: where the hull stands off a flat
    /// or convex surface, there is no concavity.
    /// Default 4, range 0 to 1000000.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 1000000>")]
    pub least_hollow_mm: f32,
    /// Fewest pixels of a region.
    /// Default 12, range 1 to 1000000.
    #[serde(deserialize_with = "crate::range::count::<_, usize, 1, 1000000>")]
    pub least_pixels: usize,
    /// Pixels by which depth and hull may be misregistered.
    /// Default 0.5, range 0 to 100.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 100>")]
    pub registration_px: f32,
    /// Bias in millimetres that a depth camera is assumed to have if its recording does not state one.
    /// Default 10, range 0 to 1000000.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 1000000>")]
    pub unstated_uncertainty_mm: f32,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            front_threshold: 0.5,
            alpha_mm: 2.0,
            window: 0.5,
            morphology_iterations: 1,
            significance: 3.0,
            growing_significance: 1.0,
            least_difference_mm: 1.0,
            least_hollow_mm: 4.0,
            least_pixels: 12,
            registration_px: 0.5,
            unstated_uncertainty_mm: 10.0,
        }
    }
}

/// The regions that one depth camera sees, with all they were found from.
#[derive(Clone, Debug)]
pub struct Regions {
    /// The hull as the depth camera sees it.
    pub front: HullRenderings,
    /// Dk - Ds in metres, corrected for the bias: positive in a cavity; NaN where either is missing.
    pub difference: Grid<f32>,
    /// Standard deviation of the difference over the front surface, σF, in metres.
    pub sigma_difference: f32,
    /// For each pixel the number of its region, from 1; 0 outside.
    pub labels: Grid<u16>,
    /// How many regions.
    pub count: usize,
    /// The regions with numbers up to this one are hollows of the object, those with larger ones free space: a depth
    /// camera sees the table, a far wall or a part of the object through what the hull claims.
    pub last_hollow: usize,
    /// What was taken off the depth.
    pub bias: Bias,
}

impl Regions {
    /// Whether a pixel belongs to a region.
    pub fn contains(&self, x: usize, y: usize) -> bool {
        self.labels[(x, y)] != 0
    }

    /// Whether a pixel within two of this one, or this one, belongs to a region.
    pub fn is_near(&self, x: usize, y: usize) -> bool {
        let (x, y) = (x as isize, y as isize);
        (y - 2..=y + 2).any(|y| {
            (x - 2..=x + 2).any(|x| self.labels.get(x, y).is_some_and(|&label| label != 0))
        })
    }

    /// Whether a pixel belongs to a region that is a hollow; no pixel beyond the picture does.
    pub fn is_hollow(&self, x: isize, y: isize) -> bool {
        let label = self.labels.get(x, y).map_or(0, |&label| usize::from(label));
        label != 0 && label <= self.last_hollow
    }

    /// For each region that is free space its pixels.
    pub fn free_space(&self) -> Vec<usize> {
        let mut pixels = Vec::new();
        for &label in self.labels.pixels() {
            if let Some(index) = usize::from(label).checked_sub(self.last_hollow + 1) {
                pixels.resize(pixels.len().max(index + 1), 0);
                pixels[index] += 1;
            }
        }
        pixels.retain(|&count| count > 0);
        pixels
    }
}

/// The offset of one depth camera's depth. `object` are the pixels that [`HullRenderings::object_pixels`] gave. `plain`
/// renders the plain hull, which is needed only where the table is not seen.
pub fn bias(
    plain: impl FnOnce() -> HullRenderings,
    view: &DepthView,
    depth: &EnhancedDepth,
    volume: &Volume,
    object: &Mask,
    parameters: &Parameters,
) -> Bias {
    let from_hull = || {
        let front = plain();
        let raw = difference(&front, depth);
        bias::from_hull(&front, &raw)
    };
    Bias::estimate(view, volume, object, parameters, from_hull)
}

/// Finds the regions that one depth camera sees of a hull whose `front` it sees. `object` are the pixels that
/// [`HullRenderings::object_pixels`] gave.
pub fn find(
    front: HullRenderings,
    depth: &EnhancedDepth,
    bias: Bias,
    object: &Mask,
    parameters: &Parameters,
) -> Regions {
    let difference = difference(&front, depth).map(|f| f - bias.metres as f32);
    let sigma_difference = standard_deviation(&difference);
    let mut regions = Regions {
        labels: Grid::filled(difference.width(), difference.height(), 0),
        front,
        difference,
        sigma_difference,
        count: 0,
        last_hollow: 0,
        bias,
    };
    if sigma_difference > 1e-3 * parameters.alpha_mm {
        let beyond =
            |difference: &Grid<f32>, k| beyond_noise(&regions, difference, depth, k, parameters);
        let sure = parameters.significance;
        let remaining = regions.bias.remaining;
        let within = on_object(&regions, depth, remaining, parameters);
        let (hollow, behind) = rayon::join(
            || hollow::depth_below_rims(depth, object, &within, hollow::FOUR_DIRECTIONS),
            || behind_the_hull(&regions, depth, parameters),
        );
        let supported = support::by_readings(depth, &hollow, 1e-3 * parameters.least_hollow_mm);
        let likely = beyond(&regions.difference, parameters.growing_significance);
        let steep = beyond(&steep_difference(&regions, depth, &within), sure);
        let belongs = |x, y| (likely[(x, y)] || steep[(x, y)]) && supported[(x, y)];
        let evidence = segment::Evidence {
            significant: &beyond(&regions.difference, sure),
            belongs: &Grid::from_fn(likely.width(), likely.height(), belongs),
            behind: &behind,
            hollow: &hollow,
        };
        let (labels, count) = segment::regions(&regions.difference, &evidence, parameters);
        (regions.labels, regions.count, regions.last_hollow) = (labels, count, count);
    }
    regions
}

/// F = Dk - Ds; NaN where either is missing.
fn difference(front: &HullRenderings, depth: &EnhancedDepth) -> Grid<f32> {
    Grid::from_fn_parallel(depth.depth.width(), depth.depth.height(), |x, y| {
        if depth.kind[(x, y)] == DepthKind::None || !front.is_front[(x, y)] {
            return f32::NAN;
        }
        depth.depth[(x, y)] - front.depth[(x, y)]
    })
}

/// The difference of readings `within` the hull where it is too steep for equation 4, less the bias; NaN elsewhere.
/// Edges of a faired hull are round, and such a strip runs along each: without its readings the region would be ragged.
fn steep_difference(regions: &Regions, depth: &EnhancedDepth, within: &Grid<bool>) -> Grid<f32> {
    let front = &regions.front;
    Grid::from_fn_parallel(depth.depth.width(), depth.depth.height(), |x, y| {
        if !within[(x, y)] || front.is_front[(x, y)] {
            return f32::NAN;
        }
        depth.depth[(x, y)] - regions.bias.metres as f32 - front.depth[(x, y)]
    })
}

/// σF of equation 5, over the pixels where there is a difference.
fn standard_deviation(difference: &Grid<f32>) -> f32 {
    let values = || {
        difference
            .pixels()
            .iter()
            .filter(|f| f.is_finite())
            .map(|&f| f64::from(f))
    };
    let count = values().count().max(1) as f64;
    let mean = values().sum::<f64>() / count;
    (values().map(|f| (f - mean).powi(2)).sum::<f64>() / count).sqrt() as f32
}

/// Where a `difference` exceeds `significance` times what noise, slope and registration explain. Along the
/// hull's outline, readings of what lies behind the object are the mixed pixels of its contour, and count as
/// nothing.
fn beyond_noise(
    regions: &Regions,
    difference: &Grid<f32>,
    depth: &EnhancedDepth,
    significance: f32,
    parameters: &Parameters,
) -> Grid<bool> {
    let least = 1e-3 * parameters.least_difference_mm;
    let remaining = regions.bias.remaining as f32;
    Grid::from_fn_parallel(depth.depth.width(), depth.depth.height(), |x, y| {
        let f = difference[(x, y)];
        if !f.is_finite() {
            return false;
        }
        // The hull's own slope; the measured depth's would hide the very rims of a cavity.
        let shift = regions.front.slope(x, y) * parameters.registration_px;
        let sigma = depth.sigma[(x, y)].hypot(shift);
        let behind_the_hull = regions.front.depth[(x, y)] + f > regions.front.exit[(x, y)];
        f > (significance * sigma).max(least) + remaining
            && !(behind_the_hull && regions.front.is_near_outline(x, y))
    })
}

/// The readings that lie on the object: within the hull, before its far side by more than they may be off, of which
/// `remaining` metres are bias. What lies on the table beside the object, or behind it, does not belong to it.
fn on_object(
    regions: &Regions,
    depth: &EnhancedDepth,
    remaining: f64,
    parameters: &Parameters,
) -> Grid<bool> {
    let (bias, remaining) = (regions.bias.metres as f32, remaining as f32);
    Grid::from_fn_parallel(depth.depth.width(), depth.depth.height(), |x, y| {
        let doubt = (parameters.significance * depth.sigma[(x, y)])
            .max(1e-3 * parameters.least_difference_mm)
            + remaining;
        depth.kind[(x, y)] == DepthKind::Measured
            && regions.front.depth[(x, y)].is_finite()
            && depth.depth[(x, y)] - bias + doubt < regions.front.exit[(x, y)]
    })
}

/// Where the depth lies behind the hull by more than its own noise, whether the hull faces the camera or not.
fn behind_the_hull(
    regions: &Regions,
    depth: &EnhancedDepth,
    parameters: &Parameters,
) -> Grid<bool> {
    let least = 1e-3 * parameters.least_difference_mm;
    let offset = (regions.bias.metres + regions.bias.remaining) as f32;
    Grid::from_fn_parallel(depth.depth.width(), depth.depth.height(), |x, y| {
        let f = depth.depth[(x, y)] - regions.front.depth[(x, y)];
        let sigma = parameters.growing_significance * depth.sigma[(x, y)];
        depth.kind[(x, y)] != DepthKind::None && f > sigma.max(least) + offset
    })
}

#[cfg(test)]
mod tests;

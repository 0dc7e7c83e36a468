//! Readings in front of the hull that the model is made from, wherever a depth camera sees it; on rims, too, which
//! `beside` leaves out. The hull contains the object: such readings show that the calibration of the depth camera or
//! of the colour cameras is wrong, or that the object's material misleads the depth camera. A pixel that mixes a rim
//! with what is behind it reads too deep, and so never in front. All doubt speaks for the hull: noise, bias, and what
//! its depth changes within two pixels. Nothing here carves.

use super::Regions;
use super::bias::{BiasSource, spread_between_places};
use crate::calibration::Volume;
use crate::image::{Grid, Mask};
use crate::reconstruct::DepthView;
use crate::reconstruct::depth::EnhancedDepth;
use crate::statistics::lower_median;

/// What a depth camera read in front of the hull beyond doubt.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct InFrontOfHull {
    /// Readings in front of it that have others beside them.
    pub pixels: usize,
    /// Metres by which half of them are in front, less what the hull's depth changes there; 0 if there is none.
    pub median: f64,
    /// Metres by which the bias at the object may differ from the one around it: what may remain of it, and at least
    /// twice its standard deviation from place to place, in places of as many pixels.
    pub bias_error: f64,
}

/// Standard errors of a reading by which it has to lie in front.
const NOISE: f32 = 3.0;
/// Pixels by which the depth may be displaced against the colour cameras.
const DISPLACED_PX: f32 = 2.0;
/// Fewest of a pixel's eight neighbours that are read in front, too.
const NEIGHBOURS: usize = 1;
/// Fewest pixels that show an error: sound captures have up to 6, and 16 where a coarse hull lost a part of its rim.
const FEWEST_PIXELS: usize = 20;
/// Standard deviations of the bias that its error is.
const SIGMAS: f64 = 2.0;

impl InFrontOfHull {
    /// Metres by which the readings contradict the hull beyond the error of the bias.
    pub fn contradiction(&self) -> f64 {
        if self.pixels < FEWEST_PIXELS {
            return 0.0;
        }
        (self.median - self.bias_error).max(0.0)
    }
}

/// Finds what was read in front of the hull; `None` where the table does not show the bias. `object` are the pixels
/// that [`super::HullRenderings::object_pixels`] gave.
pub fn in_front_of_hull(
    view: &DepthView,
    depth: &EnhancedDepth,
    regions: &Regions,
    volume: &Volume,
    object: &Mask,
) -> Option<InFrontOfHull> {
    if regions.bias.source != BiasSource::Table {
        return None;
    }
    let mut found = readings_in_front(depth, regions);
    let pixels = found.len();
    let side = (pixels as f64).sqrt() as usize;
    let spread = spread_between_places(view, volume, object, &regions.bias, side);
    Some(InFrontOfHull {
        pixels,
        median: lower_median(&mut found).unwrap_or(0.0).into(),
        bias_error: regions.bias.remaining.max(SIGMAS * spread),
    })
}

/// Metres by which each reading that counts is in front of the hull, less what the hull's depth changes there.
fn readings_in_front(depth: &EnhancedDepth, regions: &Regions) -> Vec<f32> {
    let (width, height) = (depth.depth.width(), depth.depth.height());
    let ahead = Grid::from_fn_parallel(width, height, |x, y| ahead(depth, regions, x, y));
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let counts = pixels.filter(|&(x, y)| has_company(&ahead, x, y));
    counts.filter_map(|at| ahead[at]).collect()
}

/// Metres by which a pixel's reading is in front of the hull, less what that changes around it; `None` where it may
/// not be in front, and beside the hull's outline.
fn ahead(depth: &EnhancedDepth, regions: &Regions, x: usize, y: usize) -> Option<f32> {
    let bias = &regions.bias;
    let read = depth.reading(x as isize, y as isize)? - bias.metres as f32;
    let hull = &regions.front;
    let surface = hull.depth[(x, y)];
    // Where there is no hull, its depth is infinite.
    if surface.is_infinite() || read >= surface || hull.is_near_outline(x, y) {
        return None;
    }
    let ahead = surface - read - DISPLACED_PX * hull.largest_change(x, y);
    (ahead > NOISE * depth.sigma[(x, y)] + bias.remaining as f32).then_some(ahead)
}

/// Whether enough of a pixel's neighbours are in front, too.
fn has_company(ahead: &Grid<Option<f32>>, x: usize, y: usize) -> bool {
    let (x, y) = (x as isize, y as isize);
    let square = (y - 1..=y + 1).flat_map(|y| (x - 1..=x + 1).map(move |x| (x, y)));
    let is_ahead = |&(x, y): &(isize, isize)| ahead.get(x, y).is_some_and(Option::is_some);
    // The pixel itself is one of them.
    square.filter(is_ahead).count() > NEIGHBOURS
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reconstruct::depth::DepthKind;
    use crate::reconstruct::testing::evidence;

    const SIDE: usize = 40;

    /// What a depth camera reads of a vessel, `ahead` metres in front of its hull, whose depth is 0.7 m: a floor far
    /// behind the hull, and a rim of two pixels.
    fn vessel(ahead: f32) -> (EnhancedDepth, Regions) {
        let (mut depth, regions) = evidence(0.78, Grid::filled(SIDE, SIDE, 1));
        for x in 5..35 {
            depth.depth[(x, 10)] = 0.7 - ahead;
            depth.depth[(x, 11)] = 0.7 - ahead;
        }
        (depth, regions)
    }

    #[test]
    fn a_rim_that_is_read_in_front_of_the_hull_counts_beyond_noise_and_bias() {
        let count = |ahead: f32, bias: f64, remaining: f64| {
            let (depth, mut regions) = vessel(ahead);
            (regions.bias.metres, regions.bias.remaining) = (bias, remaining);
            readings_in_front(&depth, &regions).len()
        };
        // Noise is 1 mm.
        assert_eq!(count(3.1e-3, 0.0, 0.0), 60);
        assert_eq!(count(2.9e-3, 0.0, 0.0), 0);
        assert_eq!(count(-3.1e-3, 0.0, 0.0), 0);
        assert_eq!(count(3.1e-3, 0.0, 1e-3), 0);
        assert_eq!(count(3.1e-3, -1e-3, 0.0), 0);
        assert_eq!(count(2.9e-3, 1e-3, 0.0), 60);
        let (depth, regions) = vessel(4e-3);
        for metres in readings_in_front(&depth, &regions) {
            assert!((metres - 4e-3).abs() < 1e-6, "{metres}");
        }
    }

    #[test]
    fn what_is_filled_in_or_beside_the_outline_or_alone_does_not_count() {
        let count = |change: &dyn Fn(&mut EnhancedDepth, &mut Regions)| {
            let (mut depth, mut regions) = vessel(4e-3);
            change(&mut depth, &mut regions);
            readings_in_front(&depth, &regions).len()
        };
        let filled = |depth: &mut EnhancedDepth, _: &mut Regions| {
            depth.kind = Grid::filled(SIDE, SIDE, DepthKind::Filled);
        };
        assert_eq!(count(&filled), 0);
        let hull_from = |first: usize| {
            move |_: &mut EnhancedDepth, regions: &mut Regions| {
                let is_hull = |y| y >= first;
                regions.front.depth =
                    Grid::from_fn(
                        SIDE,
                        SIDE,
                        |_, y| if is_hull(y) { 0.7 } else { f32::INFINITY },
                    );
            }
        };
        assert_eq!(count(&hull_from(8)), 60);
        assert_eq!(count(&hull_from(9)), 30);
        assert_eq!(count(&hull_from(10)), 0);
        assert_eq!(count(&hull_from(12)), 0);
        let every_third = |depth: &mut EnhancedDepth, _: &mut Regions| {
            depth.depth = Grid::from_fn(SIDE, SIDE, |x, y| {
                if x % 3 == 0 && y % 3 == 0 { 0.69 } else { 0.78 }
            });
        };
        assert_eq!(count(&every_third), 0);
    }

    #[test]
    fn where_the_hull_is_steep_the_depth_may_be_displaced_by_two_pixels() {
        let count = |metres_per_row: f32| {
            let (depth, mut regions) = vessel(4e-3);
            regions.front.depth =
                Grid::from_fn(SIDE, SIDE, |_, y| 0.7 + metres_per_row * (y as f32 - 10.5));
            readings_in_front(&depth, &regions).len()
        };
        assert_eq!(count(0.3e-3), 60);
        assert_eq!(count(1e-3), 0);
    }

    #[test]
    fn a_contradiction_needs_enough_readings_and_more_than_the_bias_may_be() {
        let contradiction = |pixels, median| {
            let found = InFrontOfHull {
                pixels,
                median,
                bias_error: 1e-3,
            };
            found.contradiction()
        };
        assert_eq!(contradiction(FEWEST_PIXELS - 1, 5e-3), 0.0);
        assert!((contradiction(FEWEST_PIXELS, 5e-3) - 4e-3).abs() < 1e-12);
        assert_eq!(contradiction(1000, 0.9e-3), 0.0);
    }
}

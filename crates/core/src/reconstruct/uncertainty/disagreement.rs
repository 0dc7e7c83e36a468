//! By how much depth cameras disagree with a place of the hull that they read, beyond what their readings may be off.
//! What they read far beneath it, where the hull is too large or hollow, is the task of `readings`.

use super::readings::{Readings, around};
use crate::reconstruct::depth::OF_READING;
use crate::statistics::shrunk;
use nalgebra::{Point3, Vector3};

/// Metres of depth between a place and what is rendered of the hull at its pixel, within which the camera sees it.
const ON_FRONT: f32 = 1e-3;
/// Pixels by which a reading's place may be off.
const LATERAL_PX: f32 = 0.25;

/// A reading of a place, in metres across the surface.
#[derive(Clone, Copy)]
struct Difference {
    /// How far beneath the place the surface was read; negative in front of it.
    mean: f64,
    /// Standard error of that.
    error: f64,
}

impl Readings<'_> {
    /// What the camera read of a place with the readings around it that agree with its own; `None` where it did not see
    /// the place.
    fn difference(&self, p: Point3<f64>, normal: Vector3<f32>) -> Option<Difference> {
        let (pixel, z) = self.camera.project(p)?;
        let (x, y) = (pixel.x.round() as isize, pixel.y.round() as isize);
        let here = self.difference_at(x, y)?;
        let (column, row) = (x as usize, y as usize);
        let front = &self.regions.front;
        let (slope, doubt) = (front.slope(column, row), self.doubt(column, row));
        let is_seen = (z as f32 - front.depth[(column, row)]).abs() <= slope.max(ON_FRONT);
        let across = self.across(p, normal);
        if !is_seen || across <= 0.0 || here < -doubt {
            return None;
        }
        let differences = around(x, y).filter_map(|(x, y)| self.difference_at(x, y));
        let agreeing = differences.filter(|there| (there - here).abs() <= doubt);
        let (sum, count) = agreeing.fold((0.0, 0.0), |(sum, count), f| (sum + f, count + 1.0));
        let noise = OF_READING * self.depth.sigma[(column, row)];
        let error = noise
            .hypot(LATERAL_PX * slope)
            .hypot(self.regions.bias.explained(self.camera) as f32);
        Some(Difference {
            mean: f64::from((sum / count).min(doubt)) * across,
            error: f64::from(error) * across,
        })
    }

    /// Metres of depth by which a pixel's reading lies behind the hull.
    fn difference_at(&self, x: isize, y: isize) -> Option<f32> {
        self.read(x, y)?;
        let difference = self.regions.difference.get(x, y).copied();
        difference.filter(|difference| difference.is_finite())
    }
}

/// By how many metres depth cameras show a place of the hull (with its unit outward normal) to be off, inwards or
/// outwards: what they differ by, less what that may be off. Where several read the place, the surest counts. 0 where
/// none did.
pub(super) fn disagreement(p: Point3<f64>, normal: Vector3<f32>, readings: &[Readings]) -> f64 {
    let each = readings
        .iter()
        .filter_map(|camera| camera.difference(p, normal));
    let surest = each.min_by(|a, b| a.error.total_cmp(&b.error));
    surest.map_or(0.0, |found| shrunk(found.mean, found.error).abs())
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Above, SIDE};
    use super::*;
    use crate::calibration::DepthResponse;
    use crate::reconstruct::region::BiasSource;

    /// For a place that faces the camera, or is turned away from it by 53 degrees.
    fn at_origin(above: &Above, is_aslant: bool) -> f64 {
        let normal = match is_aslant {
            true => Vector3::new(0.8, 0.0, 0.6),
            false => Vector3::z(),
        };
        disagreement(Point3::origin(), normal, &above.readings())
    }

    /// What is left of so many millimetres that have the noise of the readings, and so much bias.
    fn left(millimetres: f64, remaining: f64) -> f64 {
        shrunk(1e-3 * millimetres, (0.55 * 0.5e-3_f64).hypot(remaining))
    }

    #[test]
    fn a_difference_counts_on_either_side_less_its_error() {
        for millimetres in [-1.0, 1.0] {
            let above = Above::reads(0.8 + 1e-3 * millimetres as f32, 0.0, 0.0);
            let found = at_origin(&above, false);
            assert!((found - left(1.0, 0.0)).abs() < 1e-6, "{found}");
            let aslant = at_origin(&above, true);
            assert!((aslant - 0.6 * found).abs() < 1e-9, "{aslant}");
        }
        assert_eq!(at_origin(&Above::reads(0.8002, 0.0, 0.0), false), 0.0);
    }

    #[test]
    fn a_bias_that_may_remain_makes_it_doubtful_and_a_known_one_is_taken_off() {
        let found = at_origin(&Above::reads(0.801, 0.0, 0.6e-3), false);
        assert!((found - left(1.0, 0.6e-3)).abs() < 1e-6, "{found}");
        assert_eq!(at_origin(&Above::reads(0.801, 0.0, 2e-3), false), 0.0);
    }

    #[test]
    fn readings_behind_a_hull_that_may_be_too_large_make_it_doubtful() {
        let (found, spread) = (8e-3_f64, 1e-3);
        let mut above = Above::reads(0.808, 0.0, found.hypot(spread));
        // Without a source, the bias that may remain explains it.
        assert_eq!(at_origin(&above, false), 0.0);
        let bias = &mut above.regions.bias;
        (bias.source, bias.found) = (BiasSource::Hull, found);
        for unstated in [0.0, DepthResponse::MOST_UNCERTAINTY] {
            above.camera.response.uncertainty = unstated;
            let off = at_origin(&above, false);
            assert!((off - left(8.0, spread)).abs() < 1e-6, "{off}");
        }
        // What the calibration states explains it, too.
        above.camera.response.uncertainty = 8e-3;
        assert_eq!(at_origin(&above, false), 0.0);
    }

    #[test]
    fn a_place_that_is_hidden_or_was_not_read_has_none() {
        assert_eq!(at_origin(&Above::reads(0.78, 0.0, 0.0), false), 0.0);
        let mut hidden = Above::reads(0.801, 0.0, 0.0);
        hidden.regions.front.depth = crate::image::Grid::filled(SIDE, SIDE, 0.795);
        assert_eq!(at_origin(&hidden, false), 0.0);
    }

    #[test]
    fn readings_of_another_surface_beside_it_do_not_count() {
        let mut above = Above::reads(0.801, 0.0, 0.0);
        let middle = SIDE / 2;
        above.regions.difference[(middle + 1, middle)] = 30e-3;
        let found = at_origin(&above, false);
        assert!((found - left(1.0, 0.0)).abs() < 1e-6, "{found}");
    }
}

//! Estimates the constant offset that a depth camera's calibration left, robustly, where the true depth is known.
//! It is used no further than the calibration's uncertainty allows.

use super::Parameters;
use super::front::HullRenderings;
use crate::calibration::{DepthCamera, Volume};
use crate::image::{Grid, Mask};
use crate::reconstruct::DepthView;
use crate::statistics::{lower_median, shrunk, upper_median, upper_quantile};
use nalgebra::{Point2, Point3};

/// An offset of the depth.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Bias {
    /// Metres to take off each depth (positive where the camera reads too deep).
    pub metres: f64,
    /// Metres that were found, before the calibration's uncertainty limited them.
    pub found: f64,
    /// What may remain, in metres.
    pub remaining: f64,
    /// What it was estimated from.
    pub source: BiasSource,
    /// Height of the table in the rig's frame, in metres; of the likeliest plane where none was read.
    #[serde(skip)]
    pub table: f64,
}

/// Where the true depth was known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum BiasSource {
    /// The table around the object.
    Table,
    /// The hull where it touches the object.
    Hull,
    /// Nowhere: nothing is taken off.
    None,
}

/// Pixels that an estimate needs.
const LEAST_PIXELS: usize = 200;

/// Side in pixels of the places in which the table's bias is compared.
const TILE: usize = 64;
/// Least side of smaller ones.
const LEAST_SIDE: usize = 12;

/// Widths of the volume, from its middle, within which the table's bias is the object's, …
const AROUND: f64 = 1.5;
/// … and within which it varies as it does there, with more places to tell by how much.
const FAR_AROUND: f64 = 4.0;

/// Metres within which a reading can be the table.
const TABLE_BAND: f64 = 0.03;
/// Metres within which a plane nearer than the table is looked for: that of a rig whose calibration is of another size.
const NEARER_PLANE: f64 = 0.5;
/// Metres from z = 0 within which the volume's floor is that plane.
const SAME_PLANE: f64 = 2e-3;

impl Bias {
    /// Estimates the offset from the table around the object; where the table is not seen, as `from_hull` does.
    pub(super) fn estimate(
        view: &DepthView,
        volume: &Volume,
        object: &Mask,
        parameters: &Parameters,
        from_hull: impl FnOnce() -> Option<(f64, f64)>,
    ) -> Self {
        let allowed = stated_bias(&view.camera, parameters);
        let of_table = from_table(view, volume, object);
        let table = of_table.map_or(heights_of_table(volume)[0], |(table, _)| table);
        let (found, remaining, source) = of_table
            .map(|(_, (found, error))| (found, error, BiasSource::Table))
            .or_else(|| from_hull().map(|(found, error)| (found, error, BiasSource::Hull)))
            .unwrap_or((0.0, allowed, BiasSource::None));
        let known = match source {
            // A hull that contains the object proves no more than readings in front of it; behind, it may be too large.
            BiasSource::Hull => found.min(0.0),
            BiasSource::Table | BiasSource::None => found,
        };
        // An offset that is only noise would make the depth worse.
        let metres = shrunk(known, remaining).clamp(-allowed, allowed);
        Self {
            metres,
            found,
            remaining: remaining.hypot(found - metres),
            source,
            table,
        }
    }

    /// Whether the depth lies behind the hull and nothing tells which of the two is off.
    pub fn is_excess_of_hull(&self) -> bool {
        self.source == BiasSource::Hull && self.found > 0.0
    }

    /// Metres by which readings may be off for a reason that is known. How far they lie behind a hull is none: instead
    /// of it the bias counts that the camera's recording states.
    pub fn explained(&self, camera: &DepthCamera) -> f64 {
        if !self.is_excess_of_hull() {
            return self.remaining;
        }
        let response = &camera.response;
        let stated = match response.has_known_uncertainty() {
            true => response.uncertainty,
            false => 0.0,
        };
        let excess = self.found - self.metres;
        let spread = (self.remaining.powi(2) - excess.powi(2)).max(0.0).sqrt();
        spread.hypot(stated)
    }
}

/// Metres of bias that a depth camera's recording states, or that the camera is assumed to have if that states none.
pub fn stated_bias(camera: &DepthCamera, parameters: &Parameters) -> f64 {
    let stated = camera.response.uncertainty;
    if stated > 0.0 {
        stated
    } else {
        1e-3 * f64::from(parameters.unstated_uncertainty_mm)
    }
}

/// The table's height, and the median distance of readings around the object behind it with its error: how much that
/// differs from place to place, for the object stands in yet another one. Of several heights the one that explains the
/// readings best.
fn from_table(view: &DepthView, volume: &Volume, object: &Mask) -> Option<(f64, (f64, f64))> {
    let at = |table| Around {
        view,
        volume,
        object,
        table,
    };
    let heights = heights_of_table(volume);
    let found = heights
        .iter()
        .filter_map(|&table| Some((table, at(table).plane(0.0)?)));
    let nearest = found.min_by(|a, b| a.1.0.abs().total_cmp(&b.1.0.abs()));
    nearest.or_else(|| {
        let around = at(heights[0]);
        let nearer = around.nearer_plane()?;
        Some((around.table, around.plane(nearer)?))
    })
}

/// Heights at which the table may be, the likeliest first: the volume stands on it, but its floor may also cut off what
/// lies on a table at z = 0, where calibration puts it.
fn heights_of_table(volume: &Volume) -> Vec<f64> {
    let floor = volume.min.z;
    if floor.abs() < SAME_PLANE {
        vec![0.0]
    } else {
        vec![floor, 0.0]
    }
}

/// The surroundings of an object on a table of some height.
struct Around<'a> {
    view: &'a DepthView,
    volume: &'a Volume,
    object: &'a Mask,
    table: f64,
}

impl Around<'_> {
    /// Where most readings around the object are, if that is nearer than the table by more than [`TABLE_BAND`]. Nothing
    /// covers the whole table; farther away than it may be what lies below a turntable.
    fn nearer_plane(&self) -> Option<f64> {
        let mut offsets: Vec<f32> = Vec::new();
        self.for_each(AROUND, |_, _, offset| {
            if offset.abs() < NEARER_PLANE {
                offsets.push(offset as f32);
            }
        });
        let center = f64::from(lower_median(&mut offsets)?);
        let near = offsets
            .iter()
            .filter(|&&offset| (f64::from(offset) - center).abs() < TABLE_BAND);
        (center < -TABLE_BAND && 2 * near.count() > offsets.len()).then_some(center)
    }

    /// Calls for each third pixel beside the object whose ray meets the table around it, with how far the reading there
    /// is behind the table.
    fn for_each(&self, reach: f64, mut call: impl FnMut(usize, usize, f64)) {
        let camera = &self.view.camera;
        for y in (0..self.object.height()).step_by(3) {
            for x in (0..self.object.width()).step_by(3) {
                if self.object[(x, y)] >= 128 {
                    continue;
                }
                let pixel = Point2::new(x as f64, y as f64);
                if let Some(table) = depth_of_table(camera, pixel, self.table)
                    && let Some(depth) = mean_depth(self.view, x, y)
                    && is_around(camera, pixel, table, self.volume, reach)
                {
                    call(x, y, depth - table);
                }
            }
        }
    }

    /// The median distance behind the table of the readings within [`TABLE_BAND`] of `offset`, and its error.
    fn plane(&self, offset: f64) -> Option<(f64, f64)> {
        let tiles = self.tiles(AROUND, offset, TILE);
        let places = medians_of(&tiles, LEAST_PIXELS / 4);
        let (center, error) = robust_center(tiles.concat())?;
        Some((center, error.max(spread_of(places))))
    }

    /// How far the readings within [`TABLE_BAND`] of `offset` are behind the table, in squares of `side` pixels.
    fn tiles(&self, reach: f64, offset: f64, side: usize) -> Vec<Vec<f32>> {
        let columns = self.object.width().div_ceil(side);
        let mut tiles = vec![Vec::new(); columns * self.object.height().div_ceil(side)];
        self.for_each(reach, |x, y, behind| {
            if (behind - offset).abs() < TABLE_BAND {
                tiles[y / side * columns + x / side].push(behind as f32);
            }
        });
        tiles
    }
}

/// Standard deviation of the bias between places of the table around the object, squares of `side` pixels: a sensor's
/// fixed pattern is even over some 25 pixels, so that small places differ more than large ones. 0 where there are no
/// two.
pub(super) fn spread_between_places(
    view: &DepthView,
    volume: &Volume,
    object: &Mask,
    bias: &Bias,
    side: usize,
) -> f64 {
    let side = side.clamp(LEAST_SIDE, TILE);
    let around = Around {
        view,
        volume,
        object,
        table: bias.table,
    };
    let tiles = around.tiles(FAR_AROUND, bias.found, side);
    // Each third pixel of each third row is looked at.
    spread_of(medians_of(&tiles, side * side / 18))
}

/// The medians of the tiles that have at least so many readings.
fn medians_of(tiles: &[Vec<f32>], fewest: usize) -> Vec<f32> {
    let enough = tiles.iter().filter(|tile| tile.len() >= fewest);
    enough
        .filter_map(|tile| lower_median(&mut tile.clone()))
        .collect()
}

/// Whether a point of the table lies within `reach` widths of the volume's middle.
fn is_around(
    camera: &DepthCamera,
    pixel: Point2<f64>,
    depth: f64,
    volume: &Volume,
    reach: f64,
) -> bool {
    let width = volume.max - volume.min;
    camera.point(pixel, depth).is_some_and(|p| {
        let center = nalgebra::center(&volume.min, &volume.max);
        (0..2).all(|axis| (p[axis] - center[axis]).abs() < reach * width[axis])
    })
}

/// Depth at which a pixel's ray meets the table, a level plane at the height `table` in the rig's frame.
pub(super) fn depth_of_table(camera: &DepthCamera, pixel: Point2<f64>, table: f64) -> Option<f64> {
    let above = |p: Point3<f64>| p.z - table;
    let height = |depth: f64| camera.point(pixel, depth).map(above);
    let start = above(camera.camera.center()).abs().max(0.1);
    // A ray is straight but for the response's scale; two secant steps find its foot.
    let (mut a, mut b) = (start, start * 1.01);
    for _ in 0..4 {
        let (at_a, at_b) = (height(a)?, height(b)?);
        if (at_b - at_a).abs() < 1e-9 {
            break;
        }
        (a, b) = (b, b - at_b * (b - a) / (at_b - at_a));
    }
    (b.is_finite() && b > 0.0).then_some(b)
}

/// Mean over the frames of a pixel's depth, where most of them have a reading.
pub(super) fn mean_depth(view: &DepthView, x: usize, y: usize) -> Option<f64> {
    let depths = || {
        let readings = view.frames.iter().map(|f| f.readings[(x, y)]);
        readings.filter_map(|r| view.camera.response.depth(r))
    };
    let count = depths().count();
    (2 * count > view.frames.len()).then(|| depths().sum::<f64>() / count as f64)
}

/// The offset and its error by the places where the hull lies closest to the measured surface: the low end of the
/// differences on the flatter parts of its front. The hull contains the object, so that the difference is never
/// negative but for the bias; a faired hull need not. A positive one may be the hull's.
pub(super) fn from_hull(front: &HullRenderings, difference: &Grid<f32>) -> Option<(f64, f64)> {
    const LOW: f64 = 0.2;
    let mut values = Vec::new();
    for y in 0..difference.height() {
        for x in 0..difference.width() {
            let f = difference[(x, y)];
            if f.is_finite() && front.slope(x, y) < 2e-3 {
                values.push(f);
            }
        }
    }
    if values.len() < LEAST_PIXELS {
        return None;
    }
    values.sort_by(f32::total_cmp);
    let count = (LOW * values.len() as f64) as usize;
    let low = &mut values[..count];
    let greatest = *low.last()?;
    let spread = f64::from(greatest - upper_quantile(low, 0.1)?);
    let middle = f64::from(upper_median(low)?);
    // Only a sharp lower end is a surface that the hull touches; a slope is a cavity seen at a slant.
    (spread < 4e-3).then_some((middle, spread))
}

/// Median and its error, where the values agree.
fn robust_center(mut values: Vec<f32>) -> Option<(f64, f64)> {
    if values.len() < LEAST_PIXELS {
        return None;
    }
    let center = lower_median(&mut values)?;
    let spread = spread_of(values);
    // A tenth of the spread: a fixed pattern does not average out as noise does.
    (spread < 6e-3).then_some((f64::from(center), 0.1 * spread))
}

/// Standard deviation by the median of the distances from the median; 0 of fewer than two values.
fn spread_of(mut values: Vec<f32>) -> f64 {
    let Some(center) = lower_median(&mut values) else {
        return 0.0;
    };
    for v in &mut values {
        *v = (*v - center).abs();
    }
    1.4826 * f64::from(lower_median(&mut values).unwrap_or(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spread_is_that_of_most_values() {
        let values = vec![-1.0, 0.0, 1.0, -1.0, 0.0, 1.0, 900.0];
        assert!((spread_of(values) - 1.4826).abs() < 1e-6);
        assert_eq!(spread_of(vec![5.0]), 0.0);
    }
}

//! Tests a pose against the depth cameras' readings: a point that one capture measured cannot lie in front of a surface
//! that another capture measured behind it.

use super::CaptureSilhouettes;
use super::body::Body;
use crate::calibration::DepthCamera;
use crate::image::Grid;
use crate::reconstruct::DepthView;
use nalgebra::{Isometry3, Point2, Point3};

/// Points of a capture that are compared, at most.
const MOST_POINTS: usize = 6000;
/// Fewer common points tell nothing.
const LEAST_POINTS: usize = 200;
/// Metres by which a point must lie in front of a reading to contradict it, besides what calibrations may be off by.
const TOLERANCE: f64 = 0.006;
/// Metres between neighbouring readings from which on they are an edge's.
const EDGE: f64 = 0.01;
/// Metres by which the readings within two pixels of a place differ from which on it lies at an edge, where a reading
/// may be of what is behind it.
const EDGE_AROUND: f64 = 0.02;
/// Metres above the table from which on a reading is the object's.
const ABOVE_TABLE: f64 = 0.005;

/// A capture's depth images, each of one depth camera.
#[derive(Clone, Debug, Default)]
pub(super) struct Depths(Vec<Depth>);

#[derive(Clone, Debug)]
struct Depth {
    camera: DepthCamera,
    /// The nearest reading around each pixel in metres; 0 means no reading there, or an edge.
    nearest: Grid<f32>,
    points: Vec<Point3<f64>>,
    tolerance: f64,
}

/// What depth says of a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Contradiction {
    /// Share of the common points that contradict.
    pub(super) share: f64,
    /// Points that both captures measured.
    pub(super) points: usize,
}

impl Depths {
    /// Of a capture.
    pub(super) fn new(capture: &CaptureSilhouettes, body: &Body) -> Self {
        Self(
            capture
                .scene
                .depths
                .iter()
                .map(|view| Depth::new(view, capture, body))
                .collect(),
        )
    }
}

impl Depth {
    fn new(view: &DepthView, capture: &CaptureSilhouettes, body: &Body) -> Self {
        let mean = mean_depth(view);
        let around = |x: usize, y: usize| within(&mean, 1, x, y);
        let mut points = Vec::new();
        for y in 0..mean.height() {
            for x in 0..mean.width() {
                let depth = mean[(x, y)];
                let is_edge = around(x, y).any(|d| f64::from((d - depth).abs()) > EDGE);
                // Beside what is not read, as on a steep side, a reading may be mixed with that of another place.
                let is_amid_readings = around(x, y).count() == 9;
                if depth <= 0.0 || is_edge || !is_amid_readings {
                    continue;
                }
                let pixel = Point2::new(x as f64, y as f64);
                let Some(p) = view.camera.point(pixel, depth.into()) else {
                    continue;
                };
                let is_object = p.z > body.floor + ABOVE_TABLE && body.value(p, 0.0) > 0.0;
                if is_object && !is_ignored(capture, p) {
                    points.push(p);
                }
            }
        }
        let step = points.len().div_ceil(MOST_POINTS).max(1);
        Self {
            nearest: nearest(&mean),
            points: points.into_iter().step_by(step).collect(),
            tolerance: TOLERANCE + view.camera.response.uncertainty,
            camera: view.camera.clone(),
        }
    }
}

/// Whether a point lies where the silhouette of some camera says nothing: it may be a prop's, which outlines do not
/// exclude there.
fn is_ignored(capture: &CaptureSilhouettes, p: Point3<f64>) -> bool {
    let views = capture.scene.colors.iter().zip(capture.silhouettes);
    let mut unknown = views.filter_map(|(view, s)| Some((&view.camera, s.unknown.as_ref()?)));
    unknown.any(|(camera, unknown)| {
        let at = camera
            .project(p)
            .and_then(|(pixel, _)| unknown.get(pixel.x.round() as isize, pixel.y.round() as isize));
        at.is_some_and(|&at| at >= 128)
    })
}

/// The readings within so many pixels of a place.
fn within(depths: &Grid<f32>, reach: isize, x: usize, y: usize) -> impl Iterator<Item = f32> {
    let offsets = (-reach..=reach).flat_map(move |dy| (-reach..=reach).map(move |dx| (dx, dy)));
    let near = offsets.filter_map(move |(dx, dy)| depths.get(x as isize + dx, y as isize + dy));
    near.copied().filter(|&d| d > 0.0)
}

/// The nearest reading around each pixel in metres; 0 means no reading there, or an edge. A steep side is not read,
/// and a pixel of it beside the table would seem to look past the side at the table.
fn nearest(depths: &Grid<f32>) -> Grid<f32> {
    Grid::from_fn(depths.width(), depths.height(), |x, y| {
        let ends = |[low, high]: [f32; 2], d: f32| [low.min(d), high.max(d)];
        let [low, high] = within(depths, 2, x, y).fold([f32::INFINITY, 0.0], ends);
        let least = within(depths, 1, x, y).fold(f32::INFINITY, f32::min);
        let is_edge = f64::from(high - low) > EDGE_AROUND;
        if depths[(x, y)] > 0.0 && !is_edge {
            least
        } else {
            0.0
        }
    })
}

fn mean_depth(view: &DepthView) -> Grid<f32> {
    let lens = &view.camera.camera.intrinsics;
    Grid::from_fn_parallel(lens.width, lens.height, |x, y| {
        let at = |readings: &Grid<u16>| readings.get(x as isize, y as isize).copied();
        let readings = view.frames.iter().filter_map(|f| at(&f.readings));
        let depths = readings.filter_map(|r| view.camera.response.depth(r));
        let (sum, count) = depths.fold((0.0, 0), |(s, n), d| (s + d, n + 1));
        if 2 * count > view.frames.len() {
            (sum / count as f64) as f32
        } else {
            0.0
        }
    })
}

/// What the depths of two captures say of a pose; `None` where they have too little in common.
pub(super) fn contradiction(
    a: &Depths,
    b: &Depths,
    pose: &Isometry3<f64>,
) -> Option<Contradiction> {
    let back = pose.inverse();
    let (mut against, mut common) = (0, 0);
    for (from, to, pose) in [(a, b, pose), (b, a, &back)] {
        for (of, by) in from
            .0
            .iter()
            .flat_map(|of| to.0.iter().map(move |by| (of, by)))
        {
            for p in &of.points {
                let p = pose * p;
                let Some((pixel, depth)) = by.camera.project(p) else {
                    continue;
                };
                let at = (pixel.x.round() as isize, pixel.y.round() as isize);
                let Some(&seen) = by.nearest.get(at.0, at.1).filter(|&&d| d > 0.0) else {
                    continue;
                };
                common += 1;
                against += usize::from(f64::from(seen) - depth > of.tolerance.max(by.tolerance));
            }
        }
    }
    (common >= LEAST_POINTS).then(|| Contradiction {
        share: against as f64 / common as f64,
        points: common,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readings_at_an_edge_tell_nothing_and_those_of_a_slope_do() {
        let edge = Grid::from_fn(12, 5, |x, _| if x < 6 { 0.7 } else { 0.75 });
        let row: Vec<f32> = nearest(&edge).row(2).to_vec();
        assert_eq!(row[..4], [0.7; 4]);
        assert_eq!(row[4..8], [0.0; 4]);
        assert_eq!(row[8..], [0.75; 4]);
        let slope = Grid::from_fn(12, 5, |x, _| 0.7 + 0.004 * x as f32);
        assert_eq!(nearest(&slope)[(6, 2)], slope[(5, 2)]);
        let nothing = Grid::filled(12, 5, 0.0);
        assert_eq!(nearest(&nothing)[(6, 2)], 0.0);
    }

    #[test]
    fn a_steep_side_that_is_not_read_is_not_taken_for_the_table_beside_it() {
        // An object's top, its side, of which nothing is read, and the table.
        let picture = Grid::from_fn(14, 5, |x, _| match x {
            0..5 => 0.7,
            5..9 => 0.0,
            _ => 0.75,
        });
        let row: Vec<f32> = nearest(&picture).row(2).to_vec();
        assert_eq!(row[..5], [0.7; 5]);
        assert_eq!(row[5..9], [0.0; 4]);
        assert_eq!(row[9..], [0.75; 5]);
    }
}

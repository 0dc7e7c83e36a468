//! Depth enhancement (the paper's section 2.D): from a burst of raw readings to one depth image with its holes
//! filled and its expected error. This file has the order of the steps, their parameters and their result. It knows
//! nothing of hulls, only which pixels the object can cover.

mod across;
mod burst;
mod fill;
mod guide;
mod joint_bilateral;
mod noise;
mod plate;
mod pyramid;
mod several;
mod straight;
mod window;

pub use noise::SensorNoise;
pub use several::{CameraDepth, fuse};

use crate::frame::CameraId;
use crate::image::{Grid, Mask};
use crate::reconstruct::DepthView;
use burst::{Burst, Fused};
use rayon::prelude::*;

/// What is left of the noise of a single reading, on a surface that many neighbours make. A bias they share stays.
pub const OF_READING: f32 = 0.55;

/// Why a burst cannot be enhanced.
#[derive(Debug, thiserror::Error, PartialEq)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Error {
    /// A picture that is not of the size of its camera's calibration.
    #[error(
        "depth camera {camera}: {what} is {found_width}x{found_height}, expected {width}x{height} as calibrated"
    )]
    WrongSize {
        /// Whose picture it is.
        camera: CameraId,
        what: String,
        /// Width found, in pixels.
        found_width: usize,
        /// Height found, in pixels.
        found_height: usize,
        /// Width expected, in pixels.
        width: usize,
        /// Height expected, in pixels.
        height: usize,
    },
}

/// What smooths the depth.
#[derive(serde::Deserialize, serde::Serialize, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// The mean of the frames, its holes filled, and a weak plate laid through it.
    #[default]
    Plate,
    /// The mean of the frames, filtered once by the pyramid of joint bilateral filters.
    MeanThenBilateral,
    /// The paper's: each frame filtered by the pyramid of joint bilateral filters, then their mean.
    BilateralThenMean,
}

/// What becomes of a pixel whose readings spread.
#[derive(serde::Deserialize, serde::Serialize, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub enum Spread {
    /// Only the readings near their median count. A rim that some frames read on one side and some on the other stays
    /// where most of the frames see it.
    #[default]
    Majority,
    /// The paper's equation 2: the pixel is left out.
    LeaveOut,
}

/// How depth is enhanced.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// What smooths the depth.
    pub method: Method,
    /// What becomes of a pixel whose readings spread.
    pub spread: Spread,
    /// Equation 2: a pixel whose readings spread (max − min over the frames) by more than this many
    /// millimetres is left out. The paper's "≈ 30" has no unit.
    /// Default 30, range 0.001 to 1000000.
    #[serde(deserialize_with = "crate::range::from_a_thousandth::<_, f32, 1000000>")]
    pub spread_limit_mm: f32,
    /// Readings within this many millimetres of a pixel's median are its majority.
    /// Default 8, range 0.001 to 1000000.
    #[serde(deserialize_with = "crate::range::from_a_thousandth::<_, f32, 1000000>")]
    pub majority_mm: f32,
    /// A pixel counts as measured only if at least this share of the frames has a reading there. Beside a rim only some
    /// frames have a reading, and it belongs to the near side. The paper has no such test.
    /// Default 0.3, range 0 to 1.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 1>")]
    pub least_share: f32,

    /// Levels of the pyramid, including the full size.
    /// Default 4, range 1 to 12.
    #[serde(deserialize_with = "crate::range::count::<_, usize, 1, 12>")]
    pub levels: usize,
    /// The joint bilateral filter's half-width in pixels: the paper's "kernel size of 10".
    /// Default 10, range 0 to 64.
    #[serde(deserialize_with = "crate::range::count::<_, usize, 0, 64>")]
    pub half_width_px: usize,
    /// Its spatial standard deviation in pixels.
    /// Default 3, range 0.001 to 1000.
    #[serde(deserialize_with = "crate::range::from_a_thousandth::<_, f32, 1000>")]
    pub spatial_sigma_px: f32,
    /// Its range standard deviation, of an intensity in [0, 1].
    /// Default 0.1, range 0.001 to 1000.
    #[serde(deserialize_with = "crate::range::from_a_thousandth::<_, f32, 1000>")]
    pub range_sigma: f32,
    /// Standard deviation in millimetres of an additional range weight on depth; 0 means no such weight, as in the
    /// paper.
    /// Default 0, range 0 to 1000000.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 1000000>")]
    pub depth_sigma_mm: f32,

    /// If the depths on both sides of a hole differ by at least this many millimetres, the hole may be an edge that
    /// hides what is behind it.
    /// Default 12, range 0.001 to 1000000.
    #[serde(deserialize_with = "crate::range::from_a_thousandth::<_, f32, 1000000>")]
    pub least_step_mm: f32,
    /// Widest hole, in pixels, that may be such an edge; a wider one is a wall.
    /// Default 3.5, range 0 to 6.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 6>")]
    pub widest_step_px: f32,
    /// Steepest slope towards the edge (metres of depth per metre across the view) that the surface behind it may have;
    /// a steeper surface is the foot of a wall.
    /// Default 1, range 0 to 1000.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 1000>")]
    pub steepest_floor: f32,

    /// The plate's stiffness: the weight of its bending relative to its distance from the readings, both in units of a
    /// reading's expected error.
    /// Default 120, range 0 to 1000000.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 1000000>")]
    pub stiffness: f32,
    /// Bending, in expected errors per pixel squared, at which the plate begins to break. It is below the noise,
    /// because it applies to the smoothed plate.
    /// Default 0.3, range 0.001 to 1000000.
    #[serde(deserialize_with = "crate::range::from_a_thousandth::<_, f32, 1000000>")]
    pub bend_limit: f32,
    /// The same for the first round, in units of the bending that the readings' noise causes, so that noise is not
    /// mistaken for edges.
    /// Default 0.3, range 0 to 1000.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 1000>")]
    pub noise_bend: f32,
    /// How often the plate's weights are computed again.
    /// Default 5, range 0 to 100.
    #[serde(deserialize_with = "crate::range::count::<_, usize, 0, 100>")]
    pub plate_rounds: usize,
    /// Steps of conjugate gradients between two such rounds.
    /// Default 20, range 0 to 1000.
    #[serde(deserialize_with = "crate::range::count::<_, usize, 0, 1000>")]
    pub plate_steps: usize,
    /// Standard deviation in pixels of the window over which the sensor matches its pattern. The sensor averages a
    /// surface over this window, and the plate undoes that. 0 for a sensor without such a window.
    /// Default 2, range 0 to 8.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 8>")]
    pub window_sigma_px: f32,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            method: Method::default(),
            spread: Spread::default(),
            spread_limit_mm: 30.0,
            majority_mm: 8.0,
            least_share: 0.3,
            levels: 4,
            half_width_px: 10,
            spatial_sigma_px: 3.0,
            range_sigma: 0.1,
            depth_sigma_mm: 0.0,
            least_step_mm: 12.0,
            widest_step_px: 3.5,
            steepest_floor: 1.0,
            stiffness: 120.0,
            bend_limit: 0.3,
            noise_bend: 0.3,
            plate_rounds: 5,
            plate_steps: 20,
            window_sigma_px: 2.0,
        }
    }
}

/// Where a pixel's depth comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum DepthKind {
    /// No depth: outside the region, or too far from any reading to be filled.
    #[default]
    None = 0,
    /// The mean of valid readings.
    Measured = 1,
    /// There is no reading that can be trusted: the depth is filled in from the surroundings.
    Filled = 2,
}

/// What was found on the way, for report and verdict. Counts are pixels of the region.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Facts {
    /// Frames used.
    pub frames: usize,
    /// Pixels of the region.
    pub region: usize,
    /// Pixels with depth from readings.
    pub measured: usize,
    /// Pixels whose depth is filled in from the surroundings.
    pub filled: usize,
    /// Pixels without depth.
    pub empty: usize,
    /// Pixels without a reading in any frame.
    pub without_reading: usize,
    /// Pixels left out because their readings spread too much (equation 2).
    pub spread_too_much: usize,
    /// Pixels left out because too few frames had a reading there.
    pub read_too_rarely: usize,
    /// Median over measured pixels of the standard deviation over frames, in metres: the sensor's noise in
    /// one frame.
    pub temporal_noise: f32,
}

/// One depth camera's enhanced depth. The grids have the size of the camera's pictures.
#[derive(Clone, Debug)]
pub struct EnhancedDepth {
    /// Depth in metres along the optical axis, linearised; 0 where there is none.
    pub depth: Grid<f32>,
    /// Where each pixel's depth comes from.
    pub kind: Grid<DepthKind>,
    /// Expected standard error in metres; 0 where there is no depth. The camera's calibration may add its
    /// own uncertainty, which is common to all pixels and not in here.
    pub sigma: Grid<f32>,
    /// The sensor's noise as measured on this burst.
    pub noise: SensorNoise,
    /// Counts and figures.
    pub facts: Facts,
}

impl EnhancedDepth {
    /// The depth of a pixel that was read and not filled in, in metres; `None` of others, and outside the picture.
    pub fn reading(&self, x: isize, y: isize) -> Option<f32> {
        let is_measured = self.kind.get(x, y) == Some(&DepthKind::Measured);
        self.depth.get(x, y).copied().filter(|_| is_measured)
    }
}

/// Enhances a burst. `region` has the size of the camera's pictures and is 128 and up where the object can be; no
/// reading outside it is used and nothing outside it is filled. A burst without frames or readings is not an error:
/// every pixel is then [`DepthKind::None`].
///
/// # Errors
/// If a picture or the region has not the size of the camera's calibration.
pub fn enhance(
    view: &DepthView,
    region: &Mask,
    parameters: &Parameters,
) -> Result<EnhancedDepth, Error> {
    check_sizes(view, region)?;
    let burst = Burst::new(view, region);
    let fused = burst.fuse(parameters);
    let smooth = match parameters.method {
        Method::Plate => on_a_plate(view, &burst, &fused, parameters),
        Method::MeanThenBilateral => {
            let guide = vec![guide::mean(view, &burst)];
            bilateral(&burst, fused.depth.clone(), guide, parameters)
        }
        Method::BilateralThenMean => each_frame_bilateral(view, &burst, &fused, parameters),
    };
    Ok(assemble(view, &burst, fused, smooth))
}

/// The mean's holes filled and a plate laid through it, in inverse depth: there the sensor's noise is the
/// same at every distance, and a plane in space is linear in the picture.
fn on_a_plate(
    view: &DepthView,
    burst: &Burst,
    fused: &Fused,
    parameters: &Parameters,
) -> Grid<f32> {
    let guide = guide::mean(view, burst);
    let pixel = (1.0 / view.camera.camera.intrinsics.focal_px.min()) as f32;
    let filled = fill::fill(&fused.depth, &burst.inside, &guide, pixel, parameters);
    let frames = burst.frames.len().max(1);
    let share = |z: f32, count: u16| {
        if z > 0.0 {
            f32::from(count) / frames as f32
        } else {
            0.0
        }
    };
    let confidence = Grid::from_fn(burst.width, burst.height, |x, y| {
        share(fused.depth[(x, y)], fused.count[(x, y)])
    });
    let error = SensorNoise::measure(fused).inverse_depth_error(frames);
    let start = filled.map(inverse);
    let surface = start.pixels().iter().copied().filter(|&w| w > 0.0);
    let farthest = surface.fold(f32::INFINITY, f32::min);
    let plate = plate::Plate {
        stiffness: parameters.stiffness,
        bend_limit: parameters.bend_limit,
        noise_bend: parameters.noise_bend,
        rounds: parameters.plate_rounds,
        steps: parameters.plate_steps,
        window_sigma_px: parameters.window_sigma_px,
        // A step at the farthest point, in inverse depth.
        edge: 1e-3 * parameters.least_step_mm * farthest * farthest,
    };
    let laid = plate::fill_in(&start, &confidence, error, &plate);
    laid.map(inverse)
}

/// 1/z of a depth or the other way round; 0 stays 0.
fn inverse(z: &f32) -> f32 {
    if *z > 0.0 { z.recip() } else { 0.0 }
}

/// One picture through the pyramid of joint bilateral filters.
fn bilateral(
    burst: &Burst,
    depth: Grid<f32>,
    guide: Vec<Grid<f32>>,
    parameters: &Parameters,
) -> Grid<f32> {
    let kernel = joint_bilateral::Kernel {
        half_width_px: parameters.half_width_px,
        spatial_sigma_px: parameters.spatial_sigma_px,
        range_sigma: parameters.range_sigma,
        depth_sigma: (parameters.depth_sigma_mm > 0.0).then_some(parameters.depth_sigma_mm * 1e-3),
    };
    let level = pyramid::PyramidLevel {
        depth,
        guide,
        inside: burst.inside.clone(),
    };
    let step = parameters.least_step_mm * 1e-3;
    pyramid::filter_pyramid(level, parameters.levels, &kernel, step)
}

/// The paper's order: each frame by itself, then equations 1 and 2 over the filtered frames. Pixels that
/// equation 2 leaves out of the raw frames are holes in each.
fn each_frame_bilateral(
    view: &DepthView,
    burst: &Burst,
    fused: &Fused,
    parameters: &Parameters,
) -> Grid<f32> {
    let filtered: Vec<Grid<f32>> = (0..burst.frames.len())
        .into_par_iter()
        .map(|i| {
            let frame = &burst.frames[i];
            let depth = Grid::from_fn(burst.width, burst.height, |x, y| {
                let kept = fused.depth[(x, y)] > 0.0;
                if kept { frame[(x, y)] } else { 0.0 }
            });
            let guide = vec![guide::of_frame(&view.frames[i], burst)];
            bilateral(burst, depth, guide, parameters)
        })
        .collect();
    burst::mean_of_filtered(&filtered, parameters.spread_limit_mm * 1e-3)
}

fn check_sizes(view: &DepthView, region: &Mask) -> Result<(), Error> {
    let lens = &view.camera.camera.intrinsics;
    let check = |what: String, found_width, found_height| {
        if (found_width, found_height) == (lens.width, lens.height) {
            return Ok(());
        }
        Err(Error::WrongSize {
            camera: view.camera.camera.id.clone(),
            what,
            found_width,
            found_height,
            width: lens.width,
            height: lens.height,
        })
    };
    check("the region".into(), region.width(), region.height())?;
    for (i, frame) in view.frames.iter().enumerate() {
        let depth = &frame.readings;
        check(format!("depth frame {i}"), depth.width(), depth.height())?;
        if let Some(color) = &frame.color {
            let what = format!("colour of frame {i}");
            check(what, color.width(), color.height())?;
        }
    }
    Ok(())
}

/// Puts the window back into pictures of the camera's size.
fn assemble(view: &DepthView, burst: &Burst, fused: Fused, filled: Grid<f32>) -> EnhancedDepth {
    let lens = &view.camera.camera.intrinsics;
    let (width, height) = (lens.width, lens.height);
    let noise = SensorNoise::measure(&fused);
    let mut out = EnhancedDepth {
        depth: Grid::filled(width, height, 0.0),
        kind: Grid::filled(width, height, DepthKind::None),
        sigma: Grid::filled(width, height, 0.0),
        noise,
        facts: Facts {
            frames: view.frames.len(),
            temporal_noise: noise.median_deviation,
            ..fused.facts
        },
    };
    for y in 0..burst.height {
        for x in 0..burst.width {
            let z = filled[(x, y)];
            if z <= 0.0 {
                out.facts.empty += usize::from(burst.inside[(x, y)]);
                continue;
            }
            let at = (x + burst.left, y + burst.top);
            let measured = fused.depth[(x, y)] > 0.0;
            let slope = noise::slope(&filled, x, y);
            out.depth[at] = z;
            if measured {
                out.kind[at] = DepthKind::Measured;
                out.facts.measured += 1;
                out.sigma[at] = noise.standard_error(z, slope, fused.count[(x, y)].into());
            } else {
                out.kind[at] = DepthKind::Filled;
                out.facts.filled += 1;
                out.sigma[at] = noise.standard_error(z, slope, 1) + 0.5 * slope;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests;

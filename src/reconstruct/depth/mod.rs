//! Depth enhancement (the paper's section 2.D): from a burst of raw readings to one depth image with its
//! holes filled and its expected error. This file has the order of the steps, their parameters and what
//! comes out; it knows nothing of hulls, only which pixels the object can cover.

mod burst;
mod fill;
mod noise;

pub use noise::SensorNoise;

use crate::frame::CameraId;
use crate::image::{Grid, Mask};
use crate::reconstruct::DepthView;
use burst::Burst;

/// Why a burst cannot be enhanced.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum Error {
    /// A picture that is not of the size of its camera's calibration.
    #[error(
        "depth camera {camera}: {what} is {found_width}x{found_height}, expected {width}x{height} as calibrated"
    )]
    WrongSize {
        /// Whose picture it is.
        camera: CameraId,
        /// Which picture.
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
    /// A parameter out of its range.
    #[error("depth.{name} is {found}, expected {expected}")]
    BadParameter {
        /// Its name.
        name: &'static str,
        /// Its value.
        found: String,
        /// What would do.
        expected: &'static str,
    },
}

/// How depth is enhanced.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// Equation 2: a pixel whose readings spread (max − min over the frames) by more than this many
    /// millimetres is left out. The paper's "≈ 30" has no unit.
    pub spread_limit_mm: f32,
    /// A pixel is measured only where at least this share of the frames has a reading. Rims are seen in
    /// some frames and missed in others, and those readings belong to the near side. The paper has no such
    /// test.
    pub least_share: f32,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            spread_limit_mm: 30.0,
            least_share: 0.5,
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
    /// No reading that can be trusted: carried over from around.
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
    /// Pixels with depth carried over from around.
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

/// Enhances a burst. `region` has the size of the camera's pictures and is 128 and up where the object can
/// be; no reading outside it is used and nothing outside it is filled. A burst without frames or readings
/// is no error: every pixel is [`DepthKind::None`].
///
/// # Errors
/// If a picture or the region has not the size of the camera's calibration, or a parameter is out of range.
pub fn enhance(
    view: &DepthView,
    region: &Mask,
    parameters: &Parameters,
) -> Result<EnhancedDepth, Error> {
    parameters.check()?;
    check_sizes(view, region)?;
    let burst = Burst::new(view, region);
    let fused = burst.fuse(parameters);
    let filled = fill::fill(&fused.depth, &burst.inside);
    Ok(assemble(view, &burst, fused, filled))
}

impl Parameters {
    fn check(&self) -> Result<(), Error> {
        let in_range = |name, value: f32, least: f32, most: f32, expected| {
            if (least..=most).contains(&value) {
                return Ok(());
            }
            Err(Error::BadParameter {
                name,
                found: value.to_string(),
                expected,
            })
        };
        in_range(
            "spread_limit_mm",
            self.spread_limit_mm,
            1e-3,
            1e6,
            "0.001 to 1000000 mm",
        )?;
        in_range("least_share", self.least_share, 0.0, 1.0, "0 to 1")
    }
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
        let (depth, color) = (&frame.readings, &frame.color);
        check(format!("depth frame {i}"), depth.width(), depth.height())?;
        check(
            format!("colour of frame {i}"),
            color.width(),
            color.height(),
        )?;
    }
    Ok(())
}

/// Puts the window back into pictures of the camera's size.
fn assemble(
    view: &DepthView,
    burst: &Burst,
    fused: burst::Fused,
    filled: Grid<f32>,
) -> EnhancedDepth {
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

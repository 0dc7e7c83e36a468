//! Options of a simulated recording, as plain parameters; each module implements its own.

use super::{CaptureFault, Exchange, Pose, Shape};
use serde::{Deserialize, Serialize};

/// A simulated session: object, rig, sensors and faults.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// The object.
    pub shape: Shape,
    /// Edge length of the truth's triangles in millimetres. Default 2.
    pub spacing_mm: f64,
    /// What all randomness derives from. Default 1.
    pub seed: u64,
    /// Colour cameras, 2 to 99; one is enough where a board is shown. Default 11.
    pub cameras: usize,
    /// How many of them stand in the low ring, 14 degrees above the table; the others look down from 46 degrees. By
    /// default 7 of 11, rounded up.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub low_cameras: Option<usize>,
    /// Width of their pictures in pixels; the field of view stays. Default 2560.
    pub width: usize,
    /// Height of their pictures in pixels. Default 1920.
    pub height: usize,
    /// Depth cameras. Default 1.
    pub depth_cameras: usize,
    /// Angle in degrees between the first depth camera's view and straight down, at most 85; the others look at 35
    /// degrees more, so that it is at most 50 where there are others. Default 4.
    pub depth_slant_deg: f64,
    /// Metres from a depth camera to the object. Default 0.8.
    pub depth_distance: f64,
    /// Captures of the same object, at least 1. Default 1.
    pub captures: usize,
    /// The object's pose in each capture; without any it stands upright in all of them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub poses: Vec<Pose>,
    /// The object's number, which every trigger names.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub subject: Option<String>,
    /// Whether the object has a pattern. Default false.
    pub textured: bool,
    /// Whether rings are painted around the object, instead of a pattern. Default false.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub rings: bool,
    /// Whether the session holds exact masks instead of backgrounds. Default false.
    pub masks: bool,
    /// The colour cameras' sensors.
    pub color: ColorSensor,
    /// The depth cameras' sensors.
    pub depth: DepthSensor,
    /// What goes wrong.
    pub faults: Faults,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            shape: Shape::Cup,
            spacing_mm: 2.0,
            seed: 1,
            cameras: 11,
            low_cameras: None,
            width: 2560,
            height: 1920,
            depth_cameras: 1,
            depth_slant_deg: 4.0,
            depth_distance: 0.8,
            captures: 1,
            poses: Vec::new(),
            subject: None,
            textured: false,
            rings: false,
            masks: false,
            color: ColorSensor::default(),
            depth: DepthSensor::default(),
            faults: Faults::default(),
        }
    }
}

impl Options {
    /// A small session of a shape that a test can afford: eleven cameras of 320 x 240 and ten depth frames.
    pub fn small(shape: Shape) -> Self {
        Self {
            shape,
            spacing_mm: 3.0,
            width: 320,
            height: 240,
            depth: DepthSensor {
                frames: 10,
                ..DepthSensor::default()
            },
            ..Self::default()
        }
    }
}

impl Options {
    /// A rig to which calibration boards are shown: the depth camera is far enough away to see them at 0.7 to 1.3 m,
    /// and gives ten frames with two colour pictures to each placement.
    pub fn for_boards() -> Self {
        Self {
            depth_distance: 1.3,
            color: ColorSensor {
                blur_px: 0.8,
                ..ColorSensor::default()
            },
            depth: DepthSensor {
                frames: 10,
                color_every: 5,
                ..DepthSensor::default()
            },
            ..Self::default()
        }
    }
}

/// How pictures are encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum, Deserialize, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Encoding {
    /// The sensor's own mosaic, `bayer_rggb8`.
    Bayer,
    /// Grey values, `mono8`.
    Mono,
    /// JPEG.
    Jpeg,
    /// PNG.
    Png,
    /// Rows of red, green and blue, `rgb8`.
    Rgb,
}

/// A colour camera's sensor and lens.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct ColorSensor {
    /// How pictures are encoded. Default `bayer`.
    pub encoding: Encoding,
    /// Quality of JPEG, 1 to 100. Default 92.
    pub jpeg_quality: u8,
    /// Electrons at full scale: photon noise is their square root. 0 is no noise at all. Default 9000.
    pub full_well: f64,
    /// Read noise in electrons. Default 8.
    pub read_noise: f64,
    /// Standard deviation of the point spread in pixels: lens, focus and sensor together. Default 0.7.
    pub blur_px: f64,
    /// Standard deviation of the exposure's drift from the background to a picture, as a part of it;
    /// each colour drifts by a third of that on its own. Default 0.01.
    pub exposure_drift: f64,
    /// How strongly the object darkens the table around it, 0 to 1. Default 1.
    pub shadows: f64,
    /// How much of the backdrop's colour the object catches, 0 to 1. Default 0.5.
    pub spill: f64,
    /// Whether lenses distort and differ. Default true.
    pub distortion: bool,
}

impl Default for ColorSensor {
    fn default() -> Self {
        Self {
            encoding: Encoding::Bayer,
            jpeg_quality: 92,
            full_well: 9000.0,
            read_noise: 8.0,
            blur_px: 0.7,
            exposure_drift: 0.01,
            shadows: 1.0,
            spill: 0.5,
            distortion: true,
        }
    }
}

/// The depth sensor's response as a recording states it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum, Deserialize, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Response {
    /// The sensor reads millimetres, and no response is written.
    Ideal,
    /// The sensor's readings need slope, intercept and scale, which the recording holds.
    Written,
    /// As before, but the recording says nothing of it.
    Hidden,
}

/// A depth camera's sensor, after the Kinect of 2010.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct DepthSensor {
    /// Frames a capture. Default 30.
    pub frames: usize,
    /// Standard deviation of the disparity's noise, new in each frame, in steps of the disparity. 0.245 gives
    /// the spread over frames that is seen on real table tops. Default 0.245.
    pub noise_steps: f64,
    /// Standard deviation of the fixed pattern in steps of the disparity, half of it smooth, half from pixel
    /// to pixel. Default 0.25.
    pub pattern_steps: f64,
    /// Whether disparity comes in whole steps. Default true.
    pub quantized: bool,
    /// Whether there are holes: at grazing angles, in the projector's shadow, and some anywhere. Default true.
    pub holes: bool,
    /// Width in pixels over which readings at rims mix both sides. Default 1.5.
    pub smear_px: f64,
    /// Millimetres that readings are too deep, which the recording does not know. Default 0.
    pub bias_mm: f64,
    /// Millimetres by which readings of the object are deeper still, as its material may make them. Default 0.
    pub object_bias_mm: f64,
    /// Pixels by which the depth is displaced against what the calibration says. Default 0.
    pub misregistration_px: f64,
    /// How the sensor responds. Default `ideal`.
    pub response: Response,
    /// Depth frames per colour picture. Default 1.
    pub color_every: usize,
    /// Quality of the depth camera's colour as JPEG, 1 to 100; 0 is `rgb8`. Default 0.
    pub color_jpeg_quality: u8,
}

impl Default for DepthSensor {
    fn default() -> Self {
        Self {
            frames: 30,
            noise_steps: 0.245,
            pattern_steps: 0.25,
            quantized: true,
            holes: true,
            smear_px: 1.5,
            bias_mm: 0.0,
            object_bias_mm: 0.0,
            misregistration_px: 0.0,
            response: Response::Ideal,
            color_every: 1,
            color_jpeg_quality: 0,
        }
    }
}

impl DepthSensor {
    /// A sensor that measures exactly, in one frame.
    pub fn perfect() -> Self {
        Self {
            frames: 1,
            noise_steps: 0.0,
            pattern_steps: 0.0,
            quantized: false,
            holes: false,
            smear_px: 0.0,
            ..Self::default()
        }
    }
}

/// A fault of one camera.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CameraFault {
    /// The camera's id.
    pub camera: String,
    /// How much, in the unit of the fault.
    pub amount: f64,
}

/// What goes wrong in a session. The calibration knows of none of it, except where an object is cut off.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Faults {
    /// Colour cameras that were turned by some degrees after they were calibrated.
    pub turned_deg: Vec<CameraFault>,
    /// Colour cameras whose frame's edge cuts off this part of the object, from the left; the calibration is true.
    pub cut_off: Vec<CameraFault>,
    /// Colour cameras that are out of focus: pixels by which the point spread grows.
    pub blurred_px: Vec<CameraFault>,
    /// Colour cameras that are overexposed, in stops.
    pub overexposed_stops: Vec<CameraFault>,
    /// Cameras that give no frame to a capture.
    pub missing: Vec<String>,
    /// Cameras whose frames are late, in milliseconds.
    pub late_ms: Vec<CameraFault>,
    /// Colour cameras without a background (or mask).
    pub no_background: Vec<String>,
    /// No object on the table.
    pub empty_table: bool,
    /// Depth frames without a single reading.
    pub no_depth: bool,
    /// The recording says that its calibration was judged doubtful, for this reason.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub doubtful_calibration: Option<String>,
    /// A ball of this radius (millimetres) breaks out of the object's upper edge before a capture, for good.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub chip_mm: Vec<CaptureFault>,
    /// A ball of this radius (millimetres) breaks out of the middle of the top, or of a hollow's floor.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub pit_mm: Vec<CaptureFault>,
    /// Captures that show something else.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub exchanged: Vec<Exchange>,
    /// A prop of this width (millimetres), in the backdrop's cloth, stands beside the object in a capture.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub prop_mm: Vec<CaptureFault>,
    /// Whether the recording says which pixels show a prop.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub props_ignored: bool,
    /// The first colour camera does not tell this radius (millimetres) of the object's outline from the backdrop.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub lost_piece_mm: Vec<CaptureFault>,
    /// Standard deviation, in pixels, of the error of the colour cameras' calibrated principal points.
    #[serde(skip_serializing_if = "is_zero")]
    pub calibration_px: f64,
    /// Per cent by which the calibrated rig is larger than the rig is.
    #[serde(skip_serializing_if = "is_zero")]
    pub calibration_scale_percent: f64,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

impl Faults {
    /// The amount of a fault that a camera has, 0 without.
    pub(super) fn amount(list: &[CameraFault], camera: &str) -> f64 {
        list.iter()
            .find(|fault| fault.camera == camera)
            .map_or(0.0, |fault| fault.amount)
    }

    /// Nanoseconds that a camera's frames come late, a minute's at most.
    pub(super) fn late_ns(&self, camera: &str) -> u64 {
        let milliseconds = Self::amount(&self.late_ms, camera);
        (milliseconds.clamp(0.0, 60_000.0) * 1e6) as u64
    }

    /// The faults that only a colour camera has, as they are called.
    pub(super) fn of_colors(&self) -> [(&'static str, &[CameraFault]); 4] {
        [
            ("turned camera", &self.turned_deg),
            ("camera that cuts off", &self.cut_off),
            ("blurred camera", &self.blurred_px),
            ("overexposed camera", &self.overexposed_stops),
        ]
    }

    /// Every camera that a fault names.
    pub(super) fn cameras(&self) -> impl Iterator<Item = &str> {
        let amounts = [
            &self.turned_deg,
            &self.cut_off,
            &self.blurred_px,
            &self.overexposed_stops,
            &self.late_ms,
        ];
        let with_amount = amounts
            .into_iter()
            .flatten()
            .map(|fault| fault.camera.as_str());
        let without = self.missing.iter().chain(&self.no_background);
        with_amount.chain(without.map(String::as_str))
    }
}

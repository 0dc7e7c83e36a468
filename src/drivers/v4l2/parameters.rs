//! The configuration of a V4L2 camera. It is always compiled, so that a configuration can be checked without such a
//! camera.

use crate::drivers::pixel_format::PixelFormat;
use crate::frame::Transfer;
use crate::range;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A colour camera of the kernel's video drivers. What is left out is left as the camera has it, unless said otherwise.
#[derive(Deserialize, Serialize, Clone, Debug, Default, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// Its path, one that stays: below `/dev/v4l/by-id` or `/dev/v4l/by-path`, or a link of a rule of one's own. The
    /// numbers of `/dev/video0` and so on change. Needed.
    pub device: Option<String>,
    /// Width and height in pixels, 1 to 16384 each. Needed.
    #[serde(deserialize_with = "range::optional_size")]
    pub size: Option<[u32; 2]>,
    /// How its pixels come. Default `mjpeg`.
    pub pixel_format: Option<PixelFormat>,
    /// Frames in a second, above 0 and up to 1000.
    #[serde(deserialize_with = "range::optional_rate")]
    pub rate: Option<f64>,
    /// Exposure in seconds, above 0 and up to 3600 (`exposure_time_absolute`, which counts 100 µs).
    #[serde(deserialize_with = "range::optional_seconds")]
    pub exposure: Option<f64>,
    /// Whether the camera may choose the exposure. Default false, and then it is switched off.
    pub auto_exposure: Option<bool>,
    /// Gain in the camera's own steps (`gain`).
    pub gain: Option<i64>,
    /// Whether the camera may choose the gain. Default false, and then it is switched off.
    pub auto_gain: Option<bool>,
    /// Colour temperature of the light in kelvin (`white_balance_temperature`).
    pub white_balance_kelvin: Option<i64>,
    /// Whether the camera may choose the white balance. Default false, and then it is switched off.
    pub auto_white_balance: Option<bool>,
    /// Whether the camera may focus by itself. Default false, and then it is switched off.
    pub auto_focus: Option<bool>,
    /// Other controls by their names in `v4l2-ctl --list-ctrls`, set before all others, in the order of their names.
    pub controls: Option<BTreeMap<String, i64>>,
    /// What starts an exposure. Default `free-run`.
    pub trigger: Option<TriggerMode>,
    /// How its colours are encoded, which it cannot tell. Default `srgb`.
    pub transfer: Option<Transfer>,
    /// Time from the end of an exposure to the frame's last line, in seconds above 0 and up to 3600; for cameras that
    /// stamp the end of a frame. Default: the time between two frames, or 0 where that is not known.
    #[serde(deserialize_with = "range::optional_seconds")]
    pub readout: Option<f64>,
    /// Frames that the kernel has memory for, 4 to 32. Default 6.
    #[serde(deserialize_with = "range::optional_count::<_, 4, 32>")]
    pub buffers: Option<u32>,
    /// Without a frame for so long, in milliseconds, 1 to 3600000 and no less than the time between two frames where
    /// `rate` says that, a free-running camera counts as away. Default 2000.
    #[serde(deserialize_with = "range::optional_patience")]
    pub silence_ms: Option<f64>,
}

/// What starts an exposure.
#[derive(Deserialize, Serialize, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum TriggerMode {
    /// The camera itself, again and again.
    #[default]
    FreeRun,
    /// A signal at its connector, to which `controls` has set it.
    Line,
}

/// The kernel's code of four letters for a format.
pub fn fourcc(format: PixelFormat) -> [u8; 4] {
    *match format {
        PixelFormat::Mjpeg => b"MJPG",
        PixelFormat::Yuyv => b"YUYV",
        PixelFormat::Uyvy => b"UYVY",
        PixelFormat::BayerRggb8 => b"RGGB",
        PixelFormat::BayerGrbg8 => b"GRBG",
        PixelFormat::BayerGbrg8 => b"GBRG",
        PixelFormat::BayerBggr8 => b"BA81",
        PixelFormat::Rgb8 => b"RGB3",
        PixelFormat::Bgr8 => b"BGR3",
        PixelFormat::Mono8 => b"GREY",
    }
}

impl Parameters {
    /// Checks what the fields' own types cannot say.
    ///
    /// # Errors
    /// In words, if a needed field is missing or two contradict each other.
    pub fn checked(&self) -> Result<(), String> {
        let device = self.device.as_deref().unwrap_or_default();
        if device.is_empty() {
            return Err(
                "device is missing, expected a path below /dev/v4l/by-id or /dev/v4l/by-path"
                    .into(),
            );
        }
        let number = device.strip_prefix("/dev/video");
        if number.is_some_and(|n| n.bytes().all(|b| b.is_ascii_digit())) {
            return Err(format!(
                "device is {device}, a number that changes; expected a path below /dev/v4l/by-id or /dev/v4l/by-path"
            ));
        }
        if self.size.is_none() {
            return Err("size is missing, expected width and height in pixels".into());
        }
        self.fits_rate()?;
        let both = |value: bool, auto: Option<bool>| value && auto == Some(true);
        for (contradicts, fields) in [
            (
                both(self.exposure.is_some(), self.auto_exposure),
                "exposure and auto_exposure",
            ),
            (
                both(self.gain.is_some(), self.auto_gain),
                "gain and auto_gain",
            ),
            (
                both(self.white_balance_kelvin.is_some(), self.auto_white_balance),
                "white_balance_kelvin and auto_white_balance",
            ),
        ] {
            if contradicts {
                return Err(format!("{fields} are both set, expected one of them"));
            }
        }
        Ok(())
    }

    fn fits_rate(&self) -> Result<(), String> {
        let (period_ms, silence_ms) = (self.rate.map_or(0.0, |rate| 1e3 / rate), self.silence_ms());
        if self.trigger() == TriggerMode::FreeRun && silence_ms < period_ms {
            return Err(format!(
                "silence_ms is {silence_ms}, expected at least {period_ms:.1}, the time between two frames at this rate: \
                 the camera would always be away"
            ));
        }
        Ok(())
    }

    /// Its path.
    pub fn device(&self) -> &str {
        self.device.as_deref().unwrap_or_default()
    }

    /// How pixels come.
    pub fn pixel_format(&self) -> PixelFormat {
        self.pixel_format.unwrap_or(PixelFormat::Mjpeg)
    }

    /// What starts an exposure.
    pub fn trigger(&self) -> TriggerMode {
        self.trigger.unwrap_or_default()
    }

    /// How long a free-running camera may be silent.
    pub fn silence(&self) -> std::time::Duration {
        std::time::Duration::from_secs_f64(self.silence_ms() / 1e3)
    }

    fn silence_ms(&self) -> f64 {
        self.silence_ms.unwrap_or(2000.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Parameters, String> {
        toml::from_str::<Parameters>(text)
            .map_err(|e| e.to_string())
            .and_then(|p| p.checked().map(|()| p))
    }

    const PLAIN: &str = "device = '/dev/v4l/by-id/usb-x-video-index0'\nsize = [640, 480]\n";

    #[test]
    fn what_is_needed_is_enough() {
        let p = read(PLAIN).unwrap();
        assert_eq!(p.pixel_format(), PixelFormat::Mjpeg);
        assert_eq!(p.trigger(), TriggerMode::FreeRun);
        let p = read(&format!(
            "{PLAIN}pixel_format = 'bayer_grbg8'\ntrigger = 'line'"
        ))
        .unwrap();
        assert_eq!(fourcc(p.pixel_format()), *b"GRBG");
    }

    #[test]
    fn what_makes_no_sense_is_refused_by_name() {
        for (text, named) in [
            ("", "device"),
            ("device = '/dev/video0'\nsize = [640, 480]", "/dev/video0"),
            ("device = '/dev/v4l/by-id/x'", "size"),
            (
                &format!("{PLAIN}exposure = 0.01\nauto_exposure = true"),
                "auto_exposure",
            ),
            (&format!("{PLAIN}exposure = nan"), "exposure"),
            (&format!("{PLAIN}rate = -30.0"), "rate"),
            (&format!("{PLAIN}buffers = 3"), "buffers"),
            (
                &format!("{PLAIN}silence_ms = 0.0"),
                "expected 1 to 3600000 milliseconds",
            ),
            (
                &format!("{PLAIN}rate = 0.1"),
                "silence_ms is 2000, expected at least 10000.0",
            ),
            (&format!("{PLAIN}pixel_format = 'yuv'"), "pixel_format"),
            (&format!("{PLAIN}gian = 3"), "gian"),
        ] {
            let message = read(text).unwrap_err();
            assert!(message.contains(named), "{text}: {message}");
        }
    }

    #[test]
    fn each_format_has_a_name_and_letters_of_its_own() {
        let names: std::collections::BTreeSet<_> =
            PixelFormat::ALL.map(PixelFormat::encoding).into();
        let letters: std::collections::BTreeSet<_> = PixelFormat::ALL.map(fourcc).into();
        assert_eq!((names.len(), letters.len()), (10, 10));
    }
}

//! The configuration of a GigE Vision camera. It is always compiled, and does not talk to a camera.

use crate::drivers::pixel_format::PixelFormat;
use crate::frame::Transfer;
use crate::range;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::net::Ipv4Addr;

/// How a GigE Vision camera is found and set. What is left out is left as the camera has it, unless said otherwise.
#[derive(Deserialize, Serialize, Clone, Debug, Default, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// Its IPv4 address. One of `address`, `serial` and `name` is needed; an address opens fastest, and where there are
    /// several, all must be true.
    pub address: Option<Ipv4Addr>,
    /// Its serial number.
    pub serial: Option<String>,
    /// The name that a user gave it (`DeviceUserID`).
    pub name: Option<String>,
    /// Pixel encoding, by its name in a recording.
    pub pixel_format: Option<PixelFormat>,
    /// Part of the sensor that is read, in pixels.
    pub region: Option<Region>,
    /// Exposure in seconds, above 0.
    #[serde(deserialize_with = "range::optional_positive")]
    pub exposure: Option<f64>,
    /// Whether the camera may choose the exposure; default `false`, and then it is switched off.
    pub auto_exposure: Option<bool>,
    /// Gain in decibels, any finite number.
    #[serde(deserialize_with = "range::optional_finite")]
    pub gain_db: Option<f64>,
    /// Gain in the camera's own steps, for one that knows no decibels (`GainRaw`).
    pub gain_raw: Option<i64>,
    /// Whether the camera may choose the gain; default `false`, and then it is switched off.
    pub auto_gain: Option<bool>,
    /// Gains of red, green and blue, each above 0.
    #[serde(deserialize_with = "range::optional_three_positive")]
    pub white_balance: Option<[f64; 3]>,
    /// Whether the camera may choose the white balance; default `false`, and then it is switched off.
    pub auto_white_balance: Option<bool>,
    /// How its colours are encoded, which it cannot tell; default `linear`, what sensors give without a gamma.
    pub transfer: Option<Transfer>,
    /// Size of its packets in bytes, with their IP header, 220 to 16404; default: the size that the camera has, or the
    /// largest that gets through if that one does not.
    #[serde(deserialize_with = "range::optional_count::<_, 220, 16_404>")]
    pub packet_size: Option<u32>,
    /// Pause between two of its packets in nanoseconds.
    pub packet_delay_ns: Option<u32>,
    /// Pause before the first packet of a frame in nanoseconds (`GevSCFTD`), so that cameras of one link take turns. A
    /// camera without this feature takes 0, which is what the first camera of a link has.
    pub transmission_delay_ns: Option<u64>,
    /// Whether lost packets are asked for again; default `true`.
    pub packet_resend: Option<bool>,
    /// What starts an exposure; default `software`.
    pub trigger: Option<TriggerMode>,
    /// Where a `line` or `action` trigger comes from, as the camera names it; default `Line1` or `Action1`.
    pub trigger_source: Option<String>,
    /// Which edge of a line starts the exposure; default `rising-edge`.
    pub trigger_activation: Option<Activation>,
    /// Frames a second, with `free-run`, above 0.
    #[serde(deserialize_with = "range::optional_positive")]
    pub frame_rate: Option<f64>,
    /// Device key of action commands; default 0.
    pub action_device_key: Option<u32>,
    /// Group key of action commands; default 1.
    pub action_group_key: Option<u32>,
    /// Group mask of action commands; default 1.
    pub action_group_mask: Option<u32>,
    /// How long after a trigger the exposure of an action command is scheduled, in seconds above 0; default 0.02.
    #[serde(deserialize_with = "range::optional_positive")]
    pub action_lead: Option<f64>,
    /// Whether its clock follows the network's (PTP, IEEE 1588); default `true` with `action`.
    pub ptp: Option<bool>,
    /// How far it may be off its PTP master, in nanoseconds; default 100000.
    pub ptp_within_ns: Option<u64>,
    /// Which moment its timestamps are of; default `start`. `end` excludes `auto_exposure`: the exposure is read once,
    /// when the camera is opened.
    pub exposure_mark: Option<ExposureMark>,
    /// Frames that memory is kept ready for, 2 to 64; default 3, and 8 with `line` and `free-run`.
    #[serde(deserialize_with = "range::optional_count::<_, 2, 64>")]
    pub buffers: Option<u32>,
    /// Whether the camera joins 2x2 pixels for the pictures of a look, where that keeps a press waiting no longer;
    /// default `false`. Needs `region`, and `trigger` `software`.
    pub binned_looks: Option<bool>,
    /// Other features by the camera's own names, set before everything else.
    pub features: Option<BTreeMap<String, FeatureValue>>,
}

/// A format's number in the GenICam Pixel Format Naming Convention; `None` for one that GigE Vision has not.
pub fn code(format: PixelFormat) -> Option<u32> {
    Some(match format {
        PixelFormat::Mjpeg => return None,
        PixelFormat::BayerGrbg8 => 0x0108_0008,
        PixelFormat::BayerRggb8 => 0x0108_0009,
        PixelFormat::BayerGbrg8 => 0x0108_000a,
        PixelFormat::BayerBggr8 => 0x0108_000b,
        PixelFormat::Rgb8 => 0x0218_0014,
        PixelFormat::Bgr8 => 0x0218_0015,
        PixelFormat::Mono8 => 0x0108_0001,
        PixelFormat::Uyvy => 0x0210_001f,
        PixelFormat::Yuyv => 0x0210_0032,
    })
}

/// The format of a number; `None` for one that a recording has no name for.
pub fn format_of(number: u32) -> Option<PixelFormat> {
    let mut all = PixelFormat::ALL.into_iter();
    all.find(|format| code(*format) == Some(number))
}

/// A part of the sensor, in pixels.
#[derive(Deserialize, Serialize, Clone, Copy, Debug, PartialEq, Eq)]
#[serde(deny_unknown_fields)]
pub struct Region {
    /// Left edge; default 0.
    #[serde(default)]
    pub x: u32,
    /// Upper edge; default 0.
    #[serde(default)]
    pub y: u32,
    /// Width.
    pub width: u32,
    /// Height.
    pub height: u32,
}

/// What starts an exposure.
#[derive(Deserialize, Serialize, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum TriggerMode {
    /// A command to each camera.
    #[default]
    Software,
    /// An electrical signal; what raises it is not the daemon's matter.
    Line,
    /// A scheduled action command: all cameras at one time of the clock that they share (PTP).
    Action,
    /// Nothing: the camera takes frames all the time, and those around a trigger count.
    FreeRun,
}

/// Which edge of a line starts an exposure.
#[derive(Deserialize, Serialize, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum Activation {
    /// From low to high.
    #[default]
    RisingEdge,
    /// From high to low.
    FallingEdge,
}

/// Which moment a camera's timestamps are of.
#[derive(Deserialize, Serialize, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum ExposureMark {
    /// Of the exposure's start.
    #[default]
    Start,
    /// Of its end.
    End,
}

/// The value of a feature.
#[derive(Deserialize, Serialize, Clone, Debug, PartialEq)]
#[serde(untagged)]
pub enum FeatureValue {
    /// Yes or no.
    Boolean(bool),
    /// A whole number.
    Integer(i64),
    /// A number.
    Float(f64),
    /// A text, or an enumeration's entry.
    Text(String),
}

impl Parameters {
    /// What starts an exposure.
    pub fn trigger_mode(&self) -> TriggerMode {
        self.trigger.unwrap_or_default()
    }

    /// Frames that memory is kept ready for.
    pub fn buffer_count(&self) -> u32 {
        self.buffers.unwrap_or(match self.trigger_mode() {
            TriggerMode::Software | TriggerMode::Action => 3,
            TriggerMode::Line | TriggerMode::FreeRun => 8,
        })
    }

    /// How the configuration identifies the camera, as text.
    pub fn address_text(&self) -> String {
        let address = self.address.map(|a| format!("at {a}"));
        let serial = self.serial.as_ref().map(|s| format!("with serial {s}"));
        let name = self.name.as_ref().map(|n| format!("named {n:?}"));
        let words: Vec<String> = [address, serial, name].into_iter().flatten().collect();
        words.join(", ")
    }

    /// Checks what no single field shows.
    ///
    /// # Errors
    /// In words, with the fields' names.
    pub fn checked(&self) -> Result<(), String> {
        if self.address.is_none() && self.serial.is_none() && self.name.is_none() {
            return Err("expected `address`, `serial` or `name`, found none of them".into());
        }
        // What the protocol has room for (GigE Vision's bootstrap registers).
        for (field, text) in [("serial", &self.serial), ("name", &self.name)] {
            if let Some(text) = text.as_ref().filter(|t| t.is_empty() || t.len() > 16) {
                return Err(format!("{field} {text:?}: expected 1 to 16 characters"));
            }
        }
        if let Some(format) = self.pixel_format.filter(|f| code(*f).is_none()) {
            let found = format.encoding();
            return Err(format!(
                "pixel_format {found}: expected a format of raw pixels, since GigE Vision cameras \
                send no files"
            ));
        }
        let region = self.region.filter(|r| r.width == 0 || r.height == 0);
        if let Some(Region { width, height, .. }) = region {
            return Err(format!(
                "region of {width}x{height} pixels: expected at least 1x1"
            ));
        }
        self.not_both()?;
        self.fits_exposure_mark()?;
        self.fits_trigger()?;
        self.fits_binned_looks()
    }

    /// Whether the camera may join pixels for a look.
    pub fn has_binned_looks(&self) -> bool {
        self.binned_looks == Some(true)
    }

    /// Whatever a look left behind, opening has to bring the camera to the capture's settings: so they must be given.
    fn fits_binned_looks(&self) -> Result<(), String> {
        if !self.has_binned_looks() {
            return Ok(());
        }
        if self.region.is_none() {
            return Err("binned_looks needs region: what the camera is brought back to".into());
        }
        if self.trigger_mode() != TriggerMode::Software {
            return Err("binned_looks has an effect only with trigger software".into());
        }
        let automatic = [
            (self.auto_exposure, "auto_exposure"),
            (self.auto_gain, "auto_gain"),
            (self.auto_white_balance, "auto_white_balance"),
        ];
        if let Some((_, field)) = automatic.iter().find(|(auto, _)| *auto == Some(true)) {
            return Err(format!(
                "{field} and binned_looks exclude each other: the camera would measure the light anew before a capture"
            ));
        }
        let mut names = self.features.iter().flat_map(BTreeMap::keys);
        let is_ours =
            |name: &&String| ["BinningHorizontal", "BinningVertical"].contains(&name.as_str());
        match names.find(is_ours) {
            Some(name) => Err(format!(
                "features.{name} and binned_looks exclude each other: a look would change what the capture needs"
            )),
            None => Ok(()),
        }
    }

    /// A stamp of the end tells the beginning only by the exposure, which is read when the camera is opened.
    fn fits_exposure_mark(&self) -> Result<(), String> {
        if self.exposure_mark == Some(ExposureMark::End) && self.auto_exposure == Some(true) {
            return Err(
                "exposure_mark end and auto_exposure exclude each other: when an exposure began is computed from its \
                 end and its length, which the camera would change: set exposure"
                    .into(),
            );
        }
        Ok(())
    }

    fn not_both(&self) -> Result<(), String> {
        let on = |auto: Option<bool>| auto == Some(true);
        let pairs = [
            (
                "auto_exposure",
                on(self.auto_exposure),
                "exposure",
                self.exposure.is_some(),
            ),
            (
                "auto_gain",
                on(self.auto_gain),
                "gain_db",
                self.gain_db.is_some(),
            ),
            (
                "auto_gain",
                on(self.auto_gain),
                "gain_raw",
                self.gain_raw.is_some(),
            ),
            (
                "gain_db",
                self.gain_db.is_some(),
                "gain_raw",
                self.gain_raw.is_some(),
            ),
            (
                "auto_white_balance",
                on(self.auto_white_balance),
                "white_balance",
                self.white_balance.is_some(),
            ),
        ];
        match pairs.iter().find(|(_, a, _, b)| *a && *b) {
            Some((a, _, b, _)) => Err(format!("{a} and {b} exclude each other")),
            None => Ok(()),
        }
    }

    fn fits_trigger(&self) -> Result<(), String> {
        let mode = self.trigger_mode();
        let action = self.action_device_key.is_some()
            || self.action_group_key.is_some()
            || self.action_group_mask.is_some()
            || self.action_lead.is_some();
        let wired = matches!(mode, TriggerMode::Line | TriggerMode::Action);
        let misplaced = [
            (action && mode != TriggerMode::Action, "action_…", "action"),
            (
                self.trigger_source.is_some() && !wired,
                "trigger_source",
                "line or action",
            ),
            (
                self.trigger_activation.is_some() && mode != TriggerMode::Line,
                "trigger_activation",
                "line",
            ),
            (
                self.frame_rate.is_some() && mode != TriggerMode::FreeRun,
                "frame_rate",
                "free-run",
            ),
        ];
        if let Some((_, field, needed)) = misplaced.iter().find(|(wrong, ..)| *wrong) {
            return Err(format!("{field} has an effect only with trigger {needed}"));
        }
        if mode == TriggerMode::Action && self.ptp == Some(false) {
            return Err("trigger action needs ptp = true".into());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Parameters, String> {
        let parameters: Parameters = toml::from_str(text).map_err(|e| e.to_string())?;
        parameters.checked()?;
        Ok(parameters)
    }

    #[test]
    fn a_camera_is_read_with_all_that_can_be_set() {
        let parameters = read(
            "address = '10.0.0.7'\npixel_format = 'bayer_rggb8'\nexposure = 0.004\ngain_db = 3\n\
             region = { width = 640, height = 480 }\nwhite_balance = [1.5, 1, 2]\ntrigger = 'line'\n\
             trigger_source = 'Line2'\ntrigger_activation = 'falling-edge'\npacket_size = 8000\n\
             features = { Gamma = 1.0, LineDebouncerTime = 10, LineMode = 'Input', ReverseX = true }",
        )
        .unwrap();
        assert_eq!(parameters.gain_db, Some(3.0));
        assert_eq!(parameters.features.unwrap().len(), 4);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let cases = [
            ("address = '10.0.0.7'\nexposure = nan", "NaN"),
            ("address = '10.0.0.7'\nexposure = -1", "above 0"),
            ("address = '10.0.0.7'\nexposrue = 1", "exposrue"),
            ("address = '10.0.0.700'", "address"),
            ("exposure = 1", "`serial`"),
            ("serial = ''", "1 to 16"),
            ("serial = 'a'\npixel_format = 'mjpeg'", "no files"),
            (
                "serial = 'a'\npixel_format = 'bayer_rggb12'",
                "bayer_rggb12",
            ),
            ("serial = 'a'\npacket_size = 100", "220 to 16404"),
            ("serial = 'a'\nbuffers = 1", "2 to 64"),
            ("serial = 'a'\nauto_gain = true\ngain_db = 1", "exclude"),
            (
                "serial = 'a'\nauto_exposure = true\nexposure_mark = 'end'",
                "exposure_mark end and auto_exposure exclude",
            ),
            ("serial = 'a'\nframe_rate = 5", "free-run"),
            ("serial = 'a'\ntrigger = 'action'\nptp = false", "ptp"),
            ("serial = 'a'\nregion = { width = 0, height = 3 }", "0x3"),
            ("serial = 'a'\nbinned_looks = true", "needs region"),
            (
                "serial = 'a'\nbinned_looks = true\nregion = { width = 8, height = 8 }\ntrigger = 'line'",
                "trigger software",
            ),
            (
                "serial = 'a'\nbinned_looks = true\nregion = { width = 8, height = 8 }\nauto_gain = true",
                "auto_gain",
            ),
            (
                "serial = 'a'\nbinned_looks = true\nregion = { width = 8, height = 8 }\n\
                 features = { BinningVertical = 2 }",
                "features.BinningVertical",
            ),
        ];
        for (text, named) in cases {
            let message = read(text).unwrap_err();
            assert!(message.contains(named), "{text}: {message}");
        }
        let message = read("serial = 'a'\nwhite_balance = [1, 0, 1]").unwrap_err();
        assert!(message.contains("line 2"), "{message}");
    }

    #[test]
    fn formats_are_told_apart_by_name_and_number() {
        for format in PixelFormat::ALL {
            if let Some(number) = code(format) {
                assert_eq!(format_of(number), Some(format));
                // Bits 16 to 23 are the bits of a pixel.
                let bytes = (number >> 16 & 0xff) as usize / 8;
                assert_eq!(format.bytes_per_pixel(), Some(bytes));
                let name = serde_json::to_string(&format).unwrap();
                assert_eq!(name, format!("{:?}", format.encoding()));
            }
        }
        assert_eq!(format_of(0x0110_0010), None);
    }
}

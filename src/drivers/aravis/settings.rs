//! Configures a camera in the order in which settings depend on each other: trigger off, format, region, light,
//! packets, trigger on. Each setting is read back.

use super::features::{BINNING, Features, fault};
use super::parameters::{self, Activation, Parameters, Region, TriggerMode};
use crate::drivers::live::Fault;
use crate::drivers::pixel_format::PixelFormat;
use crate::frame::{CameraSettings, Transfer};
use aravis::prelude::*;
use aravis::{AcquisitionMode, GvDevice};

/// What the stages of setting share.
pub(super) struct Setting<'a, 'b> {
    /// The camera's features.
    pub features: &'a mut Features<'b>,
    /// What is asked for.
    pub parameters: &'a Parameters,
    /// The camera's protocol, for what it counts in ticks.
    pub device: &'a GvDevice,
}

/// How a camera is set, as far as its frames show it.
pub(super) struct AppliedSettings {
    /// For the recording.
    pub settings: CameraSettings,
    /// Of its frames.
    pub format: PixelFormat,
    /// Width and height of its frames in pixels.
    pub size: [u32; 2],
    /// Bytes of a frame as the camera counts them.
    pub payload: usize,
}

impl Setting<'_, '_> {
    /// Sets everything.
    ///
    /// # Errors
    /// If the camera does not take something that was asked for, or is away.
    pub(super) fn all(&mut self) -> Result<AppliedSettings, Fault> {
        self.quiet()?;
        self.unbinned()?;
        let features = self.parameters.features.iter().flatten();
        for (name, value) in features {
            self.features.value(name, value)?;
        }
        let format = self.format()?;
        let size = self.region()?;
        let exposure = self.exposure()?;
        let gain_db = self.gain()?;
        let white_balance = self.white_balance()?;
        self.packets()?;
        let trigger = self.trigger()?;
        let payload = self.features.camera.payload();
        let payload = payload.map_err(|e| fault("PayloadSize", "a number", &e))?;
        Ok(AppliedSettings {
            settings: CameraSettings {
                transfer: self.parameters.transfer.unwrap_or(Transfer::Linear),
                exposure,
                gain_db,
                white_balance,
                trigger: Some(trigger),
            },
            format,
            size,
            payload: payload as usize,
        })
    }

    /// Ends what the last client may have left running, for most settings are locked meanwhile.
    fn quiet(&mut self) -> Result<(), Fault> {
        let camera = self.features.camera;
        // A camera that is not running may decline.
        let _ = camera.stop_acquisition();
        if self.features.has("TriggerMode") {
            let off = camera.clear_triggers();
            off.map_err(|e| fault("TriggerMode", "Off", &e))?;
        }
        let continuous = camera.set_acquisition_mode(AcquisitionMode::Continuous);
        continuous.map_err(|e| fault("AcquisitionMode", "Continuous", &e))
    }

    /// Ends what a look may have left behind, if looks may be binned: also a look of a daemon that was killed.
    fn unbinned(&mut self) -> Result<(), Fault> {
        if !self.parameters.has_binned_looks() {
            return Ok(());
        }
        for name in BINNING {
            let found = self.features.camera.integer(name);
            if self.features.has(name) && !matches!(found, Ok(1)) {
                self.features.integer_unbounded(name, 1)?;
            }
        }
        Ok(())
    }

    fn format(&mut self) -> Result<PixelFormat, Fault> {
        let camera = self.features.camera;
        let asked = self.parameters.pixel_format;
        let words = asked.map_or("a format that can be recorded", PixelFormat::encoding);
        let refused = |found: String| Fault::Refused {
            field: "PixelFormat".into(),
            asked: words.into(),
            found,
        };
        if let Some(number) = asked.and_then(parameters::code) {
            let number = aravis::PixelFormat::from_raw(number);
            if let Err(error) = camera.set_pixel_format(number) {
                let known = camera.dup_available_pixel_formats_as_strings();
                let known = known.map_err(|_| fault("PixelFormat", words, &error))?;
                let known: Vec<&str> = known.iter().map(|name| name.as_str()).collect();
                return Err(refused(known.join(", ")));
            }
        }
        let found = camera
            .pixel_format()
            .map_err(|e| fault("PixelFormat", words, &e))?;
        let known = parameters::format_of(found.raw());
        match known.filter(|found| asked.is_none_or(|asked| asked == *found)) {
            Some(found) => {
                if let Some(asked) = asked {
                    self.features
                        .took("PixelFormat", asked.encoding(), found.encoding(), true)?;
                }
                Ok(found)
            }
            None => Err(refused(match camera.pixel_format_as_string() {
                Ok(name) => name.into(),
                Err(_) => format!("0x{:08x}", found.raw()),
            })),
        }
    }

    fn region(&mut self) -> Result<[u32; 2], Fault> {
        if let Some(Region {
            x,
            y,
            width,
            height,
        }) = self.parameters.region
        {
            // A large picture has no room for an offset, so that goes first, and comes last.
            for name in ["OffsetX", "OffsetY"] {
                if self.features.has(name) {
                    let home = self.features.camera.set_integer(name, 0);
                    home.map_err(|e| fault(name, "0", &e))?;
                }
            }
            self.features.integer("Width", width.into())?;
            self.features.integer("Height", height.into())?;
            for (name, offset) in [("OffsetX", x), ("OffsetY", y)] {
                if offset != 0 || self.features.has(name) {
                    self.features.integer(name, offset.into())?;
                }
            }
        }
        let region = self.features.camera.region();
        let (_, _, width, height) = region.map_err(|e| fault("Width", "a number", &e))?;
        match (u32::try_from(width), u32::try_from(height)) {
            (Ok(width @ 1..), Ok(height @ 1..)) => Ok([width, height]),
            _ => Err(Fault::Refused {
                field: "Width and Height".into(),
                asked: "some pixels".into(),
                found: format!("{width}x{height}"),
            }),
        }
    }

    /// Switches an automatic function on or off. It is not an error if the camera does not have a function that is not
    /// wanted.
    fn automatic(&mut self, name: &str, wanted: Option<bool>) -> Result<(), Fault> {
        let wanted = wanted.unwrap_or(false);
        if !wanted && !self.features.has(name) {
            return Ok(());
        }
        self.features
            .text(name, if wanted { "Continuous" } else { "Off" })
    }

    /// Exposure in seconds.
    fn exposure(&mut self) -> Result<Option<f64>, Fault> {
        self.automatic("ExposureAuto", self.parameters.auto_exposure)?;
        const NAMES: [&str; 2] = ["ExposureTime", "ExposureTimeAbs"];
        let Some(seconds) = self.parameters.exposure else {
            let name = self.features.first_of(&NAMES);
            let found = name.and_then(|name| self.features.camera.float(name).ok());
            return Ok(found.map(|microseconds| microseconds * 1e-6));
        };
        if self.features.has("ExposureMode") {
            self.features.text("ExposureMode", "Timed")?;
        }
        let name = self.features.need(&NAMES, format!("{seconds} s"))?;
        // Cameras count in steps of their lines.
        let microseconds = seconds * 1e6;
        let tolerance = f64::max(10.0, microseconds * 0.01);
        let found = self.features.float(name, microseconds, tolerance)?;
        Ok(Some(found * 1e-6))
    }

    /// Gain in decibels.
    fn gain(&mut self) -> Result<Option<f64>, Fault> {
        self.automatic("GainAuto", self.parameters.auto_gain)?;
        if let Some(asked) = self.parameters.gain_raw {
            self.features.need(&["GainRaw"], asked)?;
            self.features.integer("GainRaw", asked)?;
        }
        match self.parameters.gain_db {
            Some(asked) => {
                let name = self
                    .features
                    .need(&["Gain", "GainAbs"], format!("{asked} dB"))?;
                self.features.float(name, asked, 0.2).map(Some)
            }
            None => Ok(self.features.camera.float("Gain").ok()),
        }
    }

    /// Gains of red, green and blue.
    fn white_balance(&mut self) -> Result<Option<[f64; 3]>, Fault> {
        self.automatic("BalanceWhiteAuto", self.parameters.auto_white_balance)?;
        const NAMES: [&str; 2] = ["BalanceRatio", "BalanceRatioAbs"];
        let Some(asked) = self.parameters.white_balance else {
            return Ok(None);
        };
        let name = self.features.need(&NAMES, format!("{asked:?}"))?;
        let mut found = [0.0; 3];
        for (i, color) in ["Red", "Green", "Blue"].into_iter().enumerate() {
            // Some cameras take green as 1 and have no gain for it.
            let selected = self
                .features
                .camera
                .set_string("BalanceRatioSelector", color);
            if let Err(error) = selected {
                if color == "Green" && asked[1] == 1.0 {
                    found[1] = 1.0;
                    continue;
                }
                return Err(fault("BalanceRatioSelector", color, &error));
            }
            found[i] = self.features.float(name, asked[i], asked[i] * 0.02)?;
        }
        Ok(Some(found))
    }

    fn packets(&mut self) -> Result<(), Fault> {
        let camera = self.features.camera;
        if let Some(asked) = self.parameters.packet_size {
            let written = camera.gv_set_packet_size(asked as i32);
            let name = "GevSCPSPacketSize";
            written.map_err(|e| fault(name, &asked.to_string(), &e))?;
            let found = camera.gv_get_packet_size();
            let found = found.map_err(|e| fault(name, &asked.to_string(), &e))?;
            self.features.took(name, asked, found, found == asked)?;
        }
        if let Some(asked) = self.parameters.packet_delay_ns {
            let written = camera.gv_set_packet_delay(asked.into());
            let name = "GevSCPD in ns";
            written.map_err(|e| fault(name, &asked.to_string(), &e))?;
            let found = camera.gv_get_packet_delay();
            let found = found.map_err(|e| fault(name, &asked.to_string(), &e))?;
            // One tick of a slow clock, at most.
            let near = (found - i64::from(asked)).abs() <= 1_000;
            self.features.took(name, asked, found, near)?;
        }
        // A camera without this feature does not wait: right for the first one of a link, which has 0.
        let asked = self.parameters.transmission_delay_ns;
        if let Some(asked) = asked.filter(|ns| *ns > 0 || self.features.has("GevSCFTD")) {
            let name = self.features.need(&["GevSCFTD"], format!("{asked} ns"))?;
            self.features.integer(name, self.ticks(asked)?)?;
        }
        Ok(())
    }

    /// Nanoseconds in the camera's ticks.
    fn ticks(&self, nanoseconds: u64) -> Result<i64, Fault> {
        let frequency = self.device.timestamp_tick_frequency();
        let frequency =
            frequency.map_err(|e| fault("GevTimestampTickFrequency", "a number", &e))?;
        let ticks = u128::from(nanoseconds) * u128::from(frequency) / 1_000_000_000;
        i64::try_from(ticks).map_err(|_| Fault::Refused {
            field: "transmission_delay_ns".into(),
            asked: nanoseconds.to_string(),
            found: "more ticks than a camera can count".into(),
        })
    }

    /// Switches the trigger on; what it is, in words.
    fn trigger(&mut self) -> Result<String, Fault> {
        let parameters = self.parameters;
        let source = match parameters.trigger_mode() {
            TriggerMode::FreeRun => return self.free_run(),
            TriggerMode::Software => "Software".to_owned(),
            TriggerMode::Line => parameters.trigger_source.clone().unwrap_or("Line1".into()),
            TriggerMode::Action => {
                let source = parameters
                    .trigger_source
                    .clone()
                    .unwrap_or("Action1".into());
                self.action(&source)?;
                source
            }
        };
        if self.features.has("TriggerSelector") {
            self.features.text("TriggerSelector", "FrameStart")?;
        }
        self.features.text("TriggerSource", &source)?;
        if parameters.trigger_mode() == TriggerMode::Line {
            let edge = match parameters.trigger_activation.unwrap_or_default() {
                Activation::RisingEdge => "RisingEdge",
                Activation::FallingEdge => "FallingEdge",
            };
            self.features.text("TriggerActivation", edge)?;
        }
        self.features.text("TriggerMode", "On")?;
        Ok(source)
    }

    fn free_run(&mut self) -> Result<String, Fault> {
        if let Some(rate) = self.parameters.frame_rate {
            for name in ["AcquisitionFrameRateEnable", "AcquisitionFrameRateEnabled"] {
                if self.features.has(name) {
                    self.features.boolean(name, true)?;
                }
            }
            let names = ["AcquisitionFrameRate", "AcquisitionFrameRateAbs"];
            let name = self.features.need(&names, rate)?;
            self.features.float(name, rate, rate * 0.02)?;
        }
        Ok("free-run".into())
    }

    /// Which action commands the camera obeys.
    fn action(&mut self, source: &str) -> Result<(), Fault> {
        let parameters = self.parameters;
        let index = source.trim_start_matches(|c: char| !c.is_ascii_digit());
        let index: i64 = index.parse().map_err(|_| Fault::Refused {
            field: "trigger_source".into(),
            asked: source.into(),
            found: "a name without a number, expected one such as Action1".into(),
        })?;
        let device_key = parameters.action_device_key.unwrap_or(0);
        self.features.need(&["ActionGroupKey"], "an action's key")?;
        // The key cannot be read back: it is what keeps others from using it.
        let written = self
            .features
            .camera
            .set_integer("ActionDeviceKey", device_key.into());
        written.map_err(|e| fault("ActionDeviceKey", &device_key.to_string(), &e))?;
        if self.features.has("ActionSelector") {
            self.features.integer("ActionSelector", index)?;
        }
        let group = parameters.action_group_key.unwrap_or(1);
        self.features.integer("ActionGroupKey", group.into())?;
        let mask = parameters.action_group_mask.unwrap_or(1);
        self.features.integer("ActionGroupMask", mask.into())
    }
}

//! Configures a V4L2 camera: writes each setting, reads it back, and fails by the setting's name if the two differ.

use super::device::{self, Control};
use super::frame::ExpectedFrame;
use super::parameters::{Parameters, TriggerMode, fourcc};
use crate::drivers::live::{CameraInfo, Fault};
use crate::drivers::pixel_format::PixelFormat;
use crate::frame::{CameraSettings, Transfer};
use v4l::capability::Flags;
use v4l::video::Capture;
use v4l::video::capture::Parameters as Interval;
use v4l::{Device, Format, FourCC, Fraction};

/// Controls by their names in `v4l2-ctl`.
const EXPOSURE: &str = "exposure_time_absolute";
const AUTO_EXPOSURE: &str = "auto_exposure";
const GAIN: &str = "gain";
const AUTO_GAIN: &str = "gain_automatic";
const WHITE_BALANCE: &str = "white_balance_temperature";
const AUTO_WHITE_BALANCE: &str = "white_balance_automatic";
const AUTO_FOCUS: &str = "focus_automatic_continuous";

/// Their numbers, by which they are known whatever a kernel calls them.
const NUMBERS: [(&str, u32); 7] = [
    (AUTO_WHITE_BALANCE, 0x0098_090c),
    (AUTO_GAIN, 0x0098_0912),
    (GAIN, 0x0098_0913),
    (WHITE_BALANCE, 0x0098_091a),
    (AUTO_EXPOSURE, 0x009a_0901),
    (EXPOSURE, 0x009a_0902),
    (AUTO_FOCUS, 0x009a_090c),
];

/// Values of `auto_exposure`.
const AUTOMATIC: i64 = 0;
const MANUAL: i64 = 1;
const APERTURE_PRIORITY: i64 = 3;
/// Counts of `exposure_time_absolute` in a second.
const EXPOSURES_IN_A_SECOND: f64 = 1e4;

/// A camera while it is being set.
struct Setting<'a> {
    device: &'a Device,
    controls: Vec<Control>,
    table: Vec<[String; 3]>,
}

/// Sets a camera, reads everything back, and says what its frames have to be.
///
/// # Errors
/// If it is not a V4L2 camera, or refused a setting.
pub(super) fn apply(p: &Parameters, device: &Device) -> Result<(CameraInfo, ExpectedFrame), Fault> {
    let identity = identity(p, device)?;
    let format = format(p, device)?;
    let rate = rate(p, device)?;
    let mut setting = Setting {
        device,
        controls: device::controls(&device.handle()),
        table: Vec::new(),
    };
    let mode = mode_words(p);
    setting.row("format", &mode, &mode);
    if let (Some(asked), Some(found)) = (p.rate, rate) {
        setting.row("rate", format!("{asked}/s"), format!("{found:.3}/s"));
    }
    setting.controls(p)?;
    let exposure = setting
        .read(EXPOSURE)
        .map(|n| n as f64 / EXPOSURES_IN_A_SECOND);
    let period = rate.map_or(0.0, |r| 1.0 / r);
    let expected = ExpectedFrame {
        size: [format.width, format.height],
        format: p.pixel_format(),
        stride: format.stride,
        exposure,
        readout: p.readout.unwrap_or(period),
    };
    let settings = CameraSettings {
        transfer: p.transfer.unwrap_or(Transfer::Srgb),
        exposure,
        trigger: Some(trigger_words(p.trigger()).into()),
        ..CameraSettings::default()
    };
    let info = CameraInfo {
        identity,
        size: expected.size,
        encoding: p.pixel_format().encoding().into(),
        frame_bytes: format.size.into(),
        settings: Some(settings),
        table: setting.table,
        remarks: Vec::new(),
    };
    Ok((info, expected))
}

fn trigger_words(trigger: TriggerMode) -> &'static str {
    match trigger {
        TriggerMode::FreeRun => "free-run",
        TriggerMode::Line => "line",
    }
}

fn away(p: &Parameters, what: impl std::fmt::Display) -> Fault {
    Fault::Away(format!("{}: {what}", p.device()))
}

fn identity(p: &Parameters, device: &Device) -> Result<String, Fault> {
    let answered = device.query_caps();
    let known = answered.map_err(|e| away(p, format!("it is not a video device: {e}")))?;
    if !known
        .capabilities
        .contains(Flags::VIDEO_CAPTURE | Flags::STREAMING)
    {
        return Err(away(
            p,
            format!(
                "{} does not deliver single-planar frames through mapped memory",
                known.card
            ),
        ));
    }
    Ok(format!(
        "{}, driver {}, {}, {}",
        known.card,
        known.driver,
        known.bus,
        p.device()
    ))
}

fn mode_words(p: &Parameters) -> String {
    let [width, height] = p.size.unwrap_or_default();
    format!("{width} x {height}, {}", p.pixel_format().encoding())
}

/// Codes of four letters that a camera may have for a format.
fn codes(format: PixelFormat) -> Vec<FourCC> {
    let mut codes = vec![FourCC::new(&fourcc(format))];
    if format == PixelFormat::Mjpeg {
        codes.push(FourCC::new(b"JPEG"));
    }
    codes
}

fn format(p: &Parameters, device: &Device) -> Result<Format, Fault> {
    let [width, height] = p.size.unwrap_or_default();
    let mut answer = "no format".to_owned();
    for code in codes(p.pixel_format()) {
        match device.set_format(&Format::new(width, height, code)) {
            Ok(found) if (found.width, found.height) == (width, height) && found.fourcc == code => {
                return Ok(found);
            }
            Ok(found) => answer = format!("{} x {}, {}", found.width, found.height, found.fourcc),
            // Another program holds it, or it is gone.
            Err(why) if why.kind() == std::io::ErrorKind::ResourceBusy => return Err(away(p, why)),
            Err(why) => answer = why.to_string(),
        }
    }
    Err(Fault::Refused {
        field: "format".into(),
        asked: mode_words(p),
        found: format!("{answer}; it has {}", formats(device)),
    })
}

/// The formats that a camera has.
fn formats(device: &Device) -> String {
    let listed = device.enum_formats().unwrap_or_default();
    let one = |f: v4l::format::Description| {
        let sizes = device.enum_framesizes(f.fourcc).unwrap_or_default();
        let sizes = sizes.into_iter().flat_map(|s| s.size.to_discrete());
        let sizes: Vec<String> = sizes
            .take(40)
            .map(|s| format!("{} x {}", s.width, s.height))
            .collect();
        format!("{} in {}", f.fourcc, sizes.join(", "))
    };
    let formats: Vec<String> = listed.into_iter().take(20).map(one).collect();
    formats.join("; ")
}

/// Frames in a second, where the camera knows.
fn rate(p: &Parameters, device: &Device) -> Result<Option<f64>, Fault> {
    let taken = p.rate.map(|rate| {
        let thousandths = (rate * 1000.0).round() as u32;
        device.set_params(&Interval::new(Fraction::new(1000, thousandths)))
    });
    let found = device.params().ok().map(|found| found.interval);
    let found = found.filter(|f| f.numerator > 0 && f.denominator > 0);
    let found = found.map(|f| f64::from(f.denominator) / f64::from(f.numerator));
    let Some(asked) = p.rate else {
        return Ok(found);
    };
    if found.is_some_and(|found| (found / asked - 1.0).abs() < 0.01) {
        return Ok(found);
    }
    let answer = found.map_or("no rate".to_owned(), |f| format!("{f:.3}/s"));
    Err(Fault::Refused {
        field: "rate".into(),
        asked: format!("{asked}/s"),
        found: match taken.and_then(Result::err) {
            Some(why) => format!("{answer} ({why})"),
            None => answer,
        },
    })
}

impl Setting<'_> {
    fn row(&mut self, name: &str, asked: impl Into<String>, found: impl Into<String>) {
        self.table.push([name.into(), asked.into(), found.into()]);
    }

    /// Sets all controls: named ones, then what is automatic, then the values that it would have chosen.
    fn controls(&mut self, p: &Parameters) -> Result<(), Fault> {
        for (name, value) in p.controls.iter().flatten() {
            self.set(name, *value)?;
        }
        self.exposure_mode(p.auto_exposure == Some(true))?;
        for (name, asked, value) in [
            (AUTO_GAIN, p.auto_gain, i64::from(p.auto_gain == Some(true))),
            (
                AUTO_WHITE_BALANCE,
                p.auto_white_balance,
                i64::from(p.auto_white_balance == Some(true)),
            ),
            (
                AUTO_FOCUS,
                p.auto_focus,
                i64::from(p.auto_focus == Some(true)),
            ),
        ] {
            // What a camera cannot do by itself it does not do.
            if self.find(name).is_some() || asked == Some(true) {
                self.set(name, value)?;
            }
        }
        let counts = |seconds: f64| (seconds * EXPOSURES_IN_A_SECOND).round() as i64;
        for (name, value) in [
            (EXPOSURE, p.exposure.map(counts)),
            (GAIN, p.gain),
            (WHITE_BALANCE, p.white_balance_kelvin),
        ] {
            if let Some(value) = value {
                self.set(name, value)?;
            }
        }
        Ok(())
    }

    /// Some cameras choose the exposure alone (their aperture is fixed), some have one mode for all.
    fn exposure_mode(&mut self, automatic: bool) -> Result<(), Fault> {
        match (automatic, self.find(AUTO_EXPOSURE)) {
            (false, None) => Ok(()),
            (false, Some(_)) => self.set(AUTO_EXPOSURE, MANUAL),
            (true, _) => self
                .set(AUTO_EXPOSURE, APERTURE_PRIORITY)
                .or_else(|_| self.set(AUTO_EXPOSURE, AUTOMATIC)),
        }
    }

    fn find(&self, name: &str) -> Option<&Control> {
        let number = NUMBERS.iter().find(|(known, _)| *known == name);
        let by_number = |n: &(&str, u32)| self.controls.iter().find(|c| c.id == n.1);
        let by_name = || self.controls.iter().find(|c| c.name == device::plain(name));
        number.and_then(by_number).or_else(by_name)
    }

    fn read(&self, name: &str) -> Option<i64> {
        device::control(&self.device.handle(), self.find(name)?.id).ok()
    }

    fn set(&mut self, name: &str, value: i64) -> Result<(), Fault> {
        let refused = |found: String| Fault::Refused {
            field: name.into(),
            asked: value.to_string(),
            found,
        };
        let Some(control) = self.find(name).cloned() else {
            let names: Vec<&str> = self.controls.iter().map(|c| c.name.as_str()).collect();
            return Err(refused(format!(
                "no such control: the camera has {}",
                names.join(", ")
            )));
        };
        let handle = self.device.handle();
        let taken = device::set_control(&handle, control.id, value);
        let found = device::control(&handle, control.id);
        if let (Ok(()), Ok(found)) = (&taken, &found)
            && *found == value
        {
            self.row(name, value.to_string(), found.to_string());
            return Ok(());
        }
        let [least, most, step] = control.range;
        let found = found.map_or_else(|why| why.to_string(), |f| f.to_string());
        let why = taken.err().map_or(String::new(), |why| format!(" ({why})"));
        Err(refused(format!(
            "{found}{why}; it takes {least} to {most} in steps of {step}"
        )))
    }
}

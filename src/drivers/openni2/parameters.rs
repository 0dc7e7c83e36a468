//! The configuration of a depth camera. It is always compiled, so that a configuration can be checked without
//! OpenNI.

use crate::range;

/// A depth camera that OpenNI2 opens. What is not given has its default.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, Default, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// Which: its serial number, its URI as OpenNI lists it, the path of an `.oni` file, or `any` for the first that
    /// OpenNI lists, if no other depth camera is configured but files. A URI names a USB port's address, which changes
    /// when the camera is plugged in again. Default `any`.
    pub device: Option<String>,
    /// Width and height of depth and colour, in pixels, 1 to 16384 each. Default 640 by 480.
    #[serde(deserialize_with = "range::optional_size")]
    pub size: Option<[u32; 2]>,
    /// Frames in a second, from 1 to 240. Default 30.
    #[serde(deserialize_with = "range::optional_count::<_, 1, 240>")]
    pub rate: Option<u32>,
    /// What a raw reading counts. Default `1mm`.
    pub unit: Option<Unit>,
    /// Whether depth is registered to the colour picture; refused where the camera does not do so. Default true.
    pub registration: Option<bool>,
    /// Whether the camera has to expose depth and colour together. Where it is not given, it is done if the camera can,
    /// and the camera's entry in the list of settings says which.
    pub synchronise: Option<bool>,
    /// Whether the colour pictures are taken as well. Default true.
    pub color: Option<bool>,
    /// Depth frames that it takes for a capture, from 1 to 1000, and from `sync.min_depth_frames` to
    /// `sync.depth_frames`. Default: `sync.depth_frames`.
    #[serde(deserialize_with = "range::optional_count::<_, 1, 1000>")]
    pub burst: Option<u32>,
    /// Whether the camera's light is on for its captures alone, because depth cameras that see the same place disturb
    /// each other. Default false.
    pub take_turns: Option<bool>,
    /// Without a frame for so long, in milliseconds, 1 to 3600000 and no less than the time between two frames, the
    /// camera counts as away. Default 1000.
    #[serde(deserialize_with = "range::optional_patience")]
    pub silence_ms: Option<f64>,
    /// Time from the beginning of an exposure to the arrival of its frame, in milliseconds, 0 to 3600000; nothing
    /// measures it. Default: the time between two frames.
    #[serde(deserialize_with = "range::optional_milliseconds")]
    pub latency_ms: Option<f64>,
    /// Of an `.oni` file: whether it begins again at its end. Default true.
    pub repeat: Option<bool>,
}

/// What one count of a raw depth reading is.
#[derive(serde::Deserialize, serde::Serialize, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Unit {
    /// A millimetre.
    #[default]
    #[serde(rename = "1mm")]
    Millimetre,
    /// A tenth of a millimetre.
    #[serde(rename = "100um")]
    TenthOfMillimetre,
}

impl Unit {
    /// In words, and in metres.
    pub fn words(self) -> &'static str {
        match self {
            Self::Millimetre => "millimetres",
            Self::TenthOfMillimetre => "tenths of a millimetre",
        }
    }
}

impl Parameters {
    /// Checks what the fields' own types cannot say.
    ///
    /// # Errors
    /// In words, if a field contradicts another or is empty.
    pub fn checked(&self) -> Result<(), String> {
        if self.device.as_ref().is_some_and(|d| d.trim().is_empty()) {
            return Err(
                "device is empty, expected a serial number, a URI, a file or \"any\"".into(),
            );
        }
        if self.color == Some(false) && self.synchronise == Some(true) {
            return Err(
                "synchronise is true, but color is false: there is nothing to synchronise".into(),
            );
        }
        let (period_ms, silence_ms) = (1e3 / f64::from(self.rate()), self.silence_ms());
        if silence_ms < period_ms {
            return Err(format!(
                "silence_ms is {silence_ms}, expected at least {period_ms:.1}, the time between two frames: the camera \
                 would always be away"
            ));
        }
        if self.repeat.is_some() && !self.is_file() {
            return Err("repeat is set, but device is not an .oni file".into());
        }
        Ok(())
    }

    /// Which camera.
    pub fn device(&self) -> &str {
        self.device.as_deref().unwrap_or("any")
    }

    /// Whether a file stands for the camera.
    pub fn is_file(&self) -> bool {
        is_file(self.device())
    }

    /// Width and height, in pixels.
    pub fn size(&self) -> [u32; 2] {
        self.size.unwrap_or([640, 480])
    }

    /// Frames in a second.
    pub fn rate(&self) -> u32 {
        self.rate.unwrap_or(30).max(1)
    }

    /// Depth frames of a capture; 30 where nothing says how many.
    pub fn burst(&self) -> u32 {
        self.burst.unwrap_or(30)
    }

    /// Whether the colour pictures are taken.
    pub fn color(&self) -> bool {
        self.color.unwrap_or(true)
    }

    /// Whether depth is registered to colour.
    pub fn registration(&self) -> bool {
        self.registration.unwrap_or(true)
    }

    /// Whether the light is on for captures alone.
    pub fn take_turns(&self) -> bool {
        self.take_turns.unwrap_or(false)
    }

    /// How long a camera may be silent.
    pub fn silence(&self) -> std::time::Duration {
        std::time::Duration::from_secs_f64(self.silence_ms() / 1e3)
    }

    fn silence_ms(&self) -> f64 {
        self.silence_ms.unwrap_or(1000.0)
    }

    /// From the beginning of an exposure to its frame's arrival, in nanoseconds.
    pub fn latency_ns(&self) -> u64 {
        let period_ms = 1e3 / f64::from(self.rate());
        (self.latency_ms.unwrap_or(period_ms) * 1e6) as u64
    }
}

/// Whether a device is a recording of OpenNI's.
pub(super) fn is_file(device: &str) -> bool {
    device.ends_with(".oni")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Parameters, String> {
        toml::from_str::<Parameters>(text)
            .map_err(|e| e.to_string())
            .and_then(|p| p.checked().map(|()| p))
    }

    #[test]
    fn what_is_not_given_has_its_default() {
        let p = read("").unwrap();
        assert_eq!((p.device(), p.size(), p.rate()), ("any", [640, 480], 30));
        assert_eq!(p.latency_ns() / 1_000_000, 33);
    }

    #[test]
    fn what_makes_no_sense_is_refused_by_name() {
        for (text, named) in [
            ("device = ' '", "device"),
            ("rate = 0", "rate"),
            ("rate = -3", "rate"),
            ("burst = 5000", "burst"),
            ("size = [0, 480]", "size"),
            ("size = [640, 480, 3]", "size"),
            ("silence_ms = nan", "silence_ms"),
            ("silence_ms = 0.0", "expected 1 to 3600000 milliseconds"),
            (
                "rate = 10\nsilence_ms = 99.0",
                "silence_ms is 99, expected at least 100.0",
            ),
            ("latency_ms = -1.0", "latency_ms"),
            ("unit = '1cm'", "unit"),
            ("regitsration = true", "regitsration"),
            ("color = false\nsynchronise = true", "synchronise"),
            ("repeat = false", "repeat"),
        ] {
            let message = read(text).unwrap_err();
            assert!(message.contains(named), "{text}: {message}");
        }
        assert!(read("device = '/data/cup.oni'\nrepeat = false").is_ok());
        assert!(read("rate = 1\nsilence_ms = 1000.0").is_ok());
    }
}

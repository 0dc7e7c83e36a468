//! The data that a rig delivers: cameras' names and settings, timestamps, frames and triggers. They have no
//! behaviour beyond checking themselves; nothing here decodes, stores or reconstructs.

mod settings;

pub use settings::{CameraSettings, Transfer};

use crate::image::RawPixels;
use crate::words::beginning;
use bytes::Bytes;
use std::fmt;
use std::sync::Arc;

/// A camera's id, `[a-z0-9_-]{1,32}`; also its `frame_id` in a recording.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CameraId(Arc<str>);

/// A name that breaks the rule of its kind.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("{kind} {found:?} is not {expected}")]
pub struct NameError {
    kind: &'static str,
    found: String,
    expected: &'static str,
}

impl CameraId {
    /// Checks and wraps a name.
    ///
    /// # Errors
    /// If `name` is not `[a-z0-9_-]{1,32}`.
    pub fn new(name: &str) -> Result<Self, NameError> {
        let allowed =
            |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_' || b == b'-';
        if (1..=32).contains(&name.len()) && name.bytes().all(allowed) {
            return Ok(Self(name.into()));
        }
        Err(NameError {
            kind: "camera id",
            found: beginning(name),
            expected: "1 to 32 of a-z, 0-9, _ and -",
        })
    }

    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for CameraId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl fmt::Debug for CameraId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(&self.0, f)
    }
}

/// A capture's id and the name of its output folder: `[A-Za-z0-9._-]{1,64}`, not starting with a dot, so
/// that it can never leave the folder it is put into.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CaptureId(Arc<str>);

impl CaptureId {
    /// Checks and wraps a name.
    ///
    /// # Errors
    /// If `name` is not `[A-Za-z0-9._-]{1,64}` or starts with a dot.
    pub fn new(name: &str) -> Result<Self, NameError> {
        let allowed = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'.' | b'_' | b'-');
        let length = (1..=64).contains(&name.len());
        if length && name.bytes().all(allowed) && !name.starts_with('.') {
            return Ok(Self(name.into()));
        }
        Err(NameError {
            kind: "capture id",
            found: beginning(name),
            expected: "1 to 64 of A-Z, a-z, 0-9, ., _ and - not starting with a dot",
        })
    }

    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for CaptureId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// As their names; a timestamp as a string of decimal nanoseconds, which a JSON number cannot hold.
macro_rules! serialize_as_text {
    ($($type:ty: $text:expr;)*) => {$(
        impl serde::Serialize for $type {
            fn serialize<S: serde::Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
                let text: fn(&Self) -> _ = $text;
                to.collect_str(&text(self))
            }
        }
    )*};
}

serialize_as_text! {
    CameraId: |id| id.to_string();
    CaptureId: |id| id.to_string();
    Timestamp: |time| time.0;
}

/// UTC nanoseconds since 1970.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Timestamp(pub u64);

/// Of the system's clock; 0 before 1970.
impl From<std::time::SystemTime> for Timestamp {
    fn from(time: std::time::SystemTime) -> Self {
        let since = time.duration_since(std::time::UNIX_EPOCH);
        let since = since.unwrap_or_default().as_nanos();
        Self(u64::try_from(since).unwrap_or(u64::MAX))
    }
}

/// As it is written: a string of decimal nanoseconds.
impl<'de> serde::Deserialize<'de> for Timestamp {
    fn deserialize<D: serde::Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let text = String::deserialize(from)?;
        text.parse().map(Self).map_err(|_| {
            let found = beginning(&text);
            serde::de::Error::custom(format!("{found:?} is not a string of decimal nanoseconds"))
        })
    }
}

impl Timestamp {
    /// As ISO 8601 in UTC, to the millisecond (cut, not rounded): `2026-01-31T23:59:59.123Z`.
    pub fn iso_8601(self) -> String {
        let [year, month, day] = self.date();
        let ms = self.0 / 1_000_000;
        let seconds = ms / 1000 % 86_400;
        let (hour, minute, second) = (seconds / 3600, seconds / 60 % 60, seconds % 60);
        format!(
            "{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{:03}Z",
            ms % 1000
        )
    }

    /// Year, month and day in UTC. Years are counted from 1 March, so that the leap day is a year's last day; the
    /// calendar repeats every 400 years.
    pub fn date(self) -> [u64; 3] {
        let days = self.0 / 86_400_000_000_000 + 719_468;
        let (era, of_era) = (days / 146_097, days % 146_097);
        let year_of_era = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
        let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
        let shifted = (5 * of_year + 2) / 153;
        let day = of_year - (153 * shifted + 2) / 5 + 1;
        let month = if shifted < 10 {
            shifted + 3
        } else {
            shifted - 9
        };
        [year_of_era + era * 400 + u64::from(month <= 2), month, day]
    }

    /// Nanoseconds from `earlier` to `self`; negative where `self` is the earlier one.
    pub fn nanoseconds_since(self, earlier: Self) -> i128 {
        i128::from(self.0) - i128::from(earlier.0)
    }
}

/// What a stream of frames shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stream {
    /// Pictures of a colour camera.
    Color,
    /// Raw readings of a depth camera.
    Depth,
    /// A depth camera's own colour pictures, registered to its depth.
    DepthColor,
}

/// The pixels of a frame as they came: encoded, so that a capture stays small until it is needed.
#[derive(Clone, Debug, PartialEq)]
pub enum Picture {
    /// Rows of pixels.
    Raw {
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
        /// Name of the pixel encoding, such as `bayer_rggb8`.
        encoding: String,
        /// Bytes from one row's start to the next's.
        step: u32,
        /// The rows.
        data: Bytes,
    },
    /// A picture file.
    Compressed {
        /// `jpeg` or `png`.
        format: String,
        /// The file's bytes.
        data: Bytes,
    },
}

impl Picture {
    /// Bytes that it takes.
    pub fn bytes(&self) -> usize {
        match self {
            Self::Raw { data, .. } | Self::Compressed { data, .. } => data.len(),
        }
    }
}

/// The pixels of a raw picture; of a compressed one, an encoding that nothing reads.
impl<'a> From<&'a Picture> for RawPixels<'a> {
    fn from(picture: &'a Picture) -> Self {
        match picture {
            Picture::Raw {
                width,
                height,
                encoding,
                step,
                data,
            } => Self {
                width: *width as usize,
                height: *height as usize,
                encoding,
                step: *step as usize,
                data,
            },
            Picture::Compressed { format, data } => Self {
                width: 0,
                height: 0,
                encoding: format,
                step: 0,
                data,
            },
        }
    }
}

/// One picture of one camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Who took it.
    pub camera: CameraId,
    /// What it shows.
    pub stream: Stream,
    /// When its exposure began.
    pub timestamp: Timestamp,
    /// Its pixels.
    pub picture: Picture,
}

/// The moment a capture was asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Trigger {
    /// Names the capture.
    pub id: CaptureId,
    /// When.
    pub time: Timestamp,
    /// `pedal`, `socket`, `replay` or another word.
    pub source: String,
    /// The client's own name of the press, where it gave one.
    pub press_id: Option<String>,
    /// The object's number, where one was given.
    pub subject: Option<String>,
    /// How the object lay, in a person's words, where they were given; for people alone.
    pub placement: Option<String>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_could_leave_a_folder_are_refused() {
        for name in ["", ".", "..", ".hidden", "a/b", "a\0", "ä", &"x".repeat(65)] {
            assert!(CaptureId::new(name).is_err(), "{name:?}");
        }
        for name in ["a", "cup-000", "2026-01-01.r1", "A_b"] {
            assert_eq!(CaptureId::new(name).unwrap().as_str(), name);
        }
        for name in ["", "C00", "a.b", "a b", &"x".repeat(33)] {
            assert!(CameraId::new(name).is_err(), "{name:?}");
        }
    }

    #[test]
    fn a_long_bad_name_is_shortened_in_its_message() {
        let message = CameraId::new(&"X".repeat(100_000)).unwrap_err().to_string();
        assert!(message.len() < 200, "{}", message.len());
    }
}

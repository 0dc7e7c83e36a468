//! A foot switch as the kernel shows it: an input device with keys. It is opened exclusively, so that a press does not
//! type into another program.

use evdev::{EventSummary, KeyCode};
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Why a foot switch cannot be read.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Error {
    /// It cannot be opened as an input device.
    #[error("{}: cannot open it as an input device: {cause}; check the path, and that this user may read it", path.display())]
    Open {
        path: PathBuf,
        cause: std::io::Error,
    },
    /// It has no keys.
    #[error("{}: {name} has no keys, expected a foot switch or a keyboard", path.display())]
    NoKeys {
        path: PathBuf,
        /// The name that the device reports.
        name: String,
    },
    /// Another program holds it.
    #[error("{}: another program uses this foot switch: {cause}", path.display())]
    Taken {
        path: PathBuf,
        cause: std::io::Error,
    },
    /// Its keys cannot be read any more.
    #[error("{}: cannot read the foot switch: {cause}", path.display())]
    Read {
        path: PathBuf,
        cause: std::io::Error,
    },
    /// It was unplugged.
    #[error("{}: the foot switch was unplugged", path.display())]
    Gone { path: PathBuf },
}

/// A key went up (0) or down (1), or repeats itself (2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Input {
    /// The kernel's code of the key.
    pub code: u16,
    /// 0, 1 or 2.
    pub value: i32,
    /// When, by the kernel's clock.
    pub time: SystemTime,
}

/// An open foot switch.
pub struct Device {
    path: PathBuf,
    device: evdev::Device,
    /// Events that were read and not yet returned.
    inputs: VecDeque<Input>,
}

impl Device {
    /// Opens a device exclusively.
    ///
    /// # Errors
    /// If it is not an input device, has no keys, or another program holds it.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let open = |cause| Error::Open {
            path: path.into(),
            cause,
        };
        let mut device = evdev::Device::open(path).map_err(open)?;
        if device.supported_keys().is_none() {
            return Err(Error::NoKeys {
                path: path.into(),
                name: device.name().unwrap_or("it").into(),
            });
        }
        device.grab().map_err(|cause| Error::Taken {
            path: path.into(),
            cause,
        })?;
        Ok(Self {
            path: path.into(),
            device,
            inputs: VecDeque::new(),
        })
    }

    /// The name that the device reports.
    pub fn name(&self) -> &str {
        self.device.name().unwrap_or("an input device")
    }

    /// Forgets an unplugged device without closing it: closing would release its grab, which fails once it is gone.
    pub fn forget(self) {
        std::mem::forget(self.device);
    }

    /// Waits for the next edge of a key.
    ///
    /// # Errors
    /// If the device was unplugged or cannot be read.
    pub fn wait(&mut self) -> Result<Input, Error> {
        loop {
            if let Some(input) = self.inputs.pop_front() {
                return Ok(input);
            }
            let events = self
                .device
                .fetch_events()
                .map_err(|cause| unread(&self.path, cause))?;
            self.inputs
                .extend(events.filter_map(|event| match event.destructure() {
                    EventSummary::Key(key, code, value) => Some(Input {
                        code: code.code(),
                        value,
                        time: key.timestamp(),
                    }),
                    _ => None,
                }));
        }
    }
}

/// Why a device cannot be read. `ErrorKind` has no kind for ENODEV, which means unplugged.
fn unread(path: &Path, cause: std::io::Error) -> Error {
    let path = path.into();
    match cause.raw_os_error() {
        Some(19) => Error::Gone { path },
        _ => Error::Read { path, cause },
    }
}

/// The code of a key by its name in the kernel's list, such as `KEY_B` or `b`.
///
/// # Errors
/// If there is no key of this name.
pub fn key_code(name: &str) -> Result<u16, String> {
    let full = name.to_uppercase();
    let found = full.parse().or_else(|_| format!("KEY_{full}").parse());
    let key: KeyCode = found.map_err(|_| {
        format!(
            "{name:?} is not the name of a key, expected a name such as KEY_B: evtest shows the names"
        )
    })?;
    Ok(key.code())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_have_names() {
        assert_eq!(key_code("KEY_B"), Ok(48));
        assert_eq!(key_code("b"), Ok(48));
        assert_eq!(key_code("btn_left"), Ok(0x110));
        assert!(
            key_code("KEY_NONE_SUCH")
                .unwrap_err()
                .contains("KEY_NONE_SUCH")
        );
    }

    #[test]
    fn what_was_pulled_out_is_told_from_what_is_broken() {
        let unread = |errno| {
            let cause = std::io::Error::from_raw_os_error(errno);
            unread(Path::new("/dev/input/event3"), cause)
        };
        let (gone, broken) = (unread(19), unread(5));
        assert_eq!(
            gone.to_string(),
            "/dev/input/event3: the foot switch was unplugged"
        );
        assert!(matches!(broken, Error::Read { .. }), "{broken}");
    }

    #[test]
    fn what_is_no_input_device_is_refused() {
        let error = Device::open(Path::new("/dev/null"))
            .err()
            .unwrap()
            .to_string();
        assert!(
            error.contains("/dev/null") && error.contains("input device"),
            "{error}"
        );
    }
}

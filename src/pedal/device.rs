//! A foot switch as the kernel shows it: an input device with keys. It is held alone, so that a press types nowhere.

use evdev::{EventSummary, KeyCode};
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Why a foot switch cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// It cannot be opened.
    #[error("{}: {cause}: no input device that this user may read", path.display())]
    Open {
        /// The device.
        path: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
    /// It has no keys.
    #[error("{}: {name} has no keys, expected a foot switch or a keyboard", path.display())]
    NoKeys {
        /// The device.
        path: PathBuf,
        /// What it calls itself.
        name: String,
    },
    /// Another program holds it.
    #[error("{}: {cause}: another program holds it", path.display())]
    Taken {
        /// The device.
        path: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
    /// It does not tell its keys any more.
    #[error("{}: cannot be read: {cause}", path.display())]
    Read {
        /// The device.
        path: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
    /// It went away.
    #[error("{}: it was pulled out", path.display())]
    Gone {
        /// The device.
        path: PathBuf,
    },
}

/// A key went up (0) or down (1), or repeats itself (2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Input {
    /// The kernel's code of the key.
    pub code: u16,
    /// 0, 1 or 2.
    pub value: i32,
    /// When, by the kernel.
    pub time: SystemTime,
}

/// A foot switch that is held.
pub struct Device {
    path: PathBuf,
    device: evdev::Device,
    /// What was read and not asked for yet.
    inputs: VecDeque<Input>,
}

impl Device {
    /// Opens a device and holds it alone.
    ///
    /// # Errors
    /// If it is none, has no keys, or is held by another program.
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

    /// What it calls itself.
    pub fn name(&self) -> &str {
        self.device.name().unwrap_or("an input device")
    }

    /// Lets a device that is gone be. To close it would be to let its keys go, which it cannot any more.
    pub fn forget(self) {
        std::mem::forget(self.device);
    }

    /// Waits for the next key.
    ///
    /// # Errors
    /// If the device is gone, or cannot be read.
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

/// Why a device tells nothing any more. ENODEV, for which there is no kind, is one that was pulled out.
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
            "{name:?} is no key: expected a name such as KEY_B, see evtest or input-event-codes.h"
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
        assert_eq!(gone.to_string(), "/dev/input/event3: it was pulled out");
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

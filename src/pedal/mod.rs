//! The foot switch: keys become presses, and presses become requests to the daemon. Only `device` knows the kernel's
//! input events; everything else is tested without a device.

mod daemon;
#[cfg(feature = "pedal")]
mod device;
mod switch;

pub use daemon::{Daemon, DaemonState, Unanswered};
#[cfg(feature = "pedal")]
pub use device::{Device, Error, Input, key_code};
pub use switch::{Action, Keys, Switch};

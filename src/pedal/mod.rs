//! The foot switch: keys become presses, and presses what the daemon is asked. The device itself is read in `device`,
//! which alone knows the kernel's input events; everything else is tested without one.

mod daemon;
#[cfg(feature = "pedal")]
mod device;
mod switch;

pub use daemon::{Daemon, Watch};
#[cfg(feature = "pedal")]
pub use device::{Device, Error, Input, key_code};
pub use switch::{Action, Keys, Switch};

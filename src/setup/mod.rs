//! Prepares a rig: reads its configuration and calibration and makes a driver for each camera. Also decides which
//! settings may change while the daemon runs. Nothing here opens a camera, or knows arguments, a console or exit codes.

mod duplicate_devices;
mod line_trigger;
mod prepare;
mod reload;
mod rig_cameras;

pub use prepare::{ConfigSource, Error, Prepared};
pub use reload::ReloadableConfig;

//! From a rig's configuration to all that a daemon needs before it touches a camera, and to what of it may change while the
//! daemon runs. Nothing here opens a camera, or knows arguments, a console or exit codes.

mod duplicate_devices;
mod line_trigger;
mod prepare;
mod reload;
mod stations;

pub use prepare::{ConfigSource, Error, Prepared};
pub use reload::Running;

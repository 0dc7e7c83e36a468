//! From a rig's configuration to all that a daemon needs before it touches a camera, and to what of it may change while the
//! daemon runs. Nothing here opens a camera, or knows arguments, a console or exit codes.

mod line;
mod prepare;
mod reread;
mod stations;
mod twice;

pub use prepare::{Error, Prepared, Source};
pub use reread::Running;

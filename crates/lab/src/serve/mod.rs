//! Plays a recorded rig to the live drivers: it simulates cameras that the SDKs find, and that show a recording.

#[cfg(feature = "aravis")]
mod color;
mod depth;
#[cfg(feature = "aravis")]
mod gige;
#[cfg(feature = "aravis")]
mod pictures;

#[cfg(feature = "aravis")]
pub use color::{ColorOptions, ColorRig};
pub use depth::{SensorFile, SensorFrames, write_sensor_frames};
#[cfg(feature = "aravis")]
pub use pictures::Shown;

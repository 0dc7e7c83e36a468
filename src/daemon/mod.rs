//! The live rig: threads of cameras, of capturing and of recording, and the socket that asks for captures. This is the
//! one place that knows how a press becomes a capture on the disk; what a capture is, is decided in `sync`, how it is
//! stored in `recording`, and how a camera is spoken to in `drivers`.

#[cfg(feature = "live")]
mod capturing;
#[cfg(feature = "live")]
mod control;
#[cfg(feature = "live")]
mod disk;
#[cfg(feature = "live")]
pub mod events;
mod link;
#[cfg(feature = "live")]
mod names;
mod parameters;
#[cfg(feature = "live")]
mod plates;
#[cfg(feature = "live")]
mod readiness;
#[cfg(feature = "live")]
mod recorder;
#[cfg(feature = "live")]
mod rig;
#[cfg(feature = "live")]
mod service;
#[cfg(feature = "live")]
mod status;
#[cfg(feature = "live")]
mod systemd;
#[cfg(all(test, feature = "live"))]
mod tests;

#[cfg(feature = "live")]
pub use capturing::{Answer, Capturing, Order, Plan, Press, Reread};
#[cfg(feature = "live")]
pub use control::{ControlError, serve};
#[cfg(feature = "live")]
pub use disk::free_bytes;
pub use link::{Budget, Link, Transmission, budget};
pub use parameters::{
    CaptureParameters, RecordingParameters, RigParameters, ServiceParameters, SocketParameters,
};
#[cfg(feature = "live")]
pub use rig::{Kind, Rig, Station};
#[cfg(feature = "live")]
pub use service::Service;
#[cfg(feature = "live")]
pub use status::{CameraStatus, Status};
#[cfg(feature = "live")]
pub use systemd::{Heart, Notifier, Pulse, handed_over};

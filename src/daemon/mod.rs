//! The live rig: threads of cameras, of capturing and of recording, and the socket that asks for captures. This is the
//! one place that knows how a press becomes a capture on the disk; what a capture is, is decided in `sync`, how it is
//! stored in `recording`, and how a camera is spoken to in `drivers`.

#[cfg(feature = "live")]
mod backgrounds;
#[cfg(feature = "live")]
mod capturing;
#[cfg(feature = "live")]
mod control;
#[cfg(all(test, feature = "live"))]
mod digest_tests;
#[cfg(all(test, feature = "live"))]
mod disaster_tests;
#[cfg(feature = "live")]
mod dispatcher;
#[cfg(feature = "live")]
pub mod events;
#[cfg(feature = "live")]
mod hooks;
#[cfg(all(test, feature = "live"))]
mod hostile_tests;
#[cfg(feature = "live")]
mod names;
#[cfg(feature = "live")]
mod packing;
mod parameters;
#[cfg(feature = "live")]
mod probe;
#[cfg(feature = "live")]
mod readiness;
#[cfg(feature = "live")]
mod recorder;
#[cfg(feature = "live")]
mod request_log;
#[cfg(feature = "live")]
mod rig;
#[cfg(all(test, feature = "live"))]
mod scripted;
#[cfg(feature = "live")]
mod service;
#[cfg(all(test, feature = "live"))]
mod service_tests;
#[cfg(feature = "live")]
mod status;
#[cfg(feature = "live")]
mod systemd;
#[cfg(all(test, feature = "live"))]
mod tests;

#[cfg(feature = "live")]
pub use capturing::{Capturing, InterruptedRecordings, Plan, ReloadedSettings};
#[cfg(feature = "live")]
pub use control::{Clients, ControlError, serve};
#[cfg(feature = "live")]
pub use dispatcher::ReplyStream;
#[cfg(feature = "live")]
pub use hooks::Hooks;
#[cfg(feature = "live")]
pub use packing::Packing;
pub use parameters::{
    CaptureParameters, HooksParameters, RecordingParameters, RigParameters, ServiceParameters,
    SocketParameters,
};
#[cfg(feature = "live")]
pub use probe::probe;
#[cfg(feature = "live")]
pub use rig::{Kind, Rig, RigCamera};
#[cfg(feature = "live")]
pub use service::Service;
#[cfg(feature = "live")]
pub use status::{CameraStatus, Status};
#[cfg(feature = "live")]
pub use systemd::{Heartbeat, Notifier, Watchdog, handed_over};

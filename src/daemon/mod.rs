//! The live rig: threads for cameras, capturing and recording, and the socket on which clients ask for captures.
//! Only this room knows how a press becomes a capture on the disk. `sync` decides what a capture is, `recording`
//! how it is stored, and `drivers` how to talk to a camera.

mod parameters;

pub use parameters::{
    BoxCorners, CaptureParameters, HooksParameters, RecordingParameters, RigParameters,
    ServiceParameters, SocketParameters,
};

cfg_if::cfg_if! {
    if #[cfg(feature = "live")] {
        mod backgrounds;
        mod capturing;
        mod socket;
        #[cfg(test)]
        mod digest_tests;
        #[cfg(test)]
        mod disaster_tests;
        mod dispatcher;
        pub mod events;
        mod hooks;
        pub mod look;
        #[cfg(test)]
        mod hostile_tests;
        mod names;
        #[cfg(test)]
        mod background_tests;
        #[cfg(test)]
        mod note_tests;
        mod notes;
        mod packing;
        mod probe;
        mod readiness;
        mod recorder;
        mod presses;
        mod rig;
        #[cfg(test)]
        mod scripted;
        mod service;
        #[cfg(test)]
        mod service_tests;
        mod status;
        mod systemd;
        #[cfg(test)]
        mod tests;

        pub use capturing::{Capturing, InterruptedRecordings, CapturePlan, ReloadedSettings};
        pub use socket::{Clients, SocketError, refuse_waiting, serve};
        pub use dispatcher::ReplyStream;
        pub use hooks::Hooks;
        pub use packing::Packing;
        pub use probe::probe;
        pub use rig::{CameraKind, Rig, RigCamera};
        pub use service::Service;
        pub use status::{CameraStatus, Status};
        pub use systemd::{Heartbeat, Notifier, Watchdog, handed_over};
    }
}

//! What all live cameras share. A [`Driver`] opens a camera, a [`Device`] takes its pictures, and [`supervise`] runs a
//! thread for it, which polls the camera and reopens it when it is away. No SDK is named here.

mod clock;
mod device;
mod pool;
mod supervisor;
#[cfg(test)]
mod supervisor_tests;

use std::time::Duration;

pub use clock::{DeviceClock, Reading};
pub use device::{CameraInfo, Device, Driver, Fault, LookResult, Shot, ShotStats};
pub use pool::{Pool, PooledBuffer};
pub use supervisor::{
    Backoff, CameraEvent, Command, Message, StoppingThread, Supervised, supervise,
};

/// How much earlier than the daemon's trigger an electrical signal may start the exposure: the press takes that long
/// through the switch, USB and the socket.
pub const LINE_LEAD: Duration = Duration::from_millis(50);

/// What a look says of a camera that waits for a signal of its line.
pub const NO_SIGNAL: &str = "no signal came on its line since it was opened or a capture was taken: a signal without a \
                             press shows a picture here and records nothing";

//! What live cameras have in common. A camera has a [`Driver`] that opens it, a [`Device`] that takes its pictures, and
//! a thread of its own that [`supervise`] runs: it opens the camera, asks whether it is still there, and opens it again
//! when it is not. No SDK is named here.

mod clock;
mod device;
mod pool;
mod supervisor;
#[cfg(test)]
mod supervisor_tests;

use std::time::Duration;

pub use clock::{DeviceClock, Reading};
pub use device::{Confirmed, Device, Driver, Fault, Shot, Tally};
pub use pool::{Pool, PooledBuffer};
pub use supervisor::{Backoff, Command, Ending, Event, Message, Supervised, supervise};

/// How much earlier than the daemon's trigger an electrical signal may have started the exposure: what the press takes
/// through a switch, USB and a socket.
pub const LINE_LEAD: Duration = Duration::from_millis(50);

//! The simulated rig: objects of known shape, rendered into the pictures and depth readings that real cameras would
//! deliver, with their noise and their faults, so that accuracy can be measured.

#![cfg_attr(not(test), warn(unreachable_pub))]
#![cfg_attr(not(test), warn(clippy::unwrap_used))]
#![cfg_attr(
    test,
    allow(clippy::disallowed_methods, reason = "a test's channel ends with it")
)]

mod board;
mod burst;
mod check;
mod color;
mod coverage;
mod depth;
mod faults;
mod lay;
mod light;
mod material;
mod noise;
mod options;
mod placed;
mod pose;
mod preset;
mod prop;
mod random;
mod record;
mod render;
mod rest;
mod rig;
pub mod serve;
mod session;
mod shape;

pub use board::{
    BoardFaults, BoardOptions, BoardSession, Placement, PlacementFault, write_board_session,
};
pub use faults::{CaptureFault, Exchange, OtherObject};
pub use options::{CameraFault, ColorSensor, DepthSensor, Encoding, Faults, Options, Response};
pub use pose::Pose;
pub use preset::Preset;
pub use record::{ply, poses_json, write};
pub use rig::{DepthStation, Rig, SimulatedColorCamera};
pub use session::{Capture, Simulation};
pub use shape::Shape;

use scand_core::frame::NameError;
use scand_core::range::{self, OutOfRange};
use scand_core::{calibration, recording};

/// Why nothing is simulated.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Error {
    /// An option that cannot be met.
    #[error("{what} is {found}, expected {expected}")]
    BadOption {
        what: &'static str,
        found: String,
        expected: String,
    },
    /// A camera that cannot be.
    #[error(transparent)]
    Calibration(#[from] calibration::Error),
    /// A camera's id is invalid.
    #[error(transparent)]
    Name(#[from] NameError),
    /// What cannot be played as a live rig, in words.
    #[error("{0}")]
    Unservable(String),
    /// A recording that cannot be read or written.
    #[error(transparent)]
    Recording(#[from] recording::Error),
}

fn invalid(what: &'static str, found: impl ToString, expected: impl Into<String>) -> Error {
    Error::BadOption {
        what,
        found: found.to_string(),
        expected: expected.into(),
    }
}

/// Refuses a number that is not within its range.
fn within_range(what: &'static str, found: f64, range: [f64; 2], unit: &str) -> Result<(), Error> {
    let checked = range::check(found, range, unit);
    let refused = |e: OutOfRange| invalid(what, e.found, e.expected);
    checked.map(drop).map_err(refused)
}

#[cfg(test)]
mod tests;
#[cfg(test)]
mod tests_depth;
#[cfg(test)]
mod tests_faults;

//! scand takes synchronised pictures of an object from colour cameras and a depth camera, keeps them in a recording
//! that survives crashes and power cuts, and reconstructs the object by the method of Jang, Park and Lee, "Hybrid
//! optical system for three-dimensional shape acquisition", Applied Optics 52(16), 2013.
//!
//! Data flows one way. Live: `drivers` → `sync` → `recording`. From a recording: `recording` → `sync` → `capture` →
//! `reconstruct` → `report` → `output`. ARCHITECTURE.md has the table of the rooms that each room may use.

#![cfg_attr(not(test), warn(unreachable_pub))]
#![cfg_attr(not(test), warn(clippy::unwrap_used))]
#![cfg_attr(
    test,
    allow(clippy::disallowed_methods, reason = "a test's channel ends with it")
)]

pub use scand_core::{
    array, bag, calibrate, calibration, capture, dataset, description, evaluate, export, frame,
    gltf_file, image, level, look, make_model, markup, mesh, notes, output, publish, queue, range,
    reconstruct, recording, register, report, statistics, storage, sync, words,
};

#[cfg(feature = "live")]
pub mod check;
#[cfg(any(feature = "live", feature = "page"))]
pub mod clock;
pub mod commands;
pub mod config;
pub mod daemon;
pub mod drivers;
#[cfg(feature = "fleet")]
pub mod fleet;
#[cfg(any(feature = "live", feature = "page"))]
pub mod log;
#[cfg(feature = "page")]
pub mod page;
#[cfg(feature = "live")]
pub mod pedal;
#[cfg(any(feature = "live", feature = "page"))]
pub mod process;
#[cfg(feature = "live")]
pub mod setup;
#[cfg(any(feature = "live", feature = "page"))]
mod shares;
#[cfg(test)]
#[path = "../tests/support"]
#[allow(dead_code, reason = "it depends on the features what is used")]
mod support {
    pub mod dice;
    pub mod skipped;
    pub mod torture;
    pub mod wait;
}
pub mod trigger;
pub mod workers;

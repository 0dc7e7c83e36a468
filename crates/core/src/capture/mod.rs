//! Loads captures: replays a recording, lets `sync` assemble its captures, and makes one of them, named by its id, the
//! scene that a reconstruction starts from.

mod digest;
mod error;
mod facts;
mod load;
mod pictures;
mod placements;
mod plan;
mod replacement;
mod replay;
mod rig;

pub use digest::digest;
pub use error::Error;
pub use facts::{CaptureFacts, ColorFacts, DepthFacts, LeftOut, Silhouette};
pub use load::{CaptureSummary, Session};
pub use placements::{Placements, Readings, Shot};
pub use replacement::{CalibrationMismatch, replace_cameras};
pub use rig::RigAt;

#[cfg(test)]
mod tests;

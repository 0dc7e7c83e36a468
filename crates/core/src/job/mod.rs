//! A job is a recording and a capture's id. This room joins the recording, its replay and the
//! synchronisation into what a reconstruction is made from.

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
pub use replacement::{Misfit, replace_cameras};
pub use rig::RigAt;

#[cfg(test)]
mod tests;

//! Loads captures: replays a recording, lets `sync` assemble its captures, and makes a scene, the input of a
//! reconstruction, of the one with a given id.

mod ahead;
mod digest;
mod error;
mod extract;
mod facts;
mod load;
mod picture_files;
mod pictures;
mod placements;
mod plan;
mod replacement;
mod replay;
mod rig;

pub use digest::{calibration_digest, digest, input_digest, joint_digest};
pub use error::Error;
pub use extract::Extract;
pub use facts::{CaptureFacts, ColorFacts, DepthFacts, LeftOutCamera, Silhouette};
pub use load::{CaptureSession, CaptureSummary};
pub use picture_files::PictureFiles;
pub use placements::{Placements, Readings, Shot};
pub use replacement::{CalibrationMismatch, replace_cameras};
pub use rig::RigAt;

#[cfg(test)]
mod tests;

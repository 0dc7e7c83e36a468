//! A job is a recording and a capture's id. This room joins the recording, its replay and the
//! synchronisation into what a reconstruction is made from.

mod facts;
mod load;
mod pictures;
mod plan;
mod rig;

pub use facts::{CaptureFacts, ColorFacts, DepthFacts, LeftOut, Silhouette};
pub use load::{CaptureSummary, Error, Session};
pub use rig::RigAt;

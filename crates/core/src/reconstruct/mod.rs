//! The paper's method, one stage per folder: pure, no I/O, no hardware. `pipeline` has the order of the stages, their
//! parameters and the checks between them.

pub mod depth;
mod faired_surface;
pub mod fairing;
mod fused_captures;
pub mod hull;
mod model;
mod pipeline;
mod progress;
pub mod region;
pub mod restore;
mod scene;
pub mod silhouette;
pub mod surface;
#[cfg(test)]
mod testing;
pub mod texture;
pub mod uncertainty;

pub use fused_captures::{DepthInRigFrame, FusedCaptures, MOST_CAPTURES};
pub use model::{Model, Provenance, Texture};
pub use pipeline::{
    DepthResult, Error, Method, Parameters, Reconstruction, reconstruct, reconstruct_from,
    silhouettes,
};
pub use progress::{NoProgress, Progress, Stage};
pub use scene::{ColorView, DepthFrame, DepthView, Scene, SilhouetteSource};

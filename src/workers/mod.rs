//! Models of what was captured, made beside the capturing: jobs that lie on the disk, and processes that do them one
//! after the other, each on the path of `scand --replay`, behind limits. What a model is, is decided elsewhere; here is
//! who makes it, when, and what becomes of one who fails.

#[cfg(feature = "live")]
mod confine;
#[cfg(feature = "live")]
mod find;
#[cfg(feature = "live")]
mod job;
#[cfg(feature = "live")]
mod jobs;
#[cfg(feature = "live")]
mod outcome;
mod parameters;
#[cfg(feature = "live")]
mod pool;
pub mod protocol;
#[cfg(all(test, feature = "live"))]
mod tests;

#[cfg(feature = "live")]
pub use confine::{ConfineError, Limits, confine, part_from};
#[cfg(feature = "live")]
pub use job::Job;
#[cfg(feature = "live")]
pub use jobs::{Backlog, Error, Jobs, Running};
pub use parameters::Parameters;
#[cfg(feature = "live")]
pub use pool::{Ended, Plan, Workers};

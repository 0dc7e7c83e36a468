//! Schedules model jobs while the rig captures, and handles their failures. Jobs are files on the disk; worker
//! processes do them one after the other, confined, in the way of `scand --replay`. `make_model` builds the models;
//! nothing here does.

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

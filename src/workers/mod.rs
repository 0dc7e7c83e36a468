//! Schedules model jobs while the rig captures, and handles their failures. Jobs are files on the disk. Confined
//! worker processes do them one after the other, with the code of `scand --replay`. `make_model` builds the models;
//! nothing here does.

mod address;
mod parameters;
pub mod protocol;

pub use address::{BadAddress, FleetAddress};
pub use parameters::Parameters;

cfg_if::cfg_if! {
    if #[cfg(feature = "live")] {
        mod confine;
        mod find;
        pub mod handover;
        mod job;
        mod jobs;
        mod outcome;
        mod pool;
        #[cfg(test)]
        mod tests;

        pub use confine::{ConfineError, Limits, confine, part_from};
        pub use find::find;
        pub use job::Job;
        pub use jobs::{Backlog, Error, Jobs, Running};
        pub use pool::{Ended, WorkerPlan, Workers};
    }
}

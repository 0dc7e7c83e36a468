//! Schedules model jobs while the rig captures, and handles their failures. Jobs are files on the disk. Confined
//! worker processes do them one after the other, with the code of `scand --replay`. The files `object_*` do the same
//! for objects of which there are several captures: one thread finds how these lie, another has their model made.
//! `remakes` has a capture's model made again with other settings, when nothing else waits. `told_settings` chooses
//! what clients are told of the settings. `distrusted` says which models of the fleet have to be replaced.
//! `make_model` builds the models; nothing here does.

mod address;
pub mod object_protocol;
mod parameters;
pub mod protocol;

pub use address::{AddressError, FleetAddress};
pub use parameters::Parameters;

cfg_if::cfg_if! {
    if #[cfg(feature = "live")] {
        pub mod distrusted;
        mod find;
        pub mod handover;
        mod job;
        mod jobs;
        mod object_find;
        mod object_jobs;
        mod object_pool;
        mod outcome;
        mod pool;
        mod remake_pool;
        mod remakes;
        mod threads;
        mod told_settings;
        #[cfg(test)]
        mod object_tests;
        #[cfg(test)]
        mod tests;

        pub use crate::process::{ConfineError, Limits, confine, bind_to_parent};
        pub use find::{find, find_unchanged};
        pub use job::Job;
        pub use jobs::{Backlog, Error, Jobs, RunningJob};
        pub use object_jobs::{ObjectJob, ObjectJobs};
        pub use object_pool::{ObjectResult, start_objects};
        pub use pool::{FinishedJob, WorkerPlan, start_models};
        pub use remake_pool::{RemakeResult, start_remakes};
        pub use remakes::{Remake, Remakes};
        pub use threads::Workers;
    }
}

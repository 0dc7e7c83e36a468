//! Models on other machines: offers captures to workers through a NATS server with JetStream, does such jobs, and takes
//! their results in. A capture travels as a small recording, and a result as a bundle of files with fixed names. The
//! process with the connection opens neither: confined children list, pack, make and check (`step`). Nothing here knows
//! how a model is made. design/fleet.md has the reasons.

mod bundle;
mod commit;
mod connection;
mod dispatch_job;
mod dispatcher;
mod distrust;
mod execution;
mod file_sum;
mod find_recording;
mod job;
mod job_state;
mod late_results;
mod memory_class;
mod model_origin;
mod process_folder;
mod program;
mod receive;
mod replay_here;
mod rig;
mod status;
pub mod step;
mod store;
mod subjects;
mod transfer;
mod worker;

pub use bundle::{Bundle, BundleError, contents_sha256, read_bundle, write_bundle};
pub use commit::{CommitResult, commit};
pub use connection::{Access, AccessError, FleetClient, Role, new_key};
pub use dispatcher::{Dispatcher, DispatcherPlan, JobEvent, JobOutcome, Task};
pub use file_sum::FileSum;
pub use job::{Heartbeat, HeartbeatJob, JobOffer, JobReport};
pub use memory_class::MemoryClass;
pub use model_origin::ModelOrigin;
pub use program::{Program, ProgramError};
pub use replay_here::{HereAnswer, HereRequest};
pub use rig::{RigPlan, serve_rig};
pub use status::{JobFailure, Status, Waiting, retry, status};
pub use subjects::{InvalidName, token};
pub use worker::{WorkerError, WorkerPlan, work};

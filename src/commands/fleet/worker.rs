//! `scand worker`: makes models for the rigs and archives of a fleet.

use super::{AccessArgs, AddressParser, block_on, termination};
use crate::fleet::{MemoryClass, Program, Role, WorkerPlan, work};
use crate::log;
use crate::words::count;
use crate::workers::FleetAddress;
use std::path::PathBuf;
use std::process::ExitCode;

/// Make models for the rigs of a fleet, until SIGTERM or Ctrl-C
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  scand worker --fleet nats://127.0.0.1
  scand worker --fleet tls://fleet.museum.example --credentials worker.key --jobs 4 --memory-mb 16000")]
pub struct Args {
    /// The fleet's server: nats://HOST or tls://HOST, with :PORT if it is not 4222
    #[arg(long, value_name = "ADDRESS", value_parser = AddressParser)]
    fleet: FleetAddress,
    #[command(flatten)]
    access: AccessArgs,
    /// Models made at the same time
    #[arg(short, long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    jobs: u16,
    /// Memory that each job may take, in megabytes, 4000 or more; jobs that need more go to other workers
    #[arg(long, default_value_t = 4000, value_name = "N", value_parser = clap::value_parser!(u32).range(i64::from(MemoryClass::LEAST_MB)..))]
    memory_mb: u32,
    /// Niceness of the processes that make models, 0 to 19
    #[arg(long, default_value_t = 10, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=19))]
    nice: u32,
    /// Where recordings and models are while they are made; by default $CACHE_DIRECTORY, or a folder for temporary
    /// files
    #[arg(long, value_name = "DIR")]
    scratch: Option<PathBuf>,
}

/// Works.
///
/// # Errors
/// If this program takes no part in a fleet, the server is refused, or a rig wants this worker to stop.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let program = Program::current()?;
    let lent = std::env::var_os("CACHE_DIRECTORY").map(PathBuf::from);
    let temporary = || {
        let user = rustix::process::getuid().as_raw();
        std::env::temp_dir().join(format!("scand-worker-{user}"))
    };
    let plan = WorkerPlan {
        scratch: args.scratch.or(lent).unwrap_or_else(temporary),
        program: program.clone(),
        jobs: args.jobs.into(),
        memory_mb: args.memory_mb,
        nice: args.nice,
    };
    block_on(async {
        let fleet = args.access.connect(&args.fleet, Role::Worker).await?;
        log::notice!(
            "this worker runs program {program} and makes {} at a time",
            count(args.jobs as usize, "model")
        );
        work(fleet, plan, termination()).await?;
        Ok(ExitCode::SUCCESS)
    })
}

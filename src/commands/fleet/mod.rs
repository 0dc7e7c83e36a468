//! `scand fleet`: offers a rig's captures to workers on other machines, tells what a fleet does, and makes keys. Also
//! what its commands share: the arguments that name the server, and the runtime.

pub mod worker;

use crate::commands::{BadConfiguration, wrong_usage};
use crate::config::Config;
use crate::fleet::{
    Access, FleetClient, Program, RigPlan, Role, Status, new_key, retry, serve_rig, status,
};
use crate::storage::write_new_for_owner;
use crate::words::count;
use crate::workers::{AddressError, FleetAddress};
use anyhow::Context;
use clap::builder::TypedValueParser;
use clap::error::ErrorKind;
use clap::{Arg, Command};
use std::ffi::OsStr;
use std::future::Future;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const MEGABYTE: u64 = 1_000_000;
/// Bytes that a fleet leaves free on a disk, besides what captures need.
pub(super) const KEEP_FREE: u64 = 200 * MEGABYTE;

/// Make models on other machines: offer a rig's captures, look at what happens, make keys
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  scand fleet run --config /etc/scand/rig.toml
  scand fleet status --fleet tls://fleet.museum.example --credentials viewer.key
  scand fleet retry --fleet nats://127.0.0.1 --rig hall --capture vase-0003
  scand fleet key worker.key")]
pub struct Args {
    #[command(subcommand)]
    what: FleetCommand,
}

#[derive(Debug, clap::Subcommand)]
enum FleetCommand {
    /// Offer the rig's captures to the fleet and store the models that come back, until SIGTERM or Ctrl-C
    Run(RunArgs),
    /// Show jobs, workers and failures
    Status(StatusArgs),
    /// Have a rig offer its failed jobs again
    Retry(RetryArgs),
    /// Make the key of a rig, a worker or a viewer, and print its public part
    Key {
        /// The file to write, which only its owner can read
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
}

/// Reads an address. It never quotes what it refuses, as clap's own parsers would: that may hold a password.
#[derive(Clone, Debug)]
pub(crate) struct AddressParser;

impl TypedValueParser for AddressParser {
    type Value = FleetAddress;

    fn parse_ref(
        &self,
        command: &Command,
        _argument: Option<&Arg>,
        value: &OsStr,
    ) -> Result<FleetAddress, clap::Error> {
        let text = value.to_str().ok_or(AddressError::Form);
        text.and_then(str::parse).map_err(|cause| {
            let words = format!("invalid address for '--fleet <ADDRESS>': {cause}\n");
            clap::Error::raw(ErrorKind::ValueValidation, words).with_cmd(command)
        })
    }
}

/// How the server is reached, and as whom.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct AccessArgs {
    /// A .creds file, or a key that `scand fleet key` made; by default $CREDENTIALS_DIRECTORY/fleet, if it exists
    #[arg(long, value_name = "FILE")]
    credentials: Option<PathBuf>,
    /// Trust the certificates in this file (PEM) instead of the system's
    #[arg(long, value_name = "FILE")]
    authority: Option<PathBuf>,
    /// Let pictures cross a network unencrypted
    #[arg(long)]
    plain_text: bool,
    /// The name of this rig, worker or viewer at the server; by default that of the machine
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
}

impl AccessArgs {
    /// Connects in this role.
    pub(crate) async fn connect(
        &self,
        address: &FleetAddress,
        role: Role,
    ) -> anyhow::Result<FleetClient> {
        let access = Access {
            address: address.clone(),
            role,
            name: self.name.clone().unwrap_or_else(machine),
            credentials: self.credentials.clone(),
            authority: self.authority.clone(),
            plain_text: self.plain_text,
        };
        Ok(FleetClient::connect(&access).await?)
    }
}

/// The name of this machine, with what cannot be in a name replaced.
fn machine() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '-' };
    let name: String = name.trim().chars().take(60).map(plain).collect();
    if name.is_empty() {
        "machine".into()
    } else {
        name
    }
}

/// Runs a future to its end on this thread; children wait in threads of their own.
pub(crate) fn block_on<T>(future: impl Future<Output = anyhow::Result<T>>) -> anyhow::Result<T> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    let result = runtime.block_on(future);
    runtime.shutdown_background();
    result
}

/// Ready when this process is asked to end.
pub(crate) async fn termination() {
    use tokio::signal::unix::{SignalKind, signal};
    let terminate = signal(SignalKind::terminate());
    let interrupt = signal(SignalKind::interrupt());
    let (Ok(mut terminate), Ok(mut interrupt)) = (terminate, interrupt) else {
        return std::future::pending().await;
    };
    tokio::select! {
        _ = terminate.recv() => {}
        _ = interrupt.recv() => {}
    }
}

#[derive(Debug, clap::Args)]
struct RunArgs {
    /// The rig's configuration (TOML)
    #[arg(long, value_name = "FILE", default_value = "/etc/scand/rig.toml")]
    config: PathBuf,
    /// Set one value of the configuration; may be given several times
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    #[command(flatten)]
    access: AccessArgs,
}

#[derive(Debug, clap::Args)]
struct ServerArgs {
    /// The fleet's server: nats://HOST or tls://HOST, with :PORT if it is not 4222
    #[arg(long, value_name = "ADDRESS", value_parser = AddressParser)]
    fleet: FleetAddress,
    #[command(flatten)]
    access: AccessArgs,
}

#[derive(Debug, clap::Args)]
struct StatusArgs {
    #[command(flatten)]
    server: ServerArgs,
    /// Print it as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct RetryArgs {
    #[command(flatten)]
    server: ServerArgs,
    /// The rig whose jobs failed
    #[arg(long, value_name = "NAME")]
    rig: String,
    /// Only this capture
    #[arg(long, value_name = "ID")]
    capture: Option<String>,
}

/// Does what was asked.
///
/// # Errors
/// If the server or the configuration is refused, or does not answer.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    match args.what {
        FleetCommand::Run(args) => serve(&args),
        FleetCommand::Status(args) => block_on(print_status(&args)),
        FleetCommand::Retry(args) => block_on(async {
            let server = &args.server;
            let fleet = server.access.connect(&server.fleet, Role::Viewer).await?;
            let answer = retry(&fleet, &args.rig, args.capture.as_deref()).await;
            let answer = answer.map_err(anyhow::Error::msg)?;
            outln!("rig {}: {answer} offered again", args.rig);
            Ok(ExitCode::SUCCESS)
        }),
        FleetCommand::Key { file } => make_key(&file),
    }
}

fn serve(args: &RunArgs) -> anyhow::Result<ExitCode> {
    let program = Program::current()?;
    let config = Config::load(Some(&args.config), &args.set);
    let config = config.map_err(|e| BadConfiguration(e.into()))?;
    let Some(address) = &config.workers.fleet else {
        let file = args.config.display();
        return Err(wrong_usage(format!(
            "{file} names no server: set workers.fleet"
        )));
    };
    let recordings = std::path::absolute(&config.recording.folder)?;
    let mut parameters = config.workers.clone();
    if parameters.folder.as_os_str().is_empty() {
        parameters.folder = recordings.with_file_name("models");
    }
    parameters.folder = std::path::absolute(&parameters.folder)?;
    let plan = RigPlan {
        program,
        recordings,
        parameters,
        // More than captures need: a press is refused when they have less.
        keep_free_bytes: config.recording.keep_free_mb * MEGABYTE + KEEP_FREE,
    };
    block_on(async {
        let fleet = args.access.connect(address, Role::Rig).await?;
        serve_rig(fleet, plan, termination()).await?;
        Ok(ExitCode::SUCCESS)
    })
}

async fn print_status(args: &StatusArgs) -> anyhow::Result<ExitCode> {
    let server = &args.server;
    let fleet = server.access.connect(&server.fleet, Role::Viewer).await?;
    let status = status(&fleet).await.map_err(anyhow::Error::msg)?;
    if args.json {
        outln!("{}", serde_json::to_string_pretty(&status)?);
    } else {
        print(&status);
    }
    Ok(ExitCode::SUCCESS)
}

fn print(status: &Status) {
    let running: usize = status.workers.iter().map(|worker| worker.jobs.len()).sum();
    let waiting: usize = status.waiting.iter().map(|waiting| waiting.jobs).sum();
    outln!(
        "{waiting} waiting, {running} running, {} failed; {}",
        status.failed.len(),
        count(status.workers.len(), "worker")
    );
    for waiting in &status.waiting {
        let nobody = if waiting.has_worker {
            ""
        } else {
            ": no worker of the fleet can do them; start one with this program and enough memory (--memory-mb)"
        };
        let jobs = count(waiting.jobs, "job");
        outln!(
            "{jobs} of rig {} wait for a worker with program {} and memory class {}{nobody}",
            waiting.rig,
            waiting.program,
            waiting.needs
        );
    }
    for worker in &status.workers {
        let (results, crashed) = (worker.results, worker.crashed);
        outln!(
            "worker {} ({}): {results} done, {crashed} crashed",
            worker.worker,
            worker.program
        );
        if let Some(problem) = worker.clock_problem() {
            outln!("  {problem}");
        }
        for job in &worker.jobs {
            outln!("  {} of {}, for {:.0} s", job.capture, job.rig, job.seconds);
        }
    }
    for failed in &status.failed {
        outln!(
            "failed: {} of {} ({}): {}",
            failed.capture,
            failed.rig,
            failed.recording,
            failed.reason
        );
    }
}

fn make_key(file: &Path) -> anyhow::Result<ExitCode> {
    let (seed, public) = new_key().context("no key can be made")?;
    write_new_for_owner(file, format!("{seed}\n").as_bytes())?;
    outln!("{public}");
    Ok(ExitCode::SUCCESS)
}

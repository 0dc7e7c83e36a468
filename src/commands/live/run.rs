//! `scand run`: runs the daemon, from its configuration to its end.

use super::config_args::ConfigArgs;
use super::models::Models;
use crate::check::without_passwords;
use crate::clock::Clock;
use crate::commands::EXIT_INCOMPLETE;
use crate::daemon::events::Events;
use crate::daemon::look::LookPlan;
use crate::daemon::{
    CameraKind, CapturePlan, Capturing, Hooks, InterruptedRecordings, Notifier, Packing, Rig,
    RigCamera, Service, Watchdog, handed_over, refuse_waiting, serve,
};
use crate::drivers::live::Backoff;
use crate::log;
use crate::setup::{ConfigSource, Prepared, ReloadableConfig};
use crate::words::count;
use anyhow::Context;
use std::os::unix::net::UnixListener;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::Duration;

/// Run the rig: open its cameras, take a capture at each trigger and write it to the disk. SIGTERM or Ctrl-C finishes
/// the capture in progress, completes the session and ends the daemon.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  scand run --config rig.toml
  scand run --config rig.toml --check")]
pub struct Args {
    #[command(flatten)]
    source: ConfigArgs,
    /// Check the configuration and print a summary, without opening a camera.
    #[arg(long)]
    check: bool,
}

/// Runs the daemon.
///
/// # Errors
/// If the configuration is bad, the recordings' folder or the socket cannot be made.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let clock = Clock::system();
    let prepared = args.source.prepare(clock).inspect_err(|error| {
        if !args.check {
            refuse_clients(error);
        }
    })?;
    if args.check {
        outln!(
            "{}: {}, {}",
            args.source.config.display(),
            count(prepared.rig_cameras.len(), "camera"),
            match prepared.calibration {
                Some(_) => "all of them are calibrated",
                None => "they are not calibrated, so no models will be made",
            }
        );
        return Ok(ExitCode::SUCCESS);
    }
    let socket = handed_over().context("cannot use the socket that systemd passed")?;
    serve_rig(args.source.source(), prepared, clock, socket)
}

/// Tells the clients that had systemd start this daemon why it cannot start.
fn refuse_clients(error: &anyhow::Error) {
    if let Ok(Some(listener)) = handed_over() {
        let reason = without_passwords(&format!("the daemon cannot start: {error:#}"));
        refuse_waiting(&listener, &reason);
    }
}

fn serve_rig(
    source: ConfigSource,
    prepared: Prepared,
    clock: Clock,
    socket: Option<UnixListener>,
) -> anyhow::Result<ExitCode> {
    // What systemd lends for cameras, raw sockets, is this process's alone: no hook and no worker inherits it.
    let _ = rustix::thread::clear_ambient_capability_set();
    let notifier = Arc::new(Notifier::from_environment());
    let watchdog = Watchdog::new(notifier.clone(), clock);
    let models = Models::prepare(&prepared.config)?;
    let plan = capture_plan(&prepared, &watchdog, models.as_ref());
    let Prepared {
        config,
        rig_cameras,
        header,
        ..
    } = prepared;
    let jobs = plan.jobs.clone();
    let frames = frames_a_shot(&rig_cameras, plan.sync.depth_frames);
    // Before the cameras start, because nothing receives their events until then.
    let interrupted = InterruptedRecordings::recover(&config.recording.folder, &watchdog)?;
    let rig = Rig::start(rig_cameras, clock, frames, Backoff::default())?;
    let capturing = Arc::new(Capturing::start(rig, plan, &interrupted)?);
    let (own, policy) = (config.socket.clone(), config.service.clone());
    let hooks = Hooks::start(&config.hooks, capturing.events(), clock)?;
    let keep_free_bytes = Arc::new(AtomicU64::new(config.recording.keep_free_bytes()));
    let enqueue = |models: &Models| models.enqueue_missing(&config, interrupted.recordings());
    // The next start offers again what the disk refuses now.
    if models.as_ref().is_none_or(enqueue) {
        interrupted.forget();
    }
    let start =
        |models: Models| models.start(&config, clock, keep_free_bytes.clone(), capturing.clone());
    let workers = models.map(start).transpose()?;
    let packing = Packing::start(
        &capturing,
        &config.recording,
        keep_free_bytes.clone(),
        clock,
    )?;
    let running = ReloadableConfig {
        source,
        config,
        header,
        jobs,
        keep_free_bytes,
    };
    let reload = Box::new(move || running.reload(clock));
    let mut service = Service::new(notifier, &watchdog, policy, reload, clock);
    let clients = serve(&own, socket, &capturing, &mut service)?;
    // The order of shutdown: no new captures, workers and packing, the capture in progress with its recorder and
    // cameras, the clients' final answers, and the hooks that those caused.
    log::notice!("the daemon is ending");
    capturing.close();
    // Models are made after the next start: the capture in progress has the machine to itself.
    drop(workers);
    drop(packing);
    let stuck = capturing.stop();
    clients.finish(Duration::from_secs(1));
    hooks.into_iter().for_each(Hooks::stop);
    for camera in &stuck {
        log::error!("camera {camera}: its driver hangs, and the daemon ends without closing it");
    }
    Ok(if stuck.is_empty() {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(EXIT_INCOMPLETE)
    })
}

/// How a prepared rig captures.
fn capture_plan(prepared: &Prepared, watchdog: &Watchdog, models: Option<&Models>) -> CapturePlan {
    let config = &prepared.config;
    CapturePlan {
        sync: config.sync.clone(),
        capture: config.capture.clone(),
        recording: config.recording.clone(),
        calibration: prepared.calibration.clone(),
        header: prepared.header.clone(),
        pool: prepared.pool.clone(),
        program: concat!("scand ", env!("CARGO_PKG_VERSION")).into(),
        events: Events::default(),
        watchdog: watchdog.clone(),
        models: models.map(|_| config.workers.folder.clone()),
        jobs: models.map(|models| models.jobs.clone()),
        look: Some(LookPlan {
            // This very program, also when another version has been installed meanwhile.
            program: "/proc/self/exe".into(),
            cutting: prepared.cutting.clone(),
        }),
    }
}

/// Frames that all cameras may give to one shot.
pub(super) fn frames_a_shot(rig_cameras: &[RigCamera], depth_frames: usize) -> usize {
    let frames = rig_cameras.iter().map(|rig_camera| match rig_camera.kind {
        CameraKind::Color => 8,
        CameraKind::Depth | CameraKind::DepthInTurn => 2 * depth_frames + 16,
    });
    frames.sum()
}

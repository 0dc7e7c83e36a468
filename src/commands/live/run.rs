//! `scand run`: the daemon, from its configuration to its end.

use super::stations::stations;
use crate::calibration::{DepthCamera, DepthResponse, RigCalibration, Volume};
use crate::commands::{BadConfiguration, EXIT_LOST};
use crate::config::Config;
use crate::daemon::events::Events;
use crate::daemon::{Capturing, Kind, Plan, Rig, Station, serve};
use crate::drivers::live::{Backoff, HostClock, Pool};
use crate::frame::CameraId;
use crate::log;
use crate::recording::Preamble;
use anyhow::Context;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

/// Hold the rig's cameras, take a capture at each trigger and bring it to the disk. Ends with SIGTERM or Ctrl-C: a
/// capture in progress is finished, the session completed.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The rig's configuration (TOML).
    #[arg(long, value_name = "FILE", default_value = "/etc/scand/rig.toml")]
    config: PathBuf,
    /// One value over the configuration; may be given several times.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Check the configuration, say what it asks for, and touch nothing.
    #[arg(long)]
    check: bool,
}

/// Runs the daemon.
///
/// # Errors
/// If the configuration is bad, the recordings' folder or the socket cannot be made.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let mut config = Config::load(Some(&args.config), &args.set).map_err(bad)?;
    // Libraries of cameras change the working folder of a process for moments.
    for path in [&mut config.recording.folder, &mut config.socket.path] {
        *path = std::path::absolute(&*path)?;
    }
    let text = std::fs::read_to_string(&args.config)
        .with_context(|| format!("configuration {}", args.config.display()))?;
    let folder = args.config.parent().unwrap_or(Path::new("."));
    let calibration = calibration(&config, folder).map_err(|e| named(&args.config, e))?;
    let clock = HostClock::start();
    let pool = Pool::new(config.capture.memory_mb.saturating_mul(1_000_000));
    let stations =
        stations(&config, &calibration, clock, &pool).map_err(|e| named(&args.config, e))?;
    let preamble =
        preamble(&config, &calibration, &stations, text).map_err(|e| named(&args.config, e))?;
    if args.check {
        say!(
            "{}: {} cameras, all of them calibrated",
            args.config.display(),
            stations.len()
        );
        return Ok(ExitCode::SUCCESS);
    }
    let plan = Plan {
        sync: config.sync.clone(),
        capture: config.capture.clone(),
        recording: config.recording.clone(),
        preamble,
        pool,
        program: concat!("scand ", env!("CARGO_PKG_VERSION")).into(),
        events: Events::default(),
    };
    serve_rig(stations, clock, plan, &config)
}

fn serve_rig(
    stations: Vec<Station>,
    clock: HostClock,
    plan: Plan,
    config: &Config,
) -> anyhow::Result<ExitCode> {
    let depth_frames = 2 * plan.sync.depth_frames;
    let frames = stations.iter().map(|station| match station.kind {
        Kind::Color => 8,
        Kind::Depth | Kind::DepthInTurn => depth_frames + 16,
    });
    let frames = frames.sum();
    let rig = Rig::start(stations, clock, frames, Backoff::default())?;
    let capturing = Arc::new(Capturing::start(rig, plan)?);
    let path = &config.socket.path;
    serve(path, &capturing, || {
        log::info!("listening on {}", path.display());
    })?;
    log::notice!("ending");
    let stuck = capturing.stop();
    for camera in &stuck {
        log::error!("camera {camera}: its driver hangs");
    }
    Ok(if stuck.is_empty() {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(EXIT_LOST)
    })
}

fn bad(error: impl std::error::Error + Send + Sync + 'static) -> anyhow::Error {
    BadConfiguration(Box::new(error)).into()
}

/// What is wrong with a configuration, with the file's name.
fn named(file: &Path, problem: String) -> anyhow::Error {
    BadConfiguration(format!("configuration {}: {problem}", file.display()).into()).into()
}

fn calibration(config: &Config, folder: &Path) -> Result<RigCalibration, String> {
    if config.rig.calibration.as_os_str().is_empty() {
        return Err(
            "rig.calibration is missing, expected the file that scand calibrate wrote".into(),
        );
    }
    RigCalibration::load(&folder.join(&config.rig.calibration)).map_err(|e| e.to_string())
}

/// What every recording begins with.
fn preamble(
    config: &Config,
    calibration: &RigCalibration,
    stations: &[Station],
    configuration: String,
) -> Result<Preamble, String> {
    let of = |color: bool| {
        let chosen = stations
            .iter()
            .filter(move |s| (s.kind == Kind::Color) == color);
        chosen.filter_map(|s| calibration.cameras.get(&s.id))
    };
    let depth =
        |(camera, response): &(crate::calibration::Camera, Option<DepthResponse>)| DepthCamera {
            camera: camera.clone(),
            response: response.unwrap_or_default(),
        };
    let volume = config.rig.volume.map(|volume| {
        let volume = Volume::new(volume.min.into(), volume.max.into());
        volume.map_err(|e| format!("rig.volume: {e}"))
    });
    let volume = volume.transpose()?.or(calibration.volume);
    if volume.is_none() {
        return Err("rig.volume is missing, and the calibration proposes none".into());
    }
    Ok(Preamble {
        colors: of(true).map(|(camera, _)| camera.clone()).collect(),
        depths: of(false).map(depth).collect(),
        volume,
        settings: BTreeMap::new(),
        backgrounds: BTreeMap::<CameraId, _>::new(),
        configuration,
        about: BTreeMap::from([("rig".into(), config.rig.name.clone())]),
    })
}

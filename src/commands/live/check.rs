//! `scand check`: finds what is wrong with the rig before work begins, and packs a bundle for support.

use super::config_args::ConfigArgs;
use crate::calibration::{CalibrationLevel, CalibrationRecord};
use crate::check::{self, Bundle, Finding, Host, State, without_passwords};
use crate::clock::Clock;
use crate::commands::{BadConfiguration, EXIT_CONFIGURATION, VERSION};
use crate::config::Config;
use crate::daemon::probe;
use crate::process::{Cancel, Child};
use crate::setup::Prepared;
use crate::storage::{free_bytes, read_text};
use crate::trigger::{Client, Error, Reply, Request};
use crate::words::count;
use rustix::fs::{MemfdFlags, memfd_create};
use serde_json::{Value, json};
use std::fs::File;
use std::io::{ErrorKind, Read, Seek};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::time::Duration;

/// How long cameras are waited for.
const CAMERAS: Duration = Duration::from_secs(15);
/// How long a running daemon is waited for.
const DAEMON: Duration = Duration::from_secs(10);
/// How long a program may take whose output goes into the bundle: `df` never ends where a network's disk is away.
const PROGRAM: Duration = Duration::from_secs(20);
/// Bytes of the largest configuration that support gets.
const LARGEST_CONFIG: u64 = 1 << 20;

/// Look for problems that can be detected before work begins. Each line is ok or says what to do. If a daemon runs,
/// it is asked about its cameras; otherwise this command opens them itself.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  scand check
  scand check --config rig.toml --json
  sudo scand check --bundle support.tar.zst")]
pub struct Args {
    #[command(flatten)]
    source: ConfigArgs,
    /// Print the findings as JSON.
    #[arg(long)]
    json: bool,
    /// Pack the findings, the configuration, logs and versions into FILE (.tar.zst), for support.
    #[arg(long, value_name = "FILE")]
    bundle: Option<PathBuf>,
    /// Do not measure the disk's speed.
    #[arg(long)]
    no_speed: bool,
}

/// What was found.
struct Findings {
    all: Vec<Finding>,
    /// The running daemon's own words.
    status: Option<Value>,
    bad_configuration: bool,
}

/// Checks. The exit code is 0 where nothing is wrong (advice may be given), 78 for a bad configuration, else 1.
///
/// # Errors
/// If the bundle cannot be written.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let findings = findings(&args);
    let wrong = findings.all.iter().any(|f| f.state == State::Wrong);
    let as_json = json!({ "findings": &findings.all, "wrong": wrong });
    let as_lines: Vec<String> = findings.all.iter().map(Finding::line).collect();
    let as_lines = as_lines.join("\n");
    if args.json {
        outln!("{as_json:#}");
    } else {
        outln!("{as_lines}");
    }
    if let Some(path) = &args.bundle {
        let status = findings.status.unwrap_or_default();
        pack(&args.source, &as_lines, &as_json, &status).save(path)?;
    }
    Ok(match (findings.bad_configuration, wrong) {
        (true, _) => ExitCode::from(EXIT_CONFIGURATION),
        (_, true) => ExitCode::FAILURE,
        _ => ExitCode::SUCCESS,
    })
}

fn findings(args: &Args) -> Findings {
    let clock = Clock::system();
    match args.source.prepare(clock) {
        Ok(prepared) => prepared_findings(args, prepared, clock),
        Err(error) => {
            let found = format!("{error:#}");
            let remedy = "correct the file; config/rig.toml shows every section";
            Findings {
                all: vec![Finding::not_ok(
                    State::Wrong,
                    "configuration",
                    found,
                    remedy,
                )],
                status: None,
                bad_configuration: error.is::<BadConfiguration>(),
            }
        }
    }
}

fn prepared_findings(args: &Args, prepared: Prepared, clock: Clock) -> Findings {
    let Prepared {
        config,
        rig_cameras,
        calibration,
        header,
        ..
    } = prepared;
    let words = format!(
        "{}, {}",
        args.source.config.display(),
        count(rig_cameras.len(), "camera")
    );
    let mut all = vec![Finding::ok("configuration", words)];
    all.push(check::calibration(calibration.as_deref().map(modified)));
    all.extend(header.calibration.as_ref().and_then(doubted));
    let (daemon, status) = match ask(&config.socket.path) {
        Ok(answered) => answered,
        Err(denied) => {
            // A user outside the group cannot see the state of the rig.
            all.push(denied);
            all.extend(host(&config));
            return Findings {
                all,
                status: None,
                bad_configuration: false,
            };
        }
    };
    all.push(daemon);
    let cameras = match &status {
        Some(status) => Ok(status["cameras"].clone()),
        None => probe(rig_cameras, clock, CAMERAS)
            .map(|cameras| serde_json::to_value(cameras).unwrap_or_default()),
    };
    match &cameras {
        Ok(cameras) => all.extend(check::cameras(cameras)),
        Err(cause) => all.push(Finding::not_ok(
            State::Wrong,
            "cameras",
            cause.to_string(),
            "restart",
        )),
    }
    all.extend(host(&config));
    let capture_bytes = status.as_ref().and_then(|s| s["capture_bytes"].as_u64());
    let capture_bytes = capture_bytes.filter(|bytes| *bytes > 0);
    let capture_bytes = capture_bytes.unwrap_or(100_000_000);
    all.extend(disk(args, &config, capture_bytes, status.is_some()));
    Findings {
        all,
        status,
        bad_configuration: false,
    }
}

/// What the verdict of a calibration says against its use.
fn doubted(record: &CalibrationRecord) -> Option<Finding> {
    let verdict = &record.verdict;
    let is_refused = match verdict.level {
        CalibrationLevel::Good | CalibrationLevel::Accepted => return None,
        CalibrationLevel::Doubtful => false,
        CalibrationLevel::Refused => true,
    };
    let reason = verdict.reasons.first().map(String::as_str);
    Some(check::doubted_calibration(
        verdict.level.name(),
        is_refused,
        reason,
    ))
}

fn modified(path: &Path) -> std::io::Result<std::time::SystemTime> {
    std::fs::metadata(path)?.modified()
}

/// Whether a daemon runs, and its status. An error is that it may not be asked.
fn ask(socket: &Path) -> Result<(Finding, Option<Value>), Finding> {
    let status = || -> Result<Option<Value>, Error> {
        let mut client = Client::connect(socket, Some(DAEMON))?;
        client.send(&Request::Status {})?;
        Ok(match client.reply()? {
            Reply::Status { status } => Some(status),
            _ => None,
        })
    };
    match status() {
        Ok(Some(status)) => {
            let found = format!("it answers on {}", socket.display());
            Ok((Finding::ok("daemon", found), Some(status)))
        }
        Err(Error::Away { path, cause }) if cause.kind() == ErrorKind::PermissionDenied => {
            let found = format!("{}: {cause}", path.display());
            let remedy = "join its group: sudo adduser YOU scand, which takes effect at the next \
                login";
            Err(Finding::not_ok(State::Wrong, "daemon", found, remedy))
        }
        Err(Error::Broken { path, cause })
            if matches!(cause.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) =>
        {
            let found = format!(
                "{}: it accepts requests but does not answer: it is starting, or hangs",
                path.display()
            );
            let remedy = "ask again in a minute; journalctl -u scand says what it does";
            Err(Finding::not_ok(State::Wrong, "daemon", found, remedy))
        }
        _ => {
            let found = "no daemon runs: this check opens the cameras itself";
            Ok((Finding::ok("daemon", found), None))
        }
    }
}

fn host(config: &Config) -> Vec<Finding> {
    let host = Host::default();
    let mut findings = Vec::new();
    let gige = config.aravis.each().unwrap_or_default();
    if !gige.is_empty() {
        findings.push(host.receive_buffers());
    }
    for (id, parameters) in &gige {
        if let Some(address) = parameters.address {
            findings.push(host.packet_size(id, address, parameters.packet_size));
        }
    }
    if !config.openni2.cameras.is_empty() {
        findings.push(host.kinect_driver());
        findings.extend(host.kinects());
    }
    findings
}

fn disk(args: &Args, config: &Config, capture_bytes: u64, daemon_answers: bool) -> Vec<Finding> {
    let folder = &config.recording.folder;
    let (finding, writable) = check::folder(folder, daemon_answers);
    let mut findings = vec![finding];
    let keep_free_bytes = config.recording.keep_free_bytes();
    findings.push(check::space(
        free_bytes(folder),
        capture_bytes,
        keep_free_bytes,
    ));
    if !args.no_speed && writable && findings.iter().all(|f| f.state != State::Wrong) {
        findings.push(check::speed(folder, capture_bytes));
    }
    let limits = config.verdict.background_age_h;
    let limit_h = limits.amber.min(limits.red.unwrap_or(f64::INFINITY));
    findings.push(check::plates(folder, limit_h));
    findings
}

/// What a program prints within its time, its errors last.
fn output(program: &str, arguments: &[&str]) -> std::io::Result<Vec<u8>> {
    let mut printed = File::from(memfd_create(program, MemfdFlags::CLOEXEC)?);
    let mut command = Command::new(program);
    let nothing = Stdio::null();
    let child = Child::start_between(command.args(arguments), nothing, printed.try_clone()?)?;
    let (_, errors) = child.wait(PROGRAM, Clock::system(), &Cancel::new()?)?;
    let mut bytes = Vec::new();
    printed.rewind()?;
    printed.read_to_end(&mut bytes)?;
    bytes.extend(errors.into_bytes());
    Ok(bytes)
}

/// What support gets of what programs print: the file in the bundle, the program, its arguments.
const PRINTED: [(&str, &str, &[&str]); 7] = [
    (
        "journal.txt",
        "journalctl",
        &[
            "-u",
            "scand*",
            "--since",
            "-3 days",
            "-n",
            "20000",
            "--no-pager",
            "-o",
            "short-iso",
        ],
    ),
    (
        "kernel-log.txt",
        "journalctl",
        &["-k", "-b", "-n", "5000", "--no-pager"],
    ),
    (
        "service.txt",
        "systemctl",
        &[
            "status",
            "--no-pager",
            "-l",
            "scand.service",
            "scand.socket",
        ],
    ),
    ("network.txt", "ip", &["-s", "address"]),
    ("usb.txt", "lsusb", &["-t"]),
    ("disks.txt", "df", &["-h"]),
    (
        "packages.txt",
        "dpkg",
        &[
            "-l",
            "scand",
            "libaravis-0.8-0",
            "libopenni2-0",
            "libusb-1.0-0",
        ],
    ),
];

/// What support gets of the system's own files: the file in the bundle, and where it is.
const SYSTEM_FILES: [(&str, &str); 4] = [
    ("os-release", "/etc/os-release"),
    ("kernel.txt", "/proc/version"),
    ("memory.txt", "/proc/meminfo"),
    ("modules.txt", "/proc/modules"),
];

/// Everything that support wants to see. What is not there is left out.
fn pack(source: &ConfigArgs, lines: &str, findings: &Value, status: &Value) -> Bundle {
    let mut bundle = Bundle::default();
    bundle.add("check.txt", format!("{lines}\n"));
    bundle.add("check.json", format!("{findings:#}\n"));
    bundle.add("status.json", format!("{status:#}\n"));
    bundle.add("version.txt", format!("scand {VERSION}\n"));
    if let Ok(text) = read_text(&source.config, LARGEST_CONFIG) {
        bundle.add("rig.toml", without_passwords(&text));
    }
    if let Ok(Prepared {
        calibration: Some(calibration),
        ..
    }) = source.prepare(Clock::system())
    {
        add_file(&mut bundle, "calibration.toml", &calibration);
    }
    for (name, path) in SYSTEM_FILES {
        add_file(&mut bundle, name, Path::new(path));
    }
    for (name, program, arguments) in PRINTED {
        if let Ok(output) = output(program, arguments) {
            bundle.add(name, output);
        }
    }
    bundle
}

fn add_file(bundle: &mut Bundle, name: &str, path: &Path) {
    if std::fs::metadata(path).is_ok_and(|m| m.is_file() && m.len() < 1 << 30)
        && let Ok(contents) = std::fs::read(path)
    {
        bundle.add(name, contents);
    }
}

//! `scand pedal`: a foot switch asks the daemon for captures.

use crate::clock::Clock;
use crate::frame::Timestamp;
use crate::log;
use crate::pedal::{
    Action, Daemon, DaemonState, Device, Error, Keys, Switch, Unanswered, key_code,
};
use crate::trigger::{Reply, SOCKET};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// Ask the daemon for a capture at each press of a foot switch. Meanwhile the switch does not type into other
/// programs.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  scand pedal --device /dev/input/by-id/usb-footswitch-event-kbd
  scand pedal --device /dev/input/event5 --key KEY_B --reject-key KEY_C")]
pub struct Args {
    /// The foot switch, an input device such as /dev/input/by-id/…-event-kbd.
    #[arg(long, value_name = "PATH")]
    device: PathBuf,
    /// The daemon's socket.
    #[arg(long, value_name = "PATH", default_value = SOCKET)]
    socket: PathBuf,
    /// A key that asks for a capture, such as KEY_B; may be given several times. By default all keys do.
    #[arg(long, value_name = "KEY", value_parser = key_code)]
    key: Vec<u16>,
    /// A key that marks the last capture as rejected; may be given several times.
    #[arg(long, value_name = "KEY", value_parser = key_code)]
    reject_key: Vec<u16>,
    /// How long a key must have been released before a press counts, in milliseconds.
    #[arg(long, value_name = "MS", default_value_t = 50)]
    quiet_ms: u64,
}

/// Most presses whose answers are awaited at a time; the daemon answers all but one of them at once.
const MOST: usize = 8;

/// Reads the foot switch until it is unplugged. That is not a failure: its unit starts again when it is plugged in.
///
/// # Errors
/// If it cannot be opened or read.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let mut device = Device::open(&args.device)?;
    log::info!("{}: {}", args.device.display(), device.name());
    let daemon = Daemon::new(&args.socket, Clock::system());
    let watched = daemon.clone();
    let watch = std::thread::Builder::new().name("daemon".into());
    watch.spawn(move || tell_whether_there(&watched))?;
    let keys = Keys {
        trigger: args.key.into_iter().collect(),
        reject: args.reject_key.into_iter().collect(),
    };
    let mut switch = Switch::new(keys, Duration::from_millis(args.quiet_ms));
    let running: Arc<AtomicUsize> = Arc::default();
    loop {
        let input = match device.wait() {
            Err(gone @ Error::Gone { .. }) => {
                log::notice!("{gone}");
                device.forget();
                return Ok(ExitCode::SUCCESS);
            }
            input => input?,
        };
        let Some(action) = switch.edge(input.code, input.value, input.time) else {
            continue;
        };
        if running.fetch_add(1, Ordering::AcqRel) >= MOST {
            running.fetch_sub(1, Ordering::AcqRel);
            log::error!("the daemon does not answer: this press is ignored");
            continue;
        }
        let press_id = format!("pedal-{}", Timestamp::from(input.time).0);
        let (daemon, ended) = (daemon.clone(), running.clone());
        std::thread::Builder::new().spawn(move || {
            match action {
                Action::Trigger => press(&daemon, &press_id),
                Action::Reject => reject(&daemon),
            }
            ended.fetch_sub(1, Ordering::AcqRel);
        })?;
    }
}

fn tell_whether_there(daemon: &Daemon) {
    // Once when it changes.
    let mut there = None;
    daemon.watch(|watch| {
        let now = matches!(watch, DaemonState::There);
        if there != Some(now) {
            match watch {
                DaemonState::There => log::notice!("the daemon answers"),
                DaemonState::Away(error) => log::warning!("the daemon does not answer: {error}"),
                DaemonState::Ended => log::notice!("the daemon was told to stop, or cannot start"),
            }
        }
        there = Some(now);
        true
    });
}

fn press(daemon: &Daemon, press_id: &str) {
    let end = daemon.press(press_id, &mut |reply| {
        if let Reply::Captured { capture, .. } = reply {
            log::info!("{capture} is captured: hands may move");
        }
    });
    match end {
        Ok(Reply::Durable { capture, .. }) => log::notice!("{capture}: durable"),
        Ok(Reply::Failed { capture, reason }) => log::error!("{capture}: failed: {reason}"),
        Ok(Reply::Busy) => {
            log::warning!("busy: another order is being carried out, such as a capture");
        }
        Ok(Reply::Refused { reason }) => log::error!("a press was refused: {reason}"),
        Ok(reply) => log::warning!("the daemon gave an unexpected answer: {reply:?}"),
        Err(Unanswered {
            was_asked: true,
            error,
        }) => log::error!("whether a capture was taken is not known: {error}; see scand status"),
        Err(Unanswered { error, .. }) => log::error!("no capture was taken: {error}"),
    }
}

fn reject(daemon: &Daemon) {
    match daemon.reject_last() {
        Ok(None) => log::warning!(
            "there is no capture to reject: none was taken since this program or the daemon \
            started"
        ),
        Ok(Some((capture, Reply::Refused { reason }))) => {
            log::error!("{capture} is not marked as rejected: {reason}");
        }
        Ok(Some((capture, _))) => log::notice!("{capture}: rejected"),
        Err(error) => log::error!("the last capture is not marked as rejected: {error}"),
    }
}

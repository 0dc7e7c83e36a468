//! `scand simulate --serve`: plays a recording's cameras as devices on this machine until it is asked to quit.

use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Cameras as devices")]
pub(super) struct ServeArgs {
    /// Play this recording's colour cameras as GigE Vision cameras on loopback addresses, with one picture for each
    /// software trigger, capture after capture. Commands on the standard input: background, captures [N], stop ID,
    /// start ID, loss ID RATIO, delay ID MS, freeze ID, thaw ID, quit.
    #[arg(long, value_name = "RECORDING", conflicts_with_all = ["out", "preset", "shape"])]
    pub serve: Option<PathBuf>,
    /// The first camera's address; the others get the next ones.
    #[arg(
        long,
        value_name = "ADDRESS",
        requires = "serve",
        default_value = "127.0.1.1"
    )]
    first_address: Ipv4Addr,
    /// Show the empty rig until the command `captures` arrives.
    #[arg(long, requires = "serve")]
    empty: bool,
    /// Write the first depth camera's frames for the test sensor of OpenNI2 into this file.
    #[arg(long, value_name = "FILE", requires = "serve")]
    sensor_frames: Option<PathBuf>,
    /// Number of depth frames of a capture.
    #[arg(
        long,
        value_name = "N",
        requires = "sensor_frames",
        default_value_t = 30
    )]
    sensor_burst: usize,
}

#[cfg(not(feature = "aravis"))]
pub(super) fn run(_: &Path, _: ServeArgs) -> anyhow::Result<ExitCode> {
    anyhow::bail!("this program was built without the feature aravis, which plays cameras");
}

#[cfg(feature = "aravis")]
pub(super) fn run(recording: &Path, args: ServeArgs) -> anyhow::Result<ExitCode> {
    serving::run(recording, &args)
}

#[cfg(feature = "aravis")]
mod serving {
    use super::ServeArgs;
    use crate::frame::CameraId;
    use crate::recording::{DepthPart, Recording, Topic};
    use anyhow::Context;
    use scand_lab::serve::{ColorOptions, ColorRig, Shown, write_sensor_frames};
    use std::io::BufRead;
    use std::path::Path;
    use std::process::ExitCode;
    use std::sync::Arc;
    use std::time::Duration;

    pub(super) fn run(path: &Path, args: &ServeArgs) -> anyhow::Result<ExitCode> {
        let recording = Arc::new(Recording::open(path)?);
        if let Some(file) = &args.sensor_frames {
            let depth = recording.topics().find_map(|topic| match topic {
                Topic::Depth(id, DepthPart::Image) => Some(id.clone()),
                _ => None,
            });
            let depth = depth.with_context(|| format!("{} has no depth camera", path.display()))?;
            write_sensor_frames(&recording, &depth, args.sensor_burst, file)?;
        }
        let options = ColorOptions {
            first_address: args.first_address,
            ..ColorOptions::default()
        };
        let rig = ColorRig::start(recording, options)?;
        if args.empty {
            rig.show(Shown::Background);
        }
        for (id, address, serial) in rig.cameras() {
            outln!("{id} {address} {serial}");
        }
        outln!("serving");
        for line in std::io::stdin().lock().lines() {
            let line = line?;
            if line.trim() == "quit" {
                return Ok(ExitCode::SUCCESS);
            }
            match obey(&rig, &line) {
                Ok(()) => outln!("ok"),
                Err(error) => outln!("error: {error:#}"),
            }
        }
        // Nobody says anything any more: a signal ends it.
        loop {
            std::thread::park();
        }
    }

    fn obey(rig: &ColorRig, line: &str) -> anyhow::Result<()> {
        let words: Vec<&str> = line.split_whitespace().collect();
        let id = |name: &str| -> anyhow::Result<CameraId> {
            let id = CameraId::new(name)?;
            let is_known = rig.cameras().any(|(c, ..)| *c == id);
            anyhow::ensure!(is_known, "the recording has no camera {id}");
            Ok(id)
        };
        match words[..] {
            ["background"] => rig.show(Shown::Background),
            ["captures"] => rig.show(Shown::CapturesFrom(0)),
            ["captures", from] => rig.show(Shown::CapturesFrom(from.parse()?)),
            ["stop", name] => rig.stop_camera(&id(name)?)?,
            ["start", name] => rig.start_camera(&id(name)?)?,
            ["loss", name, ratio] => rig.set_loss(&id(name)?, ratio.parse()?)?,
            ["delay", name, ms] => {
                rig.set_delay(&id(name)?, Duration::from_millis(ms.parse()?))?;
            }
            ["freeze", name] => rig.freeze_clock(&id(name)?, true),
            ["thaw", name] => rig.freeze_clock(&id(name)?, false),
            _ => anyhow::bail!(
                "{line:?} is unknown, expected background, captures [N], stop ID, start ID, loss \
                ID RATIO, delay ID MS, \
                 freeze ID, thaw ID, quit"
            ),
        }
        Ok(())
    }
}

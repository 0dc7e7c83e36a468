//! `scand demo`: reconstructs a recording that comes with the program, so that a person sees what scand makes.

use super::{Cli, run as run_command};
use crate::storage::write_atomically;
use anyhow::Context;
use clap::Parser;
use std::path::PathBuf;
use std::process::ExitCode;

/// Reconstruct a simulated cup that comes with the program, to see what comes out
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  scand demo -o /tmp/demo")]
pub struct Args {
    /// Write the recording and its model into this folder
    #[arg(short, long, value_name = "DIR", default_value = "demo")]
    out: PathBuf,
}

/// A cup, eleven cameras and a depth camera: 1.1 MB, which is less than a simulator adds to the program.
const CUP: &[u8] = include_bytes!("../../recordings/cup.mcap");

/// Writes the recording, reconstructs it and says where to look.
///
/// # Errors
/// If the folder cannot be written.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let recording = args.out.join("cup.mcap");
    if std::fs::read(&recording).ok().as_deref() != Some(CUP) {
        anyhow::ensure!(
            recording.symlink_metadata().is_err(),
            "{} already exists and is another recording: give another folder with --out",
            recording.display()
        );
        write_atomically(&recording, CUP)?;
    }
    let models = args.out.join("models");
    let line = [
        "scand".as_ref(),
        "replay".as_ref(),
        recording.as_os_str(),
        "--out".as_ref(),
        models.as_os_str(),
    ];
    let replay = Cli::try_parse_from(line).context("the arguments of the replay")?;
    let code = run_command(replay)?;
    let model = models.join("cup/cup-000");
    outln!(
        "Look at {} first, and open {} in Blender or any viewer of glTF files.",
        model.join("preview.png").display(),
        model.join("model.glb").display()
    );
    Ok(code)
}

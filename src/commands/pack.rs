//! `scand pack`: makes complete recordings smaller, without loss.

use crate::recording::{Packed, pack};
use std::path::PathBuf;
use std::process::ExitCode;

/// Make complete recordings smaller, in place (zstd): the same messages, compared before the original goes.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Recordings.
    #[arg(required = true, value_name = "FILE.mcap")]
    paths: Vec<PathBuf>,
}

/// Packs all that is named, and goes on after a failure.
///
/// # Errors
/// None: what cannot be packed is told here, and stays as it is.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let mut code = ExitCode::SUCCESS;
    for path in &args.paths {
        let path_words = path.display();
        match pack(path, || true) {
            Ok(Packed::Smaller(before, after)) => {
                let share = 100.0 * after as f64 / before.max(1) as f64;
                outln!("{path_words}: {before} bytes are {after} now ({share:.0} %)");
            }
            Ok(Packed::Already) => outln!("{path_words}: is packed already"),
            Ok(Packed::NotWorthwhile | Packed::GivenUp) => {
                outln!("{path_words}: would hardly be smaller, and stays as it is");
            }
            Err(error) => {
                code = ExitCode::FAILURE;
                eprintln!("scand: {error}; {path_words} stays as it is");
            }
        }
    }
    Ok(code)
}

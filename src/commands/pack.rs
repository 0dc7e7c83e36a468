//! `scand pack`: makes complete recordings smaller, without loss.

use crate::recording::{Packed, Recording, pack};
use std::path::PathBuf;
use std::process::ExitCode;

/// Compress complete recordings in place (zstd). The messages stay the same; they are compared before the original is
/// replaced.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  scand pack recordings/*.mcap")]
pub struct Args {
    /// The recordings to pack.
    #[arg(required = true, value_name = "FILE.mcap")]
    paths: Vec<PathBuf>,
}

/// Packs all recordings that are named, and continues after a failure.
///
/// # Errors
/// None: a recording that cannot be packed is reported here, and stays as it is.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let mut code = ExitCode::SUCCESS;
    for path in &args.paths {
        let path_words = path.display();
        match pack(path, || true) {
            Ok(Packed::Smaller(before, after)) => {
                let share = 100.0 * after as f64 / before.max(1) as f64;
                outln!("{path_words}: packed from {before} to {after} bytes ({share:.0} %)");
            }
            Ok(Packed::Already) => match Recording::open(path).and_then(|packed| packed.verify()) {
                Ok(damage) if damage.is_empty() => outln!("{path_words}: is already packed"),
                Ok(damage) => {
                    code = ExitCode::FAILURE;
                    eprintln!(
                        "scand: {path_words}: it is damaged and stays as it is: copy it again from its source"
                    );
                    damage
                        .iter()
                        .take(5)
                        .for_each(|damage| eprintln!("  {damage}"));
                }
                Err(error) => {
                    code = ExitCode::FAILURE;
                    eprintln!("scand: {error}; {path_words} stays as it is");
                }
            },
            Ok(Packed::NotWorthwhile | Packed::GivenUp) => {
                outln!("{path_words}: would hardly become smaller and was left unchanged");
            }
            Err(error) => {
                code = ExitCode::FAILURE;
                eprintln!("scand: {error}; {path_words} was left unchanged");
            }
        }
    }
    Ok(code)
}

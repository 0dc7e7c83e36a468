//! `scand pack`: makes complete recordings smaller, without loss.

use super::first_aid::first_aid;
use crate::recording::{Packed, Recording, pack};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Compress complete recordings in place (zstd). The messages stay the same; they are compared before the original is
/// replaced.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  scand pack recordings/*.mcap")]
pub struct Args {
    /// The recordings to pack.
    #[arg(required = true, value_name = "FILE.mcap")]
    paths: Vec<PathBuf>,
    /// Print a line of JSON for each recording
    #[arg(long)]
    json: bool,
    /// Print only errors
    #[arg(short, long)]
    quiet: bool,
}

/// What became of a recording.
enum PackResult {
    /// It has so many bytes, from so many before.
    Packed {
        before: u64,
        after: u64,
    },
    AlreadyPacked,
    NotWorthwhile,
    /// It stays as it is, and why.
    Failed(String),
}

/// Packs all recordings that are named, and continues after a failure.
///
/// # Errors
/// None: a recording that cannot be packed is reported here, and stays as it is.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let mut code = ExitCode::SUCCESS;
    for path in &args.paths {
        let result = packed(path);
        if let PackResult::Failed(why) = &result {
            code = ExitCode::FAILURE;
            eprintln!("scand: {why}; {} was left unchanged", path.display());
        }
        if args.json {
            outln!("{}", result.json(path));
        } else if let Some(words) = result.words().filter(|_| !args.quiet) {
            outln!("{}: {words}", path.display());
        }
    }
    Ok(code)
}

/// Packs a recording. One that is packed already is read as a whole, so that no damaged one is called packed.
fn packed(path: &Path) -> PackResult {
    let result = match pack(path, || true) {
        Ok(Packed::Smaller(before, after)) => return PackResult::Packed { before, after },
        Ok(Packed::NotWorthwhile | Packed::GivenUp) => return PackResult::NotWorthwhile,
        Ok(Packed::Already) => Ok(()),
        Err(error) => Err(error),
    };
    // What is missing, and what to do, comes before what was found where.
    let damage = Recording::open(path).and_then(|recording| first_aid(&recording));
    match (damage, result) {
        (Ok(Some(words)), Ok(())) => PackResult::Failed(words),
        (Ok(Some(words)), Err(error)) => PackResult::Failed(format!("{words}; {error}")),
        (_, Err(error)) | (Err(error), _) => PackResult::Failed(error.to_string()),
        (Ok(None), Ok(())) => PackResult::AlreadyPacked,
    }
}

impl PackResult {
    /// The line for a person; none for a failure, which is an error.
    fn words(&self) -> Option<String> {
        match self {
            Self::Packed { before, after } => {
                let share = 100.0 * *after as f64 / (*before).max(1) as f64;
                Some(format!(
                    "packed from {before} to {after} bytes ({share:.0} %)"
                ))
            }
            Self::AlreadyPacked => Some("is already packed".into()),
            Self::NotWorthwhile => {
                Some("would hardly become smaller and was left unchanged".into())
            }
            Self::Failed(_) => None,
        }
    }

    fn json(&self, path: &Path) -> serde_json::Value {
        let file = path.display().to_string();
        match self {
            Self::Packed { before, after } => {
                json!({ "file": file, "result": "packed", "bytes_before": before, "bytes_after": after })
            }
            Self::AlreadyPacked => json!({ "file": file, "result": "already_packed" }),
            Self::NotWorthwhile => json!({ "file": file, "result": "not_worthwhile" }),
            Self::Failed(why) => json!({ "file": file, "result": "failed", "reason": why }),
        }
    }
}

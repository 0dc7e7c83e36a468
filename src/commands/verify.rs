//! `scand verify`: checks a package for an archive, made by scand or by another program.

use crate::bag::{Checked, verify};
use crate::words::{count, printable};
use std::path::PathBuf;
use std::process::ExitCode;

/// Check a package for an archive (BagIt): every file against its digest
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  scand verify /archive/1884.3")]
pub struct Args {
    /// The folders of packages
    #[arg(required = true, value_name = "DIR")]
    folders: Vec<PathBuf>,
    /// Print a line of JSON for each package
    #[arg(long)]
    json: bool,
}

/// Checks each package. The exit code is 1 if one is not intact.
///
/// # Errors
/// None: a package that cannot be read is reported here, and the next one is checked.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let mut code = ExitCode::SUCCESS;
    for folder in &args.folders {
        let name = printable(&folder.display().to_string());
        let (checked, error) = match verify(folder) {
            Ok(checked) => (checked, None),
            Err(_) if folder.is_file() => {
                let words = "it is a file, but a package is a folder: unpack it first";
                (Checked::default(), Some(words.to_owned()))
            }
            Err(error) => (Checked::default(), Some(error.to_string())),
        };
        let Checked {
            findings,
            unchecked,
        } = checked;
        let is_whole = findings.is_empty() && error.is_none();
        if !is_whole {
            code = ExitCode::FAILURE;
        }
        if args.json {
            let line = serde_json::json!({
                "package": folder, "whole": is_whole, "findings": findings, "unchecked": unchecked,
                "error": error,
            });
            outln!("{line}");
            continue;
        }
        match error {
            Some(error) => eprintln!("scand: {name}: {}", printable(&error)),
            None if is_whole => outln!("{name}: intact: no file was changed"),
            None => {
                eprintln!("scand: {name}: {}", count(findings.len(), "problem"));
                findings.iter().for_each(|finding| eprintln!("  {finding}"));
            }
        }
        unchecked
            .iter()
            .for_each(|words| eprintln!("  note: {words}"));
    }
    Ok(code)
}

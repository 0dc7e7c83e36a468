//! `scand verify`: checks a package for an archive, made by scand or by another program.

use super::EXIT_INCOMPLETE;
use crate::bag::{Checked, verify};
use crate::words::{count, printable};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
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

/// Checks each package. The exit code is 1 if one is not intact, and otherwise 3 if one has files that no list vouches
/// for, or may have lost some.
///
/// # Errors
/// None: a package that cannot be read is reported here, and the next one is checked.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let (mut is_whole, mut is_all_listed) = (true, true);
    for folder in &args.folders {
        let package = Package::check(folder);
        is_whole &= package.is_whole();
        is_all_listed &= package.checked.is_all_listed();
        match args.json {
            true => outln!("{}", package.json()),
            false => package.tell(),
        }
    }
    Ok(match (is_whole, is_all_listed) {
        (false, _) => ExitCode::FAILURE,
        (true, false) => ExitCode::from(EXIT_INCOMPLETE),
        (true, true) => ExitCode::SUCCESS,
    })
}

/// What was found out about a package.
struct Package<'a> {
    folder: &'a Path,
    checked: Checked,
    /// Why it could not be read.
    error: Option<String>,
}

impl<'a> Package<'a> {
    fn check(folder: &'a Path) -> Self {
        let (checked, error) = match verify(folder) {
            Ok(checked) => (checked, None),
            Err(_) if folder.is_file() => {
                let words = "it is a file, but a package is a folder: unpack it first";
                (Checked::default(), Some(words.to_owned()))
            }
            Err(error) => (Checked::default(), Some(error.to_string())),
        };
        Self {
            folder,
            checked,
            error,
        }
    }

    /// Whether each file that a list names is as listed, and `data/` has no other.
    fn is_whole(&self) -> bool {
        self.checked.findings.is_empty() && self.error.is_none()
    }

    fn json(&self) -> Value {
        let Checked {
            findings,
            unchecked,
            compared,
            unlisted,
            has_tag_manifest,
        } = &self.checked;
        json!({
            "package": self.folder, "whole": self.is_whole(), "findings": findings, "unchecked": unchecked,
            "error": self.error, "compared": compared, "unlisted": unlisted, "tag_manifest": has_tag_manifest,
        })
    }

    fn tell(&self) {
        let name = printable(&self.folder.display().to_string());
        let findings = &self.checked.findings;
        let compared = count(self.checked.compared, "file");
        match &self.error {
            Some(error) => eprintln!("scand: {name}: {}", printable(error)),
            None if !self.is_whole() => {
                eprintln!("scand: {name}: {}", count(findings.len(), "problem"));
                findings.iter().for_each(|finding| eprintln!("  {finding}"));
            }
            None if self.checked.is_all_listed() => {
                outln!("{name}: intact: each file that the lists name is as listed ({compared})")
            }
            None => outln!(
                "{name}: each file that the lists name is as listed ({compared}), but the lists do not vouch for the whole \
                 package"
            ),
        }
        let unchecked = self.checked.unchecked.iter();
        unchecked.for_each(|words| eprintln!("  note: {words}"));
    }
}

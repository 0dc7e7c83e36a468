//! `scand archive`: puts recordings, notes, calibrations, models, reports and all that is needed to understand them
//! into one package for an archive (BagIt, RFC 8493).

mod models;
mod page;
mod paradata;
mod select;

use super::{EXIT_INCOMPLETE, first_aid};
use crate::bag::Bag;
use crate::calibrate::of_recording;
use crate::frame::Timestamp;
use crate::recording::beside;
use crate::words::count;
use anyhow::Context;
use models::ModelInput;
use select::{ChosenCapture, SelectedCaptures};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::SystemTime;

/// Make a package for an archive (BagIt): recordings, notes, calibration, models, reports, and how to read them
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  scand archive 1884.3 --recordings /var/lib/scand/recordings --models /var/lib/scand/models -o /archive/1884.3
  scand archive recordings/cup.mcap -o cup-package
  scand verify cup-package")]
pub struct Args {
    /// Captures, objects by their numbers, sessions by their names, or files of recordings
    #[arg(required = true, value_name = "CAPTURE|OBJECT|SESSION|FILE")]
    what: Vec<String>,
    /// Make the package under this name, which nothing may have yet
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Look for captures, objects and sessions in the recordings of this folder
    #[arg(long, value_name = "DIR", default_value = ".")]
    recordings: PathBuf,
    /// Take the models from this folder
    #[arg(long, value_name = "DIR", default_value = "out")]
    models: PathBuf,
    /// Put this licence, or agreement about rights, into the package; may be given several times
    #[arg(long, value_name = "FILE")]
    licence: Vec<PathBuf>,
    /// Say that the package was made on this day (YYYY-MM-DD; default today, in UTC)
    #[arg(long, value_name = "DATE", value_parser = date)]
    date: Option<String>,
}

/// Says how to read the package without this program.
const READ_ME: &str = include_str!("read_me.txt");

/// A page without the lines that show a picture: those are not in the package.
fn without_pictures(page: &str) -> String {
    let lines = page.split_inclusive('\n');
    lines.filter(|line| !line.starts_with("![")).collect()
}

/// What goes into each package, so that it explains itself.
const DOCUMENTS: [(&str, &str); 7] = [
    ("README.txt", READ_ME),
    (
        "documentation/formats.md",
        include_str!("../../../docs/formats.md"),
    ),
    (
        "documentation/results.md",
        include_str!("../../../docs/results.md"),
    ),
    (
        "documentation/glossary.md",
        include_str!("../../../docs/glossary.md"),
    ),
    (
        "documentation/report.schema.json",
        include_str!("../../../docs/report.schema.json"),
    ),
    (
        "licences/documentation-MIT.txt",
        include_str!("../../../LICENSE-MIT"),
    ),
    (
        "licences/documentation-Apache-2.0.txt",
        include_str!("../../../LICENSE-APACHE"),
    ),
];

/// Makes the package. The exit code is 3 if a recording in it is damaged, or one that was to be searched cannot be
/// read.
///
/// # Errors
/// If nothing has one of the names, a recording is not complete, or a file cannot be read or written.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let select::Selection { chosen, unread } = select::choose(&args.what, &args.recordings)?;
    let mut packing = Packing {
        bag: Bag::create(&args.out)?,
        models: &args.models,
        kept: models::kept(&chosen),
        names: BTreeSet::new(),
        damaged: !unread.is_empty(),
        warnings: unread,
        identifiers: BTreeSet::new(),
    };
    for (path, text) in DOCUMENTS {
        packing.bag.put(path, without_pictures(text).as_bytes())?;
    }
    for (number, licence) in (1..).zip(&args.licence) {
        let name = safe(&licence.file_name().unwrap_or_default().to_string_lossy());
        packing
            .bag
            .put_file(&format!("licences/{number}-{name}"), licence)?;
    }
    for chosen in &chosen {
        packing
            .add(chosen)
            .with_context(|| chosen.path.display().to_string())?;
    }
    let captures = chosen.iter().map(|c| c.captures.len()).sum();
    let identifiers: Vec<String> = packing.identifiers.into_iter().collect();
    packing.bag.finish(&[
        ("Bagging-Date", args.date.unwrap_or_else(today)),
        (
            "Bag-Software-Agent",
            concat!("scand ", env!("CARGO_PKG_VERSION")).into(),
        ),
        ("External-Identifier", identifiers.join("; ")),
        (
            "External-Description",
            "Recordings of a 3-D scanning rig, and models made of them".into(),
        ),
    ])?;
    for warning in &packing.warnings {
        eprintln!("scand: {warning}");
    }
    outln!(
        "{}: {} of {}; check the package with scand verify",
        args.out.display(),
        count(captures, "capture"),
        count(chosen.len(), "recording")
    );
    Ok(match packing.damaged {
        true => ExitCode::from(EXIT_INCOMPLETE),
        false => ExitCode::SUCCESS,
    })
}

/// A package in the making.
struct Packing<'a> {
    bag: Bag,
    models: &'a Path,
    /// The captures whose models it has: the file names of their recordings, and their ids.
    kept: BTreeSet<(String, String)>,
    /// Names that recordings have in the package.
    names: BTreeSet<String>,
    warnings: Vec<String>,
    damaged: bool,
    identifiers: BTreeSet<String>,
}

impl Packing<'_> {
    /// Adds a recording, and what belongs to its captures.
    fn add(&mut self, chosen: &SelectedCaptures) -> anyhow::Result<()> {
        let stem = chosen
            .path
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let name = self.free_name(&safe(&stem));
        self.bag
            .put_file(&format!("recordings/{name}.mcap"), &chosen.path)?;
        let notes = beside(&chosen.path);
        if notes.is_file() {
            self.bag
                .put_file(&format!("recordings/{name}.notes.jsonl"), &notes)?;
        }
        let recording = chosen.session.recording();
        let damage = recording.verify()?;
        let bytes = recording.file_length();
        let first_aid = first_aid::words(&chosen.path, bytes, recording.is_cut_off()?, &damage);
        self.warnings.extend(first_aid);
        for damage in &damage {
            self.damaged = true;
            self.warnings
                .push(format!("{}: {damage}", chosen.path.display()));
        }
        self.warnings
            .extend(chosen.session.notes().problems().iter().cloned());
        match of_recording(recording) {
            Ok(calibration) => {
                let path = format!("calibration/{name}.toml");
                self.bag.put(&path, calibration.to_toml().as_bytes())?;
            }
            Err(error) => self
                .warnings
                .push(format!("there is no calibration to add: {error}")),
        }
        for capture in &chosen.captures {
            self.add_capture(chosen, &stem, &name, capture)?;
        }
        self.add_objects(&stem, &name)
    }

    fn add_capture(
        &mut self,
        chosen: &SelectedCaptures,
        stem: &str,
        name: &str,
        capture: &ChosenCapture,
    ) -> anyhow::Result<()> {
        let id = capture.summary.id.as_str();
        self.identifiers.insert(
            capture
                .summary
                .subject
                .clone()
                .unwrap_or_else(|| id.to_owned()),
        );
        let folder = self.models.join(stem).join(id);
        let made = self.report(chosen, capture, &folder);
        if made.is_some() {
            self.add_model(&folder, name, id)?;
        }
        let sheet = paradata::of(&chosen.session, &capture.summary, made.as_ref(), name);
        let text = serde_json::to_string_pretty(&sheet)? + "\n";
        self.bag
            .put(&format!("paradata/{name}/{id}.json"), text.as_bytes())?;
        let page = page::of(id, &sheet);
        self.bag
            .put(&format!("paradata/{name}/{id}.html"), page.as_bytes())?;
        Ok(())
    }

    /// The report of a capture's model and the model's input, if the model goes into the package; a warning says why
    /// not.
    fn report(
        &mut self,
        chosen: &SelectedCaptures,
        capture: &ChosenCapture,
        folder: &Path,
    ) -> Option<(Value, ModelInput)> {
        let id = &capture.summary.id;
        if models::is_left_out(capture) {
            self.warnings.push(format!(
                "{id}: its model is left out, because the capture was rejected"
            ));
            return None;
        }
        let Some(report) = models::report(folder) else {
            self.warnings.push(format!(
                "{id}: no model is in {}: the package has the recording",
                folder.display()
            ));
            return None;
        };
        let input = ModelInput::of(&chosen.session, &capture.summary, &report);
        self.warnings.extend(input.warning(id.as_str(), folder));
        (input != ModelInput::OtherRecording).then_some((report, input))
    }

    /// Adds the models of several captures, if the package has all of their captures.
    fn add_objects(&mut self, stem: &str, name: &str) -> anyhow::Result<()> {
        for object in models::of_objects(&self.models.join(stem), &self.kept) {
            if object.missing.is_empty() {
                let folder = object.folder.file_name().unwrap_or_default();
                self.add_model(&object.folder, name, &safe(&folder.to_string_lossy()))?;
            } else {
                self.warnings.push(format!(
                    "{}: the model of several captures is left out, because the package does not have {}",
                    object.folder.display(),
                    object.missing.join(", ")
                ));
            }
        }
        Ok(())
    }

    fn add_model(&mut self, folder: &Path, name: &str, model: &str) -> anyhow::Result<()> {
        for file in models::FILES {
            let path = folder.join(file);
            if path.is_file() {
                self.bag
                    .put_file(&format!("models/{name}/{model}/{file}"), &path)?;
            }
        }
        Ok(())
    }

    /// A name that no other recording has in the package.
    fn free_name(&mut self, name: &str) -> String {
        let numbered = (2..).map(|number| format!("{name}-{number}"));
        let mut names = std::iter::once(name.to_owned()).chain(numbered);
        let free = names.find(|name| self.names.insert(name.to_lowercase()));
        free.unwrap_or_default()
    }
}

/// A file's name that every system takes.
fn safe(name: &str) -> String {
    let letter = |c: char| {
        let is_plain = c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-');
        if is_plain { c } else { '_' }
    };
    let name: String = name.chars().take(100).map(letter).collect();
    match name.trim_start_matches('.') {
        "" => "unnamed".into(),
        name => name.into(),
    }
}

/// A day in the form that a package uses.
fn date(text: &str) -> Result<String, String> {
    let bytes = text.as_bytes();
    let is_date = bytes.len() == 10
        && bytes.iter().enumerate().all(|(i, byte)| match i {
            4 | 7 => *byte == b'-',
            _ => byte.is_ascii_digit(),
        });
    is_date
        .then(|| text.to_owned())
        .ok_or_else(|| "expected YYYY-MM-DD".into())
}

fn today() -> String {
    let now = Timestamp::from(SystemTime::now());
    now.iso_8601().chars().take(10).collect()
}

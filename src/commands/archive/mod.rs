//! `scand archive`: puts recordings, notes, calibrations, models, reports and all that is needed to understand them
//! into one package for an archive (BagIt, RFC 8493).

mod model_files;
mod models;
mod page;
mod paradata;
mod recording_file;
mod select;

use super::{EXIT_INCOMPLETE, first_aid};
use crate::bag::Bag;
use crate::calibrate::of_recording;
use crate::frame::Timestamp;
use crate::make_model::{marked_preview, marked_report};
use crate::notes::CaptureNotes;
use crate::recording::{beside, notes_to_copy};
use crate::storage;
use crate::words::{count, printable};
use anyhow::Context;
use models::{FoundModel, ModelInput, ObjectModel};
use recording_file::RecordingFile;
use select::{ChosenCapture, SelectedCaptures};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
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
    /// Make the package in this folder, which must not exist yet
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

/// Bytes of the longest licence: a text, or a scan of a signed one.
const LONGEST_LICENCE: u64 = 64 << 20;

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

/// Makes the package. The exit code is 3 if a recording in it is damaged, one that was to be searched cannot be read,
/// or a file that belongs into it is left out because something is wrong with it.
///
/// # Errors
/// If nothing has one of the names, a recording is not complete, or a file cannot be read or written.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    // Before the recordings are read: a folder that cannot be written ends it at once.
    let bag = Bag::create(&args.out).context("nothing was packed")?;
    let select::Selection { chosen, unread } = select::choose(&args.what, &args.recordings)?;
    let mut packing = Packing {
        bag,
        models: &args.models,
        kept: models::kept(&chosen),
        ambiguous: models::ambiguous(&chosen),
        names: BTreeSet::new(),
        damaged: !unread.is_empty(),
        warnings: unread,
        identifiers: BTreeSet::new(),
        decisions: decisions(&chosen),
    };
    for (path, text) in DOCUMENTS {
        packing.bag.put(path, without_pictures(text).as_bytes())?;
    }
    for (number, licence) in (1..).zip(&args.licence) {
        let name = safe(&licence.file_name().unwrap_or_default().to_string_lossy());
        let text = storage::read(licence, LONGEST_LICENCE)
            .with_context(|| format!("--licence {}", licence.display()))?;
        packing
            .bag
            .put(&format!("licences/{number}-{name}"), &text)?;
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
        eprintln!("scand: {}", printable(warning));
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
    /// File names that several of its recordings have.
    ambiguous: BTreeSet<String>,
    /// Names that recordings have in the package.
    names: BTreeSet<String>,
    warnings: Vec<String>,
    damaged: bool,
    identifiers: BTreeSet<String>,
    /// What people said of all captures in the package, by the file names of their recordings and their ids.
    decisions: BTreeMap<(String, String), CaptureNotes>,
}

fn decisions(chosen: &[SelectedCaptures]) -> BTreeMap<(String, String), CaptureNotes> {
    let of = |chosen: &SelectedCaptures| {
        let file = models::file_name(&chosen.path);
        let captures = chosen.captures.iter().map(|c| &c.summary);
        captures
            .map(|c| ((file.clone(), c.id.to_string()), c.notes.clone()))
            .collect::<Vec<_>>()
    };
    chosen.iter().flat_map(of).collect()
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
        let name = free_name(&mut self.names, &safe(&stem), "");
        let recording = chosen.session.recording();
        let file = RecordingFile::of(recording, name)?;
        self.add_recording(chosen, &file)?;
        self.warnings
            .extend(chosen.session.notes().problems().iter().cloned());
        match of_recording(recording) {
            Ok(calibration) => {
                let path = format!("calibration/{}.toml", file.name);
                self.bag.put(&path, calibration.to_toml().as_bytes())?;
            }
            Err(error) => self.warnings.push(format!(
                "{}: there is no calibration to add: {error}",
                chosen.path.display()
            )),
        }
        let mut folders = BTreeSet::new();
        for capture in &chosen.captures {
            let model = free_name(&mut folders, capture.summary.id.as_str(), "");
            self.add_capture(chosen, &stem, &file, capture, &model)?;
        }
        self.add_objects(&stem, &file.name, folders)
    }

    /// Adds a recording with the files beside it, and says what is wrong with it.
    fn add_recording(
        &mut self,
        chosen: &SelectedCaptures,
        file: &RecordingFile,
    ) -> anyhow::Result<()> {
        self.bag.put_file(&file.place(), &chosen.path)?;
        match notes_to_copy(&chosen.path) {
            Ok(Some(notes)) => {
                let place = format!("recordings/{}.notes.jsonl", file.name);
                self.bag.put_file(&place, &notes)?;
            }
            Ok(None) => {}
            Err(error) => self.leave_out(&beside(&chosen.path), &error.to_string()),
        }
        for rescued in &file.rescued {
            match &rescued.problem {
                Some(problem) => self.leave_out(&rescued.path, problem),
                None => {
                    self.bag.put_file(&file.place_of(rescued), &rescued.path)?;
                    self.warnings.push(format!(
                        "{}: {} bytes that could not be used when the recording was completed; the package has them",
                        rescued.path.display(),
                        rescued.bytes
                    ));
                }
            }
        }
        let bytes = chosen.session.recording().file_length();
        let first_aid = first_aid::words(&chosen.path, bytes, file.is_cut_off, &file.damage);
        self.warnings.extend(first_aid);
        for damage in &file.damage {
            self.damaged = true;
            self.warnings
                .push(format!("{}: {damage}", chosen.path.display()));
        }
        Ok(())
    }

    /// Adds a capture's sheet and its model, whose folder is called `model` in the package.
    fn add_capture(
        &mut self,
        chosen: &SelectedCaptures,
        stem: &str,
        file: &RecordingFile,
        capture: &ChosenCapture,
        model: &str,
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
            self.add_model(&folder, &file.name, model, &capture.summary.notes)?;
        }
        let place = format!("{}/{model}", file.name);
        let made = made.as_ref();
        let sheet = paradata::of(&chosen.session, &capture.summary, made, file, &place);
        self.add_sheet(&file.name, model, &sheet)
    }

    fn add_sheet(&mut self, name: &str, what: &str, sheet: &Value) -> anyhow::Result<()> {
        let text = serde_json::to_string_pretty(sheet)? + "\n";
        let path = format!("paradata/{name}/{what}");
        self.bag.put(&format!("{path}.json"), text.as_bytes())?;
        let page = page::of(what, sheet);
        Ok(self.bag.put(&format!("{path}.html"), page.as_bytes())?)
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
        let missing = match models::look(folder) {
            FoundModel::Model(report) => {
                let input = ModelInput::of(&chosen.session, &capture.summary, &report);
                self.warnings.extend(input.warning(id.as_str(), folder));
                return (input != ModelInput::OtherRecording).then_some((report, input));
            }
            FoundModel::Failure(reason) => format!("its model could not be made ({reason})"),
            FoundModel::Link => {
                self.damaged = true;
                format!("the model in {} is a link", folder.display())
            }
            FoundModel::Broken(problem) => {
                self.damaged = true;
                self.warnings.push(format!(
                    "{id}: {problem}; the model is left out, the package has the recording"
                ));
                return None;
            }
            FoundModel::Nothing => format!("no model is in {}", folder.display()),
        };
        self.warnings
            .push(format!("{id}: {missing}: the package has the recording"));
        None
    }

    /// Adds the models of several captures, if the package has all of their captures. `folders` has the names that the
    /// recording's models have in the package.
    fn add_objects(
        &mut self,
        stem: &str,
        name: &str,
        mut folders: BTreeSet<String>,
    ) -> anyhow::Result<()> {
        let objects = models::of_objects(&self.models.join(stem), &self.kept, &self.ambiguous);
        for problem in objects.unknown {
            self.leave_out_object(&problem);
        }
        for object in objects.found {
            if !object.missing.is_empty() {
                self.warnings.push(format!(
                    "{}: the model of several captures is left out, because the package does not have {}",
                    object.folder.display(),
                    object.missing.join(", ")
                ));
            } else if let Some(problem) = models::problem(&object.folder, &object.report) {
                self.leave_out_object(&problem);
            } else {
                // Letters that not every system takes become the same one.
                let folder = safe(&models::file_name(&object.folder));
                let subject = folder.strip_suffix(models::OBJECT);
                let model = match subject {
                    Some(subject) => free_name(&mut folders, subject, models::OBJECT),
                    None => free_name(&mut folders, &folder, ""),
                };
                self.add_object(&object, name, &model)?;
            }
        }
        Ok(())
    }

    /// Says that a model of several captures is not whole.
    fn leave_out_object(&mut self, problem: &str) {
        self.damaged = true;
        self.warnings.push(format!(
            "{problem}; the model of several captures is left out"
        ));
    }

    fn add_object(&mut self, object: &ObjectModel, name: &str, model: &str) -> anyhow::Result<()> {
        let of = |key: &(String, String)| self.decisions.get(key).cloned().unwrap_or_default();
        let captures: Vec<_> = object.captures.iter().map(|key| (key, of(key))).collect();
        // The report of a model of several says nothing of any one.
        let notes = match &captures[..] {
            [(_, only)] => only.clone(),
            _ => CaptureNotes::default(),
        };
        let sheet = paradata::of_object(&object.report, &captures, &format!("{name}/{model}"));
        self.add_model(&object.folder, name, model, &notes)?;
        self.add_sheet(name, model, &sheet)
    }

    /// Adds a model's files. Report and preview are marked with these notes: people may have said more since they were
    /// written.
    fn add_model(
        &mut self,
        folder: &Path,
        name: &str,
        model: &str,
        notes: &CaptureNotes,
    ) -> anyhow::Result<()> {
        let report = marked_report(folder, notes).with_context(|| folder.display().to_string())?;
        for file in models::FILES {
            let place = format!("models/{name}/{model}/{file}");
            let path = folder.join(file);
            let is_itself = models::is_file_itself(&path);
            match (file, &report) {
                (model_files::REPORT, Some(text)) => self.bag.put(&place, text.as_bytes())?,
                (models::PREVIEW, Some(_)) if is_itself => {
                    self.add_preview(&place, &path, notes)?;
                }
                _ if is_itself => self.bag.put_file(&place, &path)?,
                _ if path.is_symlink() => self.leave_out(&path, model_files::IS_LINK),
                _ => {}
            }
        }
        Ok(())
    }

    /// Adds a preview that is marked with these notes. The rest of a model is worth packing without it.
    fn add_preview(
        &mut self,
        place: &str,
        path: &Path,
        notes: &CaptureNotes,
    ) -> anyhow::Result<()> {
        let marked = std::fs::read(path)
            .map_err(anyhow::Error::from)
            .and_then(|bytes| Ok(marked_preview(&bytes, notes)?));
        match marked {
            Ok(picture) => self.bag.put(place, &picture)?,
            Err(error) => {
                let why = format!("it cannot be marked with the notes on its capture: {error}");
                self.leave_out(path, &why);
            }
        }
        Ok(())
    }

    /// Says of a file why the package does not have it.
    fn leave_out(&mut self, path: &Path, why: &str) {
        self.damaged = true;
        let path = path.display();
        self.warnings
            .push(format!("{path}: {why}; the package does not have it"));
    }
}

/// A name with this ending that is not among `names`, which it joins. Some disks ignore case.
fn free_name(names: &mut BTreeSet<String>, stem: &str, ending: &str) -> String {
    let numbered = (2..).map(|number| format!("{stem}-{number}{ending}"));
    let mut candidates = std::iter::once(format!("{stem}{ending}")).chain(numbered);
    let free = candidates.find(|name| names.insert(name.to_lowercase()));
    free.unwrap_or_default()
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
    if !is_date {
        return Err("expected YYYY-MM-DD".into());
    }
    let number = |range: std::ops::Range<usize>| text[range].parse::<u32>().unwrap_or_default();
    let (year, month, day) = (number(0..4), number(5..7), number(8..10));
    let is_leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
    let days = match month {
        2 => 28 + u32::from(is_leap),
        4 | 6 | 9 | 11 => 30,
        1 | 3 | 5 | 7 | 8 | 10 | 12 => 31,
        _ => 0,
    };
    match (1..=days).contains(&day) {
        true => Ok(text.to_owned()),
        false => Err("the calendar has no such day".into()),
    }
}

fn today() -> String {
    let now = Timestamp::from(SystemTime::now());
    now.iso_8601().chars().take(10).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_day_is_one_of_the_calendar() {
        for day in ["2026-01-31", "2024-02-29", "2000-02-29"] {
            assert_eq!(date(day).as_deref(), Ok(day));
        }
        for day in [
            "2026-99-99",
            "2026-02-29",
            "1900-02-29",
            "2026-04-31",
            "2026-00-10",
            "2026-01-00",
            "2026-1-1",
        ] {
            assert!(date(day).is_err(), "{day}");
        }
    }
}

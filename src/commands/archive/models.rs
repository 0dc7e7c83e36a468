//! Finds the models that belong to the captures of a package, and checks from what they were made. Nothing is written
//! here.

use super::model_files::{self, GLB, PLY, REPORT};
use super::select::{ChosenCapture, SelectedCaptures};
use crate::capture::{CaptureSession, CaptureSummary, calibration_digest, input_digest};
use crate::recording::finished_name;
use crate::storage;
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The files of a model's folder.
pub(super) const FILES: [&str; 4] = [GLB, PLY, PREVIEW, REPORT];
pub(super) const PREVIEW: &str = "preview.png";
/// Bytes of the longest report that is read.
const LONGEST_REPORT: u64 = 16 << 20;
/// The ending of the folder of a model of several captures.
pub(super) const OBJECT: &str = ".object";

/// How the input of a model relates to the capture that is recorded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum ModelInput {
    /// It is the same.
    AsRecorded,
    /// The pictures, with another calibration.
    OtherCalibration,
    /// Other pictures, although capture and calibration are the same.
    OtherPictures,
    /// A capture of the same name, of another recording.
    OtherRecording,
    /// Unknown, and why.
    Unchecked(String),
}

impl ModelInput {
    /// Compares what a report states with the recording. Decodes the capture's pictures.
    pub(super) fn of(session: &CaptureSession, capture: &CaptureSummary, report: &Value) -> Self {
        let time = report["capture"]["time_ns"].as_str();
        if time.is_some_and(|time| time != capture.time.0.to_string()) {
            return Self::OtherRecording;
        }
        let stated = |name: &str| report["description"][name].as_str();
        let (Some(input), Some(calibration)) =
            (stated("input_sha256"), stated("calibration_sha256"))
        else {
            return Self::Unchecked("the report does not state the model's input".into());
        };
        match session.load(&capture.id) {
            Ok((scene, _)) if input_digest(&scene) == input => Self::AsRecorded,
            Ok((scene, _)) if calibration_digest(&scene) != calibration => Self::OtherCalibration,
            Ok(_) => Self::OtherPictures,
            Err(error) => Self::Unchecked(error.to_string()),
        }
    }

    /// The same for the sheet of paradata.
    pub(super) fn words(&self) -> String {
        match self {
            Self::AsRecorded => "the recorded capture: its digest was compared, which shows accidents and not intent".into(),
            Self::OtherCalibration => {
                "the recorded pictures with another calibration, which is not in the package".into()
            }
            Self::OtherPictures => "other pictures than those that are recorded".into(),
            Self::OtherRecording => "a capture of another recording".into(),
            Self::Unchecked(why) => format!("not compared with the recording: {why}"),
        }
    }

    /// What a person should know of it.
    pub(super) fn warning(&self, id: &str, folder: &Path) -> Option<String> {
        let folder = folder.display();
        match self {
            Self::AsRecorded => None,
            Self::OtherRecording => Some(format!(
                "{id}: the model in {folder} is of another recording, in which a capture of this name was triggered at another \
                 time; it is left out"
            )),
            Self::Unchecked(why) => Some(format!(
                "{id}: the model in {folder} was not compared with the recording: {why}"
            )),
            _ => Some(format!(
                "{id}: the model in {folder} was made from {}",
                self.words()
            )),
        }
    }
}

/// What lies where a capture's model belongs.
pub(super) enum FoundModel {
    /// A model with this report, whose files can be read and do not contradict it.
    Model(Value),
    /// The report of a failure: why no model could be made.
    Failure(String),
    /// A link, of which nobody knows where it leads.
    Link,
    /// Something that is no whole model: the file, and what is wrong with it.
    Broken(String),
    /// Nothing.
    Nothing,
}

/// Whether a path is that of a file, and not of a link to one.
pub(super) fn is_file_itself(path: &Path) -> bool {
    path.symlink_metadata().is_ok_and(|about| about.is_file())
}

/// Looks into the folder of a capture's model, and reads the model's files.
pub(super) fn look(folder: &Path) -> FoundModel {
    let report = match report(folder) {
        Ok(report) => report,
        Err(_) if has_nothing(folder) => return FoundModel::Nothing,
        Err(problem) => return FoundModel::Broken(problem),
    };
    if folder.join(GLB).is_symlink() {
        return FoundModel::Link;
    }
    if let Some(reason) = reason_of_failure(&report) {
        return FoundModel::Failure(reason);
    }
    match problem(folder, &report) {
        Some(problem) => FoundModel::Broken(problem),
        None => FoundModel::Model(report),
    }
}

/// Whether a folder has neither a report nor a model.
fn has_nothing(folder: &Path) -> bool {
    let is_there = |file: &&str| folder.join(file).symlink_metadata().is_ok();
    ![GLB, PLY, REPORT].iter().any(is_there)
}

fn reason_of_failure(report: &Value) -> Option<String> {
    let reason = report["reason"].as_str()?;
    (!report["verdict"].is_object()).then(|| reason.to_owned())
}

/// What is wrong with the model of a report, or with its files; `None` if nothing is.
pub(super) fn problem(folder: &Path, report: &Value) -> Option<String> {
    if !report["verdict"].is_object() {
        let path = folder.join(REPORT);
        let what = "it has neither the verdict on a model nor the reason of a failure";
        return Some(format!("{}: {what}", path.display()));
    }
    model_files::problem(folder, report)
}

/// A report.
///
/// # Errors
/// If there is none that can be read; the message names the file.
fn report(folder: &Path) -> Result<Value, String> {
    let path = folder.join(REPORT);
    let bad = |problem: String| format!("{}: {problem}", path.display());
    if let Some(problem) = model_files::no_file(&path) {
        return Err(bad(problem));
    }
    let text = storage::read_text(&path, LONGEST_REPORT).map_err(|error| bad(error.to_string()))?;
    serde_json::from_str(&text).map_err(|error| bad(format!("expected a report in JSON: {error}")))
}

/// Whether a capture's model goes into the package, as far as notes decide it.
pub(super) fn is_left_out(capture: &ChosenCapture) -> bool {
    capture.summary.notes.is_rejected() && !capture.is_named
}

/// The captures whose models go into the package: the file names of their recordings, and their ids.
pub(super) fn kept(chosen: &[SelectedCaptures]) -> BTreeSet<(String, String)> {
    let of_recording = |chosen: &SelectedCaptures| {
        let file = file_name(&chosen.path);
        let kept = chosen.captures.iter().filter(|c| !is_left_out(c));
        kept.map(|c| (file.clone(), c.summary.id.to_string()))
            .collect::<Vec<_>>()
    };
    chosen.iter().flat_map(of_recording).collect()
}

/// The file names that several recordings of the package have: a model of several captures names its recordings by
/// nothing else.
pub(super) fn ambiguous(chosen: &[SelectedCaptures]) -> BTreeSet<String> {
    let mut seen = BTreeSet::new();
    let names = chosen.iter().map(|chosen| file_name(&chosen.path));
    names.filter(|name| !seen.insert(name.clone())).collect()
}

pub(super) fn file_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

/// A model of several captures.
pub(super) struct ObjectModel {
    pub(super) folder: PathBuf,
    pub(super) report: Value,
    /// Its captures: the file names of their recordings, and their ids.
    pub(super) captures: Vec<(String, String)>,
    /// Its captures that are not in the package.
    pub(super) missing: Vec<String>,
}

/// The models of several captures in a recording's folder.
#[derive(Default)]
pub(super) struct ObjectModels {
    /// Those that have at least one of the captures of the package.
    pub(super) found: Vec<ObjectModel>,
    /// Those of which nobody knows which captures they have: what is wrong with their reports.
    pub(super) unknown: Vec<String>,
}

/// The models of several captures in a recording's folder. Their files are not read yet. Of those whose captures are in
/// a recording of one of the `ambiguous` names nobody knows which these are.
pub(super) fn of_objects(
    folder: &Path,
    kept: &BTreeSet<(String, String)>,
    ambiguous: &BTreeSet<String>,
) -> ObjectModels {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut folders: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    folders.retain(|path| path.is_dir());
    folders.sort();
    let mut objects = ObjectModels::default();
    for folder in folders {
        match report(&folder) {
            Ok(report) => {
                let Some(found) = of_object(folder, report, kept) else {
                    continue;
                };
                let mut files = found.captures.iter().map(|(file, _)| file);
                match files.find(|file| ambiguous.contains(*file)) {
                    Some(file) => objects.unknown.push(format!(
                        "{}: several recordings of the package are called {file}, and the model is of one of them",
                        found.folder.display()
                    )),
                    None => objects.found.push(found),
                }
            }
            Err(problem) => {
                let is_object = file_name(&folder).ends_with(OBJECT);
                let is_unknown = is_object && !has_nothing(&folder);
                objects.unknown.extend(is_unknown.then_some(problem));
            }
        }
    }
    objects
}

fn of_object(
    folder: PathBuf,
    report: Value,
    kept: &BTreeSet<(String, String)>,
) -> Option<ObjectModel> {
    if reason_of_failure(&report).is_some() {
        return None;
    }
    let captures = report["fusion"]["captures"].as_array()?.iter();
    let fused: Vec<(String, String)> = captures
        .filter(|capture| capture["is_fused"] == true)
        .filter_map(|capture| {
            let file = PathBuf::from(capture["recording"].as_str()?);
            let file = file_name(&finished_name(&file).unwrap_or(file));
            Some((file, capture["id"].as_str()?.to_owned()))
        })
        .collect();
    let missing = fused.iter().filter(|capture| !kept.contains(capture));
    let missing: Vec<String> = missing
        .map(|(file, id)| format!("{id} of {file}"))
        .collect();
    (missing.len() < fused.len()).then_some(ObjectModel {
        folder,
        report,
        captures: fused,
        missing,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_model_whose_recording_is_one_of_two_of_a_name_is_of_neither() {
        let models = tempfile::tempdir().unwrap();
        let folder = models.path().join("17.object");
        std::fs::create_dir(&folder).unwrap();
        let capture = json!({ "recording": "cup.mcap", "id": "cup-000", "is_fused": true });
        let report = json!({ "verdict": {}, "fusion": { "captures": [capture] } });
        std::fs::write(folder.join(REPORT), report.to_string()).unwrap();
        let kept = BTreeSet::from([("cup.mcap".to_owned(), "cup-000".to_owned())]);
        let found = of_objects(models.path(), &kept, &BTreeSet::new());
        assert_eq!((found.found.len(), found.unknown.len()), (1, 0));
        let found = of_objects(models.path(), &kept, &BTreeSet::from(["cup.mcap".into()]));
        assert_eq!(found.found.len(), 0);
        let [words] = &found.unknown[..] else {
            panic!("{:?}", found.unknown);
        };
        assert!(
            words.contains("17.object") && words.contains("cup.mcap"),
            "{words}"
        );
    }
}

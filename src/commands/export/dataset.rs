//! Exports captures of recordings as datasets for other programs that reconstruct.

use super::{Args, exists};
use crate::capture::{CaptureSession, calibration_digest, input_digest};
use crate::dataset::{self, Kind, View};
use crate::export;
use crate::frame::CaptureId;
use crate::reconstruct::{Model, Scene, silhouette};
use crate::storage::StagedFolder;
use crate::sync;
use crate::words::count;
use anyhow::Context;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// The file that distinguishes a dataset of scand from other folders.
const SHEET: &str = "scand.json";

/// Writes the dataset of each capture of the recordings.
///
/// # Errors
/// At the first that cannot be read or written; those before it are complete.
pub(super) fn export(kind: Kind, args: &Args) -> anyhow::Result<()> {
    for path in &args.what {
        refuse_other(path)?;
    }
    for path in &args.what {
        let session = CaptureSession::open(path, &sync::Parameters::default())?;
        for id in wanted(&session, args).with_context(|| path.display().to_string())? {
            let capture = Capture {
                session: &session,
                path,
                id,
            };
            capture
                .export(kind, args)
                .with_context(|| format!("{}: {}", path.display(), capture.id))?;
        }
    }
    Ok(())
}

/// Says of a model what a dataset is made of.
fn refuse_other(path: &Path) -> anyhow::Result<()> {
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    let is_model = matches!(ending.as_deref(), Some("glb" | "ply"));
    anyhow::ensure!(
        !path.is_dir() && !is_model,
        "{}: a dataset is made from a recording (.mcap); --model names the model whose points it gets",
        path.display()
    );
    Ok(())
}

/// The captures that are named; if none is named, all that were not rejected and did not fail.
fn wanted(session: &CaptureSession, args: &Args) -> anyhow::Result<Vec<CaptureId>> {
    let all = session.captures();
    for name in &args.capture {
        anyhow::ensure!(
            all.iter().any(|capture| capture.id.as_str() == name),
            "there is no capture {name:?}, only {}",
            all.iter()
                .take(20)
                .map(|c| c.id.as_str())
                .collect::<Vec<_>>()
                .join(", ")
        );
    }
    let mut wanted = Vec::new();
    for capture in all {
        let is_named = args.capture.iter().any(|name| capture.id.as_str() == name);
        let reason = match &capture.failure {
            Some(failure) => Some(failure.clone()),
            None => capture
                .notes
                .is_rejected()
                .then(|| "a person rejected it; name it with --capture to export it".into()),
        };
        match reason {
            _ if is_named => wanted.push(capture.id),
            _ if !args.capture.is_empty() => {}
            Some(reason) => eprintln!("scand: {} is left out: {reason}", capture.id),
            None => wanted.push(capture.id),
        }
    }
    anyhow::ensure!(!wanted.is_empty(), "no capture can be exported");
    Ok(wanted)
}

struct Capture<'a> {
    session: &'a CaptureSession,
    path: &'a Path,
    id: CaptureId,
}

impl Capture<'_> {
    fn export(&self, kind: Kind, args: &Args) -> anyhow::Result<()> {
        let folder = args.out.join(self.id.as_str());
        refuse_to_replace(&folder, args.force)?;
        let (scene, facts) = self.session.load(&self.id)?;
        let (views, mut warnings) = dataset::views(&scene, &silhouette::Parameters::default());
        let model = args
            .model
            .as_ref()
            .map(|path| self.model(path, &scene))
            .transpose()?;
        let points = model.map_or(Vec::new(), |model| dataset::points(&model, &views));
        if let Some(verdict) = facts.calibration.as_ref().filter(|v| !v.reasons.is_empty()) {
            warnings.push(format!(
                "the recording calls its calibration {}: {}",
                verdict.level.name(),
                verdict.reasons.join("; ")
            ));
        }
        let sheet = self.sheet(kind, &scene, &views, &warnings);
        let staged = StagedFolder::create(&folder)?;
        for file in dataset::files(kind, &views, &points)? {
            staged.write(&file.path, &file.bytes)?;
        }
        staged.write(SHEET, format!("{sheet:#}\n").as_bytes())?;
        staged.commit(args.force)?;
        for warning in &warnings {
            eprintln!("scand: {}: {warning}", self.id);
        }
        let points = match points.len() {
            0 => "no points (--model MODEL adds those of a model)".into(),
            points => count(points, "point"),
        };
        let name = kind.name();
        outln!(
            "{}: {name}, {}, {points}",
            folder.display(),
            count(views.len(), "picture")
        );
        Ok(())
    }

    /// The model whose points the dataset has, which must be of this capture.
    fn model(&self, path: &Path, scene: &Scene) -> anyhow::Result<Model> {
        let read = export::read(&model_file(path, self.path, self.id.as_str()))?;
        anyhow::ensure!(
            read.about.input_sha256 == input_digest(scene),
            "{}: the model was made from other pictures or another calibration than this recording has",
            path.display()
        );
        Ok(read.model)
    }

    fn sheet(&self, kind: Kind, scene: &Scene, views: &[View], warnings: &[String]) -> Value {
        let cameras: Vec<&str> = views.iter().map(|view| view.camera.as_str()).collect();
        let capture = self.session.capture(&self.id);
        json!({
            "dataset": kind.name(),
            "program": concat!("scand ", env!("CARGO_PKG_VERSION")),
            "capture": self.id.as_str(),
            "time": capture.map(|capture| capture.time.iso_8601()),
            "input_sha256": input_digest(scene),
            "calibration_sha256": calibration_digest(scene),
            "cameras": cameras,
            "pictures": "undistorted; black where the camera's picture has nothing",
            "masks": "255 where the object is, 0 elsewhere",
            "world": "the rig's frame: metres, z up",
            "warnings": warnings,
        })
    }
}

/// The model of a capture: a file, the capture's folder, or the folder that a replay wrote to.
fn model_file(path: &Path, recording: &Path, capture: &str) -> PathBuf {
    let stem = recording.file_stem().unwrap_or_default();
    let folders = [
        path.join(stem).join(capture),
        path.join(capture),
        path.to_owned(),
    ];
    let inside = folders.iter().map(|folder| folder.join("model.glb"));
    inside
        .into_iter()
        .find(|file| file.is_file())
        .unwrap_or_else(|| path.to_owned())
}

/// A folder is replaced only if that was asked for, and if it is a dataset that scand wrote: nothing else is removed.
fn refuse_to_replace(folder: &Path, force: bool) -> anyhow::Result<()> {
    if folder.symlink_metadata().is_err() {
        return Ok(());
    }
    if !force {
        return Err(exists(folder));
    }
    anyhow::ensure!(
        folder.join(SHEET).is_file(),
        "{} is not a dataset that scand wrote, so --force does not replace it: give another --out",
        folder.display()
    );
    Ok(())
}

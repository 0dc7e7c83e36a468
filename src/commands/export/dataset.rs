//! Exports captures of recordings as datasets for other programs that reconstruct.

use super::{Args, exists};
use crate::calibration::RigCalibration;
use crate::capture::{CaptureSession, calibration_digest, input_digest, replace_cameras};
use crate::commands::replay::recording_stem;
use crate::commands::{BadConfiguration, wrong_usage};
use crate::config::Config;
use crate::dataset::{self, Kind, View};
use crate::export;
use crate::frame::CaptureId;
use crate::reconstruct::{Model, Scene, silhouette};
use crate::storage::{StagedFolder, check_writable};
use crate::words::count;
use anyhow::Context;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The file that distinguishes a dataset of scand from other folders.
const SHEET: &str = "scand.json";

/// Writes the dataset of each capture of the recordings. Where captures of several recordings have one name, the
/// datasets lie in a folder for each recording.
///
/// # Errors
/// At the first that cannot be read or written; those before it are complete. Before any work, if two recordings have
/// the same name too.
pub(super) fn export(kind: Kind, args: &Args) -> anyhow::Result<()> {
    for path in &args.what {
        refuse_other(path)?;
    }
    let bad = |error: Box<dyn std::error::Error + Send + Sync>| BadConfiguration(error);
    let config = Config::load(args.config.as_deref(), &args.set).map_err(|e| bad(e.into()))?;
    let calibration = args.calibration.as_deref().map(RigCalibration::load);
    let calibration = calibration.transpose().map_err(|e| bad(e.into()))?;
    let mut sessions = Vec::new();
    let mut seen = BTreeSet::new();
    for path in &args.what {
        if seen.insert(path.canonicalize().unwrap_or_else(|_| path.clone())) {
            let session = CaptureSession::open(path, &config.sync)?;
            let wanted = wanted(&session, args).with_context(|| path.display().to_string())?;
            sessions.push((path, session, wanted));
        }
    }
    let mut all = sessions.iter().flat_map(|(_, _, wanted)| wanted);
    let mut ids = BTreeSet::new();
    let is_apart = !all.all(|id| ids.insert(id.to_string()));
    let mut stems = BTreeSet::new();
    for (path, _, _) in sessions.iter().filter(|_| is_apart) {
        if !stems.insert(recording_stem(path)?) {
            return Err(wrong_usage(format!(
                "{}: another recording of this run has the same name and captures of the same names: export it with \
                 another --out",
                path.display()
            )));
        }
    }
    check_writable(&args.out)?;
    let settings = Settings {
        silhouette: &config.silhouette,
        calibration: calibration.as_ref(),
    };
    for (path, session, wanted) in &sessions {
        let out = match is_apart {
            true => args.out.join(recording_stem(path)?),
            false => args.out.clone(),
        };
        for id in wanted {
            let capture = Capture {
                session,
                path,
                id: id.clone(),
                out: &out,
                settings: &settings,
            };
            capture
                .export(kind, args)
                .with_context(|| format!("{}: {id}", path.display()))?;
        }
    }
    Ok(())
}

/// What datasets depend on besides recordings.
struct Settings<'a> {
    silhouette: &'a silhouette::Parameters,
    calibration: Option<&'a RigCalibration>,
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
    out: &'a Path,
    settings: &'a Settings<'a>,
}

impl Capture<'_> {
    fn export(&self, kind: Kind, args: &Args) -> anyhow::Result<()> {
        let folder = self.out.join(self.id.as_str());
        refuse_to_replace(&folder, args.force)?;
        let (mut scene, mut facts) = self.session.load(&self.id)?;
        if let Some(calibration) = self.settings.calibration {
            replace_cameras(&mut scene, calibration)?;
            facts.calibration = calibration.verdict.clone();
        }
        let (views, mut warnings) = dataset::views(&scene, self.settings.silhouette);
        let model = args
            .model
            .as_ref()
            .map(|path| self.model(path, &scene))
            .transpose()?;
        let points = model.map_or(Vec::new(), |model| dataset::points(&model, &views));
        if let Some(verdict) = facts.calibration.as_ref().filter(|v| !v.reasons.is_empty()) {
            warnings.push(format!(
                "the calibration is called {}: {}",
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
        let read = export::read(&model_file(path, self.path, self.id.as_str())?)?;
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
fn model_file(path: &Path, recording: &Path, capture: &str) -> anyhow::Result<PathBuf> {
    if !path.is_dir() {
        return Ok(path.to_owned());
    }
    let stem = recording_stem(recording)?;
    let folders = [
        path.join(&stem).join(capture),
        path.join(capture),
        path.to_owned(),
    ];
    let inside = folders.iter().map(|folder| folder.join("model.glb"));
    let file = inside.into_iter().find(|file| file.is_file());
    file.with_context(|| {
        format!(
            "{}: the folder has no model of capture {capture}: expected {stem}/{capture}/model.glb in it",
            path.display()
        )
    })
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

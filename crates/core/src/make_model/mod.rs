//! The procedure of making a capture's model, from an open recording to the files in the capture's folder, or to
//! the report of why there are none. A replay and the process `scand make-model` both use it. Nothing here knows
//! arguments, a console or exit codes.

mod about;
mod error;
mod failure;
mod mark;
mod object;
mod report_file;
mod stages;

pub use error::Error;
pub use failure::{FailedJob, report_failure};
pub use mark::{mark, mark_also, marked_preview, marked_report};
pub use object::{
    FusedCapture, Fusion, Gathered, ObjectOutcome, ObjectRequest, Pose, Registering, Source,
    Wanted, WorstStretch, gather, object_folder_name, read_poses, subject_of,
};
pub use report_file::{Model, ReportFile};

use crate::calibration::RigCalibration;
use crate::capture::{self, CaptureFacts, CaptureSession};
use crate::description::Description;
use crate::frame::CaptureId;
use crate::notes::CaptureNotes;
use crate::output;
use crate::reconstruct::{self, Reconstruction, Scene};
use crate::report::{self, Measurements, Origin, Reason, Verdict};
use crate::storage::StagedFolder;
use stages::StageTimer;
use std::path::{Path, PathBuf};

/// What models depend on besides their captures.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The method and its parameters.
    pub reconstruction: reconstruct::Parameters,
    /// How they are judged.
    pub verdict: report::Parameters,
    /// How they are written.
    pub glb: output::glb::Parameters,
    /// All of these as text, for the digest.
    pub text: String,
}

/// How models are made, and where they go.
pub struct ModelMaker<'a> {
    /// What they depend on.
    pub settings: &'a Settings,
    /// Cameras to use instead of the recorded ones.
    pub calibration: Option<&'a RigCalibration>,
    /// Whether other models may be replaced.
    pub force: bool,
    /// Where the captures' folders go.
    pub folder: PathBuf,
    /// Called when a stage of a capture begins.
    pub on_stage: &'a (dyn Fn(&CaptureId, &str) + Sync),
}

/// What became of a capture.
#[derive(Clone, Debug, PartialEq)]
pub enum ModelOutcome {
    /// A model was made.
    Made {
        /// The model.
        model: Model,
        /// Whether the recording is damaged where the capture lies.
        damaged: bool,
        /// Seconds of each stage, in the order they ran.
        seconds: Vec<(String, f64)>,
    },
    /// The model of these inputs and settings was there already.
    Unchanged {
        /// The model.
        model: Model,
        /// Whether the recording is damaged where the capture lies.
        damaged: bool,
    },
    /// There is no model; its report has the same reason.
    Failed {
        /// Why.
        reason: String,
    },
}

impl ModelMaker<'_> {
    /// Makes the model of one capture and writes its folder, or the report of its failure.
    pub fn make(&self, session: &CaptureSession, id: &CaptureId) -> ModelOutcome {
        self.try_make(session, id)
            .unwrap_or_else(|error| self.fail_with_report(session, id, &error))
    }

    /// Writes the report of a capture that failed into its folder. Returns that outcome; if the report cannot be
    /// written either, its reason says so.
    pub fn fail_with_report(
        &self,
        session: &CaptureSession,
        id: &CaptureId,
        error: &dyn std::fmt::Display,
    ) -> ModelOutcome {
        let mut reason = error.to_string();
        let summary = session.capture(id);
        let (time_ns, source) = summary.map(|c| (c.time, c.source)).unwrap_or_default();
        let job = FailedJob {
            recording: session.recording().path(),
            method: self.settings.reconstruction.method,
            capture: report::FailedCapture {
                id,
                time_ns,
                source: &source,
            },
        };
        let target = self.folder.join(id.as_str());
        if let Err(also) = report_failure(&target, job, &reason, None, self.force) {
            let also = also.to_string();
            // What kept the model from being written mostly keeps the report as well.
            if !reason.ends_with(&also) {
                reason = format!("{reason}; {also}");
            }
        }
        ModelOutcome::Failed { reason }
    }

    fn try_make(&self, session: &CaptureSession, id: &CaptureId) -> Result<ModelOutcome, Error> {
        let timer = StageTimer::new(self.on_stage, id);
        let (mut scene, mut facts) = session.load(id)?;
        if let Some(calibration) = self.calibration {
            capture::replace_cameras(&mut scene, calibration)?;
            facts.calibration = calibration.verdict.clone();
        }
        let about = about::describe(session.recording(), &scene, &facts);
        let known = about::digest_text(&about);
        let calibration_verdict = facts.calibration.as_ref();
        let (input, settings) = (&about.input_sha256, &self.settings.text);
        let digest = capture::digest(input, calibration_verdict, settings, &known);
        let notes = session.notes().on(id.as_str());
        let folder = self.folder.join(id.as_str());
        let damaged = !facts.damage.is_empty();
        if let Some(model) = self.unchanged(&folder, &digest)? {
            mark(&folder, &notes)?;
            return Ok(ModelOutcome::Unchanged { model, damaged });
        }
        let target = Target {
            folder: &folder,
            may_replace: self.force || folder.exists(),
        };
        let reconstruction =
            reconstruct::reconstruct(&scene, &self.settings.reconstruction, &timer)?;
        timer.begin("report");
        let made = Made {
            scene,
            facts,
            about,
            notes,
            reconstruction,
            captures: Vec::new(),
        };
        let path = session.recording().path();
        let origin = failure::origin(path, self.settings.reconstruction.method, &digest);
        let verdict = match self.write(target, made, &origin, &timer) {
            // Another process has made it meanwhile.
            Err(error) if error.is_taken() => {
                let model = self.unchanged(&folder, &digest)?.ok_or(error)?;
                return Ok(ModelOutcome::Unchanged { model, damaged });
            }
            made => made?,
        };
        Ok(ModelOutcome::Made {
            model: Model {
                verdict: verdict.level,
                reasons: verdict.reasons.into_iter().map(|r| r.words).collect(),
                folder,
            },
            damaged,
            seconds: timer.seconds(),
        })
    }

    /// The model of this digest, if the folder holds it.
    ///
    /// # Errors
    /// If it holds another one that may not be replaced.
    fn unchanged(&self, folder: &Path, digest: &str) -> Result<Option<Model>, Error> {
        if self.force || !folder.exists() {
            return Ok(None);
        }
        match ReportFile::read(folder) {
            Ok(report) if report.digest == digest && report.model.is_some() => Ok(report.model),
            Ok(report) if report.outcome == report::ReportOutcome::Failed => Ok(None),
            _ => Err(Error::OtherModel(folder.into())),
        }
    }

    /// Judges what was made and writes its files, all or none.
    fn write(
        &self,
        target: Target,
        made: Made,
        origin: &Origin,
        timer: &StageTimer,
    ) -> Result<Verdict, Error> {
        let staged = StagedFolder::create(target.folder)?;
        let (measured, verdict) = self.write_model(&staged, &made, Vec::new())?;
        timer.begin("files");
        let Made {
            scene,
            facts,
            about,
            notes,
            reconstruction,
            ..
        } = made;
        let finish = || -> Result<(), Error> {
            let report = report::Report::new(
                (origin, &about),
                (&facts, &notes),
                &measured,
                &verdict,
                timer.timing(),
            );
            staged.write(report_file::NAME, report::to_json(&report)?.as_bytes())?;
            staged
                .commit(target.may_replace)
                .map_err(|cause| Error::NotPlaced {
                    folder: target.folder.into(),
                    cause,
                })
        };
        // Giving back the pictures' memory takes as long as the disk does.
        rayon::join(finish, || drop((scene, reconstruction))).0?;
        Ok(verdict)
    }

    /// Measures and judges a model, and writes it and its picture, each on a core of its own. `more` are reasons
    /// besides those that its figures give.
    fn write_model(
        &self,
        staged: &StagedFolder,
        made: &Made,
        more: Vec<Reason>,
    ) -> Result<(Measurements, Verdict), Error> {
        let (model, about) = (&made.reconstruction.model, &made.about);
        let judged = || -> Result<(Measurements, Verdict), Error> {
            let measured = report::measure(
                &made.scene,
                &made.reconstruction,
                self.settings.reconstruction.method,
            );
            let verdict = report::judge(&measured, &made.facts, &self.settings.verdict);
            let verdict = verdict.with(more);
            let (scene, reconstruction) = (&made.scene, &made.reconstruction);
            let mut sheet = match &made.captures[..] {
                [] => report::preview(scene, reconstruction, &verdict, about),
                captures => {
                    report::preview_object(scene, reconstruction, &verdict, about, captures)
                }
            };
            report::stamp(&mut sheet, &made.notes);
            staged.write(mark::PREVIEW, &output::encode_png(&sheet)?)?;
            Ok((measured, verdict))
        };
        let glb = || -> Result<(), Error> {
            let bytes = output::glb::encode(model, about, &self.settings.glb)?;
            Ok(staged.write("model.glb", &bytes)?)
        };
        let ply = || -> Result<(), Error> {
            Ok(staged.write("model.ply", &output::ply::encode(model, about)?)?)
        };
        let (judged, (glb, ply)) = rayon::join(judged, || rayon::join(glb, ply));
        let judged = judged?;
        glb.and(ply)?;
        Ok(judged)
    }
}

/// Where a model goes.
struct Target<'a> {
    folder: &'a Path,
    /// Whether what was there before the model was made may be replaced: a model by force, or the report of a failure.
    may_replace: bool,
}

/// A capture and what was made of it.
struct Made {
    scene: Scene,
    facts: CaptureFacts,
    about: Description,
    notes: CaptureNotes,
    reconstruction: Reconstruction,
    /// The captures that it was fused of; none where it is one.
    captures: Vec<report::CaptureViews>,
}

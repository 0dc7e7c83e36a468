//! The procedure of making one model of several captures of an object: reads them, lets `register` find how they lie
//! against each other, joins those with a pose into one scene, and makes its model as that of a single capture.
//! `gather` finds the captures, `merge` joins them, and `part` writes the part of the report about them.

mod gather;
mod given;
mod merge;
mod name;
mod part;

pub use gather::{Gathered, Source, Wanted, gather};
pub use given::read_poses;
pub use name::object_folder_name;
pub use part::{FusedCapture, Fusion, Pose, WorstStretch};

use super::report_file::{self, ReportFile};
use super::stages::StageTimer;
use super::{Error, Made, Model, ModelMaker, about, failure};
use crate::capture;
use crate::frame::CaptureId;
use crate::notes::CaptureNotes;
use crate::reconstruct::{self, FusedCaptures, MOST_CAPTURES};
use crate::register::{self, CaptureSilhouettes, PoseEvidence, Registered, Registration};
use crate::report;
use crate::storage::StagedFolder;
use merge::{Loaded, Place, merge};
use nalgebra::Isometry3;
use part::Known;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// What a model of several captures is made of.
#[derive(Clone, Debug, Default)]
pub struct ObjectRequest<'a> {
    /// The object's number or other name.
    pub subject: &'a str,
    /// The capture whose rig becomes the model's frame; the earliest where it is `None`.
    pub upright: Option<&'a str>,
    /// For each capture its pose, mapping a point of the object into its rig.
    pub given: Option<&'a [Isometry3<f64>]>,
    /// Captures that do not count, in words.
    pub not_used: Vec<String>,
    /// Whether a model of other captures of this object may be replaced.
    pub replaces: bool,
}

/// What became of an object.
#[derive(Clone, Debug)]
pub enum ObjectOutcome {
    /// A model of all captures was made, or of two and more with others left out.
    Made {
        /// The model.
        model: Model,
        /// How the captures were fused.
        fusion: Fusion,
        /// Seconds of each stage, in the order they ran.
        seconds: Vec<(String, f64)>,
    },
    /// The model of these inputs and settings was there already.
    Unchanged {
        /// The model.
        model: Model,
        /// Captures that it leaves out.
        left_out: Vec<String>,
    },
    /// There is no model; its folder has a report that says the same.
    Failed {
        /// Why.
        reason: String,
        /// How far the fusion came; `None` if a capture could not be read.
        fusion: Option<Fusion>,
    },
}

/// What a registration says before a model is made of it.
#[derive(Clone, Debug)]
pub struct Registering {
    /// How captures lie against each other.
    pub found: Registration,
    /// The same as the report has it.
    pub fusion: Fusion,
}

impl ModelMaker<'_> {
    /// The folder of an object.
    pub fn object_folder(&self, subject: &str) -> PathBuf {
        self.folder.join(object_folder_name(subject))
    }

    /// Makes one model of the captures, which are in the order of their triggers, and writes its folder, or the report
    /// of why there is none.
    pub fn make_object(&self, sources: &[Source], request: &ObjectRequest) -> ObjectOutcome {
        let mut fusion = None;
        match self.try_make_object(sources, request, &mut fusion) {
            Ok(outcome) => outcome,
            Err(error) => {
                let mut reason = error.to_string();
                if !matches!(error, Error::OtherModel(_))
                    && let Err(also) =
                        self.report_no_object(sources, request, &reason, fusion.as_ref())
                {
                    reason = format!("{reason}; {also}");
                }
                ObjectOutcome::Failed { reason, fusion }
            }
        }
    }

    /// Finds how the captures lie against each other, and makes nothing of it.
    ///
    /// # Errors
    /// If a capture cannot be read, or has no silhouettes.
    pub fn register_object(
        &self,
        sources: &[Source],
        request: &ObjectRequest,
    ) -> Result<Registering, Error> {
        let loaded = self.load_all(sources)?;
        Ok(registering(sources, request, &loaded))
    }

    fn load_all(&self, sources: &[Source]) -> Result<Vec<Loaded>, Error> {
        let load = |source: &Source| -> Result<Loaded, Error> {
            let (mut scene, mut facts) = source.session.load(source.id)?;
            if let Some(calibration) = self.calibration {
                capture::replace_cameras(&mut scene, calibration)?;
                facts.calibration = calibration.verdict.clone();
            }
            Ok(Loaded {
                silhouettes: Vec::new(),
                scene,
                facts,
            })
        };
        let mut loaded: Vec<Loaded> = sources.iter().map(load).collect::<Result<_, _>>()?;
        for capture in &mut loaded {
            let parameters = &self.settings.reconstruction;
            capture.silhouettes = reconstruct::silhouettes(&capture.scene, parameters)?;
        }
        Ok(loaded)
    }

    fn try_make_object(
        &self,
        sources: &[Source],
        request: &ObjectRequest,
        into: &mut Option<Fusion>,
    ) -> Result<ObjectOutcome, Error> {
        let first = sources.first().ok_or(Error::NoCaptures)?;
        if sources.len() > MOST_CAPTURES {
            return Err(Error::TooManyCaptures(sources.len()));
        }
        let folder = self.object_folder(request.subject);
        let name = folder.file_name().unwrap_or_default().to_string_lossy();
        if first
            .session
            .captures()
            .iter()
            .any(|c| c.id.as_str() == name)
        {
            return Err(Error::NameTaken(folder));
        }
        let timer = StageTimer::new(self.on_stage, first.id);
        let loaded = self.load_all(sources)?;
        let digest = self.object_digest(&loaded, request);
        match self.unchanged(&folder, &digest) {
            Ok(Some(model)) => {
                let left_out = ReportFile::left_out(&folder);
                return Ok(ObjectOutcome::Unchanged { model, left_out });
            }
            Err(Error::OtherModel(_)) if request.replaces => {}
            otherwise => drop(otherwise?),
        }
        timer.begin("registration");
        let Registering { found, fusion } = registering(sources, request, &loaded);
        *into = Some(fusion.clone());
        if sources.len() > 1 && found.placed().len() < 2 {
            let left_out: Vec<String> = fusion.left_out().collect();
            return Err(Error::NotOneObject(left_out.join("; ")));
        }
        let frame = &sources[found.frame_of];
        let path = frame.session.recording().path();
        let about = about::describe(
            frame.session.recording(),
            &loaded[found.frame_of].scene,
            &loaded[found.frame_of].facts,
        );
        let placed = found.placed().into_iter();
        let placed: Vec<_> = placed
            .map(|i| (&loaded[i].scene, &loaded[i].facts))
            .collect();
        let about = about::of_several(about, &placed);
        let notes = match sources {
            [only] => only.session.notes().on(only.id.as_str()),
            _ => CaptureNotes::default(),
        };
        let captures = captures_of(&loaded, &found);
        let (scene, facts, silhouettes, standing) = joined(loaded, &found);
        let parameters = &self.settings.reconstruction;
        let reconstruction =
            reconstruct::reconstruct_from(&scene, silhouettes, &standing, parameters, &timer)?;
        timer.begin("report");
        let made = Made {
            scene,
            facts,
            about,
            notes,
            reconstruction,
            captures,
        };
        let staged = StagedFolder::create(&folder)?;
        let (measured, verdict) = self.write_model(&staged, &made, fusion.reasons())?;
        timer.begin("files");
        let origin = failure::origin(path, parameters.method, &digest);
        let report = report::Report::new(
            (&origin, &made.about),
            (&made.facts, &made.notes),
            &measured,
            &verdict,
            timer.timing(),
        );
        write_report(&staged, &report, Some(&fusion))?;
        staged.commit(true).map_err(|cause| Error::NotPlaced {
            folder: folder.clone(),
            cause,
        })?;
        Ok(ObjectOutcome::Made {
            model: Model {
                verdict: verdict.level,
                reasons: verdict.reasons.into_iter().map(|r| r.words).collect(),
                folder,
            },
            fusion,
            seconds: timer.seconds(),
        })
    }

    /// Of the captures in their order, the settings, and what was asked for.
    fn object_digest(&self, loaded: &[Loaded], request: &ObjectRequest) -> String {
        let inputs = loaded.iter().map(|l| {
            let calibration = format!("{:?}", l.facts.calibration);
            let id = &l.facts.id;
            format!("{id} {} {calibration}", capture::input_digest(&l.scene))
        });
        let inputs: Vec<String> = inputs.collect();
        let ObjectRequest {
            subject,
            upright,
            given,
            not_used,
            ..
        } = request;
        let asked = format!("{subject:?} {upright:?} {given:?} {not_used:?}");
        capture::digest(&inputs.join("\n"), None, &self.settings.text, &asked)
    }

    fn report_no_object(
        &self,
        sources: &[Source],
        request: &ObjectRequest,
        reason: &str,
        fusion: Option<&Fusion>,
    ) -> Result<(), Error> {
        let Some(first) = sources.first() else {
            return Ok(());
        };
        let folder = self.object_folder(request.subject);
        let is_model = ReportFile::read(&folder).is_ok_and(|r| r.model.is_some());
        if is_model && !self.force && !request.replaces {
            return Ok(());
        }
        let recording = first.session.recording().path();
        let origin = failure::origin(recording, self.settings.reconstruction.method, "");
        let summary = first.session.capture(first.id);
        let (time_ns, source) = summary.map(|c| (c.time, c.source)).unwrap_or_default();
        let capture = report::FailedCapture {
            id: first.id,
            time_ns,
            source: &source,
        };
        let report = report::Failure::new(&origin, capture, reason, report::Timing::default());
        let staged = StagedFolder::create(&folder)?;
        write_report(&staged, &report, fusion)?;
        staged
            .commit(true)
            .map_err(|cause| Error::NotPlaced { folder, cause })
    }
}

/// A report with what it says of the fusion.
#[derive(Serialize)]
struct WithFusion<'a, R: Serialize> {
    #[serde(flatten)]
    report: &'a R,
    fusion: Option<&'a Fusion>,
}

fn write_report(
    staged: &StagedFolder,
    report: &impl Serialize,
    fusion: Option<&Fusion>,
) -> Result<(), Error> {
    let json = report::to_json(&WithFusion { report, fusion })?;
    Ok(staged.write(report_file::NAME, json.as_bytes())?)
}

fn registering(sources: &[Source], request: &ObjectRequest, loaded: &[Loaded]) -> Registering {
    let upright = |id: &str| sources.iter().position(|s| s.id.as_str() == id);
    let frame_of = request.upright.and_then(upright).unwrap_or(0);
    let captures: Vec<CaptureSilhouettes> = loaded
        .iter()
        .map(|l| CaptureSilhouettes {
            scene: &l.scene,
            silhouettes: &l.silhouettes,
        })
        .collect();
    let found = register::register(&captures, frame_of, request.given);
    let known: Vec<Known> = sources.iter().zip(loaded).map(known).collect();
    let fusion = Fusion::new(request.subject, &known, &found, request.not_used.clone());
    Registering { found, fusion }
}

fn known((source, loaded): (&Source, &Loaded)) -> Known {
    let path = source.session.recording().path();
    let cameras = loaded.scene.colors.iter().map(|v| v.camera.id.to_string());
    Known {
        recording: file_name(path),
        id: source.id.clone(),
        cameras: cameras.collect(),
    }
}

fn file_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

/// The captures with a pose, and which views of the scene will be theirs; none for a single one.
fn captures_of(loaded: &[Loaded], found: &Registration) -> Vec<report::CaptureViews> {
    let mut captures = Vec::new();
    let mut next = 0;
    for i in found.placed().into_iter().filter(|_| loaded.len() > 1) {
        let end = next + loaded[i].scene.colors.len();
        captures.push((loaded[i].facts.id.to_string(), next..end));
        next = end;
    }
    captures
}

/// The captures with a pose as one scene. A single capture is what it was.
fn joined(
    mut loaded: Vec<Loaded>,
    found: &Registration,
) -> (
    reconstruct::Scene,
    capture::CaptureFacts,
    Vec<reconstruct::silhouette::Silhouette>,
    FusedCaptures,
) {
    if loaded.len() == 1
        && let Some(only) = loaded.pop()
    {
        return (
            only.scene,
            only.facts,
            only.silhouettes,
            FusedCaptures::default(),
        );
    }
    let frame = found.captures[found.frame_of].rig_from_object;
    let frame = frame.unwrap_or_else(Isometry3::identity);
    let mut next_rank = 0;
    let mut rank = |c: &Registered| match c.verdict {
        Ok(PoseEvidence::Nothing) => {
            next_rank += 1;
            next_rank
        }
        _ => 0,
    };
    let mut places = Vec::new();
    for capture in found.placed() {
        let registered = &found.captures[capture];
        let pose = registered
            .rig_from_object
            .unwrap_or_else(Isometry3::identity);
        places.push(Place {
            capture,
            object_from_rig: frame * pose.inverse(),
            rank: rank(registered),
        });
    }
    let merged = merge(loaded, &places, found.frame_of);
    (
        merged.scene,
        merged.facts,
        merged.silhouettes,
        merged.standing,
    )
}

/// The name of a capture, as a subject where none was given.
pub fn subject_of(captures: &[CaptureId]) -> &str {
    captures.first().map_or("", CaptureId::as_str)
}

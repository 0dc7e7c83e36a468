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
use crate::register::{self, CaptureSilhouettes, PoseEvidence, Refusal, Registered, Registration};
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
        /// How far the fusion came; `None` if captures were not compared.
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
                let reason = self.no_object(sources, request, &error, fusion.as_ref());
                ObjectOutcome::Failed { reason, fusion }
            }
        }
    }

    /// Finds how the captures lie against each other, and makes nothing of it. A capture that cannot be read, or that
    /// has no silhouettes, has no pose.
    ///
    /// # Errors
    /// If there are too many captures.
    pub fn register_object(
        &self,
        sources: &[Source],
        request: &ObjectRequest,
    ) -> Result<Registering, Error> {
        check_count(sources)?;
        Ok(registering(sources, request, &self.load_all(sources)))
    }

    fn load_all(&self, sources: &[Source]) -> Vec<Result<Loaded, Error>> {
        sources.iter().map(|source| self.load(source)).collect()
    }

    fn load(&self, source: &Source) -> Result<Loaded, Error> {
        let (mut scene, mut facts) = source.session.load(source.id)?;
        if let Some(calibration) = self.calibration {
            capture::replace_cameras(&mut scene, calibration)?;
            facts.calibration = calibration.verdict.clone();
        }
        Ok(Loaded {
            silhouettes: reconstruct::silhouettes(&scene, &self.settings.reconstruction)?,
            scene,
            facts,
        })
    }

    fn try_make_object(
        &self,
        sources: &[Source],
        request: &ObjectRequest,
        into: &mut Option<Fusion>,
    ) -> Result<ObjectOutcome, Error> {
        let first = sources.first().ok_or(Error::NoCaptures)?;
        check_count(sources)?;
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
        let mut loaded = self.load_all(sources);
        if let [_] = sources
            && let Some(problem) = loaded.pop_if(|only| only.is_err()).and_then(Result::err)
        {
            return Err(problem);
        }
        let digest = self.object_digest((sources, &loaded), request);
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
        let of_frame = loaded[found.frame_of].as_ref();
        let of_frame = of_frame.map_err(|_| Error::NoCaptures)?;
        let recording = frame.session.recording();
        let about = about::describe(recording, &of_frame.scene, &of_frame.facts);
        let placed = found.placed().into_iter();
        let placed = placed.filter_map(|i| loaded[i].as_ref().ok());
        let placed: Vec<_> = placed.map(|l| (&l.scene, &l.facts)).collect();
        let about = about::of_several(about, &placed);
        let notes = match sources {
            [only] => only.session.notes().on(only.id.as_str()),
            _ => CaptureNotes::default(),
        };
        let captures = captures_of(&loaded, &found);
        let (scene, facts, silhouettes, standing) =
            joined(loaded, &found).ok_or(Error::NoCaptures)?;
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
    fn object_digest(
        &self,
        (sources, loaded): (&[Source], &[Result<Loaded, Error>]),
        request: &ObjectRequest,
    ) -> String {
        let inputs = sources.iter().zip(loaded).map(|(source, loaded)| {
            let id = source.id;
            match loaded {
                Ok(loaded) => {
                    let calibration = format!("{:?}", loaded.facts.calibration);
                    format!(
                        "{id} {} {calibration}",
                        capture::input_digest(&loaded.scene)
                    )
                }
                Err(problem) => format!("{id} {problem}"),
            }
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

    /// Why there is no new model, in words, after that was reported in the object's folder.
    fn no_object(
        &self,
        sources: &[Source],
        request: &ObjectRequest,
        error: &Error,
        fusion: Option<&Fusion>,
    ) -> String {
        let reason = error.to_string();
        // Those folders are another's.
        if matches!(error, Error::OtherModel(_) | Error::NameTaken(_)) {
            return reason;
        }
        let folder = self.object_folder(request.subject);
        // What has no report that can be read may be a model.
        let is_failure = ReportFile::read(&folder)
            .is_ok_and(|report| report.outcome == report::ReportOutcome::Failed);
        let is_model = folder.exists() && !is_failure;
        let may_replace = self.force || request.replaces;
        if is_model && !(may_replace && is_about_the_object(error, fusion)) {
            return format!("{reason}; the model that was made before stays");
        }
        match self.report_no_object(sources, folder, &reason, fusion) {
            Ok(()) => reason,
            Err(also) => format!("{reason}; {also}"),
        }
    }

    /// Writes the report of why there is no model.
    fn report_no_object(
        &self,
        sources: &[Source],
        folder: PathBuf,
        reason: &str,
        fusion: Option<&Fusion>,
    ) -> Result<(), Error> {
        let Some(first) = sources.first() else {
            return Ok(());
        };
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

/// Refuses more captures than can be fused.
fn check_count(sources: &[Source]) -> Result<(), Error> {
    if sources.len() > MOST_CAPTURES {
        return Err(Error::TooManyCaptures(sources.len()));
    }
    Ok(())
}

/// Whether a failure says something of the object, so that a model of it that was made before is out of date: all its
/// captures were compared. A capture that cannot be read, or a disk that is full, takes no model away.
fn is_about_the_object(error: &Error, fusion: Option<&Fusion>) -> bool {
    let is_of_disk = matches!(error, Error::Storage(_) | Error::NotPlaced { .. });
    let is_compared = |c: &FusedCapture| c.refused != Some(Refusal::Unusable);
    !is_of_disk && fusion.is_some_and(|fusion| fusion.captures.iter().all(is_compared))
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

fn registering(
    sources: &[Source],
    request: &ObjectRequest,
    loaded: &[Result<Loaded, Error>],
) -> Registering {
    let upright = |id: &str| sources.iter().position(|s| s.id.as_str() == id);
    let frame_of = request.upright.and_then(upright).unwrap_or(0);
    let captures = loaded.iter().map(|loaded| {
        let loaded = loaded.as_ref().ok()?;
        Some(CaptureSilhouettes {
            scene: &loaded.scene,
            silhouettes: &loaded.silhouettes,
        })
    });
    let captures: Vec<Option<CaptureSilhouettes>> = captures.collect();
    let found = register::register(&captures, frame_of, request.given);
    let known: Vec<Known> = sources.iter().zip(loaded).map(known).collect();
    let fusion = Fusion::new(
        request.subject,
        (&known, request.given.is_some()),
        &found,
        request.not_used.clone(),
    );
    Registering { found, fusion }
}

fn known((source, loaded): (&Source, &Result<Loaded, Error>)) -> Known {
    let path = source.session.recording().path();
    let cameras = loaded.iter().flat_map(|loaded| &loaded.scene.colors);
    Known {
        recording: file_name(path),
        id: source.id.clone(),
        cameras: cameras.map(|view| view.camera.id.to_string()).collect(),
        placement: loaded
            .as_ref()
            .ok()
            .and_then(|loaded| loaded.facts.placement.clone()),
        problem: loaded.as_ref().err().map(ToString::to_string),
    }
}

fn file_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

/// The captures with a pose, and which views of the scene will be theirs; none for a single one.
fn captures_of(
    loaded: &[Result<Loaded, Error>],
    found: &Registration,
) -> Vec<report::CaptureViews> {
    let mut captures = Vec::new();
    let mut next = 0;
    let placed = found.placed().into_iter().filter(|_| loaded.len() > 1);
    for loaded in placed.filter_map(|i| loaded[i].as_ref().ok()) {
        let end = next + loaded.scene.colors.len();
        captures.push((loaded.facts.id.to_string(), next..end));
        next = end;
    }
    captures
}

/// The captures with a pose as one scene. A single capture is what it was. `None` if the capture whose rig is the
/// frame has no pose.
fn joined(
    mut loaded: Vec<Result<Loaded, Error>>,
    found: &Registration,
) -> Option<(
    reconstruct::Scene,
    capture::CaptureFacts,
    Vec<reconstruct::silhouette::Silhouette>,
    FusedCaptures,
)> {
    if loaded.len() == 1
        && let Some(Ok(only)) = loaded.pop()
    {
        return Some((
            only.scene,
            only.facts,
            only.silhouettes,
            FusedCaptures::default(),
        ));
    }
    let frame = found.captures.get(found.frame_of)?.rig_from_object;
    let frame = frame.unwrap_or_else(Isometry3::identity);
    let mut leaders = Vec::new();
    let mut placed = Vec::new();
    for (capture, (registered, loaded)) in found.captures.iter().zip(loaded).enumerate() {
        let (true, Ok(loaded)) = (registered.is_placed(), loaded) else {
            continue;
        };
        let pose = registered
            .rig_from_object
            .unwrap_or_else(Isometry3::identity);
        let place = Place {
            capture,
            object_from_rig: frame * pose.inverse(),
            rank: rank(leader(capture, registered), &mut leaders),
        };
        placed.push((place, loaded));
    }
    let merged = merge(placed, found.frame_of)?;
    Some((
        merged.scene,
        merged.facts,
        merged.silhouettes,
        merged.standing,
    ))
}

/// The capture whose turn, which is not known, a capture follows; `None` where its turn is known.
fn leader(capture: usize, registered: &Registered) -> Option<usize> {
    let is_unknown = registered.verdict == Ok(PoseEvidence::Nothing);
    is_unknown.then(|| registered.turns_with.unwrap_or(capture))
}

/// The rank of a capture: 0 where its turn is known, else one for all captures that follow the turn of the same
/// `leader`. `leaders` are those that there were already.
fn rank(leader: Option<usize>, leaders: &mut Vec<usize>) -> u8 {
    let Some(leader) = leader else {
        return 0;
    };
    let known = leaders.iter().position(|l| *l == leader);
    let place = known.unwrap_or_else(|| {
        leaders.push(leader);
        leaders.len() - 1
    });
    u8::try_from(place + 1).unwrap_or(u8::MAX)
}

/// The name of a capture, as a subject where none was given.
pub fn subject_of(captures: &[CaptureId]) -> &str {
    captures.first().map_or("", CaptureId::as_str)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn captures_that_follow_one_turn_have_one_rank() {
        let mut leaders = Vec::new();
        let ranks = [None, Some(4), Some(2), None, Some(4)].map(|l| rank(l, &mut leaders));
        assert_eq!(ranks, [0, 1, 2, 0, 1]);
    }
}

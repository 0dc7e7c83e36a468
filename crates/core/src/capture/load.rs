//! Lists the captures of a recording, and loads one of them as the scene that is reconstructed, by way of its
//! replay and the synchronisation.

use super::ahead::{FramesAhead, ReplayedFrame};
use super::error::Error;
use super::facts::{CaptureFacts, LeftOutCamera};
use super::pictures::Backgrounds;
use super::plan::{ColorPlan, DepthPlan, ImageBatch, Plan};
use super::replay::{self, ReplayEvent};
use super::rig::RigAt;
use crate::calibration::CalibrationVerdict;
use crate::frame::{CameraId, CaptureId, Timestamp, Trigger};
use crate::notes::CaptureNotes;
use crate::reconstruct::Scene;
use crate::recording::{ColorPart, Damage, DepthPart, MessageRef, Notes, Recording, Topic};
use crate::sync::{self, Capture, Synchronizer};
use parking_lot::Mutex;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// What is known of a capture before its pictures are read.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct CaptureSummary {
    /// Its name.
    pub id: CaptureId,
    /// When it was triggered.
    pub time: Timestamp,
    /// What triggered it.
    pub source: String,
    /// The object's number: the trigger's, or else the session's.
    pub subject: Option<String>,
    /// How the object lay, in a person's words.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub placement: Option<String>,
    /// Why it failed, if it did.
    pub failure: Option<String>,
    /// Spread of the colour cameras' timestamps in nanoseconds.
    pub skew_ns: u64,
    /// Colour frames it has.
    pub color_frames: usize,
    /// Depth frames it has.
    pub depth_frames: usize,
    /// People's notes on it.
    pub notes: CaptureNotes,
}

/// A capture as it was assembled.
#[derive(Debug)]
pub(super) struct Planned {
    pub(super) capture: Capture<MessageRef>,
    failure: Option<String>,
}

impl Planned {
    /// A capture that has nothing is not complete, whatever its record says.
    fn without_frames(&self) -> Option<String> {
        let has_frames = !self.capture.colors.is_empty() || !self.capture.depths.is_empty();
        (!has_frames).then(|| "the recording has no frame of it".to_owned())
    }

    fn summary(&self, recording: &Recording, notes: &Notes) -> CaptureSummary {
        let Self { capture, failure } = self;
        CaptureSummary {
            id: capture.trigger.id.clone(),
            time: capture.trigger.time,
            source: capture.trigger.source.clone(),
            subject: subject_of(recording, &capture.trigger),
            placement: capture.trigger.placement.clone(),
            failure: failure.clone().or_else(|| self.without_frames()),
            skew_ns: capture.skew_ns(),
            color_frames: capture.colors.len(),
            depth_frames: capture.depths.values().map(Vec::len).sum(),
            notes: notes.on(capture.trigger.id.as_str()),
        }
    }
}

/// An open recording with its captures.
#[derive(Debug)]
pub struct CaptureSession {
    recording: Recording,
    /// What the recorded calibration is worth, where that is known.
    calibration: Option<CalibrationVerdict>,
    captures: Vec<Planned>,
    left_out: Vec<LeftOutCamera>,
    warnings: Vec<String>,
    notes: Notes,
    /// Decoded backgrounds of the capture before; most captures of a session share them.
    backgrounds: Mutex<Backgrounds>,
}

impl CaptureSession {
    /// Opens a recording and assembles its captures.
    ///
    /// # Errors
    /// If it cannot be read, is not a recording, or has no capture.
    pub fn open(path: &Path, parameters: &sync::Parameters) -> Result<Self, Error> {
        Self::of(Recording::open(path)?, parameters)
    }

    /// Assembles the captures of an open recording.
    ///
    /// # Errors
    /// If it cannot be read or has no capture.
    pub fn of(recording: Recording, parameters: &sync::Parameters) -> Result<Self, Error> {
        let mut session = Self::of_any(recording, parameters)?;
        if session.captures.is_empty() {
            let damage = session.recording.damage().iter().map(ToString::to_string);
            let reasons: Vec<String> = session.warnings.drain(..).chain(damage).take(5).collect();
            return Err(Error::NoTrigger {
                path: session.recording.path().into(),
                details: reasons.iter().map(|r| format!("; {r}")).collect(),
            });
        }
        Ok(session)
    }

    /// As [`Self::of`], for a recording that need not have captures.
    ///
    /// # Errors
    /// If it cannot be read, or has more cameras and triggers than any rig.
    pub fn of_any(recording: Recording, parameters: &sync::Parameters) -> Result<Self, Error> {
        let (cameras, left_out) = cameras(&recording);
        check_counts(&recording, &cameras)?;
        let played = replay::events(&recording)?;
        let mut warnings = misnamed(&recording);
        warnings.extend(played.problems);
        let captures = assemble(played.events, cameras, parameters, &mut warnings);
        let calibration = recording.calibration_record().unwrap_or_else(|error| {
            warnings.push(error.to_string());
            None
        });
        let notes = Notes::of(&recording);
        Ok(Self {
            recording,
            notes,
            calibration: calibration.map(|record| record.verdict),
            captures,
            left_out,
            warnings,
            backgrounds: Mutex::default(),
        })
    }

    /// The recording.
    pub fn recording(&self) -> &Recording {
        &self.recording
    }

    /// Cameras that take no part in any capture.
    pub fn left_out(&self) -> &[LeftOutCamera] {
        &self.left_out
    }

    /// What a person should know of the recording as a whole.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// People's notes on the captures.
    pub fn notes(&self) -> &Notes {
        &self.notes
    }

    /// The parts of the file that are known to be unreadable.
    pub fn damage(&self) -> &[Damage] {
        self.recording.damage()
    }

    /// The captures in the order of their triggers.
    pub fn captures(&self) -> Vec<CaptureSummary> {
        let summary = |planned: &Planned| planned.summary(&self.recording, &self.notes);
        self.captures.iter().map(summary).collect()
    }

    /// The capture of this name.
    pub fn capture(&self, id: &CaptureId) -> Option<CaptureSummary> {
        let named = |p: &&Planned| p.capture.trigger.id == *id;
        let planned = self.captures.iter().find(named)?;
        Some(planned.summary(&self.recording, &self.notes))
    }

    /// Reads and decodes a capture.
    ///
    /// # Errors
    /// If there is no such capture, it failed, or something that it needs is missing, damaged or wrong.
    pub fn load(&self, id: &CaptureId) -> Result<(Scene, CaptureFacts), Error> {
        let planned = self.planned(id)?;
        let capture = &planned.capture;
        let cameras = capture.colors.keys().chain(capture.depths.keys());
        let rig = RigAt::new(&self.recording, capture.trigger.time, cameras)?;
        let volume = rig.volume()?;
        let mut batch = ImageBatch::default();
        let mut plan = Plan {
            recording: &self.recording,
            rig: &rig,
            trigger: capture.trigger.time,
            batch: &mut batch,
        };
        let colors = capture.colors.iter();
        let colors: Vec<ColorPlan> = colors
            .map(|(id, frame)| plan.color(id, frame))
            .collect::<Result<_, _>>()?;
        let depths = capture.depths.iter();
        let depths: Vec<DepthPlan> = depths
            .map(|(id, takes)| plan.depth(id, takes))
            .collect::<Result<_, _>>()?;
        let mut kept = self.backgrounds.lock();
        batch.check_size(&self.recording, capture.trigger.time)?;
        batch.fill(&self.recording, &kept)?;
        if self.captures.len() > 1 {
            *kept = batch.backgrounds();
        }
        drop(kept);
        let facts = self.facts(capture, &colors, &depths);
        let scene = Scene {
            colors: colors.into_iter().map(|c| c.view(&mut batch)).collect(),
            depths: depths.into_iter().map(|d| d.view(&mut batch)).collect(),
            volume,
        };
        Ok((scene, facts))
    }

    /// The capture of this name, if it can be reconstructed.
    pub(super) fn planned(&self, id: &CaptureId) -> Result<&Planned, Error> {
        let path = || self.recording.path().into();
        let named = |p: &&Planned| p.capture.trigger.id == *id;
        let Some(planned) = self.captures.iter().find(named) else {
            let known = self.captures.iter().take(20);
            let known: Vec<&str> = known.map(|p| p.capture.trigger.id.as_str()).collect();
            return Err(Error::NoSuchCapture {
                path: path(),
                id: id.clone(),
                known: known.join(", "),
            });
        };
        if let Some(reason) = &planned.failure {
            return Err(Error::Failed {
                path: path(),
                id: id.clone(),
                reason: reason.clone(),
            });
        }
        let found = planned.capture.colors.len();
        if found < 2 {
            let left_out = self.left_out_of(&planned.capture);
            return Err(Error::TooFewCameras {
                path: path(),
                id: id.clone(),
                found,
                details: first_reasons(&left_out),
            });
        }
        Ok(planned)
    }

    /// The cameras that take no part in a capture.
    fn left_out_of(&self, capture: &Capture<MessageRef>) -> Vec<LeftOutCamera> {
        let short = capture.shortfalls.iter().map(|shortfall| LeftOutCamera {
            camera: shortfall.camera.clone(),
            reason: shortfall.to_string(),
        });
        self.left_out.iter().cloned().chain(short).collect()
    }

    fn facts(
        &self,
        capture: &Capture<MessageRef>,
        colors: &[ColorPlan],
        depths: &[DepthPlan],
    ) -> CaptureFacts {
        let depths: Vec<_> = depths.iter().map(DepthPlan::facts).collect();
        let mut warnings = self.warnings.clone();
        for depth in depths.iter().filter(|d| d.color_frames == 0) {
            warnings.push(format!(
                "depth camera {} has no colour pictures near its depth; a uniform grey is used \
                instead",
                depth.camera
            ));
        }
        CaptureFacts {
            id: capture.trigger.id.clone(),
            time_ns: capture.trigger.time,
            source: capture.trigger.source.clone(),
            subject: subject_of(&self.recording, &capture.trigger),
            placement: capture.trigger.placement.clone(),
            skew_ns: capture.skew_ns(),
            colors: colors.iter().map(ColorPlan::facts).collect(),
            depths,
            calibration: self.calibration.clone(),
            left_out: self.left_out_of(capture),
            warnings,
            damage: self.recording.damage().to_vec(),
        }
    }
}

/// The number of a capture's object: that of its trigger, or else the session's pair `subject`.
fn subject_of(recording: &Recording, trigger: &Trigger) -> Option<String> {
    let said = |text: &&str| text.chars().any(|c| !c.is_control() && !c.is_whitespace());
    let of_trigger = trigger.subject.as_deref().filter(said);
    let of_session = || recording.session_pair("subject").filter(said);
    of_trigger.or_else(of_session).map(str::to_owned)
}

/// The first reasons of many, in words that follow others.
fn first_reasons(left_out: &[LeftOutCamera]) -> String {
    const MOST: usize = 3;
    let first = left_out
        .iter()
        .take(MOST)
        .map(|left_out| format!("; {}", left_out.reason));
    let words: String = first.collect();
    match left_out.len().saturating_sub(MOST) {
        0 => words,
        more => format!("{words}; and {more} more cameras"),
    }
}

/// The cameras whose frames make captures: those with both images and a calibration. The others are left
/// out, with the reason.
fn cameras(recording: &Recording) -> (sync::Cameras, Vec<LeftOutCamera>) {
    let has = |topic: Topic| !recording.messages(&topic).is_empty();
    let ids = |of: fn(&Topic) -> Option<&CameraId>| -> BTreeSet<CameraId> {
        recording.topics().filter_map(of).cloned().collect()
    };
    let mut cameras = sync::Cameras::default();
    let mut left_out = Vec::new();
    let mut decide = |camera: &CameraId, kind: &str, image: bool, calibration: bool| {
        let reason = match (image, calibration) {
            (true, true) => return true,
            (true, false) => format!("{kind} camera {camera} has images and no calibration"),
            (false, true) => format!("{kind} camera {camera} has a calibration and no images"),
            (false, false) => {
                format!("{kind} camera {camera} has neither images nor a calibration")
            }
        };
        let camera = camera.clone();
        left_out.push(LeftOutCamera { camera, reason });
        false
    };
    for id in ids(|t| match t {
        Topic::Color(id, _) => Some(id),
        _ => None,
    }) {
        let part = |part| has(Topic::Color(id.clone(), part));
        if decide(
            &id,
            "colour",
            part(ColorPart::Image),
            part(ColorPart::Calibration),
        ) {
            cameras.colors.insert(id);
        }
    }
    for id in ids(|t| match t {
        Topic::Depth(id, _) => Some(id),
        _ => None,
    }) {
        let part = |part| has(Topic::Depth(id.clone(), part));
        if decide(
            &id,
            "depth",
            part(DepthPart::Image),
            part(DepthPart::Calibration),
        ) {
            cameras.depths.insert(id.clone(), part(DepthPart::Color));
        }
    }
    (cameras, left_out)
}

/// Bounds what assembling takes: each capture asks each camera.
pub(super) fn check_counts(recording: &Recording, cameras: &sync::Cameras) -> Result<(), Error> {
    const MOST: usize = 1_000_000;
    let triggers = recording.messages(&Topic::Trigger).len();
    let records = recording.messages(&Topic::Capture).len();
    let triggers = triggers.saturating_add(records);
    let cameras = cameras.colors.len() + cameras.depths.len();
    if triggers.saturating_mul(cameras) <= MOST {
        return Ok(());
    }
    Err(Error::TooMany {
        path: recording.path().into(),
        triggers,
        cameras,
        most: MOST,
    })
}

/// Channels that look like a camera's and are not.
pub(super) fn misnamed(recording: &Recording) -> Vec<String> {
    let like_ours = |topic: &str| topic.starts_with("/color/") || topic.starts_with("/depth/");
    let channels = recording.channels().into_iter();
    channels
        .filter(|c| !c.known && like_ours(&c.topic))
        .take(20)
        .map(|c| {
            let topic: String = c.topic.chars().take(80).collect();
            format!("{topic:?} is not a topic of the format and is ignored")
        })
        .collect()
}

/// Hands everything to the synchronisation in the order of time, as a live rig would, but for frames that a later
/// trigger has listed: they come with it.
pub(super) fn assemble(
    events: Vec<(Timestamp, ReplayEvent)>,
    cameras: sync::Cameras,
    parameters: &sync::Parameters,
    warnings: &mut Vec<String>,
) -> Vec<Planned> {
    let mut synchronizer = Synchronizer::new(cameras, parameters.clone());
    let mut ahead = FramesAhead::of(&events);
    let mut failed = BTreeMap::new();
    let mut captures = Vec::new();
    for (time, event) in events {
        match event {
            ReplayEvent::Frame {
                camera,
                stream,
                timestamp,
                message,
            } => {
                let frame = ReplayedFrame {
                    camera,
                    stream,
                    timestamp,
                    message,
                };
                push(&mut synchronizer, ahead.keep(frame));
            }
            ReplayEvent::Trigger(request) => {
                captures.extend(synchronizer.advance(time));
                let id = request.trigger.id.clone();
                push(&mut synchronizer, ahead.release(&id));
                if !synchronizer.push_trigger(request.trigger, request.listed) {
                    let at = time.iso_8601();
                    let what = "repeats the id of an earlier trigger and makes no capture";
                    warnings.push(format!("/trigger at {at}: {id} {what}"));
                } else if let Some(reason) = request.failed {
                    failed.insert(id, reason);
                }
            }
        }
    }
    captures.extend(synchronizer.finish());
    let plan = |capture: Capture<MessageRef>| Planned {
        failure: match failed.remove(&capture.trigger.id) {
            Some(reason) => Some(format!("it failed at the rig: {reason}")),
            None => (!capture.complete).then(|| capture.reason()),
        },
        capture,
    };
    captures.into_iter().map(plan).collect()
}

fn push(
    synchronizer: &mut Synchronizer<MessageRef>,
    frames: impl IntoIterator<Item = ReplayedFrame>,
) {
    for frame in frames {
        synchronizer.push_frame(&frame.camera, frame.stream, frame.timestamp, frame.message);
    }
}

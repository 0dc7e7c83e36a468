//! Takes one capture out of its recording, into a small recording that holds what a reconstruction of it needs: its
//! frames, their masks, and the calibration, settings and backgrounds that were valid at its trigger.

use super::error::Error;
use super::load::{CaptureSession, CaptureSummary};
use crate::frame::{CameraId, CaptureId, Timestamp};
use crate::notes::CaptureNotes;
use crate::recording::{ColorPart, DepthPart, MessageRef, Recording, Topic};
use crate::sync;
use std::collections::BTreeSet;
use std::path::Path;

/// A capture in a recording of its own.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Extract {
    /// SHA-256 over all that the new recording holds ([`Recording::content_sha256`]).
    pub content_sha256: String,
}

impl CaptureSession {
    /// Writes a capture's own recording to `to`, packed. People's notes stay behind. The new recording is read again:
    /// it has to show the same capture, the same cameras and the same warnings.
    ///
    /// # Errors
    /// If the capture cannot be reconstructed or lacks a camera, the recording is damaged, the new one cannot be
    /// written, or it would not say the same as this one.
    pub fn extract(
        &self,
        id: &CaptureId,
        to: &Path,
        program: &str,
        parameters: &sync::Parameters,
    ) -> Result<Extract, Error> {
        let alone = |reason: &str| Error::NotExtracted {
            path: self.recording().path().into(),
            id: id.clone(),
            reason: reason.into(),
        };
        if !self.damage().is_empty() {
            return Err(alone("the recording is damaged"));
        }
        // The words on what it lacks depend on the frames and triggers around it.
        let lacking = self.planned(id)?.capture.reason();
        if !lacking.is_empty() {
            return Err(alone(&format!(
                "a recording of its own would not tell that it lacks a camera: {lacking}"
            )));
        }
        let chosen = self.messages_of(id)?;
        let content_sha256 = self.recording().extract(&chosen, to, program)?;
        let small = Self::of(Recording::open(to)?, parameters)?;
        if !self.says_the_same(&small, id) {
            return Err(alone(
                "its copy in a recording of its own does not read the same",
            ));
        }
        Ok(Extract { content_sha256 })
    }

    /// The messages that a capture needs, in the order of topics and times.
    fn messages_of(&self, id: &CaptureId) -> Result<Vec<(Topic, MessageRef)>, Error> {
        let capture = &self.planned(id)?.capture;
        let trigger = capture.trigger.time;
        let mut frames: BTreeSet<(Topic, Timestamp)> = BTreeSet::new();
        for (camera, frame) in &capture.colors {
            for part in [ColorPart::Image, ColorPart::Mask, ColorPart::Ignore] {
                frames.insert((Topic::Color(camera.clone(), part), frame.timestamp));
            }
        }
        for (camera, takes) in &capture.depths {
            for take in takes {
                let topic = |part| Topic::Depth(camera.clone(), part);
                frames.insert((topic(DepthPart::Image), take.depth.timestamp));
                if let Some(color) = &take.color {
                    frames.insert((topic(DepthPart::Color), color.timestamp));
                }
            }
        }
        let recording = self.recording();
        let mut chosen = Vec::new();
        for topic in recording.topics() {
            let taken = match topic {
                Topic::Color(_, ColorPart::Image | ColorPart::Mask | ColorPart::Ignore)
                | Topic::Depth(_, DepthPart::Image | DepthPart::Color) => {
                    let times = frames.iter().filter(|(of, _)| of == topic);
                    let taken = times.flat_map(|(_, time)| recording.messages_at(topic, *time));
                    let taken: Vec<MessageRef> = taken.copied().collect();
                    // A camera without a calibration is still one that has pictures.
                    let first = recording.messages(topic).first().copied();
                    match first.filter(|_| taken.is_empty() && self.is_left_out(topic)) {
                        Some(first) => vec![first],
                        None => taken,
                    }
                }
                Topic::Color(
                    _,
                    ColorPart::Background | ColorPart::Settings | ColorPart::Calibration,
                )
                | Topic::Depth(_, DepthPart::Calibration | DepthPart::Response)
                | Topic::Volume => self.newest_or_first(topic, trigger),
                // A message may hold the poses of some cameras only.
                Topic::Tf => recording.messages_until(topic, trigger).to_vec(),
                Topic::Trigger => self.of_capture(topic, id, |recording, message| {
                    Some(recording.trigger(message).ok()?.id.to_string())
                }),
                Topic::Capture => self.of_capture(topic, id, |recording, message| {
                    Some(recording.capture_record(message).ok()?.id)
                }),
                Topic::Note | Topic::Log => Vec::new(),
            };
            chosen.extend(taken.into_iter().map(|message| (topic.clone(), message)));
        }
        Ok(chosen)
    }

    /// What was valid at a time; the first one where nothing was yet, so that the topic is there.
    fn newest_or_first(&self, topic: &Topic, time: Timestamp) -> Vec<MessageRef> {
        let recording = self.recording();
        let newest = recording.messages_until(topic, time).last();
        let found = newest.or_else(|| recording.messages(topic).first());
        found.copied().into_iter().collect()
    }

    fn of_capture(
        &self,
        topic: &Topic,
        id: &CaptureId,
        named: impl Fn(&Recording, &MessageRef) -> Option<String>,
    ) -> Vec<MessageRef> {
        let recording = self.recording();
        let messages = recording.messages(topic).iter();
        let is_of = |m: &&MessageRef| named(recording, m).as_deref() == Some(id.as_str());
        messages.filter(is_of).copied().collect()
    }

    fn is_left_out(&self, topic: &Topic) -> bool {
        let (Topic::Color(camera, _) | Topic::Depth(camera, _)) = topic else {
            return false;
        };
        let named = |camera: &CameraId| self.left_out().iter().any(|l| l.camera == *camera);
        named(camera)
    }

    /// Whether a capture's own recording says of it what this one says.
    fn says_the_same(&self, small: &Self, id: &CaptureId) -> bool {
        let without_notes = |session: &Self| -> Option<CaptureSummary> {
            Some(CaptureSummary {
                notes: CaptureNotes::default(),
                ..session.capture(id)?
            })
        };
        without_notes(self).is_some()
            && without_notes(self) == without_notes(small)
            && self.left_out() == small.left_out()
            && self.warnings() == small.warnings()
            && small.damage().is_empty()
            && small.captures().len() == 1
    }
}

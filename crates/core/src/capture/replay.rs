//! Plays a recording back: returns its frames and triggers in the order of their timestamps, as cameras and a foot
//! switch would deliver them. A frame is returned as a reference; its pixels stay in the file until they are
//! needed.

use crate::frame::{CameraId, CaptureId, Stream, Timestamp, Trigger};
use crate::recording::{
    CaptureOutcome, CaptureRecord, ColorPart, DepthPart, Error, MessageRef, Recording, Topic,
};
use std::collections::{BTreeMap, BTreeSet};

/// What happens in a recording.
#[derive(Clone, Debug)]
pub(super) enum ReplayEvent {
    /// A capture was asked for.
    Trigger(ReplayedTrigger),
    /// A camera gave a frame.
    Frame {
        /// The camera.
        camera: CameraId,
        /// What the frame shows.
        stream: Stream,
        /// When its exposure began.
        timestamp: Timestamp,
        /// Where it is.
        message: MessageRef,
    },
}

/// A trigger with what the recording says became of it.
#[derive(Clone, Debug)]
pub(super) struct ReplayedTrigger {
    /// The trigger.
    pub(super) trigger: Trigger,
    /// The frames that the rig took, where it listed them.
    pub(super) listed: BTreeMap<CameraId, Vec<Timestamp>>,
    /// Why the capture failed at the rig, if it did.
    pub(super) failed: Option<String>,
}

/// The events of a recording, and what could not be read of them.
#[derive(Debug, Default)]
pub(super) struct ReplayEvents {
    /// In the order of their timestamps.
    pub(super) events: Vec<(Timestamp, ReplayEvent)>,
    /// Triggers and capture records that were left out, in words.
    pub(super) problems: Vec<String>,
}

/// Lists what happens in a recording.
///
/// # Errors
/// If the file cannot be read. A trigger that makes no sense is left out and named among the problems.
pub(super) fn events(recording: &Recording) -> Result<ReplayEvents, Error> {
    let mut found = ReplayEvents::default();
    let records = capture_records(recording, &mut found.problems)?;
    triggers(recording, &records, &mut found)?;
    for topic in recording.topics() {
        let (camera, stream) = match topic {
            Topic::Color(camera, ColorPart::Image) => (camera, Stream::Color),
            Topic::Depth(camera, DepthPart::Image) => (camera, Stream::Depth),
            Topic::Depth(camera, DepthPart::Color) => (camera, Stream::DepthColor),
            _ => continue,
        };
        for message in recording.messages(topic) {
            let event = ReplayEvent::Frame {
                camera: camera.clone(),
                stream,
                timestamp: message.log_time(),
                message: *message,
            };
            found.events.push((message.log_time(), event));
        }
    }
    // Stable: events of one time keep the order of their topics.
    found.events.sort_by_key(|(time, _)| *time);
    Ok(found)
}

/// Keeps a reading, or notes why there is none; only an error of the file itself ends the listing.
fn noted<T>(read: Result<T, Error>, problems: &mut Vec<String>) -> Result<Option<T>, Error> {
    match read {
        Ok(value) => Ok(Some(value)),
        Err(error @ Error::Io { .. }) => Err(error),
        Err(error) => {
            problems.push(error.to_string());
            Ok(None)
        }
    }
}

/// The last record of each capture.
fn capture_records(
    recording: &Recording,
    problems: &mut Vec<String>,
) -> Result<BTreeMap<String, (Timestamp, CaptureRecord)>, Error> {
    let mut records = BTreeMap::new();
    for (message, read) in recording.read_each(&Topic::Capture, |m| recording.capture_record(m)) {
        if let Some(record) = noted(read, problems)? {
            records.insert(record.id.clone(), (message.log_time(), record));
        }
    }
    Ok(records)
}

fn triggers(
    recording: &Recording,
    records: &BTreeMap<String, (Timestamp, CaptureRecord)>,
    found: &mut ReplayEvents,
) -> Result<(), Error> {
    let mut with_trigger = BTreeSet::new();
    for (_, read) in recording.read_each(&Topic::Trigger, |m| recording.trigger(m)) {
        let Some(trigger) = noted(read, &mut found.problems)? else {
            continue;
        };
        with_trigger.insert(trigger.id.to_string());
        let record = records.get(trigger.id.as_str()).map(|(_, r)| r);
        found
            .events
            .push((trigger.time, trigger_event(trigger, record)));
    }
    for (id, (time, record)) in records {
        if !with_trigger.contains(id) {
            let lost = trigger_of(*time, record);
            let what = if lost.is_some() {
                "the time of its first frame is used instead"
            } else {
                "it makes no capture"
            };
            found.problems.push(format!(
                "/capture: the trigger of {id:?} is missing, and {what}"
            ));
            if let Some(trigger) = lost {
                found
                    .events
                    .push((trigger.time, trigger_event(trigger, Some(record))));
            }
        }
    }
    Ok(())
}

/// A trigger for a capture whose own was lost, at its first frame.
fn trigger_of(recorded: Timestamp, record: &CaptureRecord) -> Option<Trigger> {
    let listed = record
        .cameras
        .values()
        .filter_map(|c| c.timestamps.as_ref());
    let first = listed.flatten().min()?;
    Some(Trigger {
        id: CaptureId::new(&record.id).ok()?,
        time: (*first).min(recorded),
        source: "unknown".into(),
        press_id: None,
        subject: None,
        placement: None,
    })
}

/// The event of a trigger, with what the record of its capture says.
fn trigger_event(trigger: Trigger, record: Option<&CaptureRecord>) -> ReplayEvent {
    let cameras = record.into_iter().flat_map(|r| &r.cameras);
    let listed = cameras.filter_map(|(id, camera)| {
        let id = CameraId::new(id).ok()?;
        let times = camera.timestamps.clone()?;
        (!times.is_empty()).then_some((id, times))
    });
    ReplayEvent::Trigger(ReplayedTrigger {
        trigger,
        listed: listed.collect(),
        failed: record
            .filter(|r| r.outcome == CaptureOutcome::Failed)
            .map(|r| r.reason.clone().unwrap_or_else(|| "no reason given".into())),
    })
}

//! From a capture that is on the disk to the job of making its model.

use super::super::events::{Event, Events};
use crate::frame::Trigger;
use crate::log;
use crate::workers::{Job, Jobs};
use std::path::PathBuf;

/// Lets a model be made of a capture that is on the disk. Where that cannot be, those who wait for it hear so.
pub(super) fn offer(jobs: &Jobs, events: &Events, recording: PathBuf, trigger: &Trigger) {
    let capture = trigger.id.to_string();
    let job = Job::new(&recording, &capture, trigger.time.0, &trigger.source);
    if let Err(error) = jobs.offer(&job) {
        log::error!("capture {capture}: no model will be made: {error}");
        let reason = error.to_string();
        events.publish(Event::JobFailed {
            capture,
            recording: Some(recording),
            reason,
        });
    }
}

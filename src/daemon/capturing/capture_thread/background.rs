//! Takes backgrounds of the empty rig, and tells their age.

use super::super::assemble::assemble;
use super::CaptureThread;
use super::shot::{cameras, shoot};
use crate::daemon::backgrounds::{self, Backgrounds};
use crate::daemon::events::Event;
use crate::daemon::rig::CameraKind;
use crate::frame::{CameraId, CaptureId, Timestamp, Trigger};
use crate::recording::CaptureOutcome;
use crate::sync::{self, Synchronizer};
use crate::words::count;
use std::collections::BTreeMap;

impl CaptureThread {
    /// Takes the empty rig's backgrounds and keeps them.
    pub(super) fn take_backgrounds(&mut self) -> Result<String, String> {
        self.check_capacity()?;
        let time = self.end_look();
        let trigger = Trigger {
            id: CaptureId::new("background").map_err(|e| e.to_string())?,
            time,
            source: "background".into(),
            press_id: None,
            subject: None,
            placement: None,
        };
        let colors = sync::Cameras {
            depths: BTreeMap::new(),
            ..cameras(&self.rig)
        };
        let mut synchronizer = Synchronizer::new(colors, self.plan.sync.clone());
        let only_colors = |kind| kind == CameraKind::Color;
        let (capture, result) = shoot(
            &mut self.rig,
            &self.plan,
            &mut synchronizer,
            only_colors,
            trigger,
            &self.heartbeat,
        );
        self.note_shot(&result);
        let now = self.rig.clock().timestamp();
        let kept = assemble(capture, result, f64::INFINITY, now);
        if kept.record.outcome == CaptureOutcome::Failed {
            return Err(kept.record.reason.unwrap_or_default());
        }
        let backgrounds: Backgrounds = kept
            .frames
            .into_iter()
            .map(|f| (f.camera, (f.timestamp, f.picture)))
            .collect();
        if backgrounds.is_empty() {
            return Err("no colour camera gave a picture, so the earlier ones stay".into());
        }
        let plan = &self.plan;
        let path = backgrounds::save(&plan.recording.folder, now, &backgrounds, &plan.program)
            .map_err(|e| e.to_string())?;
        let mut words = format!(
            "saved {} in {}",
            count(backgrounds.len(), "background picture"),
            path.display()
        );
        words += &self.left_out(&backgrounds);
        // Where captures go on without a camera that is away, so do backgrounds; its earlier one stays, with its age.
        let taken = backgrounds::detached(backgrounds);
        self.plan.header.backgrounds.extend(taken);
        self.header_changed();
        let told = words.clone();
        self.plan.events.publish(Event::Plates { words: told });
        Ok(words)
    }

    /// Words for the colour cameras that have no picture in this set; empty if all have one.
    fn left_out(&self, backgrounds: &Backgrounds) -> String {
        let colors = self.colors().filter(|id| !backgrounds.contains_key(*id));
        let names: Vec<&str> = colors.map(CameraId::as_str).collect();
        if names.is_empty() {
            return String::new();
        }
        format!("; there is no new picture of {}", names.join(", "))
    }

    fn colors(&self) -> impl Iterator<Item = &CameraId> {
        let states = self.rig.states();
        states.filter_map(|(id, kind, _)| (kind == CameraKind::Color).then_some(id))
    }

    /// Hours since the oldest background; `None` where a camera has none.
    pub(super) fn backgrounds_age_h(&self) -> Option<f64> {
        let backgrounds = &self.plan.header.backgrounds;
        let times: Option<Vec<Timestamp>> = self
            .colors()
            .map(|id| backgrounds.get(id).map(|(time, _)| *time))
            .collect();
        let oldest = times?.into_iter().min()?;
        let age_ns = self.rig.clock().timestamp().nanoseconds_since(oldest);
        Some(age_ns as f64 / 3.6e12)
    }
}

//! The empty rig's plates: how they are taken, and their age.

use super::super::assemble::assemble;
use super::CaptureThread;
use super::shot::{cameras, shoot};
use crate::daemon::events::Event;
use crate::daemon::plates::{self, Plates};
use crate::daemon::rig::Kind;
use crate::frame::{CaptureId, Timestamp, Trigger};
use crate::recording::Outcome;
use crate::sync::{self, Synchronizer};
use std::collections::BTreeMap;

impl CaptureThread {
    /// Takes the empty rig's plates and keeps them.
    pub(super) fn take_plates(&mut self) -> Result<String, String> {
        self.check_capacity()?;
        let trigger = Trigger {
            id: CaptureId::new("background").map_err(|e| e.to_string())?,
            time: self.rig.clock().timestamp(),
            source: "background".into(),
            press_id: None,
            subject: None,
        };
        let colors = sync::Cameras {
            depths: BTreeMap::new(),
            ..cameras(&self.rig)
        };
        let mut synchronizer = Synchronizer::new(colors, self.plan.sync.clone());
        let only_colors = |kind| kind == Kind::Color;
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
        if kept.record.outcome == Outcome::Failed {
            return Err(kept.record.reason.unwrap_or_default());
        }
        let plates: Plates = kept
            .frames
            .into_iter()
            .map(|f| (f.camera, (f.timestamp, f.picture)))
            .collect();
        let plan = &self.plan;
        let path = plates::save(&plan.recording.folder, now, &plates, &plan.program)
            .map_err(|e| e.to_string())?;
        let words = format!("{} plates in {}", plates.len(), path.display());
        self.plan.preamble.backgrounds = plates::detached(plates);
        self.preamble_changed();
        let told = words.clone();
        self.plan.events.publish(Event::Plates { words: told });
        Ok(words)
    }

    /// Hours since the oldest plate; `None` where a camera has none.
    pub(super) fn plates_age_h(&self) -> Option<f64> {
        let plates = &self.plan.preamble.backgrounds;
        let colors = self.rig.states().filter(|(_, k, _)| *k == Kind::Color);
        let times: Option<Vec<Timestamp>> = colors
            .map(|(id, ..)| plates.get(id).map(|(time, _)| *time))
            .collect();
        let oldest = times?.into_iter().min()?;
        let age_ns = self.rig.clock().timestamp().nanoseconds_since(oldest);
        Some(age_ns as f64 / 3.6e12)
    }
}

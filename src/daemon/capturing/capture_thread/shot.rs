//! A shot of the rig's cameras, and which of its frames make the capture.

use super::super::CapturePlan;
use crate::daemon::rig::{CameraKind, Rig, ShotResult};
use crate::daemon::systemd::Heartbeat;
use crate::frame::{Frame, Timestamp, Trigger};
use crate::sync::{self, Capture, Listed, Synchronizer};
use std::collections::BTreeMap;
use std::time::Duration;

/// The cameras whose frames make a capture.
pub(super) fn cameras(rig: &Rig) -> sync::Cameras {
    let mut cameras = sync::Cameras::default();
    for (id, kind, _) in rig.states() {
        match kind {
            CameraKind::Color => drop(cameras.colors.insert(id.clone())),
            CameraKind::Depth | CameraKind::DepthInTurn => {
                cameras.depths.insert(id.clone(), true);
            }
        }
    }
    cameras
}

/// Takes a shot and lets `sync` choose from its frames.
pub(super) fn shoot(
    rig: &mut Rig,
    plan: &CapturePlan,
    synchronizer: &mut Synchronizer<Frame>,
    wanted: impl Fn(CameraKind) -> bool,
    trigger: Trigger,
    heartbeat: &Heartbeat,
) -> (Capture<Frame>, ShotResult) {
    let patience = plan.sync.window_ms + plan.capture.patience_ms as f64;
    let at_most = Duration::from_secs_f64(patience / 1e3);
    let result = rig.shoot(wanted, trigger.time, at_most, heartbeat);
    synchronizer.push_trigger(trigger.clone(), Listed::new());
    for frame in &result.frames {
        synchronizer.push_frame(&frame.camera, frame.stream, frame.timestamp, frame.clone());
    }
    // All cameras have answered, or their time is over.
    let mut captures = synchronizer.finish();
    // What they gave beyond the capture is of no use to a later one: its memory is.
    synchronizer.advance(Timestamp(u64::MAX));
    let capture = captures.pop().unwrap_or_else(|| Capture {
        trigger,
        colors: BTreeMap::new(),
        depths: BTreeMap::new(),
        shortfalls: Vec::new(),
        complete: false,
    });
    (capture, result)
}

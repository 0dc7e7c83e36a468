//! Turns the result of a shot into what is recorded: the frames, the capture's record, and the reason if the capture
//! failed. It uses no thread, no clock and no file.

use super::super::rig::ShotResult;
use crate::drivers::live::{Fault, ShotStats};
use crate::frame::{CameraId, Frame, Timestamp};
use crate::recording::{
    CameraInCapture, CaptureOutcome, CaptureRecord, FinishedCapture, Lost, LostParts,
};
use crate::sync::{Capture, Shortfall};
use std::collections::{BTreeMap, BTreeSet};

/// Makes of a shot and of what `sync` took from it the capture that is kept. A failed one keeps every frame that came.
pub(super) fn assemble(
    capture: Capture<Frame>,
    result: ShotResult,
    largest_skew_ms: f64,
    time: Timestamp,
) -> FinishedCapture {
    let reasons = reasons(&capture, &result.answers, largest_skew_ms);
    let failed = !capture.complete || too_skewed(&capture, largest_skew_ms);
    let skew_ns = capture.skew_ns();
    let trigger = capture.trigger.clone();
    let frames = if failed {
        result.frames
    } else {
        frames_of(capture)
    };
    let record = CaptureRecord {
        id: trigger.id.to_string(),
        outcome: if failed {
            CaptureOutcome::Failed
        } else {
            CaptureOutcome::Complete
        },
        reason: (!reasons.is_empty()).then(|| reasons.join("; ")),
        skew_ns: Some(skew_ns),
        cameras: cameras(&frames, &result.answers),
    };
    FinishedCapture {
        trigger,
        frames,
        record,
        time,
    }
}

fn too_skewed(capture: &Capture<Frame>, largest_skew_ms: f64) -> bool {
    capture.skew_ns() as f64 / 1e6 > largest_skew_ms
}

/// The frames that `sync` took, each once.
fn frames_of(capture: Capture<Frame>) -> Vec<Frame> {
    let mut frames: Vec<Frame> = capture.colors.into_values().map(|c| c.handle).collect();
    for takes in capture.depths.into_values() {
        let mut seen = BTreeSet::new();
        for take in takes {
            frames.push(take.depth.handle);
            let color = take.color.filter(|c| seen.insert(c.timestamp));
            frames.extend(color.map(|c| c.handle));
        }
    }
    frames
}

/// Of each camera its frames' timestamps and what it lost. A depth camera is known by its depth frames.
fn cameras(
    frames: &[Frame],
    answers: &BTreeMap<CameraId, Result<ShotStats, Fault>>,
) -> BTreeMap<String, CameraInCapture> {
    let mut cameras: BTreeMap<String, CameraInCapture> = BTreeMap::new();
    for (id, answer) in answers {
        let camera = cameras.entry(id.to_string()).or_default();
        camera.timestamps = Some(Vec::new());
        camera.lost = lost(answer);
        if let Ok(stats) = answer {
            camera.remarks.clone_from(&stats.remarks);
        }
    }
    for frame in frames {
        let camera = cameras.entry(frame.camera.to_string()).or_default();
        if frame.stream != crate::frame::Stream::DepthColor {
            camera
                .timestamps
                .get_or_insert_default()
                .push(frame.timestamp);
        }
    }
    for camera in cameras.values_mut() {
        camera.timestamps.iter_mut().for_each(|t| t.sort_unstable());
    }
    cameras
}

/// What a camera lost, for the record; nothing where it lost nothing.
fn lost(answer: &Result<ShotStats, Fault>) -> Option<Lost> {
    let stats = match answer {
        Err(fault) => {
            let fault = fault.to_string();
            return Some(Lost::All { fault });
        }
        Ok(stats) => stats,
    };
    let parts = LostParts {
        frames: stats.lost.clone(),
        missing_packets: stats.missing_packets,
        resent_packets: stats.resent_packets,
        unused_frames: stats.unused,
    };
    (parts != LostParts::default()).then_some(Lost::Some(parts))
}

/// What was short, each with what its camera had to say.
fn reasons(
    capture: &Capture<Frame>,
    answers: &BTreeMap<CameraId, Result<ShotStats, Fault>>,
    largest_skew_ms: f64,
) -> Vec<String> {
    let short = |shortfall: &Shortfall| match answers.get(&shortfall.camera) {
        Some(Err(fault)) => format!("camera {}: {fault}", shortfall.camera),
        Some(Ok(stats)) if !stats.lost.is_empty() => {
            format!("{shortfall}; it lost: {}", stats.lost.join(", "))
        }
        _ => shortfall.to_string(),
    };
    let mut reasons: Vec<String> = capture.shortfalls.iter().map(short).collect();
    if too_skewed(capture, largest_skew_ms) {
        let by_time = || capture.colors.iter().map(|(id, c)| (c.timestamp, id));
        let (first, last) = (by_time().min(), by_time().max());
        if let (Some((_, first)), Some((_, last))) = (first, last) {
            reasons.push(format!(
                "the colour frames spread over {:.1} ms, from {first} to {last}, expected at most {largest_skew_ms} ms",
                capture.skew_ns() as f64 / 1e6
            ));
        }
    }
    reasons
}

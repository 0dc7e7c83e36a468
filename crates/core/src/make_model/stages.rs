//! Times the stages of a capture, and reports each as it begins.

use crate::frame::CaptureId;
use crate::reconstruct::{Progress, Stage};
use crate::report;
use parking_lot::Mutex;
use std::time::{Duration, Instant};

/// The stages that have begun, and when.
pub(super) struct StageTimer<'a> {
    on_stage: &'a (dyn Fn(&CaptureId, &str) + Sync),
    capture: &'a CaptureId,
    begun: Mutex<Vec<(String, Instant)>>,
}

impl<'a> StageTimer<'a> {
    /// Begins with reading.
    pub(super) fn new(
        on_stage: &'a (dyn Fn(&CaptureId, &str) + Sync),
        capture: &'a CaptureId,
    ) -> Self {
        let timer = Self {
            on_stage,
            capture,
            begun: Mutex::default(),
        };
        timer.begin("reading");
        timer
    }

    /// Ends a stage and begins the next one.
    pub(super) fn begin(&self, stage: &str) {
        (self.on_stage)(self.capture, stage);
        let mut begun = self.begun.lock();
        begun.push((stage.into(), Instant::now()));
    }

    /// Seconds of each stage, in their order; the last one ends now.
    pub(super) fn seconds(&self) -> Vec<(String, f64)> {
        let begun = self.begun.lock();
        let starts = begun.iter().skip(1).map(|(_, start)| *start);
        let ends = starts.chain([Instant::now()]);
        let seconds = |((name, start), end): (&(String, Instant), Instant)| {
            (name.clone(), Duration::as_secs_f64(&(end - *start)))
        };
        begun.iter().zip(ends).map(seconds).collect()
    }

    /// What the report says of the time it took, up to now.
    pub(super) fn timing(&self) -> report::Timing {
        let stage = |(stage, seconds)| report::StageTime { stage, seconds };
        let stages: Vec<_> = self.seconds().into_iter().map(stage).collect();
        let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
        report::Timing {
            total_s: stages.iter().map(|s| s.seconds).sum(),
            stages,
            threads: rayon::current_num_threads(),
            host: host.trim().to_owned(),
        }
    }
}

impl Progress for StageTimer<'_> {
    fn stage(&self, stage: Stage) {
        self.begin(stage.name());
    }
}

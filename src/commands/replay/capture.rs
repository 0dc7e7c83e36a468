//! The way of one capture: from the recording to the files in its folder.

use super::console::Console;
use super::outcome::Outcome;
use crate::calibration::RigCalibration;
use crate::config::Config;
use crate::frame::CaptureId;
use crate::job::{self, CaptureFacts, Session};
use crate::output;
use crate::reconstruct::{self, Progress, Reconstruction, Scene, Stage};
use crate::recording;
use crate::report::{self, Measurements, Verdict};
use crate::storage::StagedFolder;
use anyhow::Context;
use parking_lot::Mutex;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// How captures are reconstructed.
pub(super) struct Reconstruct<'a> {
    pub(super) config: &'a Config,
    /// Cameras to use instead of the recorded ones.
    pub(super) calibration: Option<&'a RigCalibration>,
    /// Whether other outputs may be replaced.
    pub(super) force: bool,
    /// Where the captures' folders go.
    pub(super) folder: PathBuf,
    pub(super) console: &'a Console,
}

impl Reconstruct<'_> {
    /// Reconstructs one capture and writes its folder.
    pub(super) fn capture(&self, session: &Session, id: &CaptureId) -> Outcome {
        self.try_capture(session, id)
            .unwrap_or_else(|error| self.failed(session, id, &error))
    }

    /// The outcome of a capture that failed, with its report in its folder.
    pub(super) fn failed(
        &self,
        session: &Session,
        id: &CaptureId,
        error: impl std::fmt::Display,
    ) -> Outcome {
        let mut reasons = vec![format!("{error:#}")];
        if let Err(also) = self.write_failure(session, id, &reasons[0]) {
            let also = format!("{also:#}");
            // What kept the model from being written mostly keeps the report as well.
            if !reasons[0].ends_with(&also) {
                reasons.push(also);
            }
        }
        Outcome {
            capture: Some(id.to_string()),
            damaged: !session.damage().is_empty(),
            ..Outcome::unreadable(
                session.recording().path(),
                &anyhow::anyhow!("{}", reasons.join("; ")),
            )
        }
    }

    fn write_failure(&self, session: &Session, id: &CaptureId, reason: &str) -> anyhow::Result<()> {
        let origin = self.origin(session, "");
        let summary = session.capture(id);
        let (time_ns, source) = summary.map(|c| (c.time, c.source)).unwrap_or_default();
        let capture = report::FailedCapture {
            id,
            time_ns,
            source: &source,
        };
        let report = report::Failure::new(&origin, capture, reason, report::Timing::default());
        let report = report::to_json(&report)?;
        let target = self.folder.join(id.as_str());
        Ok(output::write_failure(
            &target,
            report.as_bytes(),
            None,
            self.force,
        )?)
    }

    fn try_capture(&self, session: &Session, id: &CaptureId) -> anyhow::Result<Outcome> {
        let clock = StageClock::new(self.console, id);
        let (mut scene, facts) = session.load(id)?;
        if let Some(calibration) = self.calibration {
            job::replace_cameras(&mut scene, calibration)?;
        }
        let digest = job::digest(&scene, &self.settings());
        let target = self.folder.join(id.as_str());
        let mut outcome = Outcome {
            capture: Some(id.to_string()),
            result: "done",
            reasons: Vec::new(),
            damaged: !facts.damage.is_empty(),
            folder: Some(target.clone()),
            ..Outcome::unreadable(session.recording().path(), &anyhow::anyhow!(""))
        };
        if let Some(report) = self.unchanged(&target, &digest)? {
            outcome.result = "unchanged";
            outcome.verdict = report["verdict"]["level"].as_str().map(str::to_owned);
            outcome.reasons = reasons(&report);
            return Ok(outcome);
        }
        let reconstruction =
            reconstruct::reconstruct(&scene, &self.config.reconstruction(), &clock)?;
        clock.begin("report");
        let made = Made {
            scene,
            facts,
            reconstruction,
        };
        let origin = self.origin(session, &digest);
        let verdict = self.write(&target, made, &origin, &clock)?;
        outcome.verdict = Some(verdict.level.name().to_lowercase());
        outcome.reasons = verdict.reasons.into_iter().map(|r| r.words).collect();
        outcome.seconds = clock.seconds();
        self.console.finished(id.as_str());
        Ok(outcome)
    }

    fn origin(&self, session: &Session, digest: &str) -> report::Origin {
        let path = session.recording().path();
        // The same capture has the same report, whether its recording is complete or not.
        let path = recording::finished_name(path).unwrap_or_else(|| path.to_owned());
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        report::Origin::new(&name, self.config.method, digest)
    }

    /// All settings that the model depends on, as text.
    fn settings(&self) -> String {
        toml::to_string(&self.config.of_replay()).unwrap_or_default()
    }

    /// The report of the model of this digest, if the folder holds it.
    ///
    /// # Errors
    /// If it holds another one that may not be replaced.
    fn unchanged(&self, target: &Path, digest: &str) -> anyhow::Result<Option<Value>> {
        if self.force || !target.exists() {
            return Ok(None);
        }
        let report = std::fs::read(target.join("report.json")).unwrap_or_default();
        let report: Value = serde_json::from_slice(&report).unwrap_or_default();
        if report["digest"] == digest {
            return Ok(Some(report));
        }
        anyhow::ensure!(
            report["outcome"] == "failed",
            "{} holds a model made from other inputs or settings: give --force to replace it, or another --out",
            target.display()
        );
        Ok(None)
    }

    /// Judges what was made and writes its files, all or none.
    fn write(
        &self,
        target: &Path,
        made: Made,
        origin: &report::Origin,
        clock: &StageClock,
    ) -> anyhow::Result<Verdict> {
        let staged = StagedFolder::create(target)?;
        let (model, id) = (&made.reconstruction.model, made.facts.id.as_str());
        let judged = || -> anyhow::Result<(Measurements, Verdict)> {
            let measured = report::measure(&made.scene, &made.reconstruction, self.config.method);
            let verdict = report::judge(&measured, &made.facts, &self.config.verdict);
            let sheet = report::preview(&made.scene, &made.reconstruction, &verdict, id);
            staged.write("preview.png", &output::encode_png(&sheet)?)?;
            Ok((measured, verdict))
        };
        let glb = || -> anyhow::Result<()> {
            let file = output::glb::encode(model, id, &self.config.glb)?;
            Ok(staged.write("model.glb", &file)?)
        };
        let ply = || -> anyhow::Result<()> {
            Ok(staged.write("model.ply", &output::ply::encode(model, id)?)?)
        };
        let (judged, (glb, ply)) = rayon::join(judged, || rayon::join(glb, ply));
        let (measured, verdict) = judged?;
        glb.and(ply)?;
        clock.begin("files");
        let Made {
            scene,
            facts,
            reconstruction,
        } = made;
        let finish = || -> anyhow::Result<()> {
            let report = report::Report::new(origin, &facts, &measured, &verdict, clock.timing());
            staged.write("report.json", report::to_json(&report)?.as_bytes())?;
            let place = || target.display().to_string();
            staged.commit(true).with_context(place)
        };
        // Giving back the pictures' memory takes as long as the disk does.
        rayon::join(finish, || drop((scene, reconstruction))).0?;
        Ok(verdict)
    }
}

/// A capture and what was made of it.
struct Made {
    scene: Scene,
    facts: CaptureFacts,
    reconstruction: Reconstruction,
}

/// The words of a report's verdict.
fn reasons(report: &Value) -> Vec<String> {
    let reasons = report["verdict"]["reasons"].as_array();
    let words = reasons.into_iter().flatten().map(|r| r["words"].as_str());
    words.flatten().map(str::to_owned).collect()
}

/// Times the stages and shows them.
struct StageClock<'a> {
    console: &'a Console,
    capture: String,
    stages: Mutex<Vec<(String, Instant)>>,
}

impl<'a> StageClock<'a> {
    fn new(console: &'a Console, id: &CaptureId) -> Self {
        let clock = Self {
            console,
            capture: id.to_string(),
            stages: Mutex::default(),
        };
        clock.begin("reading");
        clock
    }

    fn begin(&self, stage: &str) {
        self.console.stage(&self.capture, stage);
        let mut stages = self.stages.lock();
        stages.push((stage.into(), Instant::now()));
    }

    /// Seconds of each stage, in their order.
    fn seconds(&self) -> Vec<(String, f64)> {
        let stages = self.stages.lock();
        let ends = stages
            .iter()
            .skip(1)
            .map(|(_, start)| *start)
            .chain([Instant::now()]);
        let seconds = |((name, start), end): (&(String, Instant), Instant)| {
            (name.clone(), Duration::as_secs_f64(&(end - *start)))
        };
        stages.iter().zip(ends).map(seconds).collect()
    }

    /// What the report says of the time it took, up to now.
    fn timing(&self) -> report::Timing {
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

impl Progress for StageClock<'_> {
    fn stage(&self, stage: Stage) {
        self.begin(stage.name());
    }
}

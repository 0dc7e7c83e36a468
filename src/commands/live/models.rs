//! Starts the workers that make models while the daemon runs, as the configuration says.

use crate::clock::Clock;
use crate::config::Config;
use crate::daemon::Capturing;
use crate::daemon::events::Event;
use crate::log;
use crate::workers::{
    FinishedJob, Jobs, ObjectResult, RemakeResult, WorkerPlan, Workers, object_protocol, protocol,
    start_models, start_objects, start_remakes,
};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

/// The queue of jobs, which takes jobs before the workers start.
pub(super) struct Models {
    pub(super) jobs: Arc<Jobs>,
}

impl Models {
    /// `None` where the configuration wants no models.
    pub(super) fn prepare(config: &Config) -> anyhow::Result<Option<Self>> {
        if config.workers.count == 0 && config.workers.fleet.is_none() {
            return Ok(None);
        }
        let jobs = Arc::new(Jobs::open(&config.recording.folder)?);
        Ok(Some(Self { jobs }))
    }

    /// Offers the captures of `interrupted` recordings that have no model yet. Returns whether the disk kept all jobs.
    pub(super) fn enqueue_missing(&self, config: &Config, interrupted: &[PathBuf]) -> bool {
        self.jobs
            .enqueue_missing(interrupted, &config.workers.folder)
    }

    /// Begins. Each press gets the result of its model, or the reason why there is none.
    pub(super) fn start(
        self,
        config: &Config,
        clock: Clock,
        keep_free_bytes: Arc<AtomicU64>,
        capturing: Arc<Capturing>,
    ) -> anyhow::Result<[Workers; 3]> {
        let plan = WorkerPlan {
            parameters: config.workers.clone(),
            settings: config.replay_toml()?,
            clock,
            method: config.method,
            keep_free: keep_free_bytes,
            // This very program, also when another version has been installed meanwhile.
            command: vec!["/proc/self/exe".into(), protocol::COMMAND.into()],
        };
        let for_objects = WorkerPlan {
            command: vec!["/proc/self/exe".into(), object_protocol::COMMAND.into()],
            ..plan.clone()
        };
        for (capture, recording) in self.jobs.heed_notes() {
            log::notice!("capture {capture}: rejected before its model was made");
            capturing.job_ended(Event::JobFailed {
                capture,
                recording: Some(recording),
                reason: "the capture was rejected before its model was made".into(),
            });
        }
        let events = capturing.events().clone();
        let tell = move |ended| capturing.job_ended(event(ended));
        let workers = start_models(&self.jobs, plan.clone(), tell)?;
        let own = events.clone();
        let tell = move |remade| own.publish(remade_event(remade));
        let remakes = start_remakes(&self.jobs, plan, tell)?;
        let tell = move |news| events.publish(object_event(news));
        let objects = start_objects(&self.jobs, for_objects, tell)?;
        Ok([workers, objects, remakes])
    }
}

fn event(ended: FinishedJob) -> Event {
    let FinishedJob {
        capture,
        recording,
        model,
    } = ended;
    match model {
        Ok(model) => Event::Done {
            capture,
            recording: Some(recording),
            verdict: model.verdict,
            reasons: model.reasons,
            model: model.folder,
        },
        Err(reason) => Event::JobFailed {
            capture,
            recording: Some(recording),
            reason,
        },
    }
}

fn remade_event(RemakeResult { capture, model }: RemakeResult) -> Event {
    let (verdict, reasons, model) = match model {
        Ok(model) => (Some(model.verdict), model.reasons, Some(model.folder)),
        Err(reason) => (None, vec![reason], None),
    };
    Event::Remade {
        capture,
        verdict,
        reasons,
        model,
    }
}

fn object_event(news: ObjectResult) -> Event {
    match news {
        ObjectResult::Registered {
            subject,
            capture,
            poses,
        } => Event::Registered {
            subject,
            capture,
            verdict: poses.verdict,
            held_by: poses.held_by,
            words: poses.words,
            left_out: poses.left_out,
            unseen_percent: poses.unseen_percent,
            show_next: poses.show_next,
        },
        ObjectResult::Fused {
            subject,
            capture,
            model,
            left_out,
        } => {
            let (verdict, reasons, model) = match model {
                Ok(model) => (Some(model.verdict), model.reasons, Some(model.folder)),
                Err(reason) => (None, vec![reason], None),
            };
            Event::Fused {
                subject,
                capture,
                verdict,
                reasons,
                left_out,
                model,
            }
        }
    }
}

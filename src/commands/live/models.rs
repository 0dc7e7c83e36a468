//! Starts the workers that make models while the daemon runs, as the configuration says.

use crate::clock::Clock;
use crate::config::Config;
use crate::daemon::Capturing;
use crate::daemon::events::Event;
use crate::workers::{Ended, Jobs, WorkerPlan, Workers, protocol};
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

    /// Begins, with the captures of `interrupted` recordings. Each press gets the result of its model, or the reason
    /// why there is none.
    pub(super) fn start(
        self,
        config: &Config,
        clock: Clock,
        interrupted: &[PathBuf],
        keep_free: Arc<AtomicU64>,
        capturing: Arc<Capturing>,
    ) -> anyhow::Result<Workers> {
        self.jobs
            .enqueue_missing(interrupted, &config.workers.folder);
        let plan = WorkerPlan {
            parameters: config.workers.clone(),
            settings: config.replay_toml()?,
            clock,
            method: config.method,
            keep_free,
            // This very program, also when another version has been installed meanwhile.
            command: vec!["/proc/self/exe".into(), protocol::COMMAND.into()],
        };
        let tell = move |ended| capturing.job_ended(event(ended));
        Ok(Workers::start(&self.jobs, plan, tell)?)
    }
}

fn event(ended: Ended) -> Event {
    let Ended {
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

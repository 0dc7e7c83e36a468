//! The thread that has models made again with other settings, one at a time and when nothing else waits for a model.
//! The new model lies beside the first, under a name of its own, and a process that fails leaves nothing there.

use super::jobs::{Error, Jobs};
use super::object_find::{named, session_of};
use super::pool::WorkerPlan;
use super::remakes::Remake;
use super::threads::Workers;
use super::{outcome, protocol};
use crate::make_model::Model;
use crate::process::{Child, ChildExit};
use crate::recording::{Recording, Topic, finished_name};
use crate::{log, queue, storage};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::Duration;

/// Remakes of one capture.
const MOST_OF_A_CAPTURE: u32 = 99;
/// The nice value of their processes: after all others.
const NICE: u32 = 19;
/// Where a process makes a model, below the folder of models.
const WORK: &str = ".remake";

/// What became of a remake.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RemakeResult {
    /// The capture.
    pub capture: String,
    /// The model, or why there is none.
    pub model: Result<Model, String>,
}

/// Starts the thread that makes models again; `tell` is called for each remake that ends.
///
/// # Errors
/// If the system has no thread left.
pub fn start_remakes(
    jobs: &Arc<Jobs>,
    plan: WorkerPlan,
    tell: impl Fn(RemakeResult) + Send + 'static,
) -> Result<Workers, Error> {
    let workers = Workers::new(jobs, plan.parameters.folder.clone());
    let making = Making {
        jobs: jobs.clone(),
        plan,
    };
    workers.spawn("remaking".into(), move || making.run(tell))?;
    Ok(workers)
}

struct Making {
    jobs: Arc<Jobs>,
    plan: WorkerPlan,
}

impl Making {
    fn run(&self, tell: impl Fn(RemakeResult)) {
        let has_turn = || self.jobs.is_idle() && self.plan.has_room();
        let may = || has_turn() && self.jobs.has_settings();
        while let Some(remake) = self.jobs.remakes().take(may) {
            let made = queue::guarded(|| self.make(&remake));
            let model = made.unwrap_or_else(|panicked| Err(panicked.to_string()));
            let _ = std::fs::remove_dir_all(self.work());
            if self.jobs.is_stopped() && model.is_err() {
                return;
            }
            if let Err(panicked) = queue::guarded(|| report(remake.capture, model, &tell)) {
                log::error!("a model that was made again: {panicked}");
            }
            // Better to report it twice, after a crash, than never.
            self.jobs.remakes().finish();
        }
    }

    fn work(&self) -> PathBuf {
        self.plan.parameters.folder.join(WORK)
    }

    fn make(&self, remake: &Remake) -> Result<Model, String> {
        let path = self.recording(&remake.capture).ok_or_else(|| {
            let folder = self.jobs.recordings().display();
            format!(
                "no recording in {folder} is named after capture {}",
                remake.capture
            )
        })?;
        let complete = finished_name(&path).unwrap_or_else(|| path.clone());
        let stem = complete.file_stem().unwrap_or_default();
        let limit = Duration::from_secs(self.plan.parameters.time_limit_s.into());
        let child = Child::start(&mut self.command(&path, remake));
        let waited = child.and_then(|child| child.wait(limit, self.plan.clock, self.jobs.cancel()));
        let (status, words) = match waited {
            Ok((ChildExit::Ended(status), words)) => (status, words),
            Ok((ChildExit::TimedOut, _)) => {
                return Err(format!(
                    "it did not finish within {} s (workers.time_limit_s)",
                    limit.as_secs()
                ));
            }
            Ok((ChildExit::Cancelled, _)) => return Err("the daemon is ending".into()),
            Err(error) => return Err(format!("the worker cannot be started: {error}")),
        };
        let made = self.work().join(stem).join(&remake.capture);
        let model = outcome::model(&made, status, &words, &self.plan.parameters)?;
        let beside = self.plan.parameters.folder.join(stem);
        let folder = name(&made, &beside, &remake.capture)?;
        Ok(Model { folder, ..model })
    }

    /// The recording that has the capture; its session's name is in its own.
    fn recording(&self, capture: &str) -> Option<PathBuf> {
        let has = |path: &PathBuf| {
            let Ok(recording) = Recording::open(path) else {
                return false;
            };
            let mut triggers = recording.messages(&Topic::Trigger).iter();
            triggers.any(|message| {
                let trigger = recording.trigger(message);
                trigger.is_ok_and(|trigger| trigger.id.as_str() == capture)
            })
        };
        let candidates = named(self.jobs.recordings(), session_of(capture));
        candidates.into_iter().find(has)
    }

    fn command(&self, path: &Path, remake: &Remake) -> Command {
        let parameters = &self.plan.parameters;
        let mut command = Command::new(self.plan.command.first().cloned().unwrap_or_default());
        let request = protocol::ModelRequest {
            confinement: protocol::Confinement {
                memory_mb: parameters.memory_mb,
                nice: NICE,
            },
            recording: path,
            capture: &remake.capture,
            models: &self.work(),
            config: &self.jobs.settings(),
        };
        command
            .args(self.plan.command.iter().skip(1))
            .args(request.arguments());
        for setting in &remake.settings {
            command.arg("--set").arg(setting);
        }
        command
    }
}

fn report(capture: String, model: Result<Model, String>, tell: impl Fn(RemakeResult)) {
    match &model {
        Ok(model) => log::notice!("{}: {}", model.folder.display(), model.verdict.name()),
        Err(reason) => log::warning!("capture {capture}: its model was not made again: {reason}"),
    }
    tell(RemakeResult { capture, model });
}

/// Gives a model that was made the first name beside the capture's own that is free: `CAPTURE.remake-1` and so on.
fn name(made: &Path, beside: &Path, capture: &str) -> Result<PathBuf, String> {
    let failed = |error: std::io::Error| format!("{}: {error}", beside.display());
    std::fs::create_dir_all(beside).map_err(failed)?;
    for number in 1..=MOST_OF_A_CAPTURE {
        let folder = beside.join(format!("{capture}.remake-{number}"));
        match storage::rename_noreplace(made, &folder) {
            Ok(()) => {
                storage::sync_folder(beside).map_err(failed)?;
                return Ok(folder);
            }
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(failed(error)),
        }
    }
    Err(format!(
        "the capture was made again {MOST_OF_A_CAPTURE} times: remove some of these models"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::Clock;
    use crate::reconstruct::Method;
    use crate::workers::Parameters;
    use std::collections::BTreeMap;

    #[test]
    fn a_remake_has_the_lowest_priority_and_its_settings_over_the_configured_ones() {
        let folder = tempfile::tempdir().unwrap();
        let parameters = Parameters {
            folder: folder.path().into(),
            nice: 3,
            ..Parameters::default()
        };
        let making = Making {
            jobs: Arc::new(Jobs::open(folder.path()).unwrap()),
            plan: WorkerPlan {
                parameters,
                settings: String::new(),
                clock: Clock::system(),
                method: Method::default(),
                keep_free: Arc::default(),
                command: vec!["scand".into()],
            },
        };
        let settings = BTreeMap::from([("hull.resolution".into(), 120.into())]);
        let remake = Remake::new("a-0001", &settings).unwrap();
        let command = making.command(Path::new("a.mcap"), &remake);
        let arguments = command.get_args();
        let arguments: Vec<_> = arguments.map(|a| a.to_string_lossy()).collect();
        assert!(arguments.iter().any(|a| a == "--nice=19"), "{arguments:?}");
        let set: Vec<_> = arguments.iter().skip_while(|a| *a != "--set").collect();
        let expected = [
            "--set",
            "hull.resolution=120.0",
            "--set",
            "hull.cell_size=0.0",
        ];
        assert_eq!(set, expected);
    }

    #[test]
    fn a_remake_takes_no_name_that_is_taken() {
        let folder = tempfile::tempdir().unwrap();
        let beside = folder.path().join("a");
        for expected in ["a-0001.remake-1", "a-0001.remake-2"] {
            let made = folder.path().join("made");
            std::fs::create_dir(&made).unwrap();
            let found = name(&made, &beside, "a-0001").unwrap();
            assert_eq!(found, beside.join(expected));
            assert!(!made.exists() && found.exists());
        }
    }
}

//! Finds the recording of a rig's job. One that is where it was is found without being opened; others are opened by a
//! confined child.

use super::dispatcher::Dispatcher;
use super::step::{self, FOUND};
use crate::log;
use crate::workers::find_unchanged;
use crate::workers::handover::OfferedJob;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::task::spawn_blocking;

impl Dispatcher {
    /// The recording in the folder `recordings` that has the job's capture now; `None` where none has, or where it
    /// cannot be found out.
    pub(super) async fn find_recording(
        self: &Arc<Self>,
        recordings: &Path,
        handed: &OfferedJob,
    ) -> Option<PathBuf> {
        if let Some(path) = find_unchanged(recordings, &handed.job) {
            return Some(path);
        }
        let _turn = self.children.acquire().await;
        let (offers, recordings, job) = (self.clone(), recordings.to_owned(), handed.file.clone());
        let found = spawn_blocking(move || offers.find_in_child(&recordings, &job)).await;
        found.ok().flatten()
    }

    fn find_in_child(&self, recordings: &Path, job: &Path) -> Option<PathBuf> {
        let number = self.next.fetch_add(1, Ordering::Relaxed);
        let spool = self.spool.path().join(number.to_string());
        let found = std::fs::create_dir_all(&spool).and_then(|()| {
            let options = vec![("recordings", recordings), ("job", job), ("to", &*spool)];
            let limits = step::Limits {
                memory_mb: self.plan.memory_mb,
                nice: self.plan.nice,
                time: Duration::from_secs(self.plan.time_limit_s.into()),
                threads: 1,
            };
            let ended = step::run("find", limits, &options, &[], &self.cancel)?;
            match ended.code {
                Some(0) => std::fs::read_to_string(spool.join(FOUND)),
                _ => Err(std::io::Error::other(ended.complaint())),
            }
        });
        let _ = std::fs::remove_dir_all(&spool);
        match found {
            Ok(name) => Some(name)
                .filter(|name| Path::new(name).file_name() == Some(name.as_ref()))
                .map(|name| recordings.join(name)),
            Err(problem) => {
                log::error!(
                    "{}: its recording cannot be found: {problem}",
                    job.display()
                );
                None
            }
        }
    }
}

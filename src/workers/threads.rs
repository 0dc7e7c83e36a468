//! Threads that take jobs until they are told to stop. What they do with a job stands in the files `*pool`.

use super::jobs::{Error, Jobs};
use crate::{log, queue};
use parking_lot::Mutex;
use std::path::PathBuf;
use std::sync::Arc;
use std::thread::JoinHandle;

/// Threads that take jobs, from outside. Dropping them ends them.
pub struct Workers {
    jobs: Arc<Jobs>,
    /// The folder of models, for messages.
    folder: PathBuf,
    threads: Mutex<Vec<JoinHandle<()>>>,
}

impl Workers {
    pub(super) fn new(jobs: &Arc<Jobs>, folder: PathBuf) -> Self {
        Self {
            jobs: jobs.clone(),
            folder,
            threads: Mutex::default(),
        }
    }

    /// Starts one more thread. Its work guards its jobs; a panic beside them ends the thread, and that is logged.
    ///
    /// # Errors
    /// If the system has no thread left.
    pub(super) fn spawn(
        &self,
        name: String,
        work: impl FnOnce() + Send + 'static,
    ) -> Result<(), Error> {
        let guarded = {
            let name = name.clone();
            move || {
                if let Err(panicked) = queue::guarded(work) {
                    log::error!(
                        "thread `{name}` ended, its jobs wait for the daemon's next start: {panicked}"
                    );
                }
            }
        };
        let thread = std::thread::Builder::new().name(name).spawn(guarded);
        let thread = thread.map_err(|cause| Error::Io {
            path: self.folder.clone(),
            cause,
        })?;
        self.threads.lock().push(thread);
        Ok(())
    }

    /// Ends the processes and the threads. What was being done is done after the next start.
    pub fn stop(&self) {
        self.jobs.stop();
        let threads = std::mem::take(&mut *self.threads.lock());
        for thread in threads {
            let _ = thread.join();
        }
    }
}

impl Drop for Workers {
    fn drop(&mut self) {
        self.stop();
    }
}

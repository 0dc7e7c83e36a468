//! Lets confined children look into recordings, and replay what cannot travel, on the machine that offers: this
//! process, which has the connection, opens none.

use super::dispatcher::Dispatcher;
use super::step::{self, ANSWER};
use crate::storage::with_advice;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::task::spawn_blocking;

/// What a child is to do with a recording.
#[derive(Clone, Debug)]
pub struct HereRequest {
    /// Its step: [`step::LIST`] or [`step::REPLAY`].
    pub step: &'static str,
    /// The recording.
    pub recording: PathBuf,
    /// The folder of all models.
    pub out: PathBuf,
    /// The configuration, as TOML.
    pub settings: String,
    /// More arguments of a replay.
    pub words: Vec<String>,
}

/// What a child answered.
#[derive(Clone, Debug)]
pub struct HereAnswer {
    /// JSON.
    pub answer: String,
    /// What a person should know, a line each.
    pub lines: Vec<String>,
}

impl Dispatcher {
    /// Lets a child do it.
    ///
    /// # Errors
    /// What it complained of, or why it ended without an answer.
    pub async fn replay_here(self: &Arc<Self>, request: HereRequest) -> Result<HereAnswer, String> {
        let _turn = self.children.acquire().await;
        let offers = self.clone();
        let ended = spawn_blocking(move || {
            let number = offers.next.fetch_add(1, Ordering::Relaxed);
            let spool = offers.spool.path().join(number.to_string());
            let answered = offers.in_child(&request, &spool);
            let _ = std::fs::remove_dir_all(&spool);
            answered
        });
        ended.await.map_err(|e| e.to_string())?
    }

    fn in_child(&self, request: &HereRequest, spool: &Path) -> Result<HereAnswer, String> {
        let (settings, calibration) = (spool.join("settings.toml"), spool.join("calibration.toml"));
        let mut files = vec![(&*settings, &*request.settings)];
        files.extend(
            self.plan
                .calibration
                .as_deref()
                .map(|text| (&*calibration, text)),
        );
        write_files(spool, &files)?;
        let mut options: step::Options = vec![
            ("replay", &request.recording),
            ("out", &request.out),
            ("config", &settings),
            ("to", spool),
        ];
        if self.plan.calibration.is_some() {
            options.push(("calibration", &calibration));
        }
        let limits = step::Limits {
            memory_mb: self.plan.memory_mb,
            nice: self.plan.nice,
            time: Duration::from_secs(self.plan.time_limit_s.into()),
            threads: 0,
        };
        let words: Vec<&str> = request.words.iter().map(String::as_str).collect();
        let ended = step::run(request.step, limits, &options, &words, &self.cancel)
            .map_err(|e| format!("no child can be started: {e}"))?;
        let lines = ended.lines();
        match std::fs::read_to_string(spool.join(ANSWER)) {
            Ok(answer) if ended.code == Some(0) => Ok(HereAnswer { answer, lines }),
            _ if ended.complaint().is_empty() => Err("it ended without saying why".into()),
            _ => Err(ended.complaint()),
        }
    }
}

/// Makes a folder and writes these files, which lie in it.
///
/// # Errors
/// What the system refused, and what to do about it.
fn write_files(folder: &Path, files: &[(&Path, &str)]) -> Result<(), String> {
    std::fs::create_dir_all(folder).map_err(|cause| with_advice(folder, &cause))?;
    for (path, text) in files {
        std::fs::write(path, text).map_err(|cause| with_advice(path, &cause))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_disk_comes_with_advice() {
        let full = Path::new("/dev/full");
        let problem = write_files(Path::new("/dev"), &[(full, "text")]).unwrap_err();
        assert!(problem.starts_with("/dev/full: "), "{problem}");
        assert!(
            problem.ends_with("free some space there, and try again"),
            "{problem}"
        );
    }
}

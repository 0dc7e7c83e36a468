//! Results that came while nobody listened: after a restart, or while the server could not be reached. Each is of
//! a job whose model is in place, and is compared with it as if it had come in time.

use super::dispatcher::Dispatcher;
use super::distrust::is_marked;
use super::job::JobReport;
use super::model_origin::ModelOrigin;
use super::status::stored_subjects;
use super::subjects::{self, RESULTS};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::task::spawn_blocking;

/// How often it is checked whether the connection was made again.
const INTERVAL: Duration = Duration::from_secs(5);

impl Dispatcher {
    /// Compares what came meanwhile, each time that the connection is made, for ever.
    pub(super) async fn compare_late_results(&self) {
        // Another model is wanted then: the one in place says nothing about the result.
        let replaces = self.plan.replace;
        let mut compared_at = None;
        while !replaces && !self.is_stopped() {
            let connections = self.fleet.connections();
            if self.fleet.is_connected()
                && compared_at != Some(connections)
                && self.compare_stored_results().await.is_ok()
            {
                compared_at = Some(connections);
            }
            self.pause(INTERVAL).await;
        }
    }

    async fn compare_stored_results(&self) -> Result<(), String> {
        let filter = subjects::result(&self.fleet.name, "*");
        let mut in_place = None;
        for subject in stored_subjects(&self.fleet, RESULTS, &filter).await? {
            let digest = subject.rsplit('.').next().unwrap_or_default();
            if !subjects::is_digest(digest) || self.is_waiting(digest) {
                continue;
            }
            let stored = self.fleet.stored(RESULTS, &subject).await;
            let stored = stored.map_err(|e| e.to_string())?;
            let Some(reported) = stored.and_then(|bytes| JobReport::parse(&bytes).ok()) else {
                continue;
            };
            if in_place.is_none() {
                let models = self.plan.models.clone();
                let found = spawn_blocking(move || models_in_place(&models)).await;
                in_place = Some(found.map_err(|e| e.to_string())?);
            }
            let committed = self.committed.lock().get(digest).cloned();
            let known = committed.or_else(|| in_place.as_ref()?.get(digest).cloned());
            // A job may have begun to wait for it meanwhile.
            if let Some(known) = known.filter(|_| !self.is_waiting(digest)) {
                self.compare(digest, &known, &reported).await;
            }
        }
        Ok(())
    }
}

/// The digests of contents of the fleet's models in a folder, by the digests of their jobs. A model whose worker is
/// distrusted is not among them.
fn models_in_place(models: &Path) -> BTreeMap<String, String> {
    let folders = |path: &Path| -> Vec<PathBuf> {
        let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
        let paths = entries.map(|entry| entry.path());
        paths.filter(|path| path.is_dir()).collect()
    };
    let targets = folders(models).into_iter().flat_map(|of| folders(&of));
    let origins = targets
        .filter(|target| !is_marked(target))
        .filter_map(|target| ModelOrigin::read(&target));
    origins
        .map(|origin| (origin.digest, origin.contents_sha256))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_are_found_by_their_jobs_but_for_those_of_distrusted_workers() {
        let home = tempfile::tempdir().unwrap();
        let place = |capture: &str, digest: &str| {
            let target = home.path().join("cup").join(capture);
            std::fs::create_dir_all(&target).unwrap();
            let origin = ModelOrigin {
                digest: digest.into(),
                contents_sha256: format!("contents of {digest}"),
                worker: "w".into(),
                made_of: String::new(),
            };
            origin.write(&target).unwrap();
            target
        };
        place("cup-000", "a");
        let marked = place("cup-001", "b");
        std::fs::write(marked.join(super::super::distrust::MARK), "").unwrap();
        let found = models_in_place(home.path());
        let expected = BTreeMap::from([("a".to_owned(), "contents of a".to_owned())]);
        assert_eq!(found, expected);
    }
}

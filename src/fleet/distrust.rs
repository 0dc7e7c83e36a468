//! Marks in the folders of models that a worker made which made another one wrong, for people and for the next run.

use super::model_origin::ModelOrigin;
use std::path::{Path, PathBuf};

pub(super) use crate::workers::distrusted::{MARK, is_marked};

/// Marks all models below a folder that a worker made; how many.
pub(super) fn mark_all(models: &Path, worker: &str) -> usize {
    let folders = |path: &Path| {
        let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
        let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
        paths.retain(|path| path.is_dir());
        paths.sort();
        paths
    };
    let targets = folders(models).into_iter().flat_map(|of| folders(&of));
    let made =
        targets.filter(|target| ModelOrigin::read(target).is_some_and(|l| l.worker == worker));
    let mark = |target: &PathBuf| {
        let words = format!(
            "The worker {worker} made this model. This rig made another of its models again and got a different one.\nMake \
             this one again before you rely on it: scand --replay RECORDING --force\n"
        );
        std::fs::write(target.join(MARK), words).is_ok()
    };
    made.filter(mark).count()
}

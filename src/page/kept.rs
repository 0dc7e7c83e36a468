//! The captures that this process heard of, kept in its own folder: those that have no report yet are not forgotten
//! when it is started again.

use super::now::{KeptCapture, Now};
use super::watch::Watch;
use crate::log;
use crate::storage::{self, read_text, write_atomically_for_owner};
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// The file's name.
const FILE: &str = "captures.json";
/// Largest file that is read, in bytes.
const LARGEST: u64 = 4 << 20;
/// How long changes are gathered before they are written.
const PAUSE: Duration = Duration::from_secs(2);

/// What the file has.
#[derive(Serialize, Deserialize)]
struct Kept {
    /// When it was written, in seconds since 1970.
    written_s: u64,
    captures: Vec<KeptCapture>,
}

/// The captures that an earlier process kept in this folder, and how long ago, by the clock on the wall. None that can
/// be read is as none at all.
pub(super) fn load(folder: &Path) -> Option<(Vec<KeptCapture>, Duration)> {
    let path = folder.join(FILE);
    let text = match read_text(&path, LARGEST) {
        Ok(text) => text,
        Err(error) => {
            if error.kind() != std::io::ErrorKind::NotFound {
                log::warning!("cannot read {}: {error}", path.display());
            }
            return None;
        }
    };
    match serde_json::from_str::<Kept>(&text) {
        Ok(kept) => {
            let ago_s = now_s().saturating_sub(kept.written_s);
            Some((kept.captures, Duration::from_secs(ago_s)))
        }
        Err(error) => {
            log::warning!(
                "{} is damaged, so earlier captures without a model are not listed: {error}",
                path.display()
            );
            None
        }
    }
}

/// Writes the captures that are known now.
///
/// # Errors
/// If the file cannot be written.
pub(super) fn store(folder: &Path, watch: &Watch) -> Result<(), storage::Error> {
    let kept = Kept {
        written_s: now_s(),
        captures: watch.look(|now| now.kept(Instant::now())),
    };
    let text = serde_json::to_string(&kept).unwrap_or_default();
    write_atomically_for_owner(&folder.join(FILE), text.as_bytes())
}

/// Writes them whenever something became known of one, for ever.
pub(super) async fn keep(folder: &Path, watch: &std::sync::Arc<Watch>) {
    let mut changes = watch.changes();
    let mut written = watch.look(Now::history);
    let mut has_failed = false;
    loop {
        if changes.changed().await.is_err() {
            return std::future::pending().await;
        }
        if watch.look(Now::history) == written {
            continue;
        }
        tokio::time::sleep(PAUSE).await;
        written = watch.look(Now::history);
        let (folder, watch) = (folder.to_owned(), watch.clone());
        let stored = tokio::task::spawn_blocking(move || store(&folder, &watch)).await;
        let error = stored.ok().and_then(Result::err);
        if let Some(error) = error.as_ref().filter(|_| !has_failed) {
            log::warning!("a restart of the page would forget captures without a model: {error}");
        }
        has_failed = error.is_some();
    }
}

fn now_s() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.unwrap_or_default().as_secs()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_kept_is_there_again_and_damage_is_as_nothing() {
        let folder = tempfile::tempdir().unwrap();
        assert!(load(folder.path()).is_none());
        let watch = Watch::new();
        let kept = r#"[{"capture":"a-0001","recording":"a","subject":"7","sign":"safe","reasons":[],
            "age_ms":5000}]"#;
        watch.restore(serde_json::from_str(kept).unwrap(), Duration::ZERO);
        store(folder.path(), &watch).unwrap();
        let (captures, ago) = load(folder.path()).unwrap();
        assert!(ago < Duration::from_secs(60));
        let again = Watch::new();
        again.restore(captures, ago);
        let names = again.look(|now| {
            now.captures()
                .map(|c| c.capture.clone())
                .collect::<Vec<_>>()
        });
        assert_eq!(names, ["a-0001"]);
        for damaged in ["", "[", r#"{"written_s":0}"#] {
            std::fs::write(folder.path().join(FILE), damaged).unwrap();
            assert!(load(folder.path()).is_none(), "{damaged:?}");
        }
    }
}

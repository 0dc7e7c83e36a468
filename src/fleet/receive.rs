//! Takes a result in: fetches it, lets a child check it and put it into place, and makes a share of the models again to
//! compare them.

use super::bundle::{has_model, stated_contents};
use super::dispatcher::{JobEvent, JobOutcome};
use super::distrust::{MARK, mark_all};
use super::file_sum::FileSum;
use super::job::{JobOffer, JobReport};
use super::job_state::{JobState, Received, SpaceFor, SpooledBytes};
use super::model_origin::ModelOrigin;
use super::step::{BUNDLE, EXIT_DIFFERS, EXIT_EQUAL, EXIT_REFUSED};
use super::subjects::{self, RESULTS};
use super::transfer::TransferError;
use crate::log;
use std::hash::BuildHasher;
use std::path::Path;
use std::time::Duration;

/// Ends what was announced of a model, by the code of the child that was to put it into place, unless the model is
/// there for sure. A child that was killed or cancelled has none, and may have put it there before.
fn end_announcement(target: &Path, code: Option<u8>) {
    match code {
        Some(0 | EXIT_EQUAL) => {}
        Some(_) => ModelOrigin::withdraw(target),
        None => ModelOrigin::settle(target),
    }
}

impl<T: Fn(JobEvent) + Sync> JobState<'_, T> {
    pub(super) async fn take(
        &mut self,
        offer: &JobOffer,
        made_of: &str,
        reported: &JobReport,
    ) -> Received {
        let fleet = &self.offers.fleet;
        let (worker, instance) = reported.sender();
        self.started.remove(instance);
        let subject = subjects::result(&fleet.name, &offer.digest);
        if self.offers.is_distrusted(worker) {
            self.offers.erase_result(&offer.digest, reported).await;
            return Received::Again;
        }
        match reported {
            JobReport::Crashed { reason, words, .. } => {
                if self.was_counted(reported) {
                    // What came in its place since then stays.
                    if self.result(offer).await.ok().flatten().as_ref() == Some(reported) {
                        fleet.erase(subject).await;
                    }
                    return Received::Nothing;
                }
                self.counted.extend(reported.crashed_attempt());
                fleet.erase(subject).await;
                self.crashed(offer, format!("worker {worker}: {reason}"), words)
                    .await
            }
            JobReport::Result {
                bytes,
                crc32,
                pieces,
                contents_sha256,
                ..
            } => {
                let sender = (worker, instance);
                let part = |piece| subjects::part(&fleet.name, &offer.digest, sender, piece);
                let bundle = self.spool.join(BUNDLE);
                let sum = FileSum {
                    bytes: *bytes,
                    crc32: *crc32,
                };
                self.wait_for_space(SpaceFor::Result(*bytes)).await;
                loop {
                    let fetched = tokio::select! {
                        fetched = fleet.fetch_file(RESULTS, part, sum, &bundle) => fetched,
                        () = self.offers.stopped() => return Received::Done(JobOutcome::Withdrawn),
                    };
                    self.set_waiting(fetched.is_err());
                    match fetched {
                        Ok(()) => break,
                        Err(TransferError::Gone | TransferError::Differs) => {
                            fleet.erase(subject).await;
                            self.report_problem(
                                "the server lost a part of the result; scand offers the job again",
                            );
                            return Received::Again;
                        }
                        Err(problem) => self.report_problem(&problem.to_string()),
                    }
                    if self.is_over() {
                        return Received::Done(self.withdraw(offer).await);
                    }
                    self.offers.pause(Duration::from_secs(2)).await;
                }
                let all = &self.offers.results_in_spool;
                let in_spool = SpooledBytes::count(all, *bytes);
                let taken = self
                    .commit(offer, made_of, (worker, contents_sha256), &bundle)
                    .await;
                let _ = std::fs::remove_file(&bundle);
                drop(in_spool);
                if !matches!(taken, Received::Done(JobOutcome::Withdrawn)) {
                    fleet.erase_file(*pieces, part).await;
                    fleet.erase(subject).await;
                }
                if matches!(
                    taken,
                    Received::Done(JobOutcome::Made | JobOutcome::Failed { .. })
                ) {
                    self.erase_capture(offer).await;
                }
                taken
            }
        }
    }

    /// A job whose child crashed, or whose result was refused.
    async fn crashed(&mut self, offer: &JobOffer, reason: String, words: &str) -> Received {
        let Some(reason) = self.count_crash(&reason) else {
            return Received::Again;
        };
        self.erase_capture(offer).await;
        let words = words.to_owned();
        Received::Done(JobOutcome::Failed { reason, words })
    }

    /// Lets a child check a result and put it into place.
    async fn commit(
        &mut self,
        offer: &JobOffer,
        made_of: &str,
        (worker, contents): (&str, &str),
        bundle: &Path,
    ) -> Received {
        loop {
            self.wait_for_space(SpaceFor::Model).await;
            let turn = self.offers.children.acquire().await;
            // So that it is known whose model it is even if this process is killed right after it was put into place.
            let origin = self.origin(offer, made_of, worker, contents);
            if let Err(error) = origin.announce(&self.task.target) {
                self.report_problem(&error.to_string());
            }
            let task = self.task.clone();
            let bundle = bundle.to_owned();
            let replace = self.replaces();
            let words = [
                format!("--contents={contents}"),
                format!("--name={}", task.name),
                format!("--capture={}", task.capture),
            ];
            let child = self.step("commit", move |run| {
                let options = vec![
                    ("bundle", &*bundle),
                    ("target", &task.target),
                    ("recording", &task.recording),
                ];
                let mut words: Vec<&str> = words.iter().map(String::as_str).collect();
                words.extend(replace.then_some("--replace"));
                run(&options, &words)
            });
            let ended = match child.await {
                Ok(ended) => ended,
                Err(_) if self.is_over() => return Received::Done(JobOutcome::Withdrawn),
                Err(error) => {
                    self.report_problem(&format!("no child can be started: {error}"));
                    drop(turn);
                    self.offers.pause(Duration::from_secs(5)).await;
                    continue;
                }
            };
            let code = ended.code.and_then(|code| u8::try_from(code).ok());
            end_announcement(&self.task.target, code);
            return match code {
                Some(0 | EXIT_EQUAL) => self.is_in_place(offer, made_of, worker, contents).await,
                Some(EXIT_DIFFERS) => self.differs(offer, worker, contents).await,
                Some(EXIT_REFUSED) => {
                    let reason = format!(
                        "worker {worker}: its result was refused: {}",
                        ended.complaint()
                    );
                    log::error!("capture {}: {reason}", self.task.capture);
                    self.crashed(offer, reason, &ended.words).await
                }
                _ if ended.cancelled || self.is_over() => Received::Done(JobOutcome::Withdrawn),
                // The models' disk itself is full: what others give back may not be enough.
                _ if self.lacks_space(SpaceFor::Capture) => {
                    self.report_problem(&ended.complaint());
                    drop(turn);
                    self.set_waiting(true);
                    self.offers.pause(Duration::from_secs(5)).await;
                    continue;
                }
                _ => {
                    let reason = format!(
                        "its result could not be put into place: {}",
                        ended.complaint()
                    );
                    self.crashed(offer, reason, &ended.words).await
                }
            };
        }
    }

    async fn is_in_place(
        &self,
        offer: &JobOffer,
        made_of: &str,
        worker: &str,
        contents: &str,
    ) -> Received {
        self.offers.note_committed(&offer.digest, contents);
        if has_model(&self.task.target) {
            self.note(&self.origin(offer, made_of, worker, contents));
        } else {
            // It is the report of a failure.
            ModelOrigin::withdraw(&self.task.target);
        }
        // Another result of this worker may have been found wrong while this one was put into place.
        if self.offers.is_distrusted(worker) {
            self.mark_models(worker);
            let reason = format!(
                "worker {worker} made another model wrongly, so this model is marked as distrusted"
            );
            let words = String::new();
            return Received::Done(JobOutcome::Failed { reason, words });
        }
        if self.is_to_be_rechecked(&offer.digest)
            && let Some(other) = self.recheck(contents).await
        {
            return Received::Done(self.is_wrong(worker, &other).await);
        }
        Received::Done(JobOutcome::Made)
    }

    /// Marks all models of a worker; how many.
    fn mark_models(&self, worker: &str) -> usize {
        let models = self.task.target.parent().and_then(Path::parent);
        models.map_or(0, |models| mark_all(models, worker))
    }

    fn origin(&self, offer: &JobOffer, made_of: &str, worker: &str, contents: &str) -> ModelOrigin {
        ModelOrigin {
            digest: offer.digest.clone(),
            contents_sha256: contents.to_owned(),
            worker: worker.to_owned(),
            made_of: made_of.to_owned(),
        }
    }

    /// Another model of the same job is in place.
    async fn differs(&self, offer: &JobOffer, worker: &str, contents: &str) -> Received {
        let known =
            ModelOrigin::read(&self.task.target).filter(|known| known.digest == offer.digest);
        let there = known.map(|known| known.contents_sha256);
        // People's notes on the picture of a model are no difference.
        if there.as_deref() == Some(contents) {
            self.offers.note_committed(&offer.digest, contents);
            return Received::Done(JobOutcome::Made);
        }
        self.offers.add_defect();
        let reason = format!(
            "worker {worker} sent a model that differs from the one in {}; scand keeps that one. Either one of them was \
             made by another version or with other settings, or one of the machines is faulty",
            self.task.target.display()
        );
        log::error!("capture {}: {reason}", self.task.capture);
        let words = String::new();
        Received::Done(JobOutcome::Failed { reason, words })
    }

    /// Whether this job is of the share that is made again. No worker can know it.
    fn is_to_be_rechecked(&self, digest: &str) -> bool {
        let place = self.offers.lots.hash_one(digest) as f64 / u64::MAX as f64;
        place < self.offers.plan.recheck || self.offers.plan.recheck >= 1.0
    }

    /// Makes the model here; what it is if it is another one.
    async fn recheck(&self, contents: &str) -> Option<String> {
        let (recording, spool) = (self.packed_path(), self.spool.clone());
        let out = spool.join("again");
        let stem = recording.file_stem().unwrap_or_default().to_owned();
        let bundle = out.join(stem).join(BUNDLE);
        let capture = format!("--capture={}", self.task.capture);
        let calibration = self.offers.plan.calibration.clone();
        let child = self.step("make", move |run| {
            let settings = spool.join("settings.toml");
            let other = spool.join("calibration.toml");
            let mut options = vec![
                ("replay", &*recording),
                ("out", &out),
                ("config", &settings),
            ];
            if let Some(text) = calibration {
                std::fs::write(&other, text)?;
                options.push(("calibration", &other));
            }
            run(&options, &[&capture, "--quiet"])
        });
        match child.await {
            Ok(ended) if bundle.exists() && ended.crash.is_none() => {
                let found = stated_contents(&bundle).ok();
                found.filter(|found| found != contents)
            }
            // That it cannot be made here says nothing of the worker.
            Ok(ended) => {
                self.report_problem(&format!("it was not made again: {}", ended.complaint()));
                None
            }
            Err(error) => {
                self.report_problem(&format!("it was not made again: {error}"));
                None
            }
        }
    }

    /// A worker's model is not the one that is made here: the worker is stopped, and what it made is marked.
    async fn is_wrong(&self, worker: &str, other: &str) -> JobOutcome {
        self.offers.add_defect();
        self.offers.distrust(worker);
        let capture = &self.task.capture;
        let fleet = &self.offers.fleet;
        let words = format!("rig {}, capture {capture}", fleet.name);
        self.offers.stop_worker(worker, words).await;
        let marked = self.mark_models(worker);
        let reason = format!(
            "worker {worker} made a model that differs from the one that this machine makes ({other}): this rig accepts no more results from that worker, and \
             has marked {marked} of its models with the file {MARK}, which says how to make them again"
        );
        log::error!("capture {capture}: {reason}");
        JobOutcome::Failed {
            reason,
            words: String::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::bundle::contents_sha256;
    use super::*;

    #[test]
    fn a_child_that_is_cancelled_after_its_model_was_put_into_place_leaves_whose_model_it_is() {
        let home = tempfile::tempdir().unwrap();
        let target = home.path().join("cup").join("a1");
        std::fs::create_dir_all(&target).unwrap();
        std::fs::write(target.join("report.json"), b"{}").unwrap();
        let origin = |contents: &str| ModelOrigin {
            digest: "d".into(),
            contents_sha256: contents.into(),
            worker: "w".into(),
            made_of: "m".into(),
        };
        let left = || std::fs::read_dir(home.path().join("cup")).unwrap().count();
        // Another model is there, and one that was refused.
        let there = contents_sha256(&target).unwrap();
        for (contents, code) in [("other", None), (&*there, Some(EXIT_REFUSED))] {
            origin(contents).announce(&target).unwrap();
            end_announcement(&target, code);
            assert_eq!((ModelOrigin::read(&target), left()), (None, 1));
        }
        origin(&there).announce(&target).unwrap();
        end_announcement(&target, None);
        assert_eq!(ModelOrigin::read(&target), Some(origin(&there)));
        assert_eq!(left(), 2);
    }
}

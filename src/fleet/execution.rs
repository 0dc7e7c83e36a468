//! How a worker does one job: fetches the capture, lets a confined child make the model, and sends the result, however
//! long the server is away meanwhile.

use super::bundle::stated_contents;
use super::file_sum::FileSum;
use super::job::{HeartbeatJob, JobOffer, JobReport};
use super::memory_class::MemoryClass;
use super::step::{self, BUNDLE};
use super::subjects::{self, CAPTURES, JobSubject};
use super::transfer::{FULL_PAUSE, Sent, TransferError, pieces};
use super::worker::Worker;
use crate::log;
use crate::storage::with_advice;
use async_nats::jetstream::{AckKind, Message};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use tokio::task::spawn_blocking;

/// How often a worker tells the server that it goes on with a job.
const PROGRESS_INTERVAL: Duration = Duration::from_secs(3);

/// Tells one delivery of a job from others, also from those of a server that lost everything and counts anew.
fn attempt(message: &Message) -> String {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    let now = since.unwrap_or_default().as_nanos();
    let info = message.info();
    info.map_or_else(
        |_| now.to_string(),
        |info| format!("{}-{}-{now}", info.stream_sequence, info.delivered),
    )
}

/// How a job ended for its worker.
enum ExecutionEnd {
    /// The rig has its report.
    JobReport,
    /// The capture is not on the server: nobody wants it any more, or it will be offered again.
    Gone,
    /// The worker stops.
    Stopped,
    /// The disk is full, or broken.
    Disk(String),
    /// Fetching the capture, or sending the result, took longer than the job may take.
    Slow(String),
}

impl ExecutionEnd {
    fn slow(doing: &str, offer: &JobOffer) -> Self {
        let limit = offer.time_limit_s;
        Self::Slow(format!(
            "{doing} took longer than the job's limit of {limit} s; the worker's connection is too slow"
        ))
    }
}

impl Worker {
    /// Does a job, and ends it at the server.
    pub(super) async fn run_job(&self, slot: usize, message: Message) {
        let subject = message.subject.to_string();
        let parts = JobSubject::parse(&subject);
        let Some(JobSubject {
            needs, rig, digest, ..
        }) = parts
        else {
            let _ = message.ack_with(AckKind::Term).await;
            return;
        };
        if message.payload.is_empty() {
            // It was withdrawn.
            let _ = message.ack().await;
            return;
        }
        let offer = match JobOffer::parse(&message.payload) {
            Ok(offer) if offer.digest == digest && self.has_memory(&offer, needs) => offer,
            Ok(offer) if offer.digest == digest => {
                let asked = offer.memory_mb;
                let problem = format!(
                    "the job asks for {asked} MB, but its subject is for memory class {needs}"
                );
                return self.refuse(&message, rig, digest, &problem).await;
            }
            Ok(_) => {
                return self
                    .refuse(&message, rig, digest, "its subject has another digest")
                    .await;
            }
            Err(problem) => return self.refuse(&message, rig, digest, &problem).await,
        };
        let capture = offer.capture.clone();
        let job = HeartbeatJob {
            rig: rig.to_owned(),
            digest: digest.to_owned(),
            capture: capture.clone(),
            seconds: 0.0,
        };
        self.running.lock().insert(slot, (job, Instant::now()));
        log::info!("capture {capture} of {rig}: its model is being made");
        self.report_started(rig, digest).await;
        self.send_heartbeat().await;
        let done = {
            let attempt = attempt(&message);
            let work = self.do_job(slot, rig, &offer, &attempt);
            tokio::pin!(work);
            let mut alive = tokio::time::interval(PROGRESS_INTERVAL);
            alive.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
            loop {
                tokio::select! {
                    done = &mut work => break done,
                    _ = alive.tick() => {
                        let _ = message.ack_with(AckKind::Progress).await;
                    }
                }
            }
        };
        match done {
            ExecutionEnd::JobReport | ExecutionEnd::Gone => {
                let _ = message.double_ack().await;
            }
            ExecutionEnd::Stopped => {
                let _ = message.ack_with(AckKind::Nak(None)).await;
            }
            ExecutionEnd::Disk(problem) | ExecutionEnd::Slow(problem) => {
                self.log_once(&format!(
                    "capture {capture} goes to another worker: {problem}"
                ));
                let later = Some(Duration::from_secs(15));
                let _ = message.ack_with(AckKind::Nak(later)).await;
                self.pause(Duration::from_secs(5)).await;
            }
        }
        self.running.lock().remove(&slot);
        self.send_heartbeat().await;
    }

    /// Whether a job asks for no more memory than its subject names and this worker gives.
    fn has_memory(&self, offer: &JobOffer, needs: &str) -> bool {
        let class = MemoryClass::of(offer.memory_mb);
        class.token() == needs && offer.memory_mb <= self.plan.memory_mb
    }

    async fn refuse(&self, message: &Message, rig: &str, digest: &str, problem: &str) {
        let reason = format!("the offer is not valid: {problem}");
        let attempt = attempt(message);
        self.report(rig, digest, &self.crash(&attempt, reason, String::new()))
            .await;
        let _ = message.ack_with(AckKind::Term).await;
    }

    fn crash(&self, attempt: &str, reason: String, words: String) -> JobReport {
        JobReport::Crashed {
            worker: self.fleet.name.clone(),
            instance: self.instance.clone(),
            attempt: attempt.to_owned(),
            reason,
            words,
        }
    }

    async fn do_job(
        &self,
        slot: usize,
        rig: &str,
        offer: &JobOffer,
        attempt: &str,
    ) -> ExecutionEnd {
        let folder = self.own.join(slot.to_string());
        let done = self.do_in(&folder, rig, offer, attempt).await;
        let _ = std::fs::remove_dir_all(&folder);
        done
    }

    async fn do_in(
        &self,
        folder: &Path,
        rig: &str,
        offer: &JobOffer,
        attempt: &str,
    ) -> ExecutionEnd {
        if let Some(full) = self.lack_of_space(offer.bytes) {
            return ExecutionEnd::Disk(full);
        }
        let place = match Place::new(folder, offer) {
            Ok(place) => place,
            Err(problem) => return ExecutionEnd::Disk(problem),
        };
        let fetched = tokio::select! {
            fetched = self.fetch(&place, rig, offer) => fetched,
            () = self.connected_for(offer.time_limit_s) => {
                Err(ExecutionEnd::slow("fetching its capture", offer))
            }
        };
        if let Err(ended) = fetched {
            return ended;
        }
        let ended = match self.make(&place, offer).await {
            Ok(ended) if ended.cancelled => return ExecutionEnd::Stopped,
            Ok(ended) => ended,
            Err(error) => return ExecutionEnd::Disk(format!("no child can be started: {error}")),
        };
        if let Some(full) = self.lack_of_space(0) {
            // Whatever it says then, the disk may be the reason.
            return ExecutionEnd::Disk(full);
        }
        let reported = if place.bundle.exists() && ended.crash.is_none() {
            let sent = tokio::select! {
                sent = self.send(&place.bundle, rig, offer, attempt) => sent,
                () = self.connected_for(offer.time_limit_s) => {
                    Err(ExecutionEnd::slow("sending its result", offer))
                }
            };
            match sent {
                Ok(reported) => reported,
                Err(done) => return done,
            }
        } else {
            self.crashed.fetch_add(1, Ordering::Relaxed);
            let complaint = match (ended.complaint(), ended.code) {
                (said, Some(code)) if said.is_empty() => {
                    format!("the child exited with code {code} and no output")
                }
                (said, _) => said,
            };
            log::error!("capture {}: {complaint}", offer.capture);
            self.crash(attempt, complaint, ended.words)
        };
        if self.report(rig, &offer.digest, &reported).await {
            self.results.fetch_add(1, Ordering::Relaxed);
            log::info!("capture {} of {rig}: its result was sent", offer.capture);
            ExecutionEnd::JobReport
        } else {
            ExecutionEnd::Stopped
        }
    }

    /// Fetches a capture, however long the server is away meanwhile.
    async fn fetch(&self, place: &Place, rig: &str, offer: &JobOffer) -> Result<(), ExecutionEnd> {
        loop {
            let subject = |piece| subjects::capture(rig, &offer.digest, piece);
            let fetched =
                self.fleet
                    .fetch_file(CAPTURES, subject, offer.file_sum(), &place.recording);
            match fetched.await {
                Ok(()) => return Ok(()),
                Err(TransferError::Gone | TransferError::Differs) => {
                    return Err(ExecutionEnd::Gone);
                }
                Err(TransferError::Disk(problem)) => return Err(ExecutionEnd::Disk(problem)),
                // No file is too large to be fetched.
                Err(problem @ TransferError::TooLarge { .. }) => {
                    return Err(ExecutionEnd::Disk(problem.to_string()));
                }
                Err(TransferError::ServerError(_)) if self.is_stopped() => {
                    return Err(ExecutionEnd::Stopped);
                }
                Err(TransferError::ServerError(problem)) => {
                    self.log_once(&problem.to_string());
                    self.pause(Duration::from_secs(1)).await;
                }
            }
        }
    }

    /// Returns when the server has been there for so many seconds.
    async fn connected_for(&self, seconds: u32) {
        let mut there = 0;
        while there < seconds {
            tokio::time::sleep(Duration::from_secs(1)).await;
            there += u32::from(self.fleet.is_connected());
        }
    }

    /// Lets a child make the model.
    async fn make(&self, place: &Place, offer: &JobOffer) -> std::io::Result<step::StepEnd> {
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        let limits = step::Limits {
            memory_mb: offer.memory_mb,
            nice: self.plan.nice,
            time: Duration::from_secs(offer.time_limit_s.into()),
            threads: (processors / self.plan.jobs).max(1),
        };
        let (place, cancel) = (place.clone(), self.cancel.clone());
        let capture = format!("--capture={}", offer.capture);
        let child = spawn_blocking(move || {
            let mut options: step::Options = vec![
                ("replay", &place.recording),
                ("out", &place.out),
                ("config", &place.settings),
            ];
            options.extend(
                place
                    .calibration
                    .as_ref()
                    .map(|path| ("calibration", &**path)),
            );
            step::run("make", limits, &options, &[&capture, "--quiet"], &cancel)
        });
        child.await.map_err(std::io::Error::other)?
    }

    /// Sends a result's pieces. Returns what is to be reported of it.
    async fn send(
        &self,
        bundle: &Path,
        rig: &str,
        offer: &JobOffer,
        attempt: &str,
    ) -> Result<JobReport, ExecutionEnd> {
        let known = || -> Result<(String, FileSum), String> {
            let contents = stated_contents(bundle).map_err(|e| e.to_string())?;
            let sum = FileSum::of(bundle).map_err(|e| e.to_string())?;
            Ok((contents, sum))
        };
        let (contents_sha256, sum) = known().map_err(ExecutionEnd::Disk)?;
        let FileSum { bytes, crc32 } = sum;
        if bytes > JobReport::LARGEST {
            return Ok(self.crash(
                attempt,
                format!("its result has {bytes} bytes"),
                String::new(),
            ));
        }
        let own = (self.fleet.name.as_str(), self.instance.as_str());
        let subject = |piece| subjects::part(rig, &offer.digest, own, piece);
        let mut sent = Sent::default();
        while let Err(problem) = self.fleet.send_file(bundle, subject, &mut sent).await {
            if self.is_stopped() {
                return Err(ExecutionEnd::Stopped);
            }
            self.log_once(&problem.to_string());
            if problem.is_full() {
                // Parts that only wait for room would keep others from theirs.
                self.fleet.erase_file(pieces(bytes), subject).await;
                sent = Sent::default();
                self.pause(FULL_PAUSE).await;
            }
            self.pause(Duration::from_secs(1)).await;
        }
        Ok(JobReport::Result {
            worker: self.fleet.name.clone(),
            instance: self.instance.clone(),
            bytes,
            crc32,
            pieces: pieces(bytes),
            contents_sha256,
        })
    }

    /// Tells the rig, however long the server is away; false if the worker stops before.
    async fn report(&self, rig: &str, digest: &str, reported: &JobReport) -> bool {
        let bytes = serde_json::to_vec(reported).unwrap_or_default();
        loop {
            let subject = subjects::result(rig, digest);
            match self.fleet.store(subject, bytes.clone().into()).await {
                Ok(()) => return true,
                Err(_) if self.is_stopped() => return false,
                Err(problem) => {
                    self.log_once(&problem.to_string());
                    self.pause(Duration::from_secs(1)).await;
                }
            }
        }
    }

    async fn report_started(&self, rig: &str, digest: &str) {
        let started = serde_json::json!({"worker": self.fleet.name, "instance": self.instance});
        let subject = subjects::started(rig, digest, &self.fleet.name);
        let _ = self
            .fleet
            .client
            .publish(subject, started.to_string().into())
            .await;
    }
}

/// Where the files of one job are.
#[derive(Clone)]
struct Place {
    recording: PathBuf,
    settings: PathBuf,
    calibration: Option<PathBuf>,
    out: PathBuf,
    bundle: PathBuf,
}

impl Place {
    fn new(folder: &Path, offer: &JobOffer) -> Result<Self, String> {
        let refused = |cause| with_advice(folder, &cause);
        let _ = std::fs::remove_dir_all(folder);
        std::fs::create_dir_all(folder).map_err(refused)?;
        let recording = folder.join(&offer.recording);
        let out = folder.join("out");
        let stem = recording.file_stem().unwrap_or_default();
        let bundle = out.join(stem).join(BUNDLE);
        let settings = folder.join("settings.toml");
        std::fs::write(&settings, &offer.settings).map_err(refused)?;
        let calibration = offer
            .calibration
            .as_ref()
            .map(|_| folder.join("calibration.toml"));
        if let (Some(path), Some(text)) = (&calibration, &offer.calibration) {
            std::fs::write(path, text).map_err(refused)?;
        }
        Ok(Self {
            recording,
            settings,
            calibration,
            out,
            bundle,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::job::an_offer;
    use super::*;
    use crate::storage::advice;

    #[test]
    fn a_folder_that_the_system_refuses_comes_with_advice() {
        let folder = Path::new("/sys/scand");
        let cause = std::fs::create_dir_all(folder).unwrap_err();
        assert!(!advice(&cause).is_empty(), "{cause}");
        let problem = Place::new(folder, &an_offer()).err().unwrap();
        assert_eq!(problem, with_advice(folder, &cause));
    }
}

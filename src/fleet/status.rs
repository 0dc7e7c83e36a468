//! What a fleet is doing, for people and programs: jobs that wait and run, workers, and failures with their reasons. It
//! only looks, except that it passes on a person's wish to have failed jobs offered again.

use super::connection::FleetClient;
use super::dispatcher::{Dispatcher, Task};
use super::job::{Heartbeat, clean, seconds_since_1970};
use super::memory_class::MemoryClass;
use super::store::ServerError;
use super::subjects::{self, FAILURES, JOBS, JobSubject};
use bytes::Bytes;
use futures_util::{StreamExt, future, stream};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tokio::time::timeout;

/// A worker says that it lives every three seconds.
const LISTEN_TIME: Duration = Duration::from_secs(4);
/// Failures that are listed at most.
const MAX_FAILURES: usize = 1000;
/// Questions to the server at the same time.
const QUESTIONS: usize = 64;
/// How long the server may take for an answer.
const ANSWER_TIME: Duration = Duration::from_secs(2);

/// What a fleet is doing.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Status {
    /// Jobs that nobody does yet, by what they need.
    pub waiting: Vec<Waiting>,
    /// The workers that are there, with what they do.
    pub workers: Vec<Heartbeat>,
    /// Jobs that failed.
    pub failed: Vec<JobFailure>,
}

/// Jobs of one rig that wait for the same kind of worker.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Waiting {
    /// The rig.
    pub rig: String,
    /// The program that has to make them, as subjects name it.
    pub program: String,
    /// The class of memory, `m4` for up to 4 GB.
    pub needs: String,
    /// How many.
    pub jobs: usize,
    /// Whether a worker is there that can do them.
    pub has_worker: bool,
}

/// A job that failed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobFailure {
    /// The rig.
    pub rig: String,
    /// The capture.
    pub capture: String,
    /// The recording.
    pub recording: String,
    /// Why.
    pub reason: String,
    /// When, in seconds since 1970.
    pub time_s: u64,
}

impl Dispatcher {
    /// Tells people on other machines that a job failed; false if the server cannot be told now.
    pub async fn tell_failure(&self, task: &Task, reason: &str) -> bool {
        let failed = JobFailure {
            capture: task.capture.clone(),
            recording: task.name.clone(),
            reason: clean(reason, 1000),
            time_s: seconds_since_1970(),
            rig: self.fleet.name.clone(),
        };
        let bytes = serde_json::to_vec(&failed).unwrap_or_default();
        let subject = self.subject_of_failure(task);
        self.fleet.store(subject, bytes.into()).await.is_ok()
    }

    /// Takes back that a job failed: it has a result now. False if the server cannot be told now.
    pub async fn forget_failure(&self, task: &Task) -> bool {
        let subject = self.subject_of_failure(task);
        let told = match self.fleet.stored(FAILURES, &subject).await {
            Ok(Some(_)) => self.fleet.store(subject, Bytes::new()).await,
            Ok(None) => Ok(()),
            Err(problem) => {
                // A question to a stream that is not there stays without an answer. The next one shall not.
                let _ = self.fleet.make_streams().await;
                Err(problem)
            }
        };
        told.is_ok()
    }

    fn subject_of_failure(&self, task: &Task) -> String {
        let digest = super::job::digest_of_text(&format!("{} {}", task.name, task.capture));
        subjects::failure(&self.fleet.name, &digest)
    }
}

/// Waits for the connection, which is made in the background.
async fn wait_for_server(fleet: &FleetClient) -> Result<(), String> {
    for _ in 0..50 {
        if fleet.is_connected() {
            return Ok(());
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    Err("the server does not answer".into())
}

/// Asks what a fleet is doing; takes four seconds.
///
/// # Errors
/// If the server does not answer.
pub async fn status(fleet: &FleetClient) -> Result<Status, String> {
    wait_for_server(fleet).await?;
    let mut heard = fleet
        .client
        .subscribe("scand.worker.*")
        .await
        .map_err(|e| e.to_string())?;
    let mut workers: BTreeMap<(String, String), Heartbeat> = BTreeMap::new();
    let until = tokio::time::Instant::now() + LISTEN_TIME;
    while let Ok(Some(message)) = tokio::time::timeout_at(until, heard.next()).await {
        if let Ok(said) = Heartbeat::parse(&message.payload) {
            workers.insert((said.worker.clone(), said.instance.clone()), said);
        }
    }
    let workers: Vec<Heartbeat> = workers.into_values().collect();
    let jobs = stored_subjects(fleet, JOBS, "scand.job.>").await?;
    let jobs = wanted(fleet, jobs).await;
    let failures = stored_subjects(fleet, FAILURES, "scand.failure.>").await?;
    let mut failed = Vec::new();
    for subject in &failures {
        if failed.len() >= MAX_FAILURES {
            break;
        }
        let stored = fleet.stored(FAILURES, subject).await;
        let stored = stored.map_err(|e| e.to_string())?;
        let parsed = stored.and_then(|bytes| serde_json::from_slice::<JobFailure>(&bytes).ok());
        failed.extend(parsed.map(|failed| JobFailure {
            rig: clean(&failed.rig, 60),
            capture: clean(&failed.capture, 200),
            recording: clean(&failed.recording, 200),
            reason: clean(&failed.reason, 1000),
            ..failed
        }));
    }
    failed.sort_by(|a, b| (a.time_s, &a.capture).cmp(&(b.time_s, &b.capture)));
    Ok(Status {
        waiting: waiting(&jobs, &workers),
        workers,
        failed,
    })
}

/// Leaves out jobs that were withdrawn: their messages are empty, and stay until a worker meets them. Those that the
/// server does not show count as wanted.
async fn wanted(fleet: &FleetClient, jobs: Vec<String>) -> Vec<String> {
    let checked = stream::iter(jobs).map(|subject| async move {
        let stored = timeout(ANSWER_TIME, fleet.stored(JOBS, &subject)).await;
        let withdrawn = matches!(stored, Ok(Ok(None)));
        (!withdrawn).then_some(subject)
    });
    let kept = checked.buffered(QUESTIONS).filter_map(future::ready);
    kept.collect().await
}

fn waiting(jobs: &[String], workers: &[Heartbeat]) -> Vec<Waiting> {
    let runs = |digest: &str| {
        let mut jobs = workers.iter().flat_map(|worker| &worker.jobs);
        jobs.any(|job| job.digest == digest)
    };
    let has_worker = |program: &str, needs: &str| {
        let can_do = |worker: &Heartbeat| {
            worker.program.replace('.', "_") == program
                && MemoryClass::fits(needs, worker.memory_mb)
        };
        workers.iter().any(can_do)
    };
    let mut waiting: BTreeMap<(&str, &str, &str), usize> = BTreeMap::new();
    for subject in jobs {
        if let Some(job) = JobSubject::parse(subject)
            && !runs(job.digest)
        {
            let key = (job.rig, job.program, job.needs);
            *waiting.entry(key).or_default() += 1;
        }
    }
    let of = |((rig, program, needs), jobs): ((&str, &str, &str), usize)| Waiting {
        rig: rig.into(),
        program: program.into(),
        needs: needs.into(),
        jobs,
        has_worker: has_worker(program, needs),
    };
    waiting.into_iter().map(of).collect()
}

/// The subjects that have a message in a stream; none if the stream is not there yet.
pub(super) async fn stored_subjects(
    fleet: &FleetClient,
    stream: &str,
    filter: &str,
) -> Result<Vec<String>, String> {
    const NO_SUCH_STREAM: u64 = 404;
    let mut found = BTreeSet::new();
    loop {
        let asked = serde_json::json!({"subjects_filter": filter, "offset": found.len()});
        let answer = fleet
            .client
            .request(
                format!("$JS.API.STREAM.INFO.{stream}"),
                asked.to_string().into(),
            )
            .await
            .map_err(|e| ServerError::error_while("answer")(&e).to_string())?;
        let answer: Value = serde_json::from_slice(&answer.payload).map_err(|e| e.to_string())?;
        match answer["error"]["code"].as_u64() {
            Some(NO_SUCH_STREAM) => return Ok(Vec::new()),
            Some(_) => {
                let why = &answer["error"]["description"];
                return Err(format!("the server refuses: {why}"));
            }
            None => {}
        }
        let known = found.len();
        let page = answer["state"]["subjects"].as_object();
        found.extend(
            page.into_iter()
                .flatten()
                .map(|(subject, _)| subject.clone()),
        );
        // A server gives 100,000 at a time; what comes and goes meanwhile may move the others by a place.
        let all = answer["total"].as_u64().unwrap_or_default();
        if found.len() == known || found.len() as u64 >= all {
            return Ok(found.into_iter().collect());
        }
    }
}

/// Asks a rig to offer failed jobs again: that of a capture, or all. Returns how many it offers.
///
/// # Errors
/// If the server or the rig does not answer, or the rig cannot offer them.
pub async fn retry(fleet: &FleetClient, rig: &str, capture: Option<&str>) -> Result<usize, String> {
    let rig = subjects::token(rig).map_err(|e| e.to_string())?;
    let wanted = Bytes::from(capture.unwrap_or_default().to_owned());
    wait_for_server(fleet).await?;
    let answer = fleet.client.request(subjects::retry(&rig), wanted).await;
    let answer = answer.map_err(|e| format!("rig {rig} does not answer: {e}"))?;
    let answer = clean(&String::from_utf8_lossy(&answer.payload), 200);
    answer
        .parse()
        .map_err(|_| format!("rig {rig} cannot offer them again: {answer}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fleet::HeartbeatJob;

    #[test]
    fn jobs_that_run_do_not_wait_and_jobs_without_a_worker_are_told() {
        let digest = |c: char| c.to_string().repeat(64);
        let job = |program: &str, c: char| format!("scand.job.{program}.m4.hall.{}", digest(c));
        let worker = Heartbeat {
            worker: "w".into(),
            instance: "i".into(),
            program: "0.1.0-x-y".into(),
            jobs: vec![HeartbeatJob {
                rig: "hall".into(),
                digest: digest('a'),
                capture: "cup".into(),
                seconds: 1.0,
            }],
            results: 0,
            crashed: 0,
            memory_mb: 4000,
            time_s: 0,
        };
        let large = job("0_1_0-x-y", 'd').replace(".m4.", ".m16.");
        let jobs = [
            job("0_1_0-x-y", 'a'),
            job("0_1_0-x-y", 'b'),
            job("old", 'c'),
            large,
        ];
        let waiting = waiting(&jobs, &[worker]);
        let told: Vec<_> = waiting
            .iter()
            .map(|w| (&*w.program, &*w.needs, w.jobs, w.has_worker))
            .collect();
        assert_eq!(
            told,
            [
                ("0_1_0-x-y", "m16", 1, false),
                ("0_1_0-x-y", "m4", 1, true),
                ("old", "m4", 1, false)
            ]
        );
    }
}

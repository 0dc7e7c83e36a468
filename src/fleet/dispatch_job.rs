//! What happens to one job, from a capture in a recording to a result in its folder: packed, offered, waited for, taken
//! in, and offered again whenever the server has lost it or its worker has failed.

use super::bundle::has_model;
use super::dispatcher::{Dispatcher, JobEvent, JobMessage, JobOutcome, Started, Task};
use super::job::{JobOffer, JobReport};
use super::job_state::{JobState, Received, SpaceFor, SpooledBytes};
use super::model_origin::ModelOrigin;
use super::step::Packed;
use super::store::ServerError;
use super::subjects::{self, CAPTURES, JOBS, RESULTS};
use super::transfer::{FULL_PAUSE, Sent, TransferError, pieces};
use crate::storage::with_advice;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};
use tokio::sync::mpsc;

/// How many workers may go away for ever while they do one job.
const MAX_LOST_WORKERS: usize = 10;
/// A worker that has not been heard of for this long, while the server was there, is lost.
const LOST_AFTER: Duration = Duration::from_secs(25);
/// How much longer than its limits a job may take a worker that the server reaches.
const HOLDING_MARGIN: Duration = Duration::from_secs(120);
/// How often the server is asked for what may have been missed.
const POLL_INTERVAL: Duration = Duration::from_secs(4);
/// How often in a row a job may be missing on the server before it is offered again.
const MAX_MISSING: u32 = 2;

impl Dispatcher {
    /// Brings a job to its end.
    pub async fn run_job(
        self: &Arc<Self>,
        task: &Task,
        on_event: impl Fn(JobEvent) + Sync,
    ) -> JobOutcome {
        JobState::new(self, task, &on_event).run().await
    }
}

impl<T: Fn(JobEvent) + Sync> JobState<'_, T> {
    async fn run(mut self) -> JobOutcome {
        let ended = self.offer_and_wait().await;
        let _ = std::fs::remove_dir_all(&self.spool);
        ended
    }

    async fn offer_and_wait(&mut self) -> JobOutcome {
        let plan = &self.offers.plan;
        let calibration = plan.calibration.clone().unwrap_or_default();
        let program = plan.program.to_string();
        let parts = [
            &*self.task.capture,
            &self.task.settings,
            &calibration,
            &program,
        ];
        let made_of = ModelOrigin::made_of(&self.task.recording, &parts).unwrap_or_default();
        ModelOrigin::settle(&self.task.target);
        let known = ModelOrigin::read(&self.task.target).filter(|_| has_model(&self.task.target));
        let known = known.filter(|_| !self.replaces());
        if let Some(known) = &known
            && known.made_of == made_of
        {
            return JobOutcome::Unchanged;
        }
        if known.is_none() && has_model(&self.task.target) && !self.replaces() {
            let reason = "its folder already has a model that the fleet did not make".into();
            return JobOutcome::MakeLocally { reason };
        }
        let packed = match self.pack().await {
            Ok(packed) => packed,
            Err(ended) => return ended,
        };
        let offer = self.offer(&packed);
        if let Some(known) = known {
            if known.digest == offer.digest {
                self.note(&ModelOrigin { made_of, ..known });
                return JobOutcome::Unchanged;
            }
            // It is refused there as any other model that is not to be replaced.
            let reason =
                "its folder has a model that was made with other settings or by another version"
                    .into();
            return JobOutcome::MakeLocally { reason };
        }
        if let Err(problem) = offer.check() {
            return JobOutcome::MakeLocally { reason: problem };
        }
        let news = self.offers.subscribe_job(&offer.digest);
        let ended = self.until_committed(&offer, &made_of, news).await;
        self.offers.leave(&offer.digest);
        ended
    }

    fn offer(&self, packed: &Packed) -> JobOffer {
        let (plan, task) = (&self.offers.plan, self.task);
        JobOffer {
            digest: JobOffer::digest_of(
                &plan.program,
                (&task.name, &task.capture),
                &packed.content_sha256,
                &task.settings,
                plan.calibration.as_deref(),
            ),
            capture: task.capture.clone(),
            recording: task.name.clone(),
            bytes: packed.bytes,
            crc32: packed.crc32,
            pieces: pieces(packed.bytes),
            settings: task.settings.clone(),
            calibration: plan.calibration.clone(),
            memory_mb: plan.memory_mb,
            time_limit_s: plan.time_limit_s,
        }
    }

    /// Lets a child write the capture's own recording.
    async fn pack(&mut self) -> Result<Packed, JobOutcome> {
        let failed = |reason: String| JobOutcome::Failed {
            reason,
            words: String::new(),
        };
        let offers = self.offers;
        loop {
            // What is packed takes space that captures need, and nobody can take it yet.
            self.wait_for_server().await;
            self.wait_for_space(SpaceFor::Capture).await;
            if self.is_over() {
                return Err(JobOutcome::Withdrawn);
            }
            let _turn = offers.children.acquire().await;
            // Others may have needed the space meanwhile, and none of them may wait for this one.
            if offers.fleet.is_there().is_err() || self.lacks_space(SpaceFor::Capture) {
                continue;
            }
            let to = self.packed_path();
            let folder = self.spool.join("packed");
            let settings = self.spool.join("settings.toml");
            let prepared = || {
                let _ = std::fs::remove_dir_all(&self.spool);
                std::fs::create_dir_all(&folder)?;
                std::fs::write(&settings, &self.task.settings)
            };
            prepared().map_err(|e| failed(with_advice(&folder, &e)))?;
            let recording = self.task.recording.clone();
            let capture = format!("--capture={}", self.task.capture);
            let child = self.step("pack", move |run| {
                let options = vec![
                    ("recording", &*recording),
                    ("config", &settings),
                    ("to", &to),
                ];
                run(&options, &[&capture])
            });
            let ended = child
                .await
                .map_err(|e| failed(format!("no child can be started: {e}")))?;
            match (ended.code, &ended.crash) {
                (Some(0), _) => {
                    let packed = Packed::read(&folder).map_err(failed)?;
                    let all = &offers.captures_in_spool;
                    self.packed = Some(SpooledBytes::count(all, packed.bytes));
                    return Ok(packed);
                }
                _ if ended.cancelled => return Err(JobOutcome::Withdrawn),
                (_, Some(_)) => match self.count_crash(&ended.complaint()) {
                    Some(reason) => return Err(failed(reason)),
                    None => continue,
                },
                _ if self.lacks_space(SpaceFor::Capture) => {
                    self.report_problem(&ended.complaint());
                }
                _ => {
                    return Err(JobOutcome::MakeLocally {
                        reason: ended.complaint(),
                    });
                }
            }
        }
    }

    /// Puts the job on the server; the capture first, so that no worker looks for it in vain.
    async fn send(&self, offer: &JobOffer, sent: &mut Sent) -> Result<(), TransferError> {
        let fleet = &self.offers.fleet;
        fleet.make_streams().await?;
        let bytes = offer.bytes;
        // Each piece takes some more there.
        let most = fleet.capacity(CAPTURES).map(|all| all / 10 * 9);
        if let Some(most) = most.filter(|most| bytes > *most) {
            return Err(TransferError::TooLarge { bytes, most });
        }
        let piece = |piece| subjects::capture(&fleet.name, &offer.digest, piece);
        fleet.send_file(&self.packed_path(), piece, sent).await?;
        let bytes = serde_json::to_vec(offer).unwrap_or_default();
        fleet.store(self.subject(offer), bytes.into()).await?;
        (self.on_event)(JobEvent::Offered);
        Ok(())
    }

    /// As [`Self::send`], however long that takes.
    ///
    /// # Errors
    /// How the job ended instead: nobody wants it any more, or it cannot travel.
    async fn send_patiently(&self, offer: &JobOffer) -> Result<(), JobOutcome> {
        let mut sent = Sent::default();
        while !self.is_over() {
            // Whoever stops the program does not wait for files that wait for their turn.
            let done = tokio::select! {
                done = self.send(offer, &mut sent) => done,
                () = self.offers.stopped() => break,
            };
            match done {
                Ok(()) => return Ok(()),
                Err(problem @ TransferError::TooLarge { .. }) => {
                    let reason = problem.to_string();
                    return Err(JobOutcome::MakeLocally { reason });
                }
                Err(problem) => {
                    self.report_problem(&problem.to_string());
                    if problem.is_full() {
                        // Pieces of what does not fit would keep others from becoming whole.
                        self.erase_capture(offer).await;
                        sent = Sent::default();
                        self.offers.pause(FULL_PAUSE).await;
                    }
                    self.offers.pause(Duration::from_secs(2)).await;
                }
            }
        }
        Err(self.withdraw(offer).await)
    }

    /// Whether the server has the job, or its result. The report of a crash that was counted is none: it may stay there
    /// for days, and nobody does the job.
    async fn is_there(&self, offer: &JobOffer) -> Result<bool, ServerError> {
        let fleet = &self.offers.fleet;
        // The job first: a worker brings the result before it acknowledges the job.
        let job = fleet.stored(JOBS, &self.subject(offer)).await?;
        let is_news = |report: JobReport| !self.was_counted(&report);
        Ok(job.is_some() || self.result(offer).await?.is_some_and(is_news))
    }

    /// What the server has as the job's result.
    pub(super) async fn result(&self, offer: &JobOffer) -> Result<Option<JobReport>, ServerError> {
        let fleet = &self.offers.fleet;
        let subject = subjects::result(&fleet.name, &offer.digest);
        let stored = fleet.stored(RESULTS, &subject).await?;
        Ok(stored.and_then(|bytes| JobReport::parse(&bytes).ok()))
    }

    async fn until_committed(
        &mut self,
        offer: &JobOffer,
        made_of: &str,
        mut news: mpsc::Receiver<JobMessage>,
    ) -> JobOutcome {
        // An earlier run may have offered it.
        if !self.is_there(offer).await.unwrap_or(false)
            && let Err(ended) = self.send_patiently(offer).await
        {
            return ended;
        }
        let mut missing = 0;
        // However many messages come from it meanwhile.
        let mut next_question = Instant::now() + POLL_INTERVAL;
        loop {
            let wait = next_question.saturating_duration_since(Instant::now());
            let heard = tokio::select! {
                heard = news.recv() => Some(heard),
                () = self.offers.pause(wait) => None,
            };
            let reported = match heard {
                Some(Some(JobMessage::Started(started))) => {
                    self.has_started(started);
                    None
                }
                Some(Some(JobMessage::Reported(reported))) => Some(reported),
                Some(None) => return JobOutcome::Withdrawn,
                None => {
                    next_question = Instant::now() + POLL_INTERVAL;
                    if let Some(ended) = self.over_or_lost(offer).await {
                        return ended;
                    }
                    if let Some(worker) = self.too_slow(offer) {
                        let reason = format!("worker {worker} took the job and sent no result");
                        if let Some(reason) = self.count_crash(&reason) {
                            self.erase_capture(offer).await;
                            let words = String::new();
                            return JobOutcome::Failed { reason, words };
                        }
                        missing = MAX_MISSING;
                    }
                    match self.is_there(offer).await {
                        // A job that is offered once more replaces the one that a worker holds.
                        Ok(true) if missing < MAX_MISSING => missing = 0,
                        Ok(true) => {}
                        Ok(false) => missing += 1,
                        // A server that has lost its streams does not say so: a question to one that is not there stays
                        // without an answer. Once they are there again, the next question finds the job missing.
                        Err(_) => drop(self.offers.fleet.make_streams().await),
                    }
                    self.result(offer).await.ok().flatten()
                }
            };
            let again = match reported {
                Some(reported) => match self.take_in(offer, made_of, &reported).await {
                    Received::Done(ended) => {
                        self.compare_others(offer, &ended, news).await;
                        return ended;
                    }
                    Received::Again => true,
                    Received::Nothing => false,
                },
                None => missing >= MAX_MISSING,
            };
            if again {
                missing = 0;
                if let Err(ended) = self.send_patiently(offer).await {
                    return ended;
                }
            }
        }
    }

    /// Takes a result in, and says meanwhile that the job is not neglected, unless it waits for space or the server:
    /// checking a result, and making it again, may take longer than a rig waits for workers.
    async fn take_in(&mut self, offer: &JobOffer, made_of: &str, reported: &JobReport) -> Received {
        let on_event = self.on_event;
        let (worker, _) = reported.sender();
        let waits = self.waits.clone();
        let taking = self.take(offer, made_of, reported);
        tokio::pin!(taking);
        let mut tick = tokio::time::interval(POLL_INTERVAL);
        loop {
            tokio::select! {
                taken = &mut taking => return taken,
                _ = tick.tick() => {
                    if !waits.load(Ordering::Relaxed) {
                        on_event(JobEvent::Started(worker));
                    }
                }
            }
        }
    }

    /// Results that other workers sent while the first was taken in.
    async fn compare_others(
        &self,
        offer: &JobOffer,
        ended: &JobOutcome,
        mut news: mpsc::Receiver<JobMessage>,
    ) {
        self.offers.leave(&offer.digest);
        let known = self.offers.committed_contents(&offer.digest);
        while let Ok(message) = news.try_recv() {
            if let (JobMessage::Reported(reported), Some(known), JobOutcome::Made) =
                (message, &known, ended)
            {
                self.offers.compare(&offer.digest, known, &reported).await;
            }
        }
    }

    async fn over_or_lost(&mut self, offer: &JobOffer) -> Option<JobOutcome> {
        if self.is_over() {
            return Some(self.withdraw(offer).await);
        }
        let lost = self.lost(&offer.digest);
        if lost < MAX_LOST_WORKERS {
            return None;
        }
        self.offers.fleet.erase(self.subject(offer)).await;
        self.erase_capture(offer).await;
        let reason = format!(
            "{lost} workers disappeared during this job; it may crash machines, so scand no longer offers it"
        );
        let words = String::new();
        Some(JobOutcome::Failed { reason, words })
    }

    fn has_started(&mut self, started: Started) {
        // However many runs of workers somebody invents.
        const MOST: usize = 1000;
        if self.started.len() < MOST || self.started.contains_key(&started.instance) {
            let instance = started.instance;
            let first = || (started.worker.clone(), Instant::now());
            self.held.entry(instance.clone()).or_insert_with(first);
            self.started.insert(instance, Instant::now());
        }
        (self.on_event)(JobEvent::Started(&started.worker));
    }

    /// A worker that has held the job for longer than fetching, making and sending may take together.
    fn too_slow(&mut self, offer: &JobOffer) -> Option<String> {
        let most = Duration::from_secs(3 * u64::from(offer.time_limit_s)) + HOLDING_MARGIN;
        let started = &self.started;
        self.held
            .retain(|instance, _| started.contains_key(instance));
        let is_slow = |(_, since): &&(String, Instant)| since.elapsed() > most;
        let (worker, _) = self.held.values().find(is_slow)?;
        let worker = worker.clone();
        // It is counted once, however long it goes on.
        self.held.clear();
        self.started.clear();
        Some(worker)
    }

    /// Workers that have started this job and were not heard of since, although the server was there all the time.
    fn lost(&mut self, digest: &str) -> usize {
        let fleet = &self.offers.fleet;
        let connections = fleet.connections();
        if connections != self.connections || !fleet.is_connected() {
            // The server's going away counts for nobody.
            self.connections = connections;
            self.started
                .values_mut()
                .for_each(|heard| *heard = Instant::now());
        }
        let offers = self.offers;
        // A worker that sent messages since then, but none of this job, has given it back.
        self.started.retain(|instance, started| {
            let heard = offers.last_heard(instance, digest);
            heard.is_none_or(|(at, does_it)| does_it || at <= *started)
        });
        let is_lost = |(instance, started): &(&String, &Instant)| {
            let heard = offers.last_heard(instance, digest);
            let last = heard.map_or(**started, |(at, _)| at.max(**started));
            last.elapsed() > LOST_AFTER
        };
        self.started.iter().filter(is_lost).count()
    }
}

//! What travels besides pictures and models: the offer of a job, what became of it, and workers' signs of life. Each is
//! a small JSON object from outside, and is checked before it is used.

use super::file_sum::FileSum;
use super::program::Program;
use super::subjects::is_digest;
use crate::frame::CaptureId;
use crate::words::hexadecimal;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

/// Bytes of the largest message.
pub(super) const LONGEST: usize = 256 << 10;
/// Bytes of a piece of a file; a server takes messages of at most a megabyte unless it is told otherwise.
pub(super) const PIECE: usize = 512 << 10;
/// Bytes of the largest recording of a capture that a worker takes.
const LARGEST_CAPTURE: u64 = 4 << 30;

/// A job as a rig, or an archive, offers it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JobOffer {
    /// Names the job and its result: SHA-256 over the capture's recording, the settings and the program.
    pub digest: String,
    /// The capture.
    pub capture: String,
    /// File name of its recording, which a model's report names.
    pub recording: String,
    /// Length of the capture's own recording, in bytes.
    pub bytes: u64,
    /// CRC-32 of its bytes.
    pub crc32: u32,
    /// In how many pieces it is on the server.
    pub pieces: usize,
    /// The configuration of the reconstruction, as TOML.
    pub settings: String,
    /// Another calibration to use instead of the recorded one, as TOML.
    #[serde(default)]
    pub calibration: Option<String>,
    /// Memory that the child may take, in megabytes.
    pub memory_mb: u32,
    /// How long the child may take, in seconds.
    pub time_limit_s: u32,
}

impl JobOffer {
    /// The digest of a job, from what its recording holds and what is to be made of it.
    pub fn digest_of(
        program: &Program,
        (recording, capture): (&str, &str),
        content_sha256: &str,
        settings: &str,
        calibration: Option<&str>,
    ) -> String {
        let mut hash = Sha256::new();
        let program = program.to_string();
        let parts = [
            "scand job 1",
            &program,
            recording,
            capture,
            content_sha256,
            settings,
            if calibration.is_some() {
                "other"
            } else {
                "own"
            },
            calibration.unwrap_or_default(),
        ];
        for part in parts {
            hash.update((part.len() as u64).to_le_bytes());
            hash.update(part);
        }
        hexadecimal(&hash.finalize())
    }

    /// Reads an offer from outside.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(bytes: &[u8]) -> Result<Self, String> {
        let offer: Self = parse(bytes)?;
        offer.check()?;
        Ok(offer)
    }

    /// What tells that its recording arrived whole.
    pub(super) fn file_sum(&self) -> FileSum {
        FileSum {
            bytes: self.bytes,
            crc32: self.crc32,
        }
    }

    /// Checks what a worker relies on.
    ///
    /// # Errors
    /// What is wrong with it.
    pub(super) fn check(&self) -> Result<(), String> {
        CaptureId::new(&self.capture).map_err(|e| e.to_string())?;
        let name = Path::new(&self.recording);
        let is_plain = name.file_name() == Some(self.recording.as_ref())
            && name.extension().is_some_and(|e| e == "mcap")
            && !self.recording.starts_with(['.', '-'])
            && self.recording.len() <= 200;
        if !is_plain {
            return Err(format!(
                "a worker takes no recording with the name {:?}: expected NAME.mcap, at most 200 bytes, without a dot or \
                 hyphen in front",
                self.recording
            ));
        }
        if !is_digest(&self.digest) {
            return Err("its digest is not 64 hexadecimal digits".into());
        }
        let most = self.bytes.div_ceil(PIECE as u64) as usize;
        if self.bytes > LARGEST_CAPTURE || self.pieces != most {
            let Self { bytes, pieces, .. } = self;
            return Err(format!(
                "{bytes} bytes in {pieces} pieces cannot be a capture"
            ));
        }
        if !(64..=1_000_000).contains(&self.memory_mb) || !(1..=86_400).contains(&self.time_limit_s)
        {
            return Err("its limits are out of range".into());
        }
        Ok(())
    }
}

/// What became of a job, as a worker says it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "outcome", deny_unknown_fields)]
pub enum JobReport {
    /// There is a result: a model, or the report of why there is none.
    Result {
        /// The worker.
        worker: String,
        /// Its run.
        instance: String,
        /// Length of the bundle in bytes.
        bytes: u64,
        /// CRC-32 of the bundle.
        crc32: u32,
        /// In how many pieces it is on the server.
        pieces: usize,
        /// SHA-256 of the files in it, but for what may differ between two runs.
        contents_sha256: String,
    },
    /// The child crashed, took too long, or could not be given what it needs.
    Crashed {
        /// The worker.
        worker: String,
        /// Its run.
        instance: String,
        /// Tells this attempt from others of the same run.
        attempt: String,
        /// Why, in words.
        reason: String,
        /// The last of what the child said.
        words: String,
    },
}

impl JobReport {
    /// Bytes of the largest result.
    pub(super) const LARGEST: u64 = 2 << 30;
    /// Longest reason, and longest words of a child, in characters.
    const LONGEST_WORDS: usize = 20_000;

    /// Reads what a worker says.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(bytes: &[u8]) -> Result<Self, String> {
        let mut said: Self = parse(bytes)?;
        let named = |worker: &str, instance: &str| {
            super::subjects::token(worker)
                .and(super::subjects::token(instance))
                .map_err(|e| e.to_string())
        };
        match &mut said {
            Self::Result {
                worker,
                instance,
                bytes,
                pieces,
                contents_sha256,
                ..
            } => {
                named(worker, instance)?;
                let most = bytes.div_ceil(PIECE as u64) as usize;
                if *bytes > Self::LARGEST || *pieces != most {
                    return Err(format!(
                        "{bytes} bytes in {pieces} pieces cannot be a result"
                    ));
                }
                if !is_digest(contents_sha256) {
                    return Err("its digest is not 64 hexadecimal digits".into());
                }
            }
            Self::Crashed {
                worker,
                instance,
                attempt,
                reason,
                words,
            } => {
                named(worker, instance)?;
                *attempt = clean(attempt, 100);
                *reason = clean(reason, 1000);
                *words = clean(words, Self::LONGEST_WORDS);
            }
        }
        Ok(said)
    }

    /// The worker that says it, and its run.
    pub fn sender(&self) -> (&str, &str) {
        match self {
            Self::Result {
                worker, instance, ..
            }
            | Self::Crashed {
                worker, instance, ..
            } => (worker, instance),
        }
    }

    /// Tells an attempt that crashed from all others; `None` for a result.
    pub(super) fn crashed_attempt(&self) -> Option<String> {
        match self {
            Self::Result { .. } => None,
            Self::Crashed {
                instance, attempt, ..
            } => Some(format!("{instance} {attempt}")),
        }
    }
}

/// A worker's sign of life, a few seconds apart.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Heartbeat {
    /// The worker.
    pub worker: String,
    /// Its run.
    pub instance: String,
    /// Its program.
    pub program: String,
    /// What it is doing.
    pub jobs: Vec<HeartbeatJob>,
    /// Results that it has sent.
    pub results: u64,
    /// Children of it that crashed.
    pub crashed: u64,
    /// Memory that it gives each job, in megabytes.
    pub memory_mb: u32,
    /// What its clock says, in seconds since 1970.
    pub time_s: u64,
}

/// A job in a sign of life.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeartbeatJob {
    /// Whose job it is.
    pub rig: String,
    /// Its digest.
    pub digest: String,
    /// The capture.
    pub capture: String,
    /// For how long, in seconds.
    pub seconds: f64,
}

impl Heartbeat {
    /// Seconds by which a worker's clock may differ from this machine's before that is reported.
    const CLOCK_TOLERANCE_S: u64 = 60;

    /// What is wrong with the worker's clock, or with this machine's. Jobs and models depend on neither.
    pub fn clock_problem(&self) -> Option<String> {
        self.clock_problem_at(seconds_since_1970())
    }

    fn clock_problem_at(&self, now_s: u64) -> Option<String> {
        let difference = self.time_s.abs_diff(now_s);
        let direction = if self.time_s > now_s {
            "ahead of"
        } else {
            "behind"
        };
        (difference > Self::CLOCK_TOLERANCE_S).then(|| {
            format!(
                "the clock of worker {} is {difference} s {direction} this machine's: correct the clock that is wrong; until then \
                 times in logs and in scand fleet status are wrong by this; models do not depend on it",
                self.worker
            )
        })
    }

    /// Reads a sign of life.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(bytes: &[u8]) -> Result<Self, String> {
        let mut said: Self = parse(bytes)?;
        super::subjects::token(&said.worker).map_err(|e| e.to_string())?;
        super::subjects::token(&said.instance).map_err(|e| e.to_string())?;
        said.program = clean(&said.program, 100);
        said.jobs.truncate(256);
        for job in &mut said.jobs {
            job.capture = clean(&job.capture, 200);
            job.rig = clean(&job.rig, 60);
        }
        Ok(said)
    }
}

/// Reads a message from outside.
pub(super) fn parse<T: serde::de::DeserializeOwned>(bytes: &[u8]) -> Result<T, String> {
    if bytes.len() > LONGEST {
        let length = bytes.len();
        return Err(format!("it has {length} bytes, expected at most {LONGEST}"));
    }
    serde_json::from_slice(bytes).map_err(|e| e.to_string())
}

/// Words from outside, for a terminal, a log and a report: bounded, and without control characters.
pub(super) fn clean(words: &str, longest: usize) -> String {
    let shown = |c: char| if c == '\n' || !c.is_control() { c } else { ' ' };
    words.chars().take(longest).map(shown).collect()
}

/// What this machine's clock says.
pub(super) fn seconds_since_1970() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.unwrap_or_default().as_secs()
}

/// The digest of a text.
pub(super) fn digest_of_text(text: &str) -> String {
    hexadecimal(&Sha256::digest(text))
}

#[cfg(test)]
pub(super) fn an_offer() -> JobOffer {
    JobOffer {
        digest: "a".repeat(64),
        capture: "cup-000".into(),
        recording: "cup.mcap".into(),
        bytes: 10,
        crc32: 7,
        pieces: 1,
        settings: String::new(),
        calibration: None,
        memory_mb: 4000,
        time_limit_s: 900,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_offer_that_makes_no_sense_is_refused() {
        let parse = |change: &dyn Fn(&mut JobOffer)| {
            let mut offer = an_offer();
            change(&mut offer);
            JobOffer::parse(&serde_json::to_vec(&offer).unwrap())
        };
        assert_eq!(parse(&|_| ()).unwrap(), an_offer());
        for name in [
            "../cup.mcap",
            "/cup.mcap",
            "cup",
            "",
            ".cup.mcap",
            "--x.mcap",
            "a/b.mcap",
        ] {
            parse(&|offer| offer.recording = name.into()).unwrap_err();
        }
        parse(&|offer| offer.capture = "../x".into()).unwrap_err();
        parse(&|offer| offer.digest = "A".repeat(64)).unwrap_err();
        parse(&|offer| offer.pieces = 2).unwrap_err();
        parse(&|offer| offer.bytes = u64::MAX).unwrap_err();
        parse(&|offer| offer.memory_mb = 1).unwrap_err();
        parse(&|offer| offer.time_limit_s = 0).unwrap_err();
        JobOffer::parse(b"{\"digest\": 3}").unwrap_err();
    }

    #[test]
    fn each_part_of_a_job_is_in_its_digest() {
        let program = Program::of("0123456789ab").unwrap();
        let digest = |recording, capture, content, settings, calibration| {
            JobOffer::digest_of(
                &program,
                (recording, capture),
                content,
                settings,
                calibration,
            )
        };
        let all = [
            digest("a.mcap", "a-1", "c", "s", None),
            digest("b.mcap", "a-1", "c", "s", None),
            digest("a.mcap", "a-2", "c", "s", None),
            digest("a.mcap", "a-1", "d", "s", None),
            digest("a.mcap", "a-1", "c", "t", None),
            digest("a.mcap", "a-1", "c", "s", Some("")),
            digest("a.mcap", "a-1", "c", "s", Some("k")),
        ];
        let different: std::collections::BTreeSet<&String> = all.iter().collect();
        assert_eq!(different.len(), all.len());
    }

    #[test]
    fn what_a_worker_says_is_cleaned_and_bounded() {
        let said = JobReport::Crashed {
            worker: "w".into(),
            instance: "i".into(),
            attempt: "1".into(),
            reason: format!("\u{1b}[31m{}", "x".repeat(5000)),
            words: "a\nb\u{7}".into(),
        };
        let bytes = serde_json::to_vec(&said).unwrap();
        let JobReport::Crashed { reason, words, .. } = JobReport::parse(&bytes).unwrap() else {
            panic!("it crashed")
        };
        assert!(
            reason.len() == 1000 && reason.starts_with(" [31m"),
            "{reason}"
        );
        assert_eq!(words, "a\nb ");
        let large = format!(
            "{{\"outcome\":\"crashed\",\"x\":\"{}\"}}",
            "x".repeat(LONGEST)
        );
        assert!(
            JobReport::parse(large.as_bytes())
                .unwrap_err()
                .contains("at most")
        );
    }
}

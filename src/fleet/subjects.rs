//! The names of everything on the server: streams, subjects, consumers. Permissions are given by subject, so a rig's
//! name is a part of each subject that is its own.

use super::memory_class::MemoryClass;
use super::program::Program;

/// Jobs that wait or are being done; a job is gone once it is acknowledged.
pub(super) const JOBS: &str = "SCAND_JOBS";
/// The recordings of captures that are offered, in pieces.
pub(super) const CAPTURES: &str = "SCAND_CAPTURES";
/// Results, in pieces, and what they are.
pub(super) const RESULTS: &str = "SCAND_RESULTS";
/// Jobs that failed, with their reasons, for people.
pub(super) const FAILURES: &str = "SCAND_FAILURES";

/// A name that cannot be a part of a subject.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} cannot name a rig or a worker: expected 1 to 60 letters, digits, hyphens and underscores"
)]
pub struct InvalidName(pub String);

/// Checks the name of a rig or a worker.
///
/// # Errors
/// If it has other characters than a part of a subject may have.
pub fn token(name: &str) -> Result<String, InvalidName> {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    if (1..=60).contains(&name.len()) && name.chars().all(is_plain) {
        Ok(name.to_owned())
    } else {
        Err(InvalidName(name.chars().take(80).collect()))
    }
}

/// Whether a text is a digest: 64 hexadecimal digits in lower case.
pub(super) fn is_digest(text: &str) -> bool {
    text.len() == 64 && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'))
}

/// A rig's job.
pub(super) fn job(program: &Program, needs: MemoryClass, rig: &str, digest: &str) -> String {
    let (program, needs) = (program.token(), needs.token());
    format!("scand.job.{program}.{needs}.{rig}.{digest}")
}

/// The jobs that a program can do which has what they need.
pub(super) fn jobs_for(program: &Program, needs: MemoryClass) -> String {
    format!("scand.job.{}.{}.>", program.token(), needs.token())
}

/// The consumer that the workers of a program share.
pub(super) fn consumer(program: &Program, needs: MemoryClass) -> String {
    format!("{}-{}", program.token(), needs.token())
}

/// What a job's subject says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct JobSubject<'a> {
    /// The token of the program that is to do it.
    pub(super) program: &'a str,
    /// The token of its memory class.
    pub(super) needs: &'a str,
    /// The name of the rig.
    pub(super) rig: &'a str,
    /// Its digest.
    pub(super) digest: &'a str,
}

impl<'a> JobSubject<'a> {
    /// Takes a subject apart; `None` if it is not that of a job.
    pub(super) fn parse(subject: &'a str) -> Option<Self> {
        let rest = subject.strip_prefix("scand.job.")?;
        let parts: Vec<&str> = rest.split('.').collect();
        match parts[..] {
            [program, needs, rig, digest] if is_digest(digest) => Some(Self {
                program,
                needs,
                rig,
                digest,
            }),
            _ => None,
        }
    }
}

/// A piece of a capture's recording.
pub(super) fn capture(rig: &str, digest: &str, piece: usize) -> String {
    format!("scand.capture.{rig}.{digest}.{piece}")
}

/// A piece of a result, by the worker that made it and its run. The worker's name is a part of the subject, so that no
/// worker can bring a model in the name of another.
pub(super) fn part(
    rig: &str,
    digest: &str,
    (worker, instance): (&str, &str),
    piece: usize,
) -> String {
    format!("scand.part.{rig}.{digest}.{worker}.{instance}.{piece}")
}

/// What became of a job.
pub(super) fn result(rig: &str, digest: &str) -> String {
    format!("scand.result.{rig}.{digest}")
}

/// That a worker has started a job.
pub(super) fn started(rig: &str, digest: &str, worker: &str) -> String {
    format!("scand.started.{rig}.{digest}.{worker}")
}

/// That a job failed, for people.
pub(super) fn failure(rig: &str, digest: &str) -> String {
    format!("scand.failure.{rig}.{digest}")
}

/// That a person wants a failed job to be offered again.
pub(super) fn retry(rig: &str) -> String {
    format!("scand.retry.{rig}")
}

/// A worker's sign of life.
pub(super) fn worker(name: &str) -> String {
    format!("scand.worker.{name}")
}

/// That a rig wants a worker to stop, whose models it found wrong.
pub(super) fn stop(name: &str) -> String {
    format!("scand.stop.{name}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_would_be_other_subjects_are_refused() {
        for name in ["", "a.b", "*", ">", "a b", "ä", &"a".repeat(61)] {
            assert!(token(name).is_err(), "{name:?}");
        }
        for name in ["hall-2", "a", "Rig_3"] {
            assert_eq!(token(name).unwrap(), name);
        }
        let digest = "0".repeat(64);
        let subject = format!("scand.job.p.m4.hall.{digest}");
        let parts = JobSubject {
            program: "p",
            needs: "m4",
            rig: "hall",
            digest: &digest,
        };
        assert_eq!(JobSubject::parse(&subject), Some(parts));
        assert_eq!(JobSubject::parse("scand.job.p.m4.hall.x"), None);
    }
}

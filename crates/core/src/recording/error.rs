//! The errors of reading and writing recordings. Each names the file and locates the fault in it.

use crate::storage::advice;
pub(super) use crate::words::shortened;
use crate::{calibration, frame};
use std::fmt;
use std::path::PathBuf;

/// Why a recording, or something in it, cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Error {
    /// The operating system refused.
    #[error("{path}: {cause}{}", advice(cause))]
    Io {
        path: PathBuf,
        /// What the system said.
        cause: std::io::Error,
    },
    /// A folder, a pipe or a device.
    #[error("{path} is {found}, expected an MCAP recording")]
    NotAFile {
        path: PathBuf,
        /// What it is instead.
        found: &'static str,
    },
    /// Nothing that a crash left behind.
    #[error("{path} is not an interrupted recording: its name should end in .mcap.part")]
    NotUnfinished { path: PathBuf },
    /// Nothing is missing at its end.
    #[error("{path} is not cut off, so there is nothing to complete: scand info lists its damage")]
    NotCutOff { path: PathBuf },
    /// A recording that is not lost.
    #[error("{path} is still being written: close its session first, or stop the daemon")]
    BeingWritten { path: PathBuf },
    /// Not an MCAP file at all.
    #[error(
        "{path} is not an MCAP file: {found}, expected the magic bytes 89 4d 43 41 50 30 0d 0a"
    )]
    NotMcap { path: PathBuf, found: String },
    /// A recording of another version.
    #[error(
        "{path} has the unknown format {found:?}, expected \"1\": a newer version of scand \
        may read it"
    )]
    UnknownFormat {
        path: PathBuf,
        /// The version it names.
        found: String,
    },
    /// A part of the file that cannot be read.
    #[error("{path}: {damage}")]
    Damaged { path: PathBuf, damage: Damage },
    /// A message that does not hold what its topic promises.
    #[error("{path}: {topic} at {}: {problem}", log_time.iso_8601())]
    Message {
        path: PathBuf,
        topic: String,
        /// Its log time.
        log_time: frame::Timestamp,
        /// What is wrong with it.
        problem: MessageError,
    },
    /// A metadata record that does not hold what its name promises.
    #[error("{path}: metadata record {name}: {cause}")]
    Metadata {
        path: PathBuf,
        name: &'static str,
        /// What is wrong with it.
        cause: calibration::Error,
    },
    /// A channel whose messages are of another kind than its topic promises.
    #[error("{path}: {topic} has schema {found:?} in {encoding:?}, expected {expected}")]
    Schema {
        path: PathBuf,
        topic: String,
        /// Name of its schema.
        found: String,
        encoding: String,
        expected: String,
    },
    /// A note about something that the recording does not have.
    #[error(
        "{path} has neither a capture nor a session named {name:?}: a note must be about one of them"
    )]
    NothingToNote {
        path: PathBuf,
        /// What the note is about, shortened.
        name: String,
    },
    /// A decision about a session.
    #[error(
        "{path}: {name:?} is the session: accept, reject and clear decide about a capture; give the capture's id, or a text"
    )]
    DecisionOnSession {
        path: PathBuf,
        /// The session's name, shortened.
        name: String,
    },
    /// The file could not be written.
    #[error("{path}: cannot write the recording: {cause}{}", advice(cause))]
    Write {
        path: PathBuf,
        /// What the system said.
        cause: std::io::Error,
    },
    /// A message that is not fit to be written.
    #[error("{path}: {topic}: {problem}")]
    Unwritable {
        path: PathBuf,
        topic: String,
        /// What is wrong with it.
        problem: MessageError,
    },
}

/// What is wrong with one message.
#[derive(Debug, thiserror::Error, PartialEq)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum MessageError {
    /// It cannot be decoded.
    #[error("is not a {schema} message: {reason}")]
    Malformed {
        schema: &'static str,
        /// What the decoder said.
        reason: String,
    },
    /// A member with an impossible value.
    #[error("{field} is {found}, expected {expected}")]
    BadField {
        field: &'static str,
        found: String,
        expected: String,
    },
    /// A member with too few or too many numbers.
    #[error("{field} has {found} numbers, expected {expected}")]
    WrongCount {
        field: &'static str,
        found: usize,
        expected: &'static str,
    },
    /// A calibration that no camera has.
    #[error(transparent)]
    Calibration(#[from] calibration::Error),
    /// A name that breaks its rule.
    #[error(transparent)]
    Name(#[from] frame::NameError),
}

/// A part of the file that could not be read, and how much was lost with it.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Damage {
    /// Where it begins, in bytes from the file's start.
    pub offset: u64,
    /// How many bytes of the file are lost with it.
    pub length: u64,
    /// What is wrong.
    pub what: String,
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            offset,
            length,
            what,
        } = self;
        write!(f, "damaged at byte {offset}: {what}")?;
        if *length > 0 {
            write!(f, " ({length} bytes lost)")?;
        }
        Ok(())
    }
}

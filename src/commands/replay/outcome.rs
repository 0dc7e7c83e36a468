//! Collects the outcome of each capture for the summary of a replay, and the exit code for all of them.

use crate::capture::CaptureSession;
use crate::commands::EXIT_INCOMPLETE;
use crate::frame::CaptureId;
use crate::level::Level;
use crate::make_model::{Model, ModelOutcome};
use crate::notes::CaptureNotes;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// How it ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum ReplayResult {
    /// A model was made.
    Done,
    /// A model of the same inputs and settings was there.
    Unchanged,
    /// No model was made, for a person rejected the capture.
    Rejected,
    /// There is no model.
    Failed,
}

/// What became of a capture, or of a whole recording that could not be read.
#[derive(Debug, serde::Serialize, serde::Deserialize)]
pub(super) struct ReplayOutcome {
    /// The recording.
    pub(super) recording: String,
    /// The capture; none for a recording that could not be read.
    pub(super) capture: Option<String>,
    /// How it ended.
    pub(super) result: ReplayResult,
    /// What the model is worth.
    pub(super) verdict: Option<Level>,
    /// Why it failed, or the reasons of its verdict.
    pub(super) reasons: Vec<String>,
    /// People's notes on the capture.
    pub(super) notes: CaptureNotes,
    /// Where its files are.
    pub(super) folder: Option<PathBuf>,
    /// Whether the recording was damaged.
    pub(super) damaged: bool,
    /// Seconds a stage.
    pub(super) seconds: Vec<(String, f64)>,
}

impl ReplayOutcome {
    /// Of a capture.
    pub(super) fn new(session: &CaptureSession, id: &CaptureId, outcome: ModelOutcome) -> Self {
        let recording = session.recording().path();
        let capture = Some(id.to_string());
        let notes = session.notes().on(id.as_str());
        let of_model = |result, model: Model, damaged, seconds| Self {
            recording: recording.display().to_string(),
            capture: capture.clone(),
            result,
            verdict: Some(model.verdict),
            reasons: model.reasons,
            notes: notes.clone(),
            folder: Some(model.folder),
            damaged,
            seconds,
        };
        match outcome {
            ModelOutcome::Made {
                model,
                damaged,
                seconds,
            } => of_model(ReplayResult::Done, model, damaged, seconds),
            ModelOutcome::Unchanged { model, damaged } => {
                of_model(ReplayResult::Unchanged, model, damaged, Vec::new())
            }
            ModelOutcome::Failed { reason } => Self {
                notes,
                capture,
                damaged: !session.damage().is_empty(),
                ..Self::failed(recording, reason)
            },
        }
    }

    /// Of a capture that is left out because a person rejected it.
    pub(super) fn rejected(session: &CaptureSession, id: &CaptureId) -> Self {
        Self {
            capture: Some(id.to_string()),
            result: ReplayResult::Rejected,
            notes: session.notes().on(id.as_str()),
            reasons: Vec::new(),
            ..Self::failed(session.recording().path(), String::new())
        }
    }

    /// Of a recording that could not be read.
    pub(super) fn unreadable(path: &Path, error: &anyhow::Error) -> Self {
        Self::failed(path, format!("{error:#}"))
    }

    fn failed(path: &Path, reason: String) -> Self {
        Self {
            recording: path.display().to_string(),
            capture: None,
            result: ReplayResult::Failed,
            verdict: None,
            reasons: vec![reason],
            notes: CaptureNotes::default(),
            folder: None,
            damaged: false,
            seconds: Vec::new(),
        }
    }

    pub(super) fn is_done(&self) -> bool {
        matches!(self.result, ReplayResult::Done | ReplayResult::Unchanged)
    }

    pub(super) fn is_failed(&self) -> bool {
        self.result == ReplayResult::Failed
    }

    fn is_red(&self) -> bool {
        self.verdict == Some(Level::Red)
    }

    fn has_lost(&self) -> bool {
        self.damaged || self.is_failed()
    }
}

/// 0: all done or left out as rejected. 1: nothing done, or a red verdict with `strict`. 3: done, but something was
/// lost.
pub(super) fn exit_code(outcomes: &[ReplayOutcome], strict: bool) -> ExitCode {
    let all_failed = outcomes.iter().all(ReplayOutcome::is_failed);
    if all_failed || (strict && outcomes.iter().any(ReplayOutcome::is_red)) {
        ExitCode::FAILURE
    } else if outcomes.iter().any(ReplayOutcome::has_lost) {
        ExitCode::from(EXIT_INCOMPLETE)
    } else {
        ExitCode::SUCCESS
    }
}

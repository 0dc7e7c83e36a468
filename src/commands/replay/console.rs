//! Shows the progress of a replay (a bar on a terminal, lines on a pipe, nothing with `--quiet`) and its summary.

use super::outcome::{ReplayOutcome, ReplayResult};
use crate::capture::CaptureSession;
use crate::commands::first_aid;
use crate::level::Level;
use crate::reconstruct::Stage;
use crate::words::{count, printable};
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::path::Path;

/// Stages of a capture: those of the reconstruction, reading, report and files.
const STAGES: u64 = Stage::ALL.len() as u64 + 3;

/// Where progress and summary go.
pub(super) struct Console {
    quiet: bool,
    json: bool,
    bars: Option<MultiProgress>,
    captures: Mutex<BTreeMap<String, ProgressBar>>,
}

impl Console {
    pub(super) fn new(quiet: bool, json: bool) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let bars = (!quiet && terminal).then(MultiProgress::new);
        Self {
            quiet,
            json,
            bars,
            captures: Mutex::default(),
        }
    }

    /// A recording was opened.
    pub(super) fn file(&self, path: &Path, session: &CaptureSession, captures: usize) {
        let recording = session.recording();
        let is_cut_off = recording.is_cut_off().unwrap_or(false);
        let bytes = recording.file_length();
        if let Some(words) = first_aid::words(path, bytes, is_cut_off, session.damage()) {
            self.error(&words);
        }
        for warning in session.warnings() {
            self.line(&format!("{}: {warning}", path.display()));
        }
        for damage in session.damage() {
            self.line(&format!("{}: {damage}", path.display()));
        }
        for problem in session.notes().problems() {
            self.line(problem);
        }
        self.line(&format!(
            "{}: {}",
            path.display(),
            count(captures, "capture")
        ));
    }

    /// A capture's stage begins.
    pub(super) fn stage(&self, capture: &str, stage: &str) {
        let Some(bars) = &self.bars else {
            return self.line(&format!("{capture}: {stage}"));
        };
        let mut captures = self.captures.lock();
        let bar = captures.entry(capture.into()).or_insert_with(|| {
            let style = ProgressStyle::with_template("{prefix} [{bar:20}] {msg}");
            let bar = ProgressBar::new(STAGES).with_prefix(capture.to_owned());
            bars.add(bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar())))
        });
        bar.set_message(stage.to_owned());
        bar.inc(1);
    }

    /// A capture has ended.
    pub(super) fn finished(&self, capture: &str) {
        let mut captures = self.captures.lock();
        if let Some(bar) = captures.remove(capture) {
            bar.finish_and_clear();
        }
    }

    /// Tells how a capture ended, for programs.
    pub(super) fn outcome(&self, outcome: &ReplayOutcome) {
        if self.json {
            outln!("{}", serde_json::to_string(outcome).unwrap_or_default());
        }
    }

    /// A line for a person. What a recording says may be in it.
    pub(super) fn line(&self, text: &str) {
        if !self.quiet {
            self.error(text);
        }
    }

    /// A line that `--quiet` does not keep back.
    pub(super) fn error(&self, text: &str) {
        let text = printable(text);
        match &self.bars {
            Some(bars) => bars.suspend(|| eprintln!("{text}")),
            None => eprintln!("{text}"),
        }
    }

    /// What became of everything.
    pub(super) fn summary(&self, outcomes: &[ReplayOutcome], out: &Path) {
        for failed in outcomes.iter().filter(|o| o.is_failed()) {
            let told = failed.reasons.join("; ");
            // Most errors name their file themselves.
            let file = format!("{}: ", failed.recording);
            let told = told.strip_prefix(&file).unwrap_or(&told);
            eprintln!("scand: {}: {}", name(failed), printable(told));
        }
        if !self.json && !self.quiet {
            self.table(outcomes, out);
        }
    }

    fn table(&self, outcomes: &[ReplayOutcome], out: &Path) {
        for outcome in outcomes.iter().filter(|o| !o.is_failed()) {
            let total: f64 = outcome.seconds.iter().map(|(_, s)| s).sum();
            let stages: Vec<String> = outcome
                .seconds
                .iter()
                .map(|(n, s)| format!("{n} {s:.2}"))
                .collect();
            let ending = match outcome.result {
                ReplayResult::Rejected => {
                    "left out, because it was rejected (--rejected reconstructs it)"
                }
                _ => outcome.verdict.map_or("done", Level::name),
            };
            outln!("{}: {ending}", name(outcome));
            for line in outcome.notes.lines() {
                outln!("  {line}");
            }
            for reason in &outcome.reasons {
                outln!("  {}", printable(reason));
            }
            match &outcome.folder {
                Some(folder) if outcome.result == ReplayResult::Unchanged => {
                    outln!("  unchanged since it was made: {}", folder.display());
                }
                Some(folder) => {
                    outln!("  {}", folder.display());
                    outln!("  {total:.2} s: {}", stages.join(", "));
                }
                None => {}
            }
        }
        let done = outcomes.iter().filter(|o| o.is_done()).count();
        let failed = outcomes.iter().filter(|o| o.is_failed()).count();
        let rejected = match outcomes.len() - done - failed {
            0 => String::new(),
            rejected => format!(", {rejected} rejected and left out"),
        };
        outln!(
            "{done} done, {failed} failed{rejected}, in {}",
            out.display()
        );
    }
}

fn name(outcome: &ReplayOutcome) -> String {
    let recording = printable(&outcome.recording);
    match &outcome.capture {
        Some(capture) => format!("{recording}: {capture}"),
        None => recording,
    }
}

//! People's notes on a capture, and which of them is valid. Data only; `recording` reads and writes notes.

use crate::description::{LONGEST, clean};
use crate::frame::Timestamp;
use serde::{Deserialize, Serialize};

/// What a note does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NoteKind {
    /// It accepts the capture.
    Accept,
    /// It rejects the capture.
    Reject,
    /// It takes back what accepted or rejected the capture before.
    Clear,
    /// It says something and decides nothing.
    Text,
}

impl NoteKind {
    /// Whether a note of this kind decides something about a capture.
    pub fn decides(self) -> bool {
        self != Self::Text
    }

    /// The kind of this name; a name that is not known is that of a text.
    pub fn of(name: &str) -> Self {
        match name {
            "accept" => Self::Accept,
            "reject" => Self::Reject,
            "clear" => Self::Clear,
            _ => Self::Text,
        }
    }
}

/// One note on a capture, wherever it lies.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CaptureNote {
    /// When the note was made, in UTC nanoseconds.
    pub time_ns: Timestamp,
    /// What it does.
    pub kind: NoteKind,
    /// In words.
    #[serde(default)]
    pub text: String,
    /// Who said it, if that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub author: Option<String>,
}

/// What was decided about a capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Decision {
    /// It is good.
    Accepted,
    /// It is not to be used.
    Rejected,
}

/// All notes on one capture.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CaptureNotes {
    /// What holds now.
    pub decision: Option<Decision>,
    /// All notes, the oldest first.
    pub said: Vec<CaptureNote>,
}

impl CaptureNotes {
    /// Orders notes by their times, each once. The last accept, reject or clear decides.
    pub fn new(mut said: Vec<CaptureNote>) -> Self {
        said.sort_by_key(|said| said.time_ns);
        said.dedup();
        let decided = said.iter().rev().find(|said| said.kind != NoteKind::Text);
        let decision = decided.and_then(|said| match said.kind {
            NoteKind::Accept => Some(Decision::Accepted),
            NoteKind::Reject => Some(Decision::Rejected),
            NoteKind::Clear | NoteKind::Text => None,
        });
        Self { decision, said }
    }

    /// Whether the capture is not to be used.
    pub fn is_rejected(&self) -> bool {
        self.decision == Some(Decision::Rejected)
    }

    /// The valid notes as lines: the decision, and each text. Empty if there are none. What people wrote becomes one
    /// line of at most 400 letters without control characters, for terminals and pictures.
    pub fn lines(&self) -> Vec<String> {
        let decided = |said: &&CaptureNote| said.kind != NoteKind::Text;
        let last = self.said.iter().rev().find(decided);
        let decision = match (self.decision, last) {
            (Some(Decision::Accepted), Some(said)) => Some(line("accepted", said)),
            (Some(Decision::Rejected), Some(said)) => Some(line("rejected", said)),
            _ => None,
        };
        let texts = self.said.iter().filter(|said| said.kind == NoteKind::Text);
        decision
            .into_iter()
            .chain(texts.map(|said| line("note", said)))
            .collect()
    }
}

fn line(what: &str, said: &CaptureNote) -> String {
    let author = said.author.as_deref().and_then(clean);
    let author = author.map_or_else(String::new, |author| format!(" by {author}"));
    let is_cut = said.text.trim().chars().count() > LONGEST;
    let more = if is_cut { "…" } else { "" };
    let text = clean(&said.text).map_or_else(String::new, |text| format!(": {text}{more}"));
    format!("{what}{author} on {}{text}", said.time_ns.iso_8601())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(kind: NoteKind, time: u64) -> CaptureNote {
        CaptureNote {
            time_ns: Timestamp(time),
            kind,
            text: String::new(),
            author: None,
        }
    }

    #[test]
    fn what_people_wrote_is_one_line_that_no_terminal_obeys() {
        let hostile = CaptureNote {
            text: "a hand\r\nball-001: green\u{1b}[2J\u{9b}1A\u{7}".into(),
            author: Some("Ann\n\u{1b}]0;root\u{7}".into()),
            ..said(NoteKind::Reject, 1)
        };
        let empty = CaptureNote {
            text: "\n\t".into(),
            author: Some(" \u{1b}".into()),
            ..said(NoteKind::Text, 2)
        };
        let lines = CaptureNotes::new(vec![hostile, empty]).lines();
        let expected = [
            "rejected by Ann  ]0;root on 1970-01-01T00:00:00.000Z: a hand  ball-001: green [2J 1A",
            "note on 1970-01-01T00:00:00.000Z",
        ];
        assert_eq!(lines, expected);
    }

    #[test]
    fn the_last_decision_holds_and_a_text_changes_nothing_of_it() {
        use NoteKind::{Accept, Clear, Reject, Text};
        for (kinds, decision) in [
            (vec![], None),
            (vec![Text], None),
            (vec![Accept, Text], Some(Decision::Accepted)),
            (vec![Accept, Reject, Text], Some(Decision::Rejected)),
            (vec![Reject, Accept], Some(Decision::Accepted)),
            (vec![Reject, Clear, Text], None),
            (vec![Reject, Clear, Reject], Some(Decision::Rejected)),
        ] {
            let all: Vec<CaptureNote> = kinds
                .iter()
                .zip(1..)
                .map(|(&kind, time)| said(kind, time))
                .collect();
            let reversed = all.iter().rev().cloned().collect();
            assert_eq!(
                CaptureNotes::new(all.clone()).decision,
                decision,
                "{kinds:?}"
            );
            assert_eq!(
                CaptureNotes::new(reversed),
                CaptureNotes::new(all),
                "{kinds:?}"
            );
        }
    }
}

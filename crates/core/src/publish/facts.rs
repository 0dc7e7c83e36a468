//! Reads the figures and the verdict of a model from its `report.json`. That file may come from anywhere: a member that
//! is missing, or is not of the form that scand writes, counts as unknown and is not published.

use super::Extra;
use crate::level::Level;
use crate::notes::CaptureNotes;
use serde_json::Value;
use std::collections::BTreeSet;

/// A reason of the verdict.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reason {
    /// Its code, such as `region_unread`.
    pub code: String,
    /// In words: those of the report, which may name cameras, if they are to be published; else what the code means.
    pub words: String,
}

/// A part of the surface by where it comes from.
#[derive(Clone, Debug, PartialEq)]
pub struct Share {
    /// Where it comes from, such as `hull`.
    pub provenance: String,
    /// Its share of the surface, 0 to 1.
    pub share: f64,
    /// Mean expected distance to the true surface, in metres.
    pub mean_expected_error: f64,
}

/// What a report says and may be public.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Facts {
    /// The verdict; `None` if it is unknown.
    pub level: Option<Level>,
    /// Why it is not green, and remarks.
    pub reasons: Vec<Reason>,
    /// Where the surface comes from.
    pub shares: Vec<Share>,
    /// Whether the surface is closed.
    pub is_watertight: Option<bool>,
    /// Volume in cubic metres.
    pub volume: Option<f64>,
    /// People's notes in words; empty unless they are to be published.
    pub notes: Vec<String>,
}

impl Facts {
    /// The facts of a report and of the notes on its capture, as far as they may be public.
    pub fn of(report: &Value, notes: &CaptureNotes, with: &BTreeSet<Extra>) -> Self {
        let verdict = &report["verdict"];
        let with_words = with.contains(&Extra::Reasons);
        let reason = |reason: &Value| {
            let code = code(reason["code"].as_str()?)?;
            let words = match with_words {
                true => reason["words"].as_str().map(str::to_owned),
                false => meaning(&code),
            };
            Some(Reason {
                words: words.unwrap_or_default(),
                code,
            })
        };
        let share = |part: &Value| {
            Some(Share {
                provenance: code(part["provenance"].as_str()?)?,
                share: part["share"].as_f64()?,
                mean_expected_error: part["mean_expected_error"].as_f64()?,
            })
        };
        let list = |value: &Value| value.as_array().cloned().unwrap_or_default();
        let model = &report["model"];
        Self {
            level: serde_json::from_value(verdict["level"].clone()).ok(),
            reasons: list(&verdict["reasons"])
                .iter()
                .filter_map(reason)
                .collect(),
            shares: list(&model["provenance"])
                .iter()
                .filter_map(share)
                .collect(),
            is_watertight: model["watertight"].as_bool(),
            volume: model["mesh"]["volume"].as_f64(),
            notes: match with.contains(&Extra::Notes) {
                true => notes.lines(),
                false => Vec::new(),
            },
        }
    }
}

/// What a code of the verdict means, in one sentence that names nothing: the first one of its row in docs/results.md.
fn meaning(code: &str) -> Option<String> {
    let page = include_str!("../../../../docs/results.md");
    let mut rows = page.lines().filter_map(|line| line.strip_prefix("| `"));
    let row = rows.find_map(|row| row.strip_prefix(code)?.strip_prefix("` | "))?;
    let cell = row.split(" | ").next()?;
    let sentence = cell.find(". ").map_or(cell, |end| &cell[..=end]);
    Some(sentence.replace('`', ""))
}

/// A code of a report: letters, digits and `_`. Anything else is no code, and could be anything.
fn code(text: &str) -> Option<String> {
    let is_code = !text.is_empty()
        && text.len() <= 60
        && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    is_code.then(|| text.to_owned())
}

#[cfg(test)]
mod tests {
    use super::super::testing::HOSTILE;
    use super::*;
    use crate::frame::Timestamp;
    use crate::notes::{CaptureNote, NoteKind};
    use serde_json::json;

    fn notes() -> CaptureNotes {
        CaptureNotes::new(vec![CaptureNote {
            time_ns: Timestamp(1),
            kind: NoteKind::Text,
            text: "dropped by Bea".into(),
            author: Some("Ann".into()),
        }])
    }

    fn report() -> Value {
        json!({
            "recording": "/home/ann/a.mcap",
            "verdict": { "level": "amber", "reasons": [
                { "code": "region_unread", "words": "the hollow was hardly read: kinect-4711" },
                { "code": HOSTILE, "words": HOSTILE },
            ] },
            "model": {
                "watertight": true, "mesh": { "volume": 0.001 },
                "provenance": [{ "provenance": "hull", "share": 0.5, "mean_expected_error": 0.001 },
                               { "provenance": HOSTILE, "share": 0.5, "mean_expected_error": 0.001 }],
            },
            "timing": { "host": "vm" },
        })
    }

    #[test]
    fn what_names_people_and_cameras_stays_out_unless_it_is_named() {
        let facts = Facts::of(&report(), &notes(), &BTreeSet::new());
        assert_eq!(facts.level, Some(Level::Amber));
        assert_eq!(facts.reasons.len(), 1);
        let words = &facts.reasons[0].words;
        assert!(
            words.starts_with("The depth camera got few readings"),
            "{words}"
        );
        assert_eq!((facts.shares.len(), facts.notes.len()), (1, 0));
        let words = format!("{facts:?}");
        for hidden in ["4711", "Ann", "Bea", "/home", "vm", "script"] {
            assert!(!words.contains(hidden), "{hidden}: {words}");
        }
        let all = Facts::of(&report(), &notes(), &Extra::ALL.into());
        assert!(all.reasons[0].words.contains("4711"));
        assert!(all.notes[0].contains("Bea") && all.notes[0].contains("Ann"));
    }

    #[test]
    fn each_code_of_the_verdict_has_a_meaning_in_one_sentence() {
        let schema = include_str!("../../../../docs/report.schema.json");
        let schema: Value = serde_json::from_str(schema).unwrap();
        let codes = schema["$defs"]["reason"]["properties"]["code"]["enum"]
            .as_array()
            .unwrap();
        assert!(codes.len() > 30);
        for code in codes {
            let meaning = meaning(code.as_str().unwrap()).unwrap_or_default();
            assert!(
                meaning.ends_with('.') && !meaning.contains(". "),
                "{code}: {meaning:?}"
            );
        }
        assert_eq!(meaning("unheard_of"), None);
    }

    #[test]
    fn a_report_that_is_none_says_nothing() {
        for report in [
            json!(null),
            json!([1]),
            json!({ "verdict": { "level": "blue", "reasons": 7 }, "model": "x" }),
        ] {
            let facts = Facts::of(&report, &CaptureNotes::default(), &Extra::ALL.into());
            assert_eq!(facts, Facts::default());
        }
    }
}

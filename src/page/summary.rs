//! What the history shows of a capture: a few members of its report, each text cut at a length. A recording may be
//! anybody's, and so may be the words in its report.

use crate::level::Level;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Longest text that is passed on from a report, in characters.
pub(super) const LONGEST_TEXT: usize = 500;
/// Cameras of a report that are looked at.
const MOST_CAMERAS: usize = 64;
/// Reasons, and notes, that are passed on of a capture.
const MOST_WORDS: usize = 50;

/// What a report says of a capture, as far as the history shows it.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct Summary {
    pub(super) capture: String,
    pub(super) recording: String,
    /// `green`, `amber`, `red`, `failed`, or `unread`: there is no report that can be read.
    pub(super) verdict: String,
    pub(super) reasons: Vec<Reason>,
    pub(super) subject: Option<String>,
    pub(super) placement: Option<String>,
    /// When it was triggered, in seconds since 1970.
    pub(super) time_s: Option<u64>,
    pub(super) decision: Option<String>,
    pub(super) notes: Vec<Note>,
    pub(super) has_preview: bool,
    pub(super) has_model: bool,
    /// Differs between one state of the model's file and another.
    pub(super) model_tag: Option<String>,
}

#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Reason {
    pub(super) level: String,
    pub(super) code: String,
    pub(super) words: String,
}

#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Note {
    pub(super) kind: String,
    #[serde(default)]
    pub(super) text: String,
    #[serde(default)]
    pub(super) author: Option<String>,
    #[serde(default)]
    pub(super) time_ns: Option<String>,
}

#[derive(Deserialize)]
pub(super) struct Report {
    verdict: Option<Verdict>,
    reason: Option<String>,
    capture: Option<Capture>,
    notes: Option<Notes>,
    #[serde(default)]
    color_cameras: Vec<ColorCamera>,
}

/// A colour camera's figures, as far as a look at it is compared with them.
#[derive(Deserialize)]
struct ColorCamera {
    camera: String,
    #[serde(default)]
    sharpness_percent: Option<u32>,
}

impl Report {
    /// How sharp each camera's picture was, in percent, if the model is green.
    pub(super) fn sharpness_of_green(&self) -> Option<BTreeMap<String, u32>> {
        let level = self.verdict.as_ref()?.level.as_str();
        let figures = self.color_cameras.iter().take(MOST_CAMERAS);
        let known = figures.filter_map(|c| Some((c.camera.clone(), c.sharpness_percent?)));
        (level == Level::Green.name()).then(|| known.collect())
    }
}

#[derive(Deserialize)]
struct Verdict {
    level: String,
    #[serde(default)]
    reasons: Vec<Reason>,
}

#[derive(Deserialize)]
struct Capture {
    time_ns: Option<String>,
    subject: Option<String>,
    #[serde(default)]
    placement: Option<String>,
}

#[derive(Deserialize)]
struct Notes {
    decision: Option<String>,
    #[serde(default)]
    said: Vec<Note>,
}

impl Summary {
    /// Takes in what a report says.
    pub(super) fn add(&mut self, report: Report) {
        match (report.verdict, report.reason) {
            (Some(verdict), _) => {
                let known = Level::ALL.iter().any(|level| level.name() == verdict.level);
                self.verdict = if known {
                    verdict.level
                } else {
                    "unread".into()
                };
                self.reasons = verdict.reasons;
            }
            (None, Some(words)) => {
                self.verdict = "failed".into();
                self.reasons = vec![Reason {
                    level: Level::Red.name().into(),
                    code: "failed".into(),
                    words,
                }];
            }
            (None, None) => {}
        }
        self.reasons.truncate(MOST_WORDS);
        for reason in &mut self.reasons {
            let texts = [&mut reason.level, &mut reason.code, &mut reason.words];
            texts.into_iter().for_each(shorten);
        }
        if let Some(capture) = report.capture {
            self.subject = capture.subject;
            self.placement = capture.placement;
            let seconds = |ns: u64| ns / 1_000_000_000;
            self.time_s = capture.time_ns.and_then(|ns| ns.parse().ok()).map(seconds);
        }
        self.subject.iter_mut().for_each(shorten);
        self.placement.iter_mut().for_each(shorten);
        if let Some(notes) = report.notes {
            self.decision = notes.decision;
            self.notes = notes.said;
        }
        self.decision.iter_mut().for_each(shorten);
        self.notes.truncate(MOST_WORDS);
        for note in &mut self.notes {
            let texts = [&mut note.kind, &mut note.text];
            texts.into_iter().for_each(shorten);
            note.author
                .iter_mut()
                .chain(&mut note.time_ns)
                .for_each(shorten);
        }
    }
}

fn shorten(text: &mut String) {
    if let Some((end, _)) = text.char_indices().nth(LONGEST_TEXT) {
        text.truncate(end);
    }
}

#[cfg(test)]
mod tests {
    use serde_json::Value;
    use std::io::{Error, ErrorKind};

    #[test]
    fn the_catalogue_has_a_sentence_for_every_reason_in_each_language() {
        let schema: Value =
            serde_json::from_str(include_str!("../../docs/report.schema.json")).unwrap();
        let codes = &schema["$defs"]["reason"]["properties"]["code"]["enum"];
        let codes = codes.as_array().unwrap().iter().filter_map(Value::as_str);
        let codes: Vec<_> = codes.chain(["failed"]).collect();
        for (language, words) in [
            ("en", include_str!("../../ui/src/words/en.ts")),
            ("de", include_str!("../../ui/src/words/de.ts")),
        ] {
            let keys = words
                .lines()
                .filter_map(|line| line.trim().split_once(": \""));
            let mut known: Vec<_> = keys
                .filter_map(|(key, _)| key.strip_prefix("reason_"))
                .collect();
            let mut codes = codes.clone();
            known.sort_unstable();
            codes.sort_unstable();
            assert_eq!(known, codes, "{language}");
        }
    }

    /// The sources that say what the catalogue knows word for word.
    const SOURCES: [&str; 50] = [
        include_str!("../commands/live/models.rs"),
        include_str!("../commands/make_look.rs"),
        include_str!("../daemon/capturing/assemble.rs"),
        include_str!("../daemon/capturing/capture_thread/admission.rs"),
        include_str!("../daemon/capturing/capture_thread/background.rs"),
        include_str!("../daemon/capturing/capture_thread/looking.rs"),
        include_str!("../daemon/capturing/capture_thread/sessions.rs"),
        include_str!("../daemon/capturing/mod.rs"),
        include_str!("../daemon/look/maker.rs"),
        include_str!("../daemon/look/measured.rs"),
        include_str!("../daemon/notes.rs"),
        include_str!("../daemon/presses/mod.rs"),
        include_str!("../daemon/recorder.rs"),
        include_str!("../daemon/rig.rs"),
        include_str!("../daemon/rig/looking.rs"),
        include_str!("../daemon/status.rs"),
        include_str!("../drivers/aravis/binning.rs"),
        include_str!("../drivers/aravis/camera.rs"),
        include_str!("../drivers/aravis/find.rs"),
        include_str!("../drivers/aravis/look.rs"),
        include_str!("../drivers/aravis/precision_time.rs"),
        include_str!("../drivers/aravis/shoot.rs"),
        include_str!("../drivers/aravis/stream.rs"),
        include_str!("../drivers/live/device.rs"),
        include_str!("../drivers/live/mod.rs"),
        include_str!("../drivers/openni2/parameters.rs"),
        include_str!("../drivers/openni2/settings.rs"),
        include_str!("../drivers/v4l2/camera.rs"),
        include_str!("../drivers/v4l2/settings.rs"),
        include_str!("../workers/outcome.rs"),
        include_str!("../workers/remake_pool.rs"),
        include_str!("../workers/remakes.rs"),
        include_str!("daemon.rs"),
        include_str!("http/guard.rs"),
        include_str!("http/history.rs"),
        include_str!("sessions.rs"),
        include_str!("../../crates/core/src/capture/error.rs"),
        include_str!("../../crates/core/src/capture/load.rs"),
        include_str!("../../crates/core/src/look/mod.rs"),
        include_str!("../../crates/core/src/make_model/object/part.rs"),
        include_str!("../../crates/core/src/reconstruct/silhouette/mod.rs"),
        include_str!("../../crates/core/src/recording/error.rs"),
        include_str!("../../crates/core/src/report/verdict/capture.rs"),
        include_str!("../../crates/core/src/report/verdict/depth.rs"),
        include_str!("../../crates/core/src/report/verdict/mod.rs"),
        include_str!("../../crates/core/src/report/verdict/model.rs"),
        include_str!("../../crates/core/src/report/verdict/silhouettes.rs"),
        include_str!("../../crates/core/src/storage/files.rs"),
        include_str!("../../crates/core/src/storage/mod.rs"),
        include_str!("../../crates/core/src/sync/mod.rs"),
    ];
    const ENGLISH: &str = include_str!("../../ui/src/words/en.ts");
    const GERMAN: &str = include_str!("../../ui/src/words/de.ts");

    /// Keys and words of a catalogue whose keys begin so.
    fn entries(catalogue: &'static str, beginnings: &[&str]) -> Vec<(&'static str, &'static str)> {
        let entries = catalogue.lines().filter_map(|line| {
            let (key, rest) = line.trim().split_once(": \"")?;
            let is_one = beginnings.iter().any(|begin| key.starts_with(begin));
            is_one.then_some((key, rest.strip_suffix("\",")?))
        });
        entries.collect()
    }

    /// What the page recognizes: sentences, and parts of them.
    fn recognized(catalogue: &'static str) -> Vec<(&'static str, &'static str)> {
        entries(catalogue, &["said_", "part_"])
    }

    #[test]
    fn the_page_names_where_a_surface_comes_from_as_previews_do() {
        let known = crate::description::PROVENANCES;
        let expected = known.map(|(name, words)| (format!("from_{name}"), words));
        let found = entries(ENGLISH, &["from_"]).into_iter();
        let found: Vec<_> = found.map(|(key, words)| (key.to_owned(), words)).collect();
        assert_eq!(found, expected);
        let keys = |words| entries(words, &["from_"]).into_iter().map(|(key, _)| key);
        assert!(keys(ENGLISH).eq(keys(GERMAN)));
    }

    #[test]
    fn the_page_recognizes_what_the_operating_system_says() {
        let known = entries(ENGLISH, &["os_"]);
        assert!(known.len() > 20, "{}", known.len());
        for (key, words) in known {
            let number = key.strip_prefix("os_").unwrap().parse().unwrap();
            assert_eq!(words, Error::from_raw_os_error(number).to_string());
        }
        let kinds = [
            ("kind_not_found", ErrorKind::NotFound),
            ("kind_permission_denied", ErrorKind::PermissionDenied),
            ("kind_connection_refused", ErrorKind::ConnectionRefused),
            ("kind_connection_reset", ErrorKind::ConnectionReset),
            ("kind_broken_pipe", ErrorKind::BrokenPipe),
            ("kind_timed_out", ErrorKind::TimedOut),
            ("kind_unexpected_eof", ErrorKind::UnexpectedEof),
            ("kind_storage_full", ErrorKind::StorageFull),
            ("kind_out_of_memory", ErrorKind::OutOfMemory),
        ];
        let known = entries(ENGLISH, &["kind_"]);
        assert_eq!(known.len(), kinds.len());
        for ((key, words), (expected, kind)) in known.into_iter().zip(kinds) {
            assert_eq!(
                (key, words),
                (expected, Error::from(kind).to_string().as_str())
            );
        }
    }

    #[test]
    fn the_sentences_that_the_page_recognizes_are_the_daemons_own() {
        let sources = SOURCES.map(joined);
        let entries = recognized(ENGLISH);
        assert!(entries.len() > 120, "{}", entries.len());
        for (key, sentence) in entries {
            let is_there = sources.iter().any(|source| is_said(source, sentence));
            assert!(is_there, "{key}: no source says {sentence:?}");
        }
    }

    #[test]
    fn another_language_names_nothing_that_the_daemons_sentence_does_not_name() {
        let english = recognized(ENGLISH);
        let german = recognized(GERMAN);
        assert_eq!(english.len(), german.len());
        for (key, words) in german {
            let own = english.iter().find(|(known, _)| *known == key);
            let own = own.map(|(_, sentence)| names(sentence)).unwrap_or_default();
            let unknown: Vec<_> = names(words)
                .into_iter()
                .filter(|name| !own.contains(name))
                .collect();
            assert!(unknown.is_empty(), "{key}: {unknown:?}");
        }
    }

    /// What stands between braces.
    fn names(sentence: &str) -> Vec<&str> {
        let pieces = sentence.split('{').skip(1);
        pieces
            .filter_map(|piece| Some(piece.split_once('}')?.0))
            .collect()
    }

    /// A source with each text that goes over several lines on one.
    fn joined(source: &str) -> String {
        let mut joined = String::new();
        for line in source.lines() {
            match joined.strip_suffix('\\') {
                Some(begin) => joined = begin.to_owned() + line.trim_start(),
                None => {
                    joined.push('\n');
                    joined.push_str(line);
                }
            }
        }
        joined
    }

    /// Whether a source has this as a whole text, but for what stands between braces.
    fn is_said(source: &str, sentence: &str) -> bool {
        let pieces = sentence.split('{');
        let mut pieces = pieces.map(|piece| piece.rsplit('}').next().unwrap_or_default());
        let first = pieces.next().unwrap_or_default();
        let others: Vec<&str> = pieces.collect();
        let mut begins = source.match_indices(first);
        begins.any(|(at, _)| {
            let behind = &source[at + first.len()..];
            let behind = others.iter().try_fold(behind, |left, piece| {
                let (_, behind) = left.strip_prefix('{')?.split_once('}')?;
                behind.strip_prefix(*piece)
            });
            source[..at].ends_with('"') && behind.is_some_and(|left| left.starts_with('"'))
        })
    }
}

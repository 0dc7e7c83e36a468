//! What the daemon said about models that are not the first of a capture: of objects with several captures, how these
//! lie against each other, which side to show next, and what became of the model of all of them; and of the last models
//! that were made again with other settings. No I/O.

use crate::trigger::Event;
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::path::Path;
use std::time::Instant;

/// Objects that are remembered, the newest ones.
const MOST_OBJECTS: usize = 50;
/// Models that were made again that are remembered, the newest ones, one of a capture.
const MOST_REMADE: usize = 10;

/// The objects that events named.
#[derive(Default)]
pub(super) struct Objects {
    told: VecDeque<Object>,
    /// Of which capture, when, and what was told of it.
    remade: VecDeque<(String, (Instant, Value))>,
}

/// What became of a capture of an object last, and when: `taken`, `accepted`, `rejected`, or `cleared` if a decision
/// was taken back.
struct Changed {
    at: Instant,
    capture: String,
    what: &'static str,
}

struct Object {
    subject: String,
    changed: Option<Changed>,
    registered: Option<(Instant, Value)>,
    fused: Option<(Instant, Value)>,
}

impl Objects {
    /// Takes in `registered`, `fused` and `remade`; of other events it has nothing to keep.
    pub(super) fn hear(&mut self, event: &Event, at: Instant) {
        match event {
            Event::Registered {
                subject,
                capture,
                verdict,
                held_by,
                words,
                left_out,
                unseen_percent,
                show_next,
            } => {
                let told = json!({ "capture": capture, "level": verdict, "held_by": held_by, "words": words,
                    "left_out": left_out, "unseen_percent": unseen_percent, "show_next": show_next });
                self.entry(subject).registered = Some((at, told));
            }
            Event::Fused {
                subject,
                capture,
                verdict,
                reasons,
                left_out,
                model,
            } => {
                let folder = model.as_deref().and_then(folder_of);
                let told = json!({ "capture": capture, "level": verdict, "reasons": reasons, "left_out": left_out,
                    "folder": folder });
                self.entry(subject).fused = Some((at, told));
            }
            Event::Remade {
                capture,
                verdict,
                reasons,
                model,
            } => {
                let folder = model.as_deref().and_then(folder_of);
                let told = json!({ "capture": capture, "level": verdict, "reasons": reasons, "folder": folder });
                self.remade.retain(|(known, _)| known != capture);
                self.remade.truncate(MOST_REMADE - 1);
                self.remade.push_front((capture.clone(), (at, told)));
            }
            _ => {}
        }
    }

    /// Takes in what became of a capture of an object ([`Changed`]): what was told before is not about that.
    pub(super) fn change(&mut self, subject: &str, capture: &str, what: &'static str, at: Instant) {
        let mut told = self.told.iter_mut();
        if let Some(object) = told.find(|object| object.subject == subject) {
            let capture = capture.to_owned();
            object.changed = Some(Changed { at, capture, what });
        }
    }

    /// The last models that were made again, or why they were not, the newest first.
    pub(super) fn remade(&self, at: Instant) -> Vec<Value> {
        let remade = self.remade.iter();
        remade.map(|(_, told)| aged(told, at)).collect()
    }

    /// The object's entry, which becomes the newest.
    fn entry(&mut self, subject: &str) -> &mut Object {
        let known = self
            .told
            .iter()
            .position(|object| object.subject == subject);
        let object = known.and_then(|place| self.told.remove(place));
        let object = object.unwrap_or_else(|| Object {
            subject: subject.into(),
            changed: None,
            registered: None,
            fused: None,
        });
        self.told.truncate(MOST_OBJECTS - 1);
        self.told.push_front(object);
        &mut self.told[0]
    }

    /// What is known of an object, with ages in milliseconds: `Level` as text, the model's folder as recording and
    /// name, whether something changed since (`is_old`), and what changed last (`changed`).
    pub(super) fn of(&self, subject: &str, at: Instant) -> Option<Value> {
        let object = self.told.iter().find(|object| object.subject == subject)?;
        let aged = |told: &Option<(Instant, Value)>| {
            told.as_ref().map(|told| {
                let mut value = aged(told, at);
                let changed = object.changed.as_ref();
                let changed = changed.filter(|changed| changed.at > told.0);
                value["is_old"] = changed.is_some().into();
                value["changed"] = changed.map_or(
                    Value::Null,
                    |changed| json!({ "capture": changed.capture, "what": changed.what }),
                );
                value
            })
        };
        Some(
            json!({ "subject": subject, "registered": aged(&object.registered), "fused": aged(&object.fused) }),
        )
    }
}

/// What was told, with its age in milliseconds.
fn aged((since, value): &(Instant, Value), at: Instant) -> Value {
    let mut value = value.clone();
    value["age_ms"] = (at.saturating_duration_since(*since).as_millis() as u64).into();
    value
}

/// The recording and the name under which the history has a model; the daemon's paths stay here.
pub(super) fn folder_of(model: &Path) -> Option<[String; 2]> {
    let name = |path: &Path| Some(path.file_name()?.to_str()?.to_owned());
    Some([name(model.parent()?)?, name(model)?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn heard(objects: &mut Objects, line: &str, at: Instant) {
        objects.hear(&serde_json::from_str(line).unwrap(), at);
    }

    #[test]
    fn the_newest_of_an_object_is_told_without_paths() {
        let at = Instant::now();
        let mut objects = Objects::default();
        heard(
            &mut objects,
            r#"{"type":"registered","subject":"7","capture":"a-0002","verdict":"green","held_by":"colours","words":"w",
                "left_out":[],"unseen_percent":9,"show_next":"on a side"}"#,
            at,
        );
        let told = objects.of("7", at + Duration::from_secs(2)).unwrap();
        assert_eq!(told["registered"]["show_next"], "on a side");
        assert_eq!(told["registered"]["level"], "green");
        assert_eq!(told["registered"]["held_by"], "colours");
        assert_eq!(told["registered"]["age_ms"], 2000);
        assert!(told["fused"].is_null());
        let fused = r#"{"type":"fused","subject":"7","capture":"a-0002","verdict":"amber","reasons":["r"],"left_out":[],
            "model":"/secret/models/a/7.object"}"#;
        heard(&mut objects, fused, at);
        let told = objects.of("7", at).unwrap();
        assert_eq!(told["fused"]["folder"], json!(["a", "7.object"]));
        assert!(!told.to_string().contains("secret"));
        let none = r#"{"type":"fused","subject":"7","capture":"a-0003","reasons":["no pose"],"left_out":[]}"#;
        heard(&mut objects, none, at);
        let told = objects.of("7", at).unwrap();
        assert!(told["fused"]["level"].is_null() && told["fused"]["folder"].is_null());
        assert!(objects.of("8", at).is_none());
        assert!(objects.remade(at).is_empty());
        let remade = r#"{"type":"remade","capture":"a-0001","verdict":"green","reasons":[],
            "model":"/secret/models/a/a-0001.remake-1"}"#;
        heard(&mut objects, remade, at);
        let told = objects.remade(at);
        assert_eq!(told[0]["folder"], json!(["a", "a-0001.remake-1"]));
    }

    #[test]
    fn the_newest_model_that_was_made_again_is_told_of_each_of_the_last_captures() {
        let at = Instant::now();
        let mut objects = Objects::default();
        let mut made = |capture: usize, n: usize| {
            let line = format!(
                r#"{{"type":"remade","capture":"a-{capture}","verdict":"green","model":"/m/a/a-{capture}.remake-{n}"}}"#
            );
            heard(&mut objects, &line, at);
            let told = objects.remade(at).into_iter();
            told.map(|told| told["folder"][1].clone())
                .collect::<Vec<_>>()
        };
        made(1, 1);
        made(2, 1);
        assert_eq!(made(1, 2), ["a-1.remake-2", "a-2.remake-1"]);
        for capture in 3..3 + MOST_REMADE {
            made(capture, 1);
        }
        let last = made(99, 1);
        assert_eq!(last.len(), MOST_REMADE);
        assert_eq!(last[0], "a-99.remake-1");
    }

    #[test]
    fn what_was_told_before_a_capture_was_taken_or_rejected_is_old() {
        let at = Instant::now();
        let later = |s| at + Duration::from_secs(s);
        let mut objects = Objects::default();
        // Of an object that nothing was told of, nothing is old.
        objects.change("7", "a-0003", "taken", at);
        assert!(objects.of("7", at).is_none());
        let registered = r#"{"type":"registered","subject":"7","capture":"a-0002","verdict":"green","words":"w",
            "left_out":[],"unseen_percent":9}"#;
        let fused = r#"{"type":"fused","subject":"7","capture":"a-0002","verdict":"green","reasons":[],"left_out":[],
            "model":"/m/a/7.object"}"#;
        heard(&mut objects, registered, at);
        heard(&mut objects, fused, at);
        let old = |objects: &Objects| {
            let told = objects.of("7", later(9)).unwrap();
            [&told["registered"], &told["fused"]].map(|told| told["is_old"] == true)
        };
        assert_eq!(old(&objects), [false, false]);
        assert!(objects.of("7", at).unwrap()["fused"]["changed"].is_null());
        objects.change("8", "a-0003", "taken", later(1));
        assert_eq!(old(&objects), [false, false]);
        objects.change("7", "a-0002", "rejected", later(1));
        assert_eq!(old(&objects), [true, true]);
        let told = objects.of("7", later(1)).unwrap();
        let expected = json!({ "capture": "a-0002", "what": "rejected" });
        assert_eq!(told["fused"]["changed"], expected);
        // After a reject the model is made again, and what is to be shown next is not told again.
        heard(&mut objects, fused, later(2));
        assert_eq!(old(&objects), [true, false]);
        heard(&mut objects, registered, later(3));
        assert_eq!(old(&objects), [false, false]);
    }

    #[test]
    fn memory_is_bounded() {
        let at = Instant::now();
        let mut objects = Objects::default();
        for n in 0..3 * MOST_OBJECTS {
            let line = format!(
                r#"{{"type":"fused","subject":"{n}","capture":"a-0003","reasons":[],"left_out":[]}}"#
            );
            heard(&mut objects, &line, at);
        }
        assert_eq!(objects.told.len(), MOST_OBJECTS);
        let newest = (3 * MOST_OBJECTS - 1).to_string();
        assert!(objects.of(&newest, at).is_some() && objects.of("0", at).is_none());
    }
}

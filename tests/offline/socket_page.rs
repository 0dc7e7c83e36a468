//! Compares docs/socket.md with the program: every message on the page exists, and every message that exists is on
//! the page.

use scand::trigger::{Event, Request};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::{BTreeMap, BTreeSet};
use std::mem::discriminant;

const PAGE: &str = include_str!("../../docs/socket.md");

/// The examples of a section, as they stand between backticks.
fn examples(heading: &str) -> Vec<&'static str> {
    let section = PAGE
        .split("\n## ")
        .find(|s| s.starts_with(heading))
        .unwrap_or_else(|| panic!("no section {heading}"));
    let quoted = section.split('`').skip(1).step_by(2);
    quoted.filter(|text| text.starts_with('{')).collect()
}

/// The types that a message may have, as its reader lists them.
fn types<T: DeserializeOwned>() -> BTreeSet<String> {
    let error = serde_json::from_str::<T>("{\"type\":\"?\"}").err().unwrap();
    let words = error.to_string();
    let named = words.split('`').skip(1).step_by(2);
    named.filter(|n| *n != "?").map(Into::into).collect()
}

fn messages<T: DeserializeOwned + Serialize>(sections: &[&str]) -> BTreeMap<&'static str, T> {
    let examples = sections.iter().flat_map(|s| examples(s));
    let read = |example: &'static str| {
        let message = serde_json::from_str(example).unwrap_or_else(|e| panic!("{example}: {e}"));
        (example, message)
    };
    examples.map(read).collect()
}

fn types_of<'a>(examples: impl Iterator<Item = &'a &'static str>) -> BTreeSet<String> {
    let value = |example: &str| serde_json::from_str::<serde_json::Value>(example).unwrap();
    let of = |example: &&str| value(example)["type"].as_str().unwrap().to_owned();
    examples.map(of).collect()
}

#[test]
fn every_request_stands_on_the_page_as_it_is() {
    let requests = messages::<Request>(&["Requests"]);
    for (example, request) in &requests {
        let found: serde_json::Value = serde_json::from_str(example).unwrap();
        let written = serde_json::to_value(request).unwrap();
        // A member that the program does not know would be missing from what it writes.
        for (name, value) in found.as_object().unwrap() {
            assert_eq!(written.get(name), Some(value), "{example}: {name}");
        }
    }
    assert_eq!(types_of(requests.keys()), types::<Request>());
}

/// Types, members and their order, to the byte.
#[test]
fn every_reply_and_every_event_stands_on_the_page_as_it_is_written() {
    let replies = messages::<Event>(&["A press and its answers", "Other replies"]);
    let events = messages::<Event>(&["Events"]);
    for (example, event) in replies.iter().chain(&events) {
        assert_eq!(serde_json::to_string(event).unwrap(), *example);
    }
    for (example, reply) in &replies {
        assert_eq!(serde_json::to_string(&reply.to_reply()).unwrap(), *example);
    }
    // What a press is answered is the view of an event of the same type.
    for (example, event) in events.iter().filter(|(_, event)| event.capture().is_some()) {
        let of_type = |reply: &&Event| discriminant(*reply) == discriminant(event);
        assert!(replies.values().any(|reply| of_type(&reply)), "{example}");
    }
    let shown = types_of(replies.keys().chain(events.keys()));
    assert_eq!(shown, types::<Event>());
}

//! docs/socket.md against the program: every message of the page is one, and every message that there is stands on it.

use scand::trigger::{Event, Reply, Request};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeSet;

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

fn check<T: DeserializeOwned + Serialize>(sections: &[&str]) {
    let mut shown = BTreeSet::new();
    for example in sections.iter().flat_map(|s| examples(s)) {
        let message: T = serde_json::from_str(example).unwrap_or_else(|e| panic!("{example}: {e}"));
        let found: serde_json::Value = serde_json::from_str(example).unwrap();
        let written = serde_json::to_value(&message).unwrap();
        // A member that the program does not know would be missing from what it writes.
        for (name, value) in found.as_object().unwrap() {
            assert_eq!(written.get(name), Some(value), "{example}: {name}");
        }
        shown.insert(found["type"].as_str().unwrap().to_owned());
    }
    assert_eq!(shown, types::<T>());
}

#[test]
fn every_request_stands_on_the_page_as_it_is() {
    check::<Request>(&["Requests"]);
}

#[test]
fn every_reply_stands_on_the_page_as_it_is() {
    check::<Reply>(&["A press and its answers", "Other replies"]);
}

#[test]
fn every_event_stands_on_the_page_as_it_is() {
    check::<Event>(&["Events"]);
}

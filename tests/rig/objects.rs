//! Several captures of one object: the daemon fuses them by itself.

use crate::network;
use crate::stand::Stand;
use scand::trigger::{Client, Event, Request};
use std::path::{Path, PathBuf};

/// The next event of an object's model.
fn fused(events: &mut Client) -> (String, Option<PathBuf>, Vec<String>) {
    loop {
        if let Event::Fused {
            subject,
            model,
            reasons,
            ..
        } = events.reply().unwrap()
        {
            return (subject, model, reasons);
        }
    }
}

fn fused_captures(folder: &Path) -> Vec<String> {
    let report = std::fs::read_to_string(folder.join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    let captures = report["fusion"]["captures"].as_array().unwrap();
    let ids = captures
        .iter()
        .map(|c| c["id"].as_str().unwrap().to_owned());
    ids.collect()
}

#[test]
fn two_presses_for_one_object_are_registered_at_once_and_fused() {
    network::alone(
        "objects::two_presses_for_one_object_are_registered_at_once_and_fused",
        || {
            let mut stand = Stand::start(&["workers.count=1", "vertices=4000"]);
            stand.tell("background");
            stand.ask_done(&Request::Background {});
            stand.tell("captures");
            let mut events = stand.listen();
            let first = stand.press_of("17");
            let other = stand.press_of("18");
            let second = stand.press_of("17");
            // Known while the object still stands there: its model may wait for those of the captures.
            loop {
                match events.reply().unwrap() {
                    Event::Registered {
                        subject,
                        capture,
                        held_by,
                        words,
                        ..
                    } => {
                        assert_eq!((subject.as_str(), &capture), ("17", &second));
                        assert!(held_by.is_some(), "{words}");
                        break;
                    }
                    Event::Fused { .. } => panic!("fused before it was registered"),
                    _ => {}
                }
            }
            let (subject, model, reasons) = fused(&mut events);
            let model = model.unwrap_or_else(|| panic!("{reasons:?}: {}", stand.log()));
            assert_eq!(subject, "17");
            assert!(model.ends_with("17.object"));
            assert_eq!(fused_captures(&model), [first.clone(), second.clone()]);
            assert!(model.join("model.glb").is_file());
            // A third one is registered with the others, and a kill repeats what was being done.
            let third = stand.press_of("17");
            stand.kill_and_restart();
            let mut events = stand.listen();
            stand.until_models("the object is not fused again", |models| {
                models["objects"] == 0
            });
            assert_eq!(
                fused_captures(&model),
                [first.clone(), second.clone(), third.clone()]
            );
            // Rejected captures are left out, and the model is made again without them.
            for capture in [&second, &third] {
                stand.ask_done(&Request::Note {
                    capture: capture.clone(),
                    kind: "reject".into(),
                    text: String::new(),
                    author: None,
                });
            }
            let (_, model, _) = fused(&mut events);
            let model = model.unwrap();
            stand.until_models("the object is not fused again", |models| {
                models["objects"] == 0
            });
            assert_eq!(fused_captures(&model), [first]);
            let _ = other;
        },
    );
}

//! Pictures of the cameras over HTTP: who may see them, how many connections to the daemon they take, and when that
//! ends.

use super::sessions::Role;
use super::testing::{Answer, Page};
use crate::support::wait::until;
use serde_json::Value;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

fn look(page: &Page, session: &str, since: &str) -> Answer {
    let cookie = format!("Cookie: scand={session}\r\n");
    page.get(&format!("/api/look{since}"), &cookie)
}

/// Looks until a condition holds of an answer.
fn look_until(page: &Page, session: &str, wanted: impl Fn(&Value) -> bool) -> Value {
    let begin = Instant::now();
    loop {
        let answer = look(page, session, "?since=0");
        assert_eq!(answer.status, 200, "{}", answer.body);
        let found: Value = serde_json::from_str(&answer.body).unwrap();
        if wanted(&found) {
            return found;
        }
        assert!(begin.elapsed() < Duration::from_secs(60), "{found}");
    }
}

#[test]
fn viewers_see_pictures_and_nobody_without_a_session_does() {
    let page = Page::start();
    assert_eq!(page.get("/api/look?since=0", "").status, 401);
    assert_eq!(look(&page, &"0".repeat(64), "?since=0").status, 401);
    let viewer = page.session(Role::Viewer);
    for since in [
        "",
        "?since=",
        "?since=-1",
        "?since=1&x=2",
        "?x=1",
        "?since=99999999999999999999",
    ] {
        assert_eq!(look(&page, &viewer, since).status, 400, "{since}");
    }
    assert_eq!(page.daemon.looking.load(Ordering::SeqCst), 0);
    let found = look_until(&page, &viewer, |found| {
        found["cameras"]["c00"]["picture"] == "AAAA"
    });
    assert_eq!(found["cameras"]["c01"]["words"], "<b>away</b>");
    assert!(found["cameras"]["c00"]["age_ms"].as_u64().unwrap() >= 7);
    // What is known is not sent again; a number of an earlier process counts for nothing.
    let number = found["number"].as_u64().unwrap();
    let newer = look(&page, &viewer, &format!("?since={number}"));
    let newer: Value = serde_json::from_str(&newer.body).unwrap();
    assert!(newer["cameras"].get("c01").is_none(), "{newer}");
    let other = look(&page, &viewer, "?since=123456789");
    let other: Value = serde_json::from_str(&other.body).unwrap();
    assert!(other["cameras"].get("c01").is_some(), "{other}");
}

#[test]
fn the_last_good_capture_is_found_while_somebody_looks() {
    let page = Page::start();
    let viewer = page.session(Role::Viewer);
    let begun = look_until(&page, &viewer, |found| {
        found["cameras"]["c00"]["picture"] == "AAAA"
    });
    assert_eq!(begun["good"], serde_json::json!({}));
    let report = r#"{"verdict":{"level":"green"},"color_cameras":[{"camera":"c00","sharpness_percent":61}]}"#;
    let path = page.root.path().join("models/a/a-0001/report.json");
    std::fs::write(path, report).unwrap();
    look_until(&page, &viewer, |found| found["good"]["c00"] == 61);
    assert_eq!(page.daemon.most_looking.load(Ordering::SeqCst), 1);
}

#[test]
fn many_who_look_take_one_connection_which_ends_after_them() {
    let page = Arc::new(Page::start());
    let viewer = page.session(Role::Viewer);
    let threads: Vec<_> = (0..24)
        .map(|_| {
            let (page, viewer) = (page.clone(), viewer.clone());
            std::thread::spawn(move || {
                let statuses = (0..5).map(|_| look(&page, &viewer, "?since=0").status);
                statuses.collect::<Vec<_>>()
            })
        })
        .collect();
    for thread in threads {
        assert!(
            thread
                .join()
                .unwrap()
                .iter()
                .all(|status| [200, 503].contains(status))
        );
    }
    assert_eq!(page.daemon.most_looking.load(Ordering::SeqCst), 1);
    until("somebody looks", || {
        page.daemon.looking.load(Ordering::SeqCst) == 0
    });
    assert_eq!(page.daemon.asked(), 0);
}

//! Rates the cameras' status: that of the daemon, or of cameras that were opened for this check.

use super::{Finding, State};
use crate::words::count;
use serde_json::Value;

/// Rates the cameras of a status (`cameras` in docs/socket.md).
pub fn cameras(cameras: &Value) -> Vec<Finding> {
    let all = cameras.as_object().into_iter().flatten();
    all.flat_map(|(id, camera)| one(id, camera)).collect()
}

/// How what is said of a camera's PTP clock begins.
const CLOCK: &str = "PTP: ";
/// How remarks begin that tell how a depth camera is and leave nothing to be done.
const IN_ORDER: [&str; 2] = ["a raw reading counts ", "a file of OpenNI's: "];

fn one(id: &str, camera: &Value) -> Vec<Finding> {
    let subject = format!("camera {id}");
    let words = camera["words"].as_str().unwrap_or("");
    if camera["state"] != "ready" {
        let found = if words.is_empty() { "no answer" } else { words };
        let remedy = "check its power, cable and address; docs/cameras.md explains each message";
        return vec![Finding::not_ok(State::Wrong, subject, found, remedy)];
    }
    let mut findings = vec![Finding::ok(subject.clone(), words)];
    let texts = |key: &str| camera[key].as_array().cloned().unwrap_or_default();
    for setting in texts("settings") {
        let part = |i: usize| setting[i].as_str().unwrap_or("").to_owned();
        if part(1) != part(2) {
            let found = format!("{}: asked for {}, has {}", part(0), part(1), part(2));
            findings.push(Finding::ok(subject.clone(), found));
        }
    }
    // A remark tells how the clock was when the camera was opened; what it reports about itself is newer.
    let health = texts("health");
    let clock = health.iter().find(|pair| pair[0] == "PTP");
    let clock = clock.map(|pair| format!("{CLOCK}{}", pair[1].as_str().unwrap_or("")));
    let remarks = texts("remarks");
    let remarks = remarks.iter().map(|remark| remark.as_str().unwrap_or(""));
    let lasting = remarks.filter(|remark| clock.is_none() || !remark.starts_with(CLOCK));
    let told = clock.as_deref().into_iter().chain(lasting);
    findings.extend(told.map(|remark| judge_remark(&subject, remark)));
    let lost = camera["lost_frames"].as_u64().unwrap_or(0);
    if lost > 0 {
        let found = format!(
            "lost {} since the daemon started",
            count(lost as usize, "frame")
        );
        let remedy = "check its link: cable, switch, packet_delay_ns, receive buffers";
        findings.push(Finding::not_ok(State::Advice, subject, found, remedy));
    }
    findings
}

/// A remark of a camera is advice, except about what is in order, and about its PTP clock: that is in order if it
/// follows a master, and wrong if not.
fn judge_remark(subject: &str, remark: &str) -> Finding {
    if IN_ORDER.iter().any(|begin| remark.starts_with(begin)) {
        return Finding::ok(subject, remark);
    }
    let Some(state) = remark.strip_prefix(CLOCK) else {
        let remedy = "docs/cameras.md";
        return Finding::not_ok(State::Advice, subject, remark, remedy);
    };
    let follows = state.starts_with("Master") || state.starts_with("Slave");
    if follows && !state.contains("more than") {
        return Finding::ok(subject, remark);
    }
    let remedy = "run a PTP master on its network (ptp4l, or a camera) and wait half a minute until the clock follows it";
    Finding::not_ok(State::Wrong, subject, remark, remedy)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_clock_is_judged_as_it_is_now_and_not_as_it_was_when_its_camera_was_opened() {
        let of = |now: &str| {
            let status = json!({ "c00": {"state": "ready", "words": "Maker M1",
                "health": [["temperature", "31.0 °C"], ["PTP", now]],
                "remarks": ["PTP: Listening, expected Slave or Master", "its packets have 1500 bytes"]} });
            let states = cameras(&status).into_iter().map(|f| f.state);
            states.collect::<Vec<_>>()
        };
        let follows = of("Slave, 120 ns from its master");
        assert_eq!(follows, [State::Ok, State::Ok, State::Advice]);
        let far = of("the clock is 900000 ns from its master, expected at most 100000 ns");
        assert_eq!(far, [State::Ok, State::Wrong, State::Advice]);
    }

    #[test]
    fn a_camera_that_is_away_is_wrong_and_remarks_are_judged() {
        let status = json!({
            "c00": {"state": "ready", "words": "Maker M1", "settings": [["exposure", "0.008", "0.008"]],
                "remarks": ["PTP: Slave, 120 ns from its master"], "lost_frames": 0},
            "c01": {"state": "ready", "words": "Maker M1", "settings": [["gain", "3.0", "2.9"]],
                "remarks": ["PTP: Listening, expected Slave or Master"], "lost_frames": 7},
            "c02": {"state": "away", "words": "no answer from 10.0.1.3"},
            "c03": {"state": "ready", "words": "Maker M2", "remarks": ["its packets have 1500 bytes"]},
            "kinect": {"state": "ready", "words": "Kinect", "remarks": ["a raw reading counts millimetres",
                "a file of OpenNI's: its frames are stamped when they are read"]},
        });
        let findings = cameras(&status);
        let of = |id: &str| -> Vec<State> {
            let subject = format!("camera {id}");
            let own = findings.iter().filter(|f| f.subject == subject);
            own.map(|f| f.state).collect()
        };
        assert_eq!(of("c00"), [State::Ok, State::Ok]);
        assert_eq!(
            of("c01"),
            [State::Ok, State::Ok, State::Wrong, State::Advice]
        );
        assert_eq!(of("c02"), [State::Wrong]);
        assert_eq!(of("c03"), [State::Ok, State::Advice]);
        assert_eq!(of("kinect"), [State::Ok; 3]);
        assert!(
            findings
                .iter()
                .any(|f| f.found == "gain: asked for 3.0, has 2.9")
        );
        assert!(cameras(&Value::Null).is_empty());
    }
}

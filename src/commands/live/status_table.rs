//! Prints the daemon's status as a table for a terminal. It reads JSON, so that it understands daemons of other
//! versions.

use crate::words::count;
use serde_json::Value;

/// The status in lines.
pub(super) fn status(status: &Value) -> String {
    let mut text = captures(status);
    text += &disk(status);
    text += &models(status);
    text += &match status["plates_age_h"].as_f64() {
        Some(hours) => format!("background {hours:.1} h old\n"),
        None => "background none (take it with scand background)\n".into(),
    };
    if let Some(hours) = status["calibration_age_h"].as_f64() {
        let days = (hours / 24.0).floor() as usize;
        text += &format!("calibrated {} ago\n", count(days, "day"));
    }
    text += &cameras(status);
    text
}

/// Whether the cameras are listed in the form that this program knows.
pub(super) fn is_known(status: &Value) -> bool {
    let cameras = &status["cameras"];
    cameras.is_object() || cameras.is_null()
}

fn number(value: &Value, key: &str) -> u64 {
    value[key].as_u64().unwrap_or(0)
}

fn word<'a>(value: &'a Value, key: &str) -> &'a str {
    value[key].as_str().unwrap_or("")
}

fn captures(status: &Value) -> String {
    let mut text = format!(
        "session    {}\ncaptures   {} complete, {} failed, {} refused\n",
        status["session"].as_str().unwrap_or("none"),
        number(status, "complete"),
        number(status, "failed"),
        number(status, "refused"),
    );
    for (name, rate) in status["takes_ms"].as_object().into_iter().flatten() {
        let at = |part: &str| rate[part].as_f64().unwrap_or(0.0);
        text += &format!(
            "{:10} p50 {:.0} ms, p99 {:.0} ms after the press\n",
            name,
            at("p50"),
            at("p99")
        );
    }
    text
}

fn disk(status: &Value) -> String {
    let waiting = match number(status, "waiting") {
        0 => String::new(),
        n => format!(", {n} wait for it"),
    };
    format!(
        "disk       room for {} of {:.1} MB{waiting}\n",
        count(number(status, "captures_left") as usize, "capture"),
        number(status, "capture_bytes") as f64 / 1e6,
    )
}

/// What waits for its model, where models are made.
fn models(status: &Value) -> String {
    let Some(queue) = status["models"].as_object() else {
        return String::new();
    };
    let value = Value::Object(queue.clone());
    let expected = match value["expected_s"].as_f64() {
        Some(seconds) if seconds >= 90.0 => format!(", done in {:.0} min", seconds / 60.0),
        Some(seconds) => format!(", done in {seconds:.0} s"),
        None => String::new(),
    };
    format!(
        "models     {} being made, {} wait{expected}\n",
        value["running"].as_array().map_or(0, Vec::len),
        number(&value, "waiting")
    )
}

fn cameras(status: &Value) -> String {
    let cameras = &status["cameras"];
    if !is_known(status) {
        return "cameras    unknown, because this scand cannot read the daemon's reply: check that both have the same \
                version\n"
            .to_owned();
    }
    let mut text = format!("{:12} {:8} {:>5}  {}\n", "camera", "state", "lost", "");
    for (id, camera) in cameras.as_object().into_iter().flatten() {
        text += &format!(
            "{id:12} {:8} {:>5}  {}\n",
            word(camera, "state"),
            number(camera, "lost_frames"),
            word(camera, "words")
        );
        text += &details(camera);
    }
    text
}

/// The settings and the values read back, the camera's health, and its remarks.
fn details(camera: &Value) -> String {
    let part = |list: &Value, i: usize| list[i].as_str().unwrap_or("").to_owned();
    let mut lines = Vec::new();
    let mut same = Vec::new();
    for setting in camera["settings"].as_array().into_iter().flatten() {
        let [name, asked, found] = [0, 1, 2].map(|i| part(setting, i));
        if asked == found {
            same.push(format!("{name} {found}"));
        } else {
            lines.push(format!("{name}: asked for {asked}, has {found}"));
        }
    }
    let health = camera["health"].as_array().into_iter().flatten();
    let told: Vec<String> = health
        .clone()
        .map(|h| format!("{} {}", part(h, 0), part(h, 1)))
        .collect();
    lines.extend((!told.is_empty()).then(|| told.join(", ")));
    // A remark tells how the clock was when the camera was opened; what it reports about itself is newer.
    let is_clock_told = health.clone().any(|h| part(h, 0) == "PTP");
    let remarks = camera["remarks"].as_array().into_iter().flatten();
    let remarks = remarks.filter_map(|r| r.as_str());
    let lasting = remarks.filter(|r| !(is_clock_told && r.starts_with("PTP: ")));
    lines.extend(lasting.map(Into::into));
    lines.extend((!same.is_empty()).then(|| format!("as asked for: {}", same.join(", "))));
    lines
        .iter()
        .map(|line| format!("{:28}{line}\n", ""))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_that_matters_is_in_the_table() {
        let status = super::status(&serde_json::json!({
            "session": "amphora", "complete": 3, "failed": 1, "refused": 0,
            "capture_bytes": 54_000_000, "captures_left": 120, "waiting": 1,
            "plates_age_h": 2.25,
            "calibration_age_h": 75.0,
            "takes_ms": { "durable": { "p50": 800.4, "p99": 1200.0 } },
            "models": { "running": [{}], "waiting": 4, "expected_s": 200.0 },
            "cameras": {
                "c00": {
                    "state": "ready", "words": "Acme, serial 7", "lost_frames": 2,
                    "settings": [["ExposureTime", "8000", "7996"], ["Gain", "0", "0"]],
                    "health": [["temperature", "41.5 °C"], ["PTP", "Slave, 120 ns from its master"]],
                    "remarks": ["PTP: Listening, expected Slave or Master", "its packets have 1500 bytes"],
                },
                "c01": { "state": "away", "words": "no answer" },
            },
        }));
        for line in [
            "session    amphora",
            "captures   3 complete, 1 failed, 0 refused",
            "durable    p50 800 ms, p99 1200 ms after the press",
            "disk       room for 120 captures of 54.0 MB, 1 wait for it",
            "models     1 being made, 4 wait, done in 3 min",
            "background 2.2 h old",
            "calibrated 3 days ago",
            "c00          ready        2  Acme, serial 7",
            "ExposureTime: asked for 8000, has 7996",
            "temperature 41.5 °C, PTP Slave, 120 ns from its master",
            "its packets have 1500 bytes",
            "as asked for: Gain 0",
            "c01          away         0  no answer",
        ] {
            assert!(status.contains(line), "{line}:\n{status}");
        }
        // As its clock was when the camera was opened.
        assert!(!status.contains("Listening"), "{status}");
        // A daemon that says nothing of this is no reason to fail.
        let other = super::status(&serde_json::json!({ "cameras": [{ "id": "c00" }] }));
        assert!(other.contains("cameras    unknown"), "{other}");
        assert!(super::status(&Value::Null).contains("session    none"));
    }
}

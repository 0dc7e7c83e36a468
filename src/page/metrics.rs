//! What `/metrics` tells, in OpenMetrics' text: presses by outcome, how long they took, and what the last status said.

use super::now::captures_left;
use crate::level::Level;
use crate::trigger::Event;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::time::{Duration, Instant};

/// Upper ends of the histograms' buckets in seconds.
const BUCKETS: [f64; 12] = [
    0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 300.0, 900.0,
];
/// Captures whose end is waited for.
const MOST_OPEN: usize = 1000;
/// Outcomes of presses.
const OUTCOMES: [&str; 8] = [
    "durable",
    "failed",
    "retried",
    "refused",
    Level::Green.name(),
    Level::Amber.name(),
    Level::Red.name(),
    "model_failed",
];

#[derive(Clone, Debug, Default)]
struct Histogram {
    buckets: [u64; BUCKETS.len()],
    sum_s: f64,
    count: u64,
}

impl Histogram {
    fn add(&mut self, took: Duration) {
        let seconds = took.as_secs_f64();
        let reached = self.buckets.iter_mut().zip(BUCKETS);
        reached
            .filter(|(_, end)| seconds <= *end)
            .for_each(|(bucket, _)| *bucket += 1);
        self.sum_s += seconds;
        self.count += 1;
    }

    fn write(&self, text: &mut String, name: &str, help: &str) {
        let _ = writeln!(
            text,
            "# TYPE {name} histogram\n# UNIT {name} seconds\n# HELP {name} {help}"
        );
        for (count, end) in self.buckets.iter().zip(BUCKETS) {
            let _ = writeln!(text, "{name}_bucket{{le=\"{end:?}\"}} {count}");
        }
        let (sum, count) = (self.sum_s, self.count);
        let _ = writeln!(
            text,
            "{name}_bucket{{le=\"+Inf\"}} {count}\n{name}_sum {sum}\n{name}_count {count}"
        );
    }
}

/// What was counted since the page began.
#[derive(Default)]
pub(super) struct Metrics {
    outcomes: BTreeMap<&'static str, u64>,
    open: BTreeMap<String, Instant>,
    captured: Histogram,
    durable: Histogram,
    model: Histogram,
}

impl Metrics {
    /// Counts an event that arrived at that time.
    pub(super) fn hear(&mut self, event: &Event, at: Instant) {
        let took = |metrics: &Self, capture: &str| {
            let begun = metrics.open.get(capture)?;
            Some(at.saturating_duration_since(*begun))
        };
        match event {
            Event::Accepted { capture, .. } => {
                self.open.insert(capture.clone(), at);
                self.forget_the_oldest();
            }
            Event::Captured { capture, .. } => {
                let took = took(self, capture);
                took.into_iter().for_each(|took| self.captured.add(took));
            }
            Event::Durable { capture, .. } => {
                let took = took(self, capture);
                took.into_iter().for_each(|took| self.durable.add(took));
                self.count("durable");
            }
            Event::Done {
                capture, verdict, ..
            } => {
                let took = took(self, capture);
                took.into_iter().for_each(|took| self.model.add(took));
                self.end(capture, verdict.name());
            }
            Event::Retried { capture, .. } => self.end(capture, "retried"),
            Event::Failed { capture, .. } => self.end(capture, "failed"),
            Event::JobFailed { capture, .. } => self.end(capture, "model_failed"),
            Event::Refused { .. } => self.count("refused"),
            _ => {}
        }
    }

    fn forget_the_oldest(&mut self) {
        if self.open.len() > MOST_OPEN {
            let oldest = self.open.iter().min_by_key(|(_, begun)| **begun);
            let oldest = oldest.map(|(capture, _)| capture.clone());
            oldest.and_then(|capture| self.open.remove(&capture));
        }
    }

    fn end(&mut self, capture: &str, outcome: &'static str) {
        self.open.remove(capture);
        self.count(outcome);
    }

    fn count(&mut self, outcome: &'static str) {
        *self.outcomes.entry(outcome).or_default() += 1;
    }

    /// Everything as text; without a fresh status, what it would tell is missing.
    pub(super) fn text(&self, status: Option<&Value>) -> String {
        let mut text = String::new();
        let up = u8::from(status.is_some());
        gauge(
            &mut text,
            "scand_daemon_up",
            "Whether the daemon answers",
            &[("", f64::from(up))],
        );
        let name = "scand_presses";
        let _ = writeln!(
            text,
            "# TYPE {name} counter\n# HELP {name} Presses by outcome, since the page began"
        );
        for outcome in OUTCOMES {
            let count = self.outcomes.get(outcome).copied().unwrap_or(0);
            let _ = writeln!(text, "{name}_total{{outcome=\"{outcome}\"}} {count}");
        }
        let from = "from accepted until";
        self.captured.write(
            &mut text,
            "scand_captured_seconds",
            &format!("Time {from} all pictures were in"),
        );
        self.durable.write(
            &mut text,
            "scand_durable_seconds",
            &format!("Time {from} the capture was on the disk"),
        );
        self.model.write(
            &mut text,
            "scand_model_seconds",
            &format!("Time {from} the model was made"),
        );
        status
            .into_iter()
            .for_each(|status| of_status(&mut text, status));
        text + "# EOF\n"
    }
}

fn of_status(text: &mut String, status: &Value) {
    let captures_left = captures_left(status);
    for (name, help, value) in [
        (
            "scand_captures_left",
            "Captures that fit on the disk",
            &captures_left,
        ),
        (
            "scand_models_waiting",
            "Captures that wait for their model",
            &status["models"]["waiting"],
        ),
        (
            "scand_captures_waiting",
            "Captures that wait for the disk",
            &status["waiting"],
        ),
        (
            "scand_plates_age_hours",
            "Age of the oldest background",
            &status["plates_age_h"],
        ),
    ] {
        if let Some(value) = value.as_f64() {
            gauge(text, name, help, &[("", value)]);
        }
    }
    let cameras = status["cameras"].as_object().into_iter().flatten();
    // Names of cameras have no quotes and no backslashes; any other is left out.
    let is_plain = |id: &str| {
        id.bytes()
            .all(|b| b.is_ascii_alphanumeric() || b"_-".contains(&b))
    };
    let cameras: Vec<_> = cameras.filter(|(id, _)| is_plain(id)).collect();
    let up = |camera: &Value| f64::from(u8::from(camera["state"] == "ready"));
    let ups: Vec<_> = cameras
        .iter()
        .map(|(id, c)| (format!("{{camera=\"{id}\"}}"), up(c)))
        .collect();
    let ups: Vec<_> = ups
        .iter()
        .map(|(label, up)| (label.as_str(), *up))
        .collect();
    gauge(text, "scand_camera_up", "Whether a camera is ready", &ups);
}

fn gauge(text: &mut String, name: &str, help: &str, values: &[(&str, f64)]) {
    let _ = writeln!(text, "# TYPE {name} gauge\n# HELP {name} {help}");
    for (labels, value) in values {
        let _ = writeln!(text, "{name}{labels} {value}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn presses_are_counted_by_outcome_and_timed() {
        let mut metrics = Metrics::default();
        let begin = Instant::now();
        for (line, ms) in [
            (r#"{"type":"accepted","capture":"a-0001"}"#, 0),
            (r#"{"type":"captured","capture":"a-0001","skew_ns":1}"#, 150),
            (
                r#"{"type":"durable","capture":"a-0001","recording":"/r/a.mcap"}"#,
                600,
            ),
            (
                r#"{"type":"done","capture":"a-0001","verdict":"red","model":"/m"}"#,
                4000,
            ),
            (r#"{"type":"refused","reason":"full"}"#, 5000),
        ] {
            let at = begin + Duration::from_millis(ms);
            metrics.hear(&serde_json::from_str(line).unwrap(), at);
        }
        let status = json!({ "captures_left": 12, "capture_bytes": 100, "models": null, "plates_age_h": 1.5,
            "cameras": { "c00": { "state": "ready" }, "c01": { "state": "away" }, "x\"y": {} } });
        let text = metrics.text(Some(&status));
        for line in [
            "scand_daemon_up 1",
            "scand_presses_total{outcome=\"red\"} 1",
            "scand_presses_total{outcome=\"refused\"} 1",
            "scand_presses_total{outcome=\"failed\"} 0",
            "scand_captured_seconds_bucket{le=\"0.1\"} 0",
            "scand_captured_seconds_bucket{le=\"0.2\"} 1",
            "scand_captured_seconds_bucket{le=\"+Inf\"} 1",
            "scand_durable_seconds_sum 0.6",
            "scand_model_seconds_count 1",
            "scand_captures_left 12",
            "scand_plates_age_hours 1.5",
            "scand_camera_up{camera=\"c00\"} 1",
            "scand_camera_up{camera=\"c01\"} 0",
        ] {
            assert!(text.lines().any(|found| found == line), "{line}:\n{text}");
        }
        assert!(
            text.ends_with("# EOF\n") && !text.contains("x\"y") && !text.contains("models_waiting")
        );
        assert!(metrics.open.is_empty());
        assert!(!metrics.text(None).contains("captures_left"));
        // While no camera has told its settings, a capture has no size.
        let unknown = json!({ "captures_left": 0, "capture_bytes": 0 });
        assert!(!metrics.text(Some(&unknown)).contains("captures_left"));
    }

    #[test]
    fn the_board_asks_for_metrics_that_there_are() {
        let status = json!({ "captures_left": 1, "capture_bytes": 100, "models": { "waiting": 2 }, "waiting": 0, "plates_age_h": 1.0,
            "cameras": { "c00": { "state": "ready" } } });
        let text = Metrics::default().text(Some(&status));
        let board = include_str!("../../docs/grafana.json");
        let _: Value = serde_json::from_str(board).unwrap();
        let is_name = |c: char| c.is_ascii_lowercase() || c == '_';
        let named = board.split(|c| !is_name(c));
        let named: Vec<_> = named.filter(|word| word.starts_with("scand_")).collect();
        assert!(named.len() >= 9);
        for name in named {
            let is_told = |line: &str| {
                line.strip_prefix(name)
                    .is_some_and(|rest| rest.starts_with([' ', '{']))
            };
            assert!(text.lines().any(is_told), "{name}:\n{text}");
        }
    }
}

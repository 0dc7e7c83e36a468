//! Writes a sheet of paradata as a page to read, without scripts and without external resources.

use crate::frame::Timestamp;
use crate::markup::escaped;
use serde_json::Value;
use std::fmt::Write;

const STYLE: &str = "body{font:16px/1.5 serif;max-width:60rem;margin:2rem auto;padding:0 1rem}\
table{border-collapse:collapse;width:100%}th,td{border:1px solid #999;padding:.2rem .5rem;text-align:left;\
vertical-align:top}th{width:14rem;font-weight:normal;background:#eee}";

/// The page of a capture, or of a model of several.
pub(super) fn of(what: &str, sheet: &Value) -> String {
    let title = escaped(what);
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<title>Paradata of {title}</title>\n\
         <style>{STYLE}</style>\n</head>\n<body>\n<h1>Paradata of {title}</h1>\n"
    );
    for (name, value) in sheet.as_object().into_iter().flatten() {
        let _ = writeln!(page, "<h2>{}</h2>\n{}", words(name), shown(value));
    }
    page + "</body>\n</html>\n"
}

/// A value as HTML: objects as tables, lists as lists.
fn shown(value: &Value) -> String {
    match value {
        Value::Null => "–".into(),
        Value::String(text) => escaped(text),
        Value::Object(members) => {
            let rows = members.iter().map(|(name, value)| row(name, value));
            format!("<table>\n{}</table>", rows.collect::<String>())
        }
        Value::Array(values) if values.iter().all(|v| v.is_number() || v.is_string()) => {
            values.iter().map(shown).collect::<Vec<_>>().join(", ")
        }
        Value::Array(values) => {
            let item = |value: &Value| format!("<li>{}</li>\n", shown(value));
            format!("<ol>\n{}</ol>", values.iter().map(item).collect::<String>())
        }
        other => escaped(&other.to_string()),
    }
}

/// A line of a table. People read a time as a date.
fn row(name: &str, value: &Value) -> String {
    let (name, value) = match time(name, value) {
        Some(time) => ("time", escaped(&time.iso_8601())),
        None => (name, shown(value)),
    };
    format!("<tr><th>{}</th><td>{value}</td></tr>\n", words(name))
}

/// The time that a member in nanoseconds states.
fn time(name: &str, value: &Value) -> Option<Timestamp> {
    let text = value.as_str().filter(|_| name == "time_ns")?;
    text.parse().ok().map(Timestamp)
}

fn words(name: &str) -> String {
    escaped(&name.replace('_', " "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_that_a_recording_says_becomes_markup() {
        let hostile = "</td><script>alert('x')</script>&\u{1b}";
        let sheet = serde_json::json!({ hostile: { hostile: [hostile, { "a": hostile }] } });
        let page = of(hostile, &sheet);
        assert!(
            !page.contains("<script") && !page.contains('\u{1b}'),
            "{page}"
        );
        assert_eq!(page.matches("&lt;script&gt;").count(), 6);
    }

    #[test]
    fn a_time_is_a_date() {
        let note = |time: &str| serde_json::json!({ "notes": { "said": [{ "time_ns": time }] } });
        let page = of("a-0001", &note("1767225605000000000"));
        assert!(
            page.contains("<tr><th>time</th><td>2026-01-01T00:00:05.000Z</td></tr>"),
            "{page}"
        );
        let page = of("a-0001", &note("soon"));
        assert!(
            page.contains("<tr><th>time ns</th><td>soon</td></tr>"),
            "{page}"
        );
    }
}

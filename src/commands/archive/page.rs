//! Writes a sheet of paradata as a page to read, without scripts and without external resources.

use crate::markup::escaped;
use serde_json::Value;
use std::fmt::Write;

const STYLE: &str = "body{font:16px/1.5 serif;max-width:60rem;margin:2rem auto;padding:0 1rem}\
table{border-collapse:collapse;width:100%}th,td{border:1px solid #999;padding:.2rem .5rem;text-align:left;\
vertical-align:top}th{width:14rem;font-weight:normal;background:#eee}";

/// The page of a capture.
pub(super) fn of(capture: &str, sheet: &Value) -> String {
    let title = escaped(capture);
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<title>Paradata of {title}</title>\n\
         <style>{STYLE}</style>\n</head>\n<body>\n<h1>Paradata of capture {title}</h1>\n"
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
            let row = |(name, value): (&String, &Value)| {
                format!(
                    "<tr><th>{}</th><td>{}</td></tr>\n",
                    words(name),
                    shown(value)
                )
            };
            format!(
                "<table>\n{}</table>",
                members.iter().map(row).collect::<String>()
            )
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
}

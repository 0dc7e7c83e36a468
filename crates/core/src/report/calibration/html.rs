//! Text and style of the page.

/// Text with what HTML would take for its own made harmless.
pub(super) fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => safe += "&amp;",
            '<' => safe += "&lt;",
            '>' => safe += "&gt;",
            '"' => safe += "&quot;",
            letter if letter.is_control() => safe.push(' '),
            letter => safe.push(letter),
        }
    }
    safe
}

/// The page's style sheet.
pub(super) fn style() -> &'static str {
    "body{font:15px/1.45 system-ui,sans-serif;margin:2em auto;max-width:70em;padding:0 1em;color:#222}\
     h1{font-size:1.7em}h2{font-size:1.2em;margin-top:1.8em;border-bottom:1px solid #ddd}\
     table{border-collapse:collapse;font-variant-numeric:tabular-nums}td,th{padding:.15em .7em;text-align:right;\
     border-bottom:1px solid #eee}td:first-child,th:first-child{text-align:left}\
     .good{color:#17702f}.fair{color:#7a6a00}.poor{color:#b35900}.bad{color:#c01616;font-weight:bold}\
     .figure{display:inline-block;margin:0 1.4em .4em 0}.figure b{font-size:1.3em}.missing{color:#555}\
     .pictures{display:flex;flex-wrap:wrap;gap:1em}figure{margin:0}figcaption{font-size:.9em}\
     svg{background:#fafafa;border:1px solid #ccc}svg text{font:11px system-ui,sans-serif;fill:#222}"
}

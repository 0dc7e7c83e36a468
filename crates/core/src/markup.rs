//! Text within HTML, XML, and JSON that a reader may take for HTML: what people wrote cannot become markup.

/// Text with what HTML or XML would take for markup made harmless. Letters that control a terminal or turn the
/// direction of what follows become U+FFFD.
pub fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            '\n' => out.push('\n'),
            c if c.is_control() || turns_direction(c) => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

/// Whether a letter is one of Unicode's that embed, override or isolate a direction.
fn turns_direction(letter: char) -> bool {
    matches!(letter, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// Text for a reader of JSON that may take it for HTML: nothing in it is markup, and no letter turns the direction.
pub fn without_markup(text: &str) -> String {
    let letter = |c: char| match c {
        '<' => '‹',
        '>' => '›',
        '&' => '＆',
        c if c.is_control() || turns_direction(c) => '\u{fffd}',
        c => c,
    };
    text.chars().map(letter).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOSTILE: &str = "\"><script>alert(1)</script>'\u{1b}\u{202e}x";

    #[test]
    fn nothing_is_left_that_is_markup() {
        for safe in [escaped(HOSTILE), without_markup(HOSTILE)] {
            assert!(!safe.contains(['<', '>', '\u{1b}', '\u{202e}']), "{safe}");
            assert!(safe.contains("script"), "the words stay: {safe}");
        }
        assert!(!escaped(HOSTILE).contains(['"', '\'']));
        assert_eq!(escaped("Ä & Ö"), "Ä &amp; Ö");
    }
}

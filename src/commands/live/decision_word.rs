//! Tells a misspelt decision about a capture from a text: `rejcet` must not become a mere text, and `object was turned`
//! must not be taken for `reject`.

use crate::words::distance;

/// The words that decide something about a capture.
pub(super) const KINDS: [&str; 3] = ["accept", "reject", "clear"];

/// Words that people write in notes, although only a letter or two separates them from a decision.
const ORDINARY: [&str; 12] = [
    "accent", "access", "aspect", "clean", "cleat", "clerk", "eject", "react", "recent", "reflect",
    "repeat", "respect",
];

/// The decision that a text seems to mean: its first word is one in any form or with one mistake, or it is a single
/// word with two mistakes.
pub(super) fn meant(text: &str) -> Option<&'static str> {
    let mut words = text.split_whitespace();
    let first = words.next()?.to_lowercase();
    let (first, more) = match first.find([',', ':', '.', ';', '!', '-', '–', '—']) {
        Some(at) => (&first[..at], true),
        None => (first.as_str(), words.next().is_some()),
    };
    if ORDINARY.contains(&first) {
        return None;
    }
    KINDS.into_iter().find(|kind| {
        let mistakes = distance(first, kind);
        let similar = first.chars().next() == kind.chars().next();
        let similar = similar && first.chars().count().min(kind.len()) >= 6;
        let most = if similar && !more { 2 } else { 1 };
        mistakes <= most || is_form(first, kind)
    })
}

/// Whether a word is a form of the decision, such as `rejected`.
fn is_form(word: &str, kind: &str) -> bool {
    let ending = word.strip_prefix(kind);
    ending.is_some_and(|ending| ["", "s", "ed", "ing"].contains(&ending))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_misspelt_decision_is_found() {
        for (text, kind) in [
            ("accpt", "accept"),
            ("ACCEPT", "accept"),
            ("accepty", "accept"),
            ("acecpt", "accept"),
            ("rejcet", "reject"),
            ("rejetc", "reject"),
            ("rejected: a hand", "reject"),
            ("reject a hand", "reject"),
            ("rejcet, a hand", "reject"),
            ("Rejects - blurred", "reject"),
            ("cleer", "clear"),
            ("cleared.", "clear"),
            ("clewr that", "clear"),
        ] {
            assert_eq!(meant(text), Some(kind), "{text}");
        }
    }

    #[test]
    fn an_ordinary_text_is_none() {
        #[rustfmt::skip]
        let first_words = [
            "object", "project", "clean", "except", "access", "accent", "subject", "select", "respect", "reflect",
            "recent", "repeat", "result", "aspect", "expect", "effect", "inject", "adept", "concept", "excerpt",
            "accident", "react", "retake", "rejoin", "clay", "class", "click", "clamp", "close", "cleaner", "clerk",
            "cellar", "near", "rear", "blurred", "dear", "glare", "a", "the", "after", "left", "lamp", "hand", "yes",
        ];
        for word in first_words {
            assert_eq!(meant(word), None, "{word}");
            for text in [" was turned left", ": turned", ", turned"] {
                assert_eq!(meant(&format!("{word}{text}")), None, "{word}{text}");
            }
        }
        assert_eq!(meant(""), None);
        assert_eq!(meant(": why"), None);
    }
}

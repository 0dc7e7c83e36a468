//! Text that several rooms need: counts with their plurals, the known word that is closest to a wrong one, names as a
//! shell takes them, bytes as hexadecimal digits, and the beginnings of hostile texts.

use std::path::Path;

/// A count with its noun: `1 capture`, `2 captures`.
pub fn count(number: usize, noun: &str) -> String {
    let plural = if number == 1 { "" } else { "s" };
    format!("{number} {noun}{plural}")
}

/// Bytes as hexadecimal digits in lower case, two for each, as `sha256sum` prints a digest.
pub fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Enough of a hostile text to find it, and no more.
pub fn beginning(text: &str) -> String {
    text.chars().take(80).collect()
}

/// The beginning of a hostile text, with nothing that a terminal would obey.
pub fn shortened(text: &str) -> String {
    printable(&beginning(text))
}

/// A hostile text as one line of a terminal: what it would obey, or what would turn the order of letters round, is
/// escaped.
pub fn printable(text: &str) -> String {
    let turns = |c| matches!(c, '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    let mut line = String::with_capacity(text.len());
    for letter in text.chars() {
        if letter.is_control() || turns(letter) {
            line.extend(letter.escape_default());
        } else {
            line.push(letter);
        }
    }
    line
}

/// At most so many letters of a text; the last one says that there are more.
pub fn at_most(letters: usize, text: &str) -> String {
    match text.char_indices().nth(letters) {
        Some(_) => text.chars().take(letters.max(1) - 1).chain(['…']).collect(),
        None => text.to_owned(),
    }
}

/// A file's name as a person can paste it into a shell.
pub fn shell_word(path: &Path) -> String {
    let name = path.display().to_string();
    let is_plain = |c: char| c.is_alphanumeric() || "/._-+@%:=,".contains(c);
    match !name.is_empty() && name.chars().all(is_plain) {
        true => name,
        false => format!("'{}'", name.replace('\'', r"'\''")),
    }
}

/// The known word that is closest to `word`, if it is close: at most a third of the letters differ, and at most three.
pub fn closest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let word = word.to_lowercase();
    let most = (word.chars().count() / 3).clamp(1, 3);
    let distances = known
        .into_iter()
        .map(|known| (distance(&word, known), known));
    let closest = distances.min_by_key(|(distance, _)| *distance)?;
    (closest.0 <= most).then_some(closest.1)
}

/// How many letters must be put in, taken out, changed or swapped with their neighbour to make one word of the other.
pub fn distance(a: &str, b: &str) -> usize {
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().collect(), b.chars().collect());
    let mut rows = vec![(0..=b.len()).collect::<Vec<usize>>()];
    for i in 1..=a.len() {
        let mut row = vec![i];
        for j in 1..=b.len() {
            let change = rows[i - 1][j - 1] + usize::from(a[i - 1] != b[j - 1]);
            let mut least = change.min(rows[i - 1][j] + 1).min(row[j - 1] + 1);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                least = least.min(rows[i - 2][j - 2] + 1);
            }
            row.push(least);
        }
        rows.push(row);
    }
    rows[a.len()][b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_byte_has_two_hexadecimal_digits() {
        assert_eq!(hexadecimal(&[0, 0x0f, 0xa5]), "000fa5");
    }

    #[test]
    fn close_words_are_found_and_far_ones_are_not() {
        let known = ["accept", "reject", "clear"];
        for (word, expected) in [
            ("accpt", Some("accept")),
            ("Accept", Some("accept")),
            ("rejcet", Some("reject")),
            ("rejected", Some("reject")),
            ("cleer", Some("clear")),
            ("a hand in the picture", None),
            ("blurred", None),
            ("", None),
        ] {
            assert_eq!(closest(word, known), expected, "{word}");
        }
        assert_eq!(distance("", "abc"), 3);
        assert_eq!(distance("xy", "yx"), 1);
    }

    #[test]
    fn a_name_is_one_word_of_a_shell() {
        for (name, word) in [
            ("a/cup-1.mcap", "a/cup-1.mcap"),
            ("Größe.mcap", "Größe.mcap"),
            ("my cup", "'my cup'"),
            ("it's; rm x", r"'it'\''s; rm x'"),
        ] {
            assert_eq!(shell_word(Path::new(name)), word);
        }
    }

    #[test]
    fn a_terminal_obeys_nothing_of_a_printable_text() {
        let hostile = "a\nb\u{1b}[2J\u{9b}\u{202e}ü…";
        let line = r"a\nb\u{1b}[2J\u{9b}\u{202e}ü…";
        assert_eq!(printable(hostile), line);
        assert_eq!([at_most(3, "abc"), at_most(3, "abcd")], ["abc", "ab…"]);
    }

    #[test]
    fn one_has_no_plural() {
        assert_eq!(
            [0, 1, 2].map(|n| count(n, "image")),
            ["0 images", "1 image", "2 images"]
        );
    }
}

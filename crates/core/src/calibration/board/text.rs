//! Boards as text: the compact form of the command line, `charuco:11x8:25mm:two-sided`, and the key-value pairs of
//! a recording's metadata.

use super::{Board, BoardKind, Error, MARKER_PART, Markers, bad};
use calib_targets_aruco::resolve_dictionary;
use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

const FORM: &str =
    "KIND:COLUMNSxROWS:SQUARE, such as checkerboard:11x8:25mm or charuco:11x8:25mm:two-sided";
const KINDS: &str =
    "checkerboard or charuco (circle grids, AprilGrids and other boards cannot be read)";
const SIZE: &str = "COLUMNSxROWS in inner corners, such as 11x8";
const LENGTH: &str = "a length with its unit, such as 25mm";

/// What is known of a board before its markers are.
#[derive(Default)]
struct Draft {
    is_charuco: bool,
    size: (usize, usize),
    square: f64,
    two_sided: bool,
    thickness: f64,
    marker: Option<f64>,
    dictionary: Option<String>,
}

impl Draft {
    fn board(self) -> Result<Board, Error> {
        let (columns, rows) = self.size;
        let plain = Board::checkerboard(columns, rows, self.square)?;
        let board = Board {
            two_sided: self.two_sided,
            thickness: self.thickness,
            ..plain
        };
        if !self.is_charuco {
            if self.marker.is_some() || self.dictionary.is_some() {
                let found = "a checkerboard".to_owned();
                return bad("board with markers", found, "a charuco board");
            }
            return board.checked();
        }
        let dictionary = match self.dictionary {
            None => board.usual_dictionary(),
            Some(name) => match resolve_dictionary(&name) {
                Some(dictionary) => dictionary.name(),
                None => return bad("board dictionary", shown(&name), "such as DICT_4X4_100"),
            },
        };
        let side = self.marker.unwrap_or(MARKER_PART * self.square);
        let kind = BoardKind::Charuco(Markers { side, dictionary });
        Board { kind, ..board }.checked()
    }
}

impl FromStr for Board {
    type Err = Error;

    /// Reads `KIND:COLUMNSxROWS:SQUARE` and any of `two-sided`, `thickness=5mm`, `marker=18mm` and
    /// `dictionary=DICT_4X4_250` behind it.
    fn from_str(text: &str) -> Result<Self, Error> {
        let mut parts = text.split(':').map(str::trim);
        let (Some(kind), Some(size), Some(square)) = (parts.next(), parts.next(), parts.next())
        else {
            return bad("board", shown(text), FORM);
        };
        let mut draft = Draft {
            is_charuco: is_charuco(kind)?,
            size: pair(size)?,
            square: length("board square", square)?,
            ..Draft::default()
        };
        for part in parts {
            match part.split_once('=') {
                None if part == "two-sided" => draft.two_sided = true,
                Some(("thickness", value)) => draft.thickness = length("board thickness", value)?,
                Some(("marker", value)) => draft.marker = Some(length("board marker", value)?),
                Some(("dictionary", value)) => draft.dictionary = Some(value.to_owned()),
                _ => {
                    let expected = "two-sided, thickness=5mm, marker=18mm or dictionary=NAME";
                    return bad("board option", shown(part), expected);
                }
            }
        }
        draft.board()
    }
}

/// The text that [`Board::from_str`] reads back.
impl fmt::Display for Board {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (columns, rows, square) = (self.columns, self.rows, length_text(self.square));
        write!(f, "{}:{columns}x{rows}:{square}", self.kind_name())?;
        if self.two_sided {
            f.write_str(":two-sided")?;
        }
        if self.thickness != 0.0 {
            write!(f, ":thickness={}", length_text(self.thickness))?;
        }
        if let BoardKind::Charuco(markers) = self.kind {
            let usual = Board::charuco(columns, rows, self.square, self.two_sided);
            let usual = usual.ok().map(|board| board.kind);
            if usual != Some(self.kind) {
                let (side, dictionary) = (length_text(markers.side), markers.dictionary);
                write!(f, ":marker={side}:dictionary={dictionary}")?;
            }
        }
        Ok(())
    }
}

impl Board {
    fn kind_name(&self) -> &'static str {
        match self.kind {
            BoardKind::Checkerboard => "checkerboard",
            BoardKind::Charuco(_) => "charuco",
        }
    }

    /// The pairs of a recording's metadata record `board`: `kind`, `size` and `square`, and what else there is to say,
    /// `two_sided`, `thickness`, `marker` and `dictionary`; lengths are metres.
    pub fn pairs(&self) -> BTreeMap<String, String> {
        let size = format!("{}x{}", self.columns, self.rows);
        let mut pairs = vec![
            ("kind", self.kind_name().to_owned()),
            ("size", size),
            ("square", self.square.to_string()),
        ];
        if let BoardKind::Charuco(markers) = self.kind {
            pairs.push(("marker", markers.side.to_string()));
            pairs.push(("dictionary", markers.dictionary.to_owned()));
        }
        if self.two_sided {
            pairs.push(("two_sided", true.to_string()));
            pairs.push(("thickness", self.thickness.to_string()));
        }
        let owned = |(key, value): (&str, String)| (key.to_owned(), value);
        pairs.into_iter().map(owned).collect()
    }

    /// Reads the pairs of a recording's metadata record `board`. Pairs that it does not know are ignored.
    ///
    /// # Errors
    /// If `kind`, `size` or `square` is missing, or a pair cannot be what it stands for.
    pub fn from_pairs(pairs: &BTreeMap<String, String>) -> Result<Self, Error> {
        let optional = |key: &str| pairs.get(key).map(String::as_str);
        let needed = |key: &str| optional(key).unwrap_or_default();
        let number = |what, key| optional(key).map(|value| metres(what, value)).transpose();
        Draft {
            is_charuco: is_charuco(needed("kind"))?,
            size: pair(needed("size"))?,
            square: metres("board square", needed("square"))?,
            two_sided: flag(optional("two_sided").unwrap_or("false"))?,
            thickness: number("board thickness", "thickness")?.unwrap_or(0.0),
            marker: number("board marker", "marker")?,
            dictionary: optional("dictionary").map(str::to_owned),
        }
        .board()
    }
}

fn is_charuco(kind: &str) -> Result<bool, Error> {
    match kind.to_ascii_lowercase().as_str() {
        "checkerboard" | "chessboard" => Ok(false),
        "charuco" => Ok(true),
        _ => bad("board kind", shown(kind), KINDS),
    }
}

fn flag(text: &str) -> Result<bool, Error> {
    let parsed = text.parse();
    parsed.or_else(|_| bad("board two_sided", shown(text), "true or false"))
}

/// Two whole numbers, as people write them: `11x8`, `11 x 8`, `11,8`.
fn pair(text: &str) -> Result<(usize, usize), Error> {
    let inner = text.trim().trim_matches(['[', ']', '(', ')']);
    let parts = inner.split_once(['x', 'X', '×', ',']);
    let number = |part: &str| part.trim().parse().ok();
    let both = parts.and_then(|(a, b)| Some((number(a)?, number(b)?)));
    both.map_or_else(|| bad("board size", shown(text), SIZE), Ok)
}

/// A number of metres.
fn metres(what: &'static str, text: &str) -> Result<f64, Error> {
    let parsed = text.trim().parse();
    parsed.or_else(|_| bad(what, shown(text), "metres, such as 0.025"))
}

/// A length in metres. A number without a unit is one of metres, where a board can be so small: `25` is a mistake for
/// `25mm`.
fn length(what: &'static str, text: &str) -> Result<f64, Error> {
    let value = crate::range::metres_below(1.0, text).filter(|&value| value >= 0.0);
    // Millimetres are what a plain number of this size most likely counts.
    let is_plain = text.trim().parse::<f64>().is_ok_and(|number| number >= 1.0);
    match value {
        Some(value) => Ok(value),
        None if is_plain => bad(
            what,
            format!(
                "{} without a unit ({}mm counts millimetres)",
                shown(text),
                text.trim()
            ),
            LENGTH,
        ),
        None => bad(what, shown(text), LENGTH),
    }
}

/// A length as [`length`] reads it back: in millimetres, or in metres where no short number of millimetres would do.
fn length_text(metres: f64) -> String {
    let text = format!("{}mm", (metres * 1e9).round() / 1e6);
    match length("", &text) {
        Ok(read) if read == metres => text,
        _ => format!("{metres}m"),
    }
}

/// Enough of a text to find it.
fn shown(text: &str) -> String {
    format!("{:?}", text.chars().take(60).collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn texts_are_read_and_written() {
        for text in [
            "checkerboard:11x8:25mm",
            "charuco:11x8:25mm",
            "charuco:11x8:25mm:two-sided",
            "charuco:11x8:25mm:two-sided:thickness=5mm",
            "charuco:9x6:32.5mm:marker=20mm:dictionary=DICT_APRILTAG_36h11",
        ] {
            let board: Board = text.parse().unwrap();
            assert_eq!(board.to_string(), text);
        }
        let board: Board = "chessboard:9x6:2.5cm".parse().unwrap();
        assert_eq!(board.to_string(), "checkerboard:9x6:25mm");
        let board: Board = "charuco:9x6:0.025m:dictionary=4X4_250".parse().unwrap();
        assert!(board.to_string().ends_with("dictionary=DICT_4X4_250"));
    }

    #[test]
    fn a_board_may_have_more_markers_than_the_usual_dictionaries() {
        let text = "charuco:49x40:20mm:dictionary=DICT_APRILTAG_36h10";
        let board: Board = text.parse().unwrap();
        let BoardKind::Charuco(markers) = board.kind else {
            panic!("{board:?}")
        };
        assert_eq!(markers.dictionary, "DICT_APRILTAG_36h10");
        assert_eq!(markers.side, 0.75 * 0.02);
        assert_eq!(board.to_string().parse::<Board>().unwrap(), board);
        // Without its name, the largest of the usual ones is too small.
        let message = "charuco:49x40:20mm".parse::<Board>().unwrap_err();
        let named = "DICT_4X4_1000, 1000 markers for the 1025 that";
        assert!(message.to_string().contains(named), "{message}");
    }

    #[test]
    fn what_is_wrong_with_a_text_is_said() {
        for (text, named) in [
            ("checkerboard:11x8", "KIND:COLUMNSxROWS:SQUARE"),
            (
                "circles:11x8:25mm",
                "\"circles\", expected checkerboard or charuco",
            ),
            ("checkerboard:11:25mm", "\"11\", expected COLUMNSxROWS"),
            (
                "checkerboard:11x8:25",
                "\"25\" without a unit (25mm counts millimetres), expected a length with its unit",
            ),
            ("checkerboard:11x8:25mm:two-sided", "cannot be told apart"),
            (
                "checkerboard:11x8:25mm:marker=18mm",
                "expected a charuco board",
            ),
            ("charuco:11x8:25mm:both", "\"both\", expected two-sided"),
            ("charuco:11x8:25mm:dictionary=X", "\"X\", expected such as"),
            ("charuco:11x8:25m", "25 m, expected 0.001 to 1 m"),
        ] {
            let message = text.parse::<Board>().unwrap_err().to_string();
            assert!(message.contains(named), "{message}");
        }
    }

    #[test]
    fn metadata_of_others_is_read() {
        let pairs = |size: &str, square: &str| {
            let pairs = [("kind", "Checkerboard"), ("size", size), ("square", square)];
            BTreeMap::from(pairs.map(|(k, v)| (k.to_owned(), v.to_owned())))
        };
        for size in ["9x6", "9 x 6", "9X6", "9,6", "[9, 6]"] {
            let board = Board::from_pairs(&pairs(size, "0.025")).unwrap();
            assert_eq!((board.columns, board.rows, board.square), (9, 6, 0.025));
        }
        for (size, square, named) in [
            ("9", "0.025", "board size is \"9\""),
            ("9x6", "25mm", "board square is \"25mm\""),
            ("9x6", "25", "board square is 25 m"),
        ] {
            let message = Board::from_pairs(&pairs(size, square)).unwrap_err();
            assert!(message.to_string().contains(named), "{message}");
        }
        let message = Board::from_pairs(&BTreeMap::new()).unwrap_err().to_string();
        assert!(message.contains("board kind"), "{message}");
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(
            columns in 2..30_usize, rows in 2..30_usize, tenths in 50..1000_u32,
            is_charuco: bool, two_sided: bool,
        ) {
            let square = f64::from(tenths) / 1e4;
            let board = match is_charuco {
                true => Board::charuco(columns, rows, square, two_sided).unwrap(),
                false => Board::checkerboard(columns, rows, square).unwrap(),
            };
            prop_assert_eq!(board.to_string().parse::<Board>().unwrap(), board);
            prop_assert_eq!(Board::from_pairs(&board.pairs()).unwrap(), board);
        }

        #[test]
        fn no_text_panics(text in ".{0,40}") {
            let _ = text.parse::<Board>();
            let _ = pair(&text);
        }
    }
}

//! Calibration boards as sheets to print: the pattern true to scale, rulers to check the scale, and the board's
//! description.

use super::pdf::{Page, pdf};
use crate::calibration::{Board, Face};

/// Sheets that are printed on: their names and sizes in millimetres, upright, the smallest first.
const PAPERS: [(&str, [f64; 2]); 7] = [
    ("a4", [210.0, 297.0]),
    ("letter", [215.9, 279.4]),
    ("a3", [297.0, 420.0]),
    ("a2", [420.0, 594.0]),
    ("a1", [594.0, 841.0]),
    ("a0", [841.0, 1189.0]),
    ("2a0", [1189.0, 1682.0]),
];
/// Millimetres that printers leave white.
const UNPRINTED_MM: f64 = 5.0;
/// Millimetres of white around the pattern, as a part of a square, and for rulers and text outside it.
const QUIET: f64 = 0.5;
const STRIP_MM: f64 = 12.0;
/// Smallest and largest height of the letters, and their mean width as a part of it. They are smaller where one line of
/// these does not fit the page.
const LETTERS_MM: [f64; 2] = [3.0, 4.5];
const LETTER_WIDTH: f64 = 0.5;

/// Millimetres beside the pattern and its quiet zone, on each side.
const BESIDE_MM: f64 = STRIP_MM + UNPRINTED_MM;

/// What a board is printed on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Paper {
    /// The smallest sheet of the A series that has room.
    Smallest,
    /// A page as large as the board needs.
    Custom,
    /// A sheet by its place in the table.
    Named(usize),
}

impl std::str::FromStr for Paper {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let lower = text.to_ascii_lowercase();
        match lower.as_str() {
            "auto" => Ok(Self::Smallest),
            "custom" => Ok(Self::Custom),
            name => {
                let found = PAPERS.iter().position(|(paper, _)| *paper == name);
                let names = PAPERS.map(|(paper, _)| paper).join(", ");
                found
                    .map(Self::Named)
                    .ok_or_else(|| format!("{text:.20?} is not auto, custom, {names}"))
            }
        }
    }
}

/// A board as a PDF file: a page a face. With it the name of the paper.
///
/// # Errors
/// If the paper is too small; the message says for what, and which squares would fit.
pub fn board_sheet(board: &Board, paper: Paper) -> Result<(Vec<u8>, String), String> {
    let outline = board.outline();
    let pattern = [0, 1].map(|a| 1e3 * (outline.max[a] - outline.min[a]));
    let quiet = QUIET * 1e3 * board.square;
    // The strips are on both sides, so that the pattern is in the middle of the page and a back lies behind its front.
    // Lengths went through metres: a tiny excess over a whole millimetre is rounded off.
    let needed = pattern.map(|side| side + 2.0 * (quiet + BESIDE_MM) - 1e-6);
    let (name, size) = sheet(paper, needed).map_err(|words| {
        let fitting = largest_square_mm(board, paper);
        let advice = fitting.map(|mm| format!(" (squares of {mm} mm would fit)"));
        words + &advice.unwrap_or_default()
    })?;
    let pages: Vec<Page> = board
        .faces()
        .iter()
        .map(|&face| page(board, face, size, pattern, quiet))
        .collect();
    Ok((pdf(&board.to_string(), &pages), name))
}

/// The largest squares, in half millimetres, with which a board of these corners fits a sheet; where the sheet is not
/// named, A4. `None` where none does, or the page is as large as the board needs.
pub fn largest_square_mm(board: &Board, paper: Paper) -> Option<f64> {
    let [width, height] = match paper {
        Paper::Custom => return None,
        Paper::Smallest => PAPERS[0].1,
        Paper::Named(k) => PAPERS[k.min(PAPERS.len() - 1)].1,
    };
    // One square more than inner corners, and the quiet zones.
    let squares = [board.columns, board.rows].map(|n| (n + 1) as f64 + 2.0 * QUIET);
    let side = |mm: f64, squares: f64| (2.0 * (mm - 2.0 * BESIDE_MM) / squares).floor() / 2.0;
    let of = |[across, down]: [f64; 2]| side(across, squares[0]).min(side(down, squares[1]));
    let best = of([width, height]).max(of([height, width]));
    (best >= 1.0).then_some(best)
}

/// The paper's name, and its size turned as the board fits.
fn sheet(paper: Paper, needed: [f64; 2]) -> Result<(String, [f64; 2]), String> {
    let fitting = |size: [f64; 2]| {
        let turned = [size, [size[1], size[0]]];
        turned
            .into_iter()
            .find(|s| s[0] >= needed[0] && s[1] >= needed[1])
    };
    let [width, height] = needed.map(f64::ceil);
    match paper {
        Paper::Custom => Ok((format!("{width}x{height} mm"), [width, height])),
        Paper::Smallest => {
            let series = PAPERS.iter().filter(|(name, _)| name.contains('a'));
            let found = series
                .into_iter()
                .find_map(|(name, size)| Some((name, fitting(*size)?)));
            let (name, size) = found.ok_or_else(|| {
                format!("the board needs {width} x {height} mm, more than 2A0: give --paper custom")
            })?;
            Ok((name.to_uppercase(), size))
        }
        Paper::Named(k) => {
            let (name, size) = PAPERS[k.min(PAPERS.len() - 1)];
            let name = name.to_uppercase();
            let fitted = fitting(size).ok_or_else(|| {
                format!("the board needs {width} x {height} mm, more than {name} has: take larger paper or smaller squares")
            })?;
            Ok((name, fitted))
        }
    }
}

fn page(board: &Board, face: Face, size: [f64; 2], pattern: [f64; 2], quiet: f64) -> Page {
    let mut page = Page::new(size[0], size[1]);
    let origin = [0, 1].map(|a| 0.5 * (size[a] - pattern[a]));
    let outline = board.outline();
    page.fill(board.black_rectangles(face).iter().map(|r| {
        let at = |a: usize| origin[a] + 1e3 * (r.min[a] - outline.min[a]);
        let length = |a: usize| 1e3 * (r.max[a] - r.min[a]);
        [at(0), at(1), length(0), length(1)]
    }));
    let bottom = origin[1] + pattern[1] + quiet;
    ruler(&mut page, [origin[0], bottom + 1.0], pattern[0], false);
    ruler(
        &mut page,
        [origin[0] - quiet - 1.0, origin[1]],
        pattern[1],
        true,
    );
    let side = match (board.two_sided, face) {
        (false, _) => "",
        (true, Face::Front) => ", front: this edge down",
        (true, Face::Back) => ", back: this edge down",
    };
    let words = format!(
        "--board {board}{side}. Print at 100 %; the rulers must be as long as they say: {} mm, {} mm.",
        ruler_length(pattern[0]),
        ruler_length(pattern[1])
    );
    let (left, letters) = line_of_text(size[0], origin[0], words.chars().count());
    page.text([left, bottom + STRIP_MM - 1.0], letters, &words);
    page
}

/// Where a line of so many letters begins on a page of a width, below the pattern or further left, and their height; in
/// millimetres.
fn line_of_text(width: f64, pattern_left: f64, count: usize) -> (f64, f64) {
    let right = width - UNPRINTED_MM;
    let per_height = LETTER_WIDTH * count as f64;
    let [least, most] = LETTERS_MM;
    let letters = ((right - pattern_left) / per_height).clamp(least, most);
    let letters = letters.min((right - UNPRINTED_MM) / per_height);
    (pattern_left.min(right - per_height * letters), letters)
}

/// Millimetres of a ruler beside a pattern of a length: whole centimetres.
fn ruler_length(along: f64) -> f64 {
    // A hair less than a whole centimetre is one: the length went through metres.
    ((along + 1e-6) / 10.0).floor() * 10.0
}

/// A ruler with a tick a millimetre from a place on, along the page's width or height.
fn ruler(page: &mut Page, from: [f64; 2], along: f64, is_upright: bool) {
    let length = ruler_length(along);
    let at = |along: f64, away: f64| match is_upright {
        false => [from[0] + along, from[1] + away],
        true => [from[0] - away, from[1] + along],
    };
    page.line(at(0.0, 0.0), at(length, 0.0), 0.1);
    for k in 0..=length.round() as usize {
        let tick = match k % 10 {
            0 => 4.0,
            5 => 3.0,
            _ => 2.0,
        };
        page.line(at(k as f64, 0.0), at(k as f64, tick), 0.1);
        if k % 50 == 0 {
            let place = match is_upright {
                false => [from[0] + k as f64 + 0.6, from[1] + 6.5],
                true => [from[0] - 9.5, from[1] + k as f64 + 2.6],
            };
            page.text(place, 2.5, &k.to_string());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The filled rectangles of each page in millimetres, as a viewer would find them.
    fn rectangles(file: &[u8]) -> Vec<Vec<[f64; 4]>> {
        let text = std::str::from_utf8(file).unwrap();
        let streams = text.split("stream\n").skip(1).step_by(2);
        let of_page = |stream: &str| {
            let rectangles = stream.lines().filter(|line| line.ends_with(" re"));
            let numbers = |line: &str| {
                let parts: Vec<f64> = line
                    .split(' ')
                    .take(4)
                    .map(|n| n.parse::<f64>().unwrap() * 25.4 / 72.0)
                    .collect();
                <[f64; 4]>::try_from(parts).unwrap()
            };
            rectangles.map(numbers).collect()
        };
        streams.map(of_page).collect()
    }

    #[test]
    fn squares_are_as_large_as_they_should_be_and_stand_in_the_middle() {
        let board: Board = "checkerboard:9x6:25mm".parse().unwrap();
        let (file, paper) = board_sheet(&board, Paper::Smallest).unwrap();
        assert_eq!(paper, "A3");
        let pages = rectangles(&file);
        assert_eq!((pages.len(), pages[0].len()), (1, 35));
        for [x, y, width, height] in &pages[0] {
            assert!((width - 25.0).abs() < 1e-4 && (height - 25.0).abs() < 1e-4);
            // A3 lies: 420 x 297 mm, the pattern 250 x 175 mm.
            let (column, row) = ((x - 85.0) / 25.0, (y - 61.0) / 25.0);
            assert!(
                (column - column.round()).abs() < 1e-5 && (0.0..10.0).contains(&column.round())
            );
            assert!((row - row.round()).abs() < 1e-5 && (0.0..7.0).contains(&row.round()));
        }
    }

    #[test]
    fn the_line_below_the_pattern_stays_on_the_page() {
        for board in [
            "checkerboard:4x3:10mm",
            "checkerboard:4x13:12mm",
            "charuco:7x5:20mm",
        ] {
            let board: Board = board.parse().unwrap();
            for paper in ["custom", "auto", "a2"].map(|name| name.parse().unwrap()) {
                let (file, name) = board_sheet(&board, paper).unwrap();
                let text = String::from_utf8(file).unwrap();
                let after = text.split("/MediaBox [0 0 ").nth(1).unwrap();
                let width: f64 = after.split(' ').next().unwrap().parse().unwrap();
                let line = text.lines().find(|l| l.contains("(--board")).unwrap();
                let words: Vec<&str> = line.split(' ').collect();
                let [letters, left] = [2, 4].map(|k| words[k].parse::<f64>().unwrap());
                let count = line.split(['(', ')']).nth(1).unwrap().len();
                let unprinted = UNPRINTED_MM / 25.4 * 72.0 - 0.01;
                let right = left + LETTER_WIDTH * letters * count as f64;
                assert!(
                    left > unprinted && right < width - unprinted,
                    "{board} {name}"
                );
            }
        }
    }

    #[test]
    fn the_largest_squares_fit_and_half_a_millimetre_more_does_not() {
        for (columns, rows) in [(9, 6), (11, 8), (4, 13), (30, 20)] {
            for paper in ["a4", "letter", "a3"].map(|name| name.parse::<Paper>().unwrap()) {
                let any = Board::checkerboard(columns, rows, 0.02).unwrap();
                let mm = largest_square_mm(&any, paper).unwrap();
                let board = |mm: f64| Board::checkerboard(columns, rows, 1e-3 * mm).unwrap();
                assert!(
                    board_sheet(&board(mm), paper).is_ok(),
                    "{columns}x{rows} {mm}"
                );
                assert!(
                    board_sheet(&board(mm + 0.5), paper).is_err(),
                    "{columns}x{rows} {mm}"
                );
            }
        }
        let many = Board::checkerboard(100, 100, 0.02).unwrap();
        let [small, custom] = ["a4", "custom"].map(|name| name.parse().unwrap());
        assert_eq!(largest_square_mm(&many, small), Some(1.5));
        assert_eq!(largest_square_mm(&many, custom), None);
    }

    #[test]
    fn a_back_has_its_own_markers_behind_the_front() {
        let board: Board = "charuco:7x5:20mm:two-sided".parse().unwrap();
        let (file, _) = board_sheet(&board, Paper::Custom).unwrap();
        let pages = rectangles(&file);
        assert_eq!(pages.len(), 2);
        assert_ne!(pages[0], pages[1]);
        let text = String::from_utf8(file).unwrap();
        assert!(text.contains("(--board charuco:7x5:20mm:two-sided, front: this edge down."));
        assert!(text.contains("160 mm, 120 mm"));
    }

    #[test]
    fn paper_that_is_too_small_is_refused_with_what_is_needed() {
        let board: Board = "checkerboard:9x6:25mm".parse().unwrap();
        let paper = "A4".parse().unwrap();
        let message = board_sheet(&board, paper).unwrap_err();
        let told = "309 x 234 mm, more than A4 has: take larger paper or smaller squares (squares of 22 mm would fit)";
        assert!(message.contains(told), "{message}");
        assert!(board_sheet(&board, "a2".parse().unwrap()).is_ok());
        assert!(
            "a9".parse::<Paper>()
                .unwrap_err()
                .contains("auto, custom, a4")
        );
        let huge: Board = "checkerboard:60x40:50mm".parse().unwrap();
        assert!(board_sheet(&huge, Paper::Smallest).is_err());
        assert!(board_sheet(&huge, Paper::Custom).is_ok());
    }
}

//! Letters in pictures, for legends and captions: one small fixed-width font, drawn for this program. `font.txt` beside
//! this file has it in a form that can be read and corrected by eye.

use super::RgbImage;
use std::sync::OnceLock;

/// Columns of a letter.
const COLUMNS: usize = 5;
/// Rows of a letter; capitals fill the first seven, tails of small letters the eighth.
const ROWS: usize = 8;
/// From one letter to the next, in font pixels.
const ADVANCE: usize = COLUMNS + 1;
/// From one line to the next, in font pixels.
const LINE: usize = ROWS + 2;

/// A letter's rows from top to bottom; the highest of five bits is the left column.
type Glyph = [u8; ROWS];

/// What stands for letters the font does not have.
const MISSING: Glyph = [31, 17, 17, 17, 17, 17, 31, 0];

/// Width and height in pixels that `text` takes, with `scale` pixels to one of the font's.
pub fn text_size(text: &str, scale: usize) -> (usize, usize) {
    let columns = text.lines().map(|line| line.chars().count()).max();
    let rows = text.lines().count();
    let width = (columns.unwrap_or(0) * ADVANCE).saturating_sub(1);
    let height = (rows * LINE).saturating_sub(LINE - ROWS);
    (width * scale, height * scale)
}

/// Writes `text` with its top left corner at (x, y), `scale` pixels to one of the font's. A newline begins a
/// new line; what lies outside the picture is cut off; letters the font lacks become a box.
pub fn draw_text(
    image: &mut RgbImage,
    (x, y): (isize, isize),
    scale: usize,
    color: [u8; 3],
    text: &str,
) {
    for (row, line) in text.lines().enumerate() {
        for (column, letter) in line.chars().enumerate() {
            let left = x + (column * ADVANCE * scale) as isize;
            let top = y + (row * LINE * scale) as isize;
            draw_glyph(image, (left, top), scale, color, glyph(letter));
        }
    }
}

fn draw_glyph(
    image: &mut RgbImage,
    (x, y): (isize, isize),
    scale: usize,
    color: [u8; 3],
    glyph: Glyph,
) {
    for row in 0..ROWS * scale {
        for column in 0..COLUMNS * scale {
            let set = glyph[row / scale] >> (COLUMNS - 1 - column / scale) & 1 == 1;
            let (px, py) = (x + column as isize, y + row as isize);
            if set && image.get(px, py).is_some() {
                image[(px as usize, py as usize)] = color;
            }
        }
    }
}

fn glyph(letter: char) -> Glyph {
    static FONT: OnceLock<Vec<(char, Glyph)>> = OnceLock::new();
    let font = FONT.get_or_init(|| parse(include_str!("font.txt")));
    match font.binary_search_by_key(&letter, |&(c, _)| c) {
        Ok(index) => font[index].1,
        Err(_) => MISSING,
    }
}

/// The font's file is blocks of a line that names the letters and [`ROWS`] lines that show them, a letter
/// every [`ADVANCE`] columns.
fn parse(drawing: &str) -> Vec<(char, Glyph)> {
    let lines: Vec<Vec<char>> = drawing.lines().map(|l| l.chars().collect()).collect();
    let mut font = Vec::new();
    for block in lines.chunks_exact(ROWS + 1) {
        for (index, &letter) in block[0].iter().step_by(ADVANCE).enumerate() {
            let left = index * ADVANCE;
            let bits = |row: usize| {
                let cells = &block[row + 1][left..left + COLUMNS];
                cells
                    .iter()
                    .fold(0, |bits, &c| bits << 1 | u8::from(c == '#'))
            };
            font.push((letter, std::array::from_fn(bits)));
        }
    }
    font.sort_unstable();
    font
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(text: &str, scale: usize) -> RgbImage {
        let (width, height) = text_size(text, scale);
        let mut image = RgbImage::filled(width, height, [0; 3]);
        draw_text(&mut image, (0, 0), scale, [255; 3], text);
        image
    }

    #[test]
    fn every_printable_letter_has_its_own_shape() {
        let letters: Vec<char> = (' '..='~').chain("±°µ×–→σ".chars()).collect();
        let shapes: Vec<_> = letters.iter().map(|&c| glyph(c)).collect();
        for (i, shape) in shapes.iter().enumerate() {
            assert_ne!(*shape, MISSING, "{}", letters[i]);
            let twin = shapes[..i].iter().position(|other| other == shape);
            let dashes = letters[i] == '–' && twin.map(|t| letters[t]) == Some('-');
            assert!(twin.is_none() || dashes, "{} {twin:?}", letters[i]);
        }
        assert_eq!(glyph('漢'), MISSING);
    }

    #[test]
    fn text_fits_the_size_that_is_told_and_scales() {
        assert_eq!(text_size("ab\nc", 2), (22, 36));
        let image = picture("HI", 1);
        let row: Vec<bool> = image.row(0).iter().map(|p| p[0] > 0).collect();
        let wanted = "#...#..###.".chars().map(|c| c == '#');
        assert!(row.iter().copied().eq(wanted), "{row:?}");
        let large = picture("HI", 3);
        for y in 0..large.height() {
            for x in 0..large.width() {
                assert_eq!(large[(x, y)], image[(x / 3, y / 3)]);
            }
        }
    }

    #[test]
    fn what_lies_outside_is_cut_off() {
        let mut image = RgbImage::filled(4, 4, [0; 3]);
        for at in [(-3, -3), (2, 2), (-1000, 5), (isize::MAX / 2, 0)] {
            draw_text(&mut image, at, 1, [255; 3], "H\nH");
        }
        assert!(image.pixels().contains(&[255; 3]));
    }
}

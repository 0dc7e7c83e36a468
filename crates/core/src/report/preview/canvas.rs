//! Draws on the sheet: rectangles, pictures, text. It does not know what they show.

use crate::image::{RgbImage, draw_text, text_size};

/// The sheet.
pub(super) const PAPER: [u8; 3] = [22, 24, 29];
/// Behind pictures, where there is nothing to show.
pub(super) const EMPTY: [u8; 3] = [36, 39, 46];
/// Words.
pub(super) const INK: [u8; 3] = [232, 234, 238];
/// Words that matter less.
pub(super) const PALE: [u8; 3] = [150, 156, 168];

/// Fills a rectangle, cut to the sheet.
pub(super) fn fill(
    sheet: &mut RgbImage,
    (left, top): (usize, usize),
    (width, height): (usize, usize),
    color: [u8; 3],
) {
    let right = (left + width).min(sheet.width());
    for y in top..(top + height).min(sheet.height()) {
        sheet.row_mut(y)[left.min(right)..right].fill(color);
    }
}

/// Puts a picture on the sheet, cut to it.
pub(super) fn paste(sheet: &mut RgbImage, part: &RgbImage, (left, top): (usize, usize)) {
    let width = part.width().min(sheet.width().saturating_sub(left));
    for y in 0..part.height().min(sheet.height().saturating_sub(top)) {
        sheet.row_mut(top + y)[left..left + width].copy_from_slice(&part.row(y)[..width]);
    }
}

/// A frame of `thickness` pixels along the inside of a picture's edge.
pub(super) fn frame(picture: &mut RgbImage, thickness: usize, color: [u8; 3]) {
    let (width, height) = (picture.width(), picture.height());
    fill(picture, (0, 0), (width, thickness), color);
    let (bottom, right) = (
        height.saturating_sub(thickness),
        width.saturating_sub(thickness),
    );
    fill(picture, (0, bottom), (width, thickness), color);
    fill(picture, (0, 0), (thickness, height), color);
    fill(picture, (right, 0), (thickness, height), color);
}

/// Writes one line, shortened to `width` pixels.
pub(super) fn write(
    sheet: &mut RgbImage,
    (left, top): (usize, usize),
    scale: usize,
    color: [u8; 3],
    (width, text): (usize, &str),
) {
    let letters = letters_in(width, scale);
    let text = if text.chars().count() > letters {
        let kept: String = text.chars().take(letters.saturating_sub(2)).collect();
        kept + ".."
    } else {
        text.to_owned()
    };
    draw_text(sheet, (left as isize, top as isize), scale, color, &text);
}

/// Letters that a line of `width` pixels has room for.
pub(super) fn letters_in(width: usize, scale: usize) -> usize {
    let advance = text_size("nn", scale)
        .0
        .saturating_sub(text_size("n", scale).0);
    width / advance.max(1)
}

/// Breaks a text at its spaces into lines of at most `letters`; a longer word goes on in the next line.
pub(super) fn wrap(text: &str, letters: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    let pieces = |word: &str| -> Vec<String> {
        let word: Vec<char> = word.chars().collect();
        let parts = word.chunks(letters.max(1));
        parts.map(|part| part.iter().collect()).collect()
    };
    for word in text.split_whitespace().flat_map(pieces) {
        let last = lines.len() - 1;
        let used = lines[last].chars().count();
        if used > 0 && used + 1 + word.chars().count() > letters {
            lines.push(word);
        } else {
            if used > 0 {
                lines[last].push(' ');
            }
            lines[last] += &word;
        }
    }
    lines
}

/// `share` of `over` laid on `under`.
pub(super) fn blend(under: [u8; 3], over: [u8; 3], share: f32) -> [u8; 3] {
    std::array::from_fn(|i| {
        let (a, b) = (f32::from(under[i]), f32::from(over[i]));
        (a + (b - a) * share).round() as u8
    })
}

/// A colour between `stops` that are evenly spaced over [0, 1].
pub(super) fn ramp(stops: &[[u8; 3]], value: f32) -> [u8; 3] {
    let last = stops.len() - 1;
    let at = value.clamp(0.0, 1.0) * last as f32;
    let below = (at as usize).min(last.saturating_sub(1));
    blend(
        stops[below],
        stops[(below + 1).min(last)],
        at - below as f32,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_broken_at_spaces() {
        assert_eq!(wrap("one two three", 7), ["one two", "three"]);
        assert_eq!(
            wrap("an incomprehensible one", 6),
            ["an", "incomp", "rehens", "ible", "one"]
        );
        assert_eq!(wrap("", 5), [""]);
    }

    #[test]
    fn drawing_is_cut_to_the_sheet() {
        let mut sheet = RgbImage::filled(8, 6, PAPER);
        fill(&mut sheet, (6, 4), (90, 90), INK);
        paste(&mut sheet, &RgbImage::filled(5, 5, PALE), (5, 3));
        paste(&mut sheet, &RgbImage::filled(5, 5, PALE), (50, 30));
        assert_eq!((sheet[(7, 5)], sheet[(4, 3)]), (PALE, PAPER));
    }

    #[test]
    fn a_ramp_meets_its_stops() {
        let stops = [[0, 0, 0], [100, 0, 0], [100, 200, 0]];
        assert_eq!(ramp(&stops, 0.5), [100, 0, 0]);
        assert_eq!(ramp(&stops, 0.75), [100, 100, 0]);
        assert_eq!(ramp(&stops, 7.0), [100, 200, 0]);
    }
}

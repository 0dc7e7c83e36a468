//! Curves over time as a picture, one under the other, with the least and the most of each.

use scand::image::{RgbImage, draw_text};
use std::path::Path;

const WIDTH: usize = 900;
const HEIGHT: usize = 160;
const MARGIN: usize = 10;
/// Room for the words above a curve.
const WORDS: usize = 24;
const DARK: [u8; 3] = [40, 40, 40];
const BLUE: [u8; 3] = [30, 90, 200];

/// Writes curves, each a name and its values at `times`. Each begins at 0.
pub fn write(path: &Path, times: &[f64], series: &[(&str, Vec<f64>)]) {
    let mut picture = RgbImage::filled(WIDTH, HEIGHT * series.len(), [255; 3]);
    for (i, (name, values)) in series.iter().enumerate() {
        let least = values.iter().copied().fold(f64::INFINITY, f64::min);
        let most = values.iter().copied().fold(0.0, f64::max);
        let seconds = times.last().copied().unwrap_or(0.0);
        let words = format!(
            "{name}: {least:.1} to {most:.1}, {} captures in {seconds:.0} s",
            values.len()
        );
        let top = i * HEIGHT;
        draw_text(
            &mut picture,
            (MARGIN as isize, (top + 4) as isize),
            2,
            DARK,
            &words,
        );
        let place = |time: f64, value: f64| {
            let x = time / seconds.max(1e-9) * (WIDTH - 2 * MARGIN - 1) as f64;
            let y = value / most.max(1e-9) * (HEIGHT - WORDS - MARGIN - 1) as f64;
            (MARGIN as f64 + x, (top + HEIGHT - MARGIN) as f64 - y)
        };
        line(&mut picture, place(0.0, 0.0), place(seconds, 0.0), DARK);
        let points: Vec<_> = times
            .iter()
            .zip(values)
            .map(|(t, v)| place(*t, *v))
            .collect();
        for pair in points.windows(2) {
            line(&mut picture, pair[0], pair[1], BLUE);
        }
    }
    std::fs::write(path, scand::output::encode_png(&picture).unwrap()).unwrap();
}

fn line(picture: &mut RgbImage, from: (f64, f64), to: (f64, f64), color: [u8; 3]) {
    let steps = (to.0 - from.0)
        .abs()
        .max((to.1 - from.1).abs())
        .ceil()
        .max(1.0);
    for step in 0..=steps as usize {
        let t = step as f64 / steps;
        let (x, y) = (from.0 + t * (to.0 - from.0), from.1 + t * (to.1 - from.1));
        let (x, y) = (x.round() as usize, y.round() as usize);
        if x < picture.width() && y < picture.height() {
            picture.row_mut(y)[x] = color;
        }
    }
}

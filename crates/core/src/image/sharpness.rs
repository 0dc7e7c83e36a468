//! How sharp the edges of a picture are, as a figure that can be compared between pictures of one camera.

use super::{PixelRect, RgbImage};

/// How far apart two pixels are between which an edge is looked for.
const ACROSS: usize = 4;
/// Least difference of their grey values that is an edge and no noise.
const EDGE: i32 = 24;
/// Edges below which nothing can be said.
const FEWEST: u64 = 500;
/// Pixels around an object in which its outline's edge lies, however blurred it is.
const MARGIN: usize = 8;

/// How much of the contrast of strong edges lies between neighbouring pixels, in percent: 100 if every edge is a step
/// from one pixel to the next, 0 if every one is a ramp of four pixels and more. What counts is `part`, the extent of
/// an object, and eight pixels around it. `None` if that has fewer than 500 pixels on strong edges.
///
/// Along rows and columns, wherever two pixels four apart differ by at least 24 grey values, the sum of the squared
/// differences of the neighbours between them is divided by the square of the whole difference: 1 for a step, 1/4 for
/// a ramp.
pub fn sharpness_percent(picture: &RgbImage, part: PixelRect) -> Option<u32> {
    let part = part.grown(MARGIN, picture.width(), picture.height());
    let mut sums = Sums::default();
    let row =
        |y: usize| -> Vec<i32> { picture.row(y)[part.x0..part.x1].iter().map(grey).collect() };
    let mut window: Vec<Vec<i32>> = Vec::with_capacity(ACROSS + 1);
    for y in part.y0..part.y1 {
        let line = row(y);
        for values in line.windows(ACROSS + 1) {
            sums.add(values.iter().copied());
        }
        if window.len() > ACROSS {
            window.remove(0);
        }
        window.push(line);
        if window.len() > ACROSS {
            for x in 0..part.width() {
                sums.add(window.iter().map(|line| line[x]));
            }
        }
    }
    if sums.edges < FEWEST {
        return None;
    }
    let share = sums.near as f64 / sums.across as f64;
    let ramp = 1.0 / ACROSS as f64;
    Some((((share - ramp) / (1.0 - ramp)).clamp(0.0, 1.0) * 100.0).round() as u32)
}

fn grey(pixel: &[u8; 3]) -> i32 {
    let [r, g, b] = pixel.map(i32::from);
    (r + 2 * g + b) / 4
}

#[derive(Default)]
struct Sums {
    edges: u64,
    near: u64,
    across: u64,
}

impl Sums {
    /// Adds what lies between the first value and the last, if that is an edge.
    fn add(&mut self, values: impl Iterator<Item = i32>) {
        let (mut near, mut first, mut before) = (0, None, 0);
        for value in values {
            if first.is_some() {
                near += (value - before) * (value - before);
            }
            first.get_or_insert(value);
            before = value;
        }
        let across = before - first.unwrap_or(before);
        if across.abs() >= EDGE {
            self.edges += 1;
            self.near += near as u64;
            self.across += (across * across) as u64;
        }
    }
}

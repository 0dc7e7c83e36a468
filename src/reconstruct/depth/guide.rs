//! The guide: the intensity of the depth camera's colour picture, cut to the burst's window.

use super::burst::Burst;
use crate::image::{Grid, RgbImage};
use crate::reconstruct::DepthView;
use std::sync::Arc;

/// Intensity in [0, 1] of a picture in the window: the mean of its three channels.
pub fn intensity(color: &RgbImage, burst: &Burst) -> Grid<f32> {
    Grid::from_fn(burst.width, burst.height, |x, y| {
        let [r, g, b] = color[(x + burst.left, y + burst.top)];
        (f32::from(r) + f32::from(g) + f32::from(b)) / 765.0
    })
}

/// Mean intensity over a burst's pictures, each counted once however many frames share it.
pub fn mean(view: &DepthView, burst: &Burst) -> Grid<f32> {
    let mut sum = Grid::filled(burst.width, burst.height, 0.0f32);
    let mut count = 0.0;
    let mut last: Option<&Arc<RgbImage>> = None;
    for frame in &view.frames {
        if last.is_some_and(|last| Arc::ptr_eq(last, &frame.color)) {
            continue;
        }
        last = Some(&frame.color);
        count += 1.0;
        let picture = intensity(&frame.color, burst);
        for (sum, value) in sum.pixels_mut().iter_mut().zip(picture.pixels()) {
            *sum += value;
        }
    }
    for value in sum.pixels_mut() {
        *value /= f32::max(count, 1.0);
    }
    sum
}

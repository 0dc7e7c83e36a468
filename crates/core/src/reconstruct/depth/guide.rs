//! The guide: the intensity of the depth camera's colour picture, cut to the burst's window.

use super::burst::Burst;
use crate::image::{Grid, RgbImage};
use crate::reconstruct::{DepthFrame, DepthView};
use rayon::prelude::*;
use std::sync::Arc;

/// Intensity in [0, 1] of a picture in the window: the mean of its three channels.
fn intensity(color: &RgbImage, burst: &Burst) -> Grid<f32> {
    Grid::from_fn(burst.width, burst.height, |x, y| {
        let [r, g, b] = color[(x + burst.left, y + burst.top)];
        (f32::from(r) + f32::from(g) + f32::from(b)) / 765.0
    })
}

/// Intensity of a frame's picture. Without one it is the same everywhere: that guides nothing and hinders nothing.
pub(super) fn of_frame(frame: &DepthFrame, burst: &Burst) -> Grid<f32> {
    match &frame.color {
        Some(color) => intensity(color, burst),
        None => Grid::filled(burst.width, burst.height, 0.0),
    }
}

/// Mean intensity over a burst's pictures, each counted once however many frames share it; 0 everywhere if it has none.
pub(super) fn mean(view: &DepthView, burst: &Burst) -> Grid<f32> {
    let colors = view.frames.iter().filter_map(|f| f.color.as_ref());
    let mut different: Vec<&Arc<RgbImage>> = colors.collect();
    different.dedup_by(|a, b| Arc::ptr_eq(a, b));
    let pictures = different.par_iter().map(|color| intensity(color, burst));
    let pictures: Vec<Grid<f32>> = pictures.collect();
    let mut sum = Grid::filled(burst.width, burst.height, 0.0f32);
    for picture in &pictures {
        for (sum, value) in sum.pixels_mut().iter_mut().zip(picture.pixels()) {
            *sum += value;
        }
    }
    let count = pictures.len().max(1) as f32;
    for value in sum.pixels_mut() {
        *value /= count;
    }
    sum
}

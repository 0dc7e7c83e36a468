//! A part of a camera's picture as a panel of the sheet: crops, and the projection that goes with them.

use super::canvas::EMPTY;
use crate::image::{PixelRect, RgbImage};

/// A rectangle of a picture, shown at some scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Window {
    /// Left and top edge in the picture's pixels (the edge of pixel 0 is at -0.5).
    pub left: f64,
    /// See `left`.
    pub top: f64,
    /// Pixels of the picture to one of the panel.
    pub scale: f64,
    /// Width of the panel in pixels.
    pub width: usize,
    /// Its height.
    pub height: usize,
}

impl Window {
    /// Shows `rect` with some margin, in the middle of a panel.
    pub(super) fn around(rect: PixelRect, (width, height): (usize, usize)) -> Self {
        const MARGIN: f64 = 1.12;
        let side = |pixels: usize, panel: usize| MARGIN * pixels.max(1) as f64 / panel as f64;
        let scale = side(rect.width(), width).max(side(rect.height(), height));
        let middle = |first: usize, end: usize| 0.5 * (first + end) as f64 - 0.5;
        Self {
            left: middle(rect.x0, rect.x1) - 0.5 * scale * width as f64,
            top: middle(rect.y0, rect.y1) - 0.5 * scale * height as f64,
            scale,
            width,
            height,
        }
    }

    /// Projected pixel coordinates as coordinates of the panel.
    pub(super) fn panel_from_picture(&self, [x, y, depth]: [f32; 3]) -> [f32; 3] {
        let to = |p: f32, edge: f64| ((f64::from(p) - edge) / self.scale - 0.5) as f32;
        [to(x, self.left), to(y, self.top), depth]
    }

    /// The picture's coordinates of a point of the panel.
    pub(super) fn picture_from_panel(&self, x: f64, y: f64) -> (f64, f64) {
        (
            self.left + (x + 0.5) * self.scale,
            self.top + (y + 0.5) * self.scale,
        )
    }

    /// A panel whose pixels are computed from the nearest pixel of the picture.
    pub(super) fn nearest(&self, color: impl Fn(isize, isize) -> [u8; 3]) -> RgbImage {
        let (columns, rows) = self.samples(1);
        RgbImage::from_fn(self.width, self.height, |x, y| color(columns[x], rows[y]))
    }

    /// The picture's columns and rows nearest to this many evenly spaced samples of each of the panel's.
    pub(super) fn samples(&self, samples: usize) -> (Vec<isize>, Vec<isize>) {
        let at = |k: usize| {
            let offset = ((k % samples) as f64 + 0.5) / samples as f64 - 0.5;
            (k / samples) as f64 + offset
        };
        let column = |k| self.picture_from_panel(at(k), 0.0).0.round() as isize;
        let row = |k| self.picture_from_panel(0.0, at(k)).1.round() as isize;
        (
            (0..samples * self.width).map(column).collect(),
            (0..samples * self.height).map(row).collect(),
        )
    }

    /// The picture in the window, the mean of up to 3 x 3 of its pixels to one of the panel's.
    pub(super) fn crop(&self, picture: &RgbImage) -> RgbImage {
        let samples = (self.scale.round() as usize).clamp(1, 3);
        let (columns, rows) = self.samples(samples);
        RgbImage::from_fn(self.width, self.height, |x, y| {
            let (mut sum, mut count) = ([0u32; 3], 0);
            for &row in &rows[y * samples..][..samples] {
                for &column in &columns[x * samples..][..samples] {
                    if let Some(pixel) = picture.get(column, row) {
                        (0..3).for_each(|i| sum[i] += u32::from(pixel[i]));
                        count += 1;
                    }
                }
            }
            if count == 0 {
                return EMPTY;
            }
            sum.map(|s| ((s + count / 2) / count) as u8)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_goes_both_ways_and_holds_its_rectangle() {
        let rect = PixelRect {
            x0: 100,
            y0: 40,
            x1: 300,
            y1: 90,
        };
        let window = Window::around(rect, (50, 50));
        let (x, y) = window.picture_from_panel(7.0, 11.0);
        let back = window.panel_from_picture([x as f32, y as f32, 2.0]);
        assert!(
            (back[0] - 7.0).abs() < 1e-4 && (back[1] - 11.0).abs() < 1e-4,
            "{back:?}"
        );
        for (x, y) in [(100.0, 40.0), (299.0, 89.0)] {
            let [x, y, _] = window.panel_from_picture([x, y, 1.0]);
            assert!(
                (0.0..49.0).contains(&x) && (0.0..49.0).contains(&y),
                "{x} {y}"
            );
        }
    }

    #[test]
    fn a_crop_beyond_the_picture_is_empty() {
        let picture = RgbImage::filled(20, 20, [200, 10, 10]);
        let window = Window::around(PixelRect::whole(40, 40), (30, 30));
        let crop = window.crop(&picture);
        assert_eq!((crop[(10, 10)], crop[(29, 29)]), ([200, 10, 10], EMPTY));
    }
}

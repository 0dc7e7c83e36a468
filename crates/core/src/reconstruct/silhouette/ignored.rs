//! Pixels that are to be ignored, because something in front of the object hides it there. This file decides how far
//! around them a silhouette is unknown, and makes pictures and masks in which nothing is seen there. Other files decide
//! what an unknown pixel means for the hull.

use super::Silhouette;
use crate::image::{Grid, Mask, RgbImage};
use std::borrow::Cow;

/// How far lens and mosaic carry what is ignored, in pixels.
const HIDDEN_PX: usize = 2;
/// How far from what is hidden a silhouette may be wrong, because it ends there: as far as a contour's pixels and their
/// majority are looked for.
const BESIDE_PX: usize = 3;

/// The first value that is ignored.
const IGNORED: u8 = 128;

/// What is ignored of a picture.
pub(super) struct Ignored {
    /// 255 where the picture may show it: there it is not looked at.
    pub hidden: Mask,
    /// 255 where the silhouette says nothing.
    pub unknown: Mask,
}

impl Ignored {
    pub(super) fn new(ignored: &Mask) -> Self {
        Self {
            hidden: grown(ignored, HIDDEN_PX),
            unknown: grown(ignored, HIDDEN_PX + BESIDE_PX),
        }
    }

    /// The picture with the backdrop in place of what is hidden.
    pub(super) fn picture(&self, picture: &RgbImage, plate: &RgbImage) -> RgbImage {
        let mut seen = picture.clone();
        let each = seen.pixels_mut().iter_mut().zip(plate.pixels());
        for ((pixel, &plate), &hidden) in each.zip(self.hidden.pixels()) {
            if hidden >= IGNORED {
                *pixel = plate;
            }
        }
        seen
    }

    /// The mask with nothing in place of what is hidden.
    pub(super) fn mask(&self, mask: &Mask) -> Mask {
        let mut seen = mask.clone();
        for (level, &hidden) in seen.pixels_mut().iter_mut().zip(self.hidden.pixels()) {
            if hidden >= IGNORED {
                *level = 0;
            }
        }
        seen
    }
}

/// 255 within so many columns and rows of what is ignored, 0 elsewhere.
fn grown(ignored: &Mask, px: usize) -> Mask {
    let (width, height) = (ignored.width(), ignored.height());
    let across = Grid::from_fn(width, height, |x, y| {
        let columns = x.saturating_sub(px)..(x + px + 1).min(width);
        ignored.row(y)[columns].iter().any(|&m| m >= IGNORED)
    });
    Grid::from_fn(width, height, |x, y| {
        let mut rows = y.saturating_sub(px)..(y + px + 1).min(height);
        if rows.any(|y| across[(x, y)]) { 255 } else { 0 }
    })
}

impl Silhouette {
    /// The same silhouette, which says nothing of what is unknown.
    pub(super) fn without(mut self, unknown: Option<Mask>) -> Self {
        let count = |mask: &Mask| mask.pixels().iter().filter(|&&m| m >= IGNORED).count();
        if let Some(mask) = &unknown {
            for (level, &unknown) in self.level.pixels_mut().iter_mut().zip(mask.pixels()) {
                if unknown >= IGNORED {
                    *level = 0;
                }
            }
        }
        self.facts.unknown_px = unknown.as_ref().map(count);
        self.unknown = unknown;
        self
    }

    /// The level set, and 255 where it says nothing: what is 128 or more is not known to lie outside.
    pub fn possible_object(&self) -> Cow<'_, Mask> {
        let Some(unknown) = &self.unknown else {
            return Cow::Borrowed(&self.level);
        };
        let mut level = self.level.clone();
        for (level, &unknown) in level.pixels_mut().iter_mut().zip(unknown.pixels()) {
            *level = (*level).max(unknown);
        }
        Cow::Owned(level)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_beside_an_ignored_pixel_is_unknown_too() {
        let mut ignored = Mask::filled(9, 7, 127);
        ignored[(4, 3)] = 128;
        let grown = grown(&ignored, 2);
        for y in 0..7_usize {
            for x in 0..9_usize {
                let near = x.abs_diff(4) <= 2 && y.abs_diff(3) <= 2;
                assert_eq!(grown[(x, y)] == 255, near, "{x} {y}");
            }
        }
    }
}

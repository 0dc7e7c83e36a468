//! What a look at a camera shows while a rig is set up: a small picture, highlights that are clipped, how sharp its
//! edges are, and the silhouette's outline as it would be cut. It judges one picture and keeps nothing; other rooms
//! take the pictures and show them.

mod contours;
#[cfg(test)]
mod tests;

use crate::calibration::{Camera, Intrinsics, Volume};
use crate::image::{Grid, Mask, PixelRect, RgbImage, sharpness_percent};
use crate::reconstruct::silhouette::{self, extract};
use crate::reconstruct::{ColorView, SilhouetteSource};
use contours::contours;
use nalgebra::Vector2;
use std::sync::Arc;

/// Longest side of a look's picture in pixels.
pub const LONGEST_SIDE: usize = 640;
/// A channel that reads this much or more is clipped.
const CLIPPED: u8 = 254;

/// What is needed to cut an object out of a camera's picture.
#[derive(Clone, Debug)]
pub struct Segmentation {
    /// The camera, of the size of its full picture.
    pub camera: Camera,
    /// The box in which the object is.
    pub volume: Volume,
    /// The camera's view of the empty rig, of the same size.
    pub background: RgbImage,
    /// The silhouettes' settings for full pictures.
    pub parameters: silhouette::Parameters,
}

/// A look at a colour camera.
#[derive(Clone, Debug)]
pub struct ColorLook {
    /// The picture, each pixel the mean of a square of pixels.
    pub picture: RgbImage,
    /// Pixels of the full picture on a side of that square.
    pub scale: usize,
    /// How many of a million pixels are clipped in a channel.
    pub clipped_ppm: u32,
    /// Where at least half of a square is clipped: closed polygons in pixels of the small picture.
    pub clipped: Vec<Vec<[u16; 2]>>,
    /// How sharp the edges are, 0 to 100; `None` if there are too few, see [`sharpness_percent`].
    pub sharpness_percent: Option<u32>,
    /// The silhouette's outline, or why there is none.
    pub outline: Result<Outline, String>,
}

/// A look at a colour camera that joined pixels for it: what does not depend on single pixels.
#[derive(Clone, Debug)]
pub struct BinnedLook {
    /// The picture, each pixel the mean of a square of the camera's pixels.
    pub picture: RgbImage,
    /// Pixels of the camera's full picture on a side of that square.
    pub scale: usize,
    /// The silhouette's outline, or why there is none.
    pub outline: Result<Outline, String>,
}

/// A silhouette's outline in a small picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outline {
    /// Closed polygons in pixels of the small picture, outer contours and those of holes.
    pub polygons: Vec<Vec<[u16; 2]>>,
    /// Sides of the frame that the object touches: of `left`, `top`, `right`, `bottom`.
    pub touches: Vec<&'static str>,
}

/// Looks at a colour camera's picture. `cutting` is what it takes to cut the object out, or why that is not there.
pub fn color(picture: &RgbImage, cutting: Result<&Segmentation, String>) -> ColorLook {
    let scale = scale_of(picture.width(), picture.height());
    let small = reduced(picture, scale);
    let (clipped_ppm, clipped) = clipped(picture, scale);
    let cut = cutting.and_then(|cutting| cut(&small, scale, cutting));
    let part = match &cut {
        Ok(mask) => full_size(
            mask.extent(whole(mask), |&level| level >= 128),
            scale,
            picture,
        ),
        Err(_) => PixelRect::whole(picture.width(), picture.height()),
    };
    ColorLook {
        scale,
        clipped_ppm,
        clipped: contours(&clipped),
        sharpness_percent: sharpness_percent(picture, part),
        outline: cut.map(|mask| outline(&mask)),
        picture: small,
    }
}

/// Looks at a picture for which a colour camera joined squares of `joined` pixels a side. `cutting` is for full
/// pictures, as for [`color`].
pub fn binned(
    picture: &RgbImage,
    joined: usize,
    cutting: Result<&Segmentation, String>,
) -> BinnedLook {
    let by = scale_of(picture.width(), picture.height());
    let small = reduced(picture, by);
    let scale = by * joined;
    let cut = cutting.and_then(|cutting| cut(&small, scale, cutting));
    BinnedLook {
        scale,
        outline: cut.map(|mask| outline(&mask)),
        picture: small,
    }
}

/// A look at a depth camera: readings as grey values, near bright and none black, and how many of a hundred are there.
pub fn depth(readings: &Grid<u16>) -> (RgbImage, u32) {
    let mut there: Vec<u16> = readings
        .pixels()
        .iter()
        .copied()
        .filter(|&r| r > 0)
        .collect();
    let percent = (there.len() * 100 / readings.pixels().len().max(1)) as u32;
    there.sort_unstable();
    let at = |share: usize| there.get((there.len().saturating_sub(1)) * share / 100);
    let (near, far) = (*at(1).unwrap_or(&0), *at(99).unwrap_or(&0));
    let span = f32::from(far.saturating_sub(near).max(1));
    let grey = readings.map(|&reading| match reading {
        0 => [0; 3],
        reading => {
            let from_near = f32::from(reading.clamp(near, far) - near) / span;
            [(255.0 - 205.0 * from_near) as u8; 3]
        }
    });
    (
        reduced(&grey, scale_of(grey.width(), grey.height())),
        percent,
    )
}

fn whole<T>(grid: &Grid<T>) -> PixelRect {
    PixelRect::whole(grid.width(), grid.height())
}

/// Pixels a side that become one, so that the picture is at most [`LONGEST_SIDE`] long.
fn scale_of(width: usize, height: usize) -> usize {
    width.max(height).div_ceil(LONGEST_SIDE).max(1)
}

/// The picture whose pixels are the means of squares; what is left over at the right and at the bottom is dropped.
fn reduced(picture: &RgbImage, scale: usize) -> RgbImage {
    let size = [picture.width(), picture.height()].map(|side| (side / scale).max(1));
    let count = (scale * scale) as u32;
    RgbImage::from_fn(size[0], size[1], |x, y| {
        let mut sums = [0_u32; 3];
        for row in y * scale..((y + 1) * scale).min(picture.height()) {
            let across = x * scale..((x + 1) * scale).min(picture.width());
            for pixel in &picture.row(row)[across] {
                for (sum, &value) in sums.iter_mut().zip(pixel) {
                    *sum += u32::from(value);
                }
            }
        }
        sums.map(|sum| ((sum + count / 2) / count).min(255) as u8)
    })
}

/// How many of a million pixels are clipped, and the squares of which at least half is.
fn clipped(picture: &RgbImage, scale: usize) -> (u32, Mask) {
    let is_clipped = |pixel: &[u8; 3]| pixel.iter().any(|&value| value >= CLIPPED);
    let all = picture
        .pixels()
        .iter()
        .filter(|pixel| is_clipped(pixel))
        .count();
    let ppm = all as u64 * 1_000_000 / picture.pixels().len().max(1) as u64;
    let size = [picture.width(), picture.height()].map(|side| (side / scale).max(1));
    let mask = Mask::from_fn(size[0], size[1], |x, y| {
        let rows = y * scale..((y + 1) * scale).min(picture.height());
        let across = x * scale..((x + 1) * scale).min(picture.width());
        let pixels = rows.flat_map(|row| &picture.row(row)[across.clone()]);
        let count = pixels.filter(|pixel| is_clipped(pixel)).count();
        if 2 * count >= scale * scale { 255 } else { 0 }
    });
    (ppm as u32, mask)
}

/// The silhouette in a small picture, with the settings for full ones.
fn cut(small: &RgbImage, scale: usize, cutting: &Segmentation) -> Result<Mask, String> {
    let background = &cutting.background;
    let background_size = [background.width() / scale, background.height() / scale];
    if background_size != [small.width(), small.height()] {
        return Err(format!(
            "its background picture is {}x{} pixels, and the camera gives another size now: take background pictures again",
            background.width(),
            background.height()
        ));
    }
    let camera = reduced_camera(&cutting.camera, scale).map_err(|error| error.to_string())?;
    let view = ColorView {
        camera,
        image: small.clone(),
        silhouette: SilhouetteSource::Background(Arc::new(reduced(background, scale))),
        ignored: None,
    };
    let parameters = silhouette::Parameters {
        smallest_hole_px: cutting.parameters.smallest_hole_px / (scale * scale) as f32,
        ..cutting.parameters.clone()
    };
    let found = extract(&view, &cutting.volume, &parameters);
    found.map(|found| found.level).map_err(|error| match error {
        silhouette::Error::Empty { reason, .. } => format!("no object is found: {reason}"),
        other => other.to_string(),
    })
}

/// The camera of a picture whose pixels are squares of `scale` pixels. Pixel 0 has its centre at 0 in either.
fn reduced_camera(camera: &Camera, scale: usize) -> Result<Camera, crate::calibration::Error> {
    let lens = &camera.intrinsics;
    let by = scale as f64;
    let center = lens.center_px.map(|c| (c + 0.5) / by - 0.5);
    let lens = Intrinsics::new(
        (lens.width / scale).max(1),
        (lens.height / scale).max(1),
        lens.focal_px / by,
        Vector2::new(center.x, center.y),
        lens.distortion,
    )?;
    Ok(Camera::new(camera.id.clone(), lens, camera.rig_from_camera))
}

/// The part of the full picture that a part of the small one stands for; all of it for none.
fn full_size(part: Option<PixelRect>, scale: usize, picture: &RgbImage) -> PixelRect {
    let all = PixelRect::whole(picture.width(), picture.height());
    part.map_or(all, |part| PixelRect {
        x0: part.x0 * scale,
        y0: part.y0 * scale,
        x1: (part.x1 * scale).min(all.x1),
        y1: (part.y1 * scale).min(all.y1),
    })
}

fn outline(mask: &Mask) -> Outline {
    let bounds = mask
        .extent(whole(mask), |&level| level >= 128)
        .unwrap_or_default();
    let sides = [
        ("left", bounds.x0 == 0),
        ("top", bounds.y0 == 0),
        ("right", bounds.x1 == mask.width()),
        ("bottom", bounds.y1 == mask.height()),
    ];
    let touched = sides
        .into_iter()
        .filter(|(_, touches)| *touches && !bounds.is_empty());
    Outline {
        polygons: contours(mask),
        touches: touched.map(|(side, _)| side).collect(),
    }
}

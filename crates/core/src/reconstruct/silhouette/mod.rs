//! Makes a silhouette, whose contour is located to a fraction of a pixel, from a picture and a mask or a
//! background. This file has the result and the order of the steps, which are in one file each: `region` (where the
//! object can be) → `cells` (coarse means of picture and background) → `photometry` (exposure drift and noise) →
//! `evidence` (object or backdrop, for each cell) → `segment` (a decision regularised in space; `grey` without
//! colours) → `components` (specks and pinholes) → `contour` (the mixture of object and backdrop along the
//! outline).

mod cells;
mod components;
mod contour;
mod cut;
mod evidence;
mod facts;
mod grey;
mod ignored;
mod mask;
mod photometry;
mod region;
mod segment;

pub use facts::{DifferenceFacts, Facts};

use super::{ColorView, SilhouetteSource};
use crate::calibration::Volume;
use crate::frame::CameraId;
use crate::image::{Mask, PixelRect, RgbImage};
use cells::Cells;
use ignored::Ignored;
use photometry::Photometry;
use region::Region;

/// What the silhouettes' settings are. The defaults are for pictures of 0.3 to 5 megapixels.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// Side of the cells that are segmented before the contour is located, in pixels; 0 chooses 1, 2 or 4
    /// from the size of the object's region.
    /// Default 0, range 0 to 16.
    #[serde(deserialize_with = "crate::range::count::<_, usize, 0, 16>")]
    pub cell_px: usize,
    /// How many standard deviations of noise a cell must differ from the background to count as object.
    /// Default 4, range 0.001 to 1000.
    #[serde(deserialize_with = "crate::range::from_a_thousandth::<_, f32, 1000>")]
    pub significance: f32,
    /// Darkest shadow that may fall on the backdrop, as a share of the backdrop's brightness.
    /// Default 0.12, range 0 to 1.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 1>")]
    pub darkest_shadow: f32,
    /// How strongly a shadow may be coloured, as a share of the light that it removes.
    /// Default 0.15, range 0 to 1.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 1>")]
    pub shadow_tint: f32,
    /// How much light the object may reflect onto the backdrop, as a share of the backdrop's brightness.
    /// Default 0.06, range 0 to 1.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 1>")]
    pub spill: f32,
    /// Cost of a boundary along one side of a cell, in units of evidence.
    /// Default 12, range 0 to 1000000.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 1000000>")]
    pub smoothness: f32,
    /// Smallest hole in a silhouette that is kept, in pixels.
    /// Default 40, range 0 to 1000000000.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 1000000000>")]
    pub smallest_hole_px: f32,
    /// Smallest separate piece that is kept, as a share of the largest one's area.
    /// Default 0.005, range 0 to 1.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 1>")]
    pub smallest_piece: f32,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            cell_px: 0,
            significance: 4.0,
            darkest_shadow: 0.12,
            shadow_tint: 0.15,
            spill: 0.06,
            smoothness: 12.0,
            smallest_hole_px: 40.0,
            smallest_piece: 0.005,
        }
    }
}

/// A silhouette as a level set.
#[derive(Clone, Debug)]
pub struct Silhouette {
    /// Of the picture's size: 255 well inside the object, 0 well outside; interpolated bilinearly it crosses
    /// 127.5 at the contour, to a fraction of a pixel. Nothing falls to 0 towards the picture's border: an
    /// object that the frame cuts stays cut open there.
    pub level: Mask,
    /// Where the picture was looked at: the volume's projection and a margin. Outside it the level is 0.
    pub region: PixelRect,
    /// The object's pixels (128 and up), without those of a mask that are specks or beside the volume's projection.
    pub bounds: PixelRect,
    /// What was found on the way.
    pub facts: Facts,
    /// 255 where the silhouette says nothing, because the picture is ignored there or beside: neither object nor
    /// backdrop, though the level is 0. What bounds it is no contour.
    pub unknown: Option<Mask>,
}

/// Why there is no silhouette.
#[derive(Clone, Debug, thiserror::Error, PartialEq)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Error {
    /// A picture that does not fit its camera.
    #[error(
        "camera {camera}: its {what} has {}x{} pixels, but its calibration is for {}x{}",
        found.0, found.1, expected.0, expected.1
    )]
    Size {
        camera: CameraId,
        what: &'static str,
        found: (usize, usize),
        expected: (usize, usize),
    },
    /// The volume is not in the picture.
    #[error("camera {camera}: the volume's projection lies outside its picture")]
    VolumeNotSeen { camera: CameraId },
    /// No object.
    #[error("camera {camera}: its silhouette is empty: {reason}")]
    Empty {
        camera: CameraId,
        /// What was seen instead.
        reason: String,
    },
}

/// The silhouette of what is in `volume`.
///
/// # Errors
/// If a picture's size is not the calibration's, the volume is not in the picture, or there is no object.
pub fn extract(
    view: &ColorView,
    volume: &Volume,
    parameters: &Parameters,
) -> Result<Silhouette, Error> {
    let camera = &view.camera;
    let expected = (camera.intrinsics.width, camera.intrinsics.height);
    let check = |what, found: (usize, usize)| {
        (found == expected).then_some(()).ok_or(Error::Size {
            camera: camera.id.clone(),
            what,
            found,
            expected,
        })
    };
    check("picture", (view.image.width(), view.image.height()))?;
    let region = region::project(camera, volume).ok_or_else(|| Error::VolumeNotSeen {
        camera: camera.id.clone(),
    })?;
    let ignored = match &view.ignored {
        Some(mask) => {
            check("ignore mask", (mask.width(), mask.height()))?;
            Some(Ignored::new(mask))
        }
        None => None,
    };
    let silhouette = match &view.silhouette {
        SilhouetteSource::Mask(mask) => {
            check("mask", (mask.width(), mask.height()))?;
            let of = |mask: &Mask| mask::silhouette(&view.image, mask, &region, parameters);
            match &ignored {
                Some(ignored) => of(&ignored.mask(mask)),
                None => of(mask),
            }
        }
        SilhouetteSource::Background(plate) => {
            check("background", (plate.width(), plate.height()))?;
            match &ignored {
                Some(ignored) => {
                    let seen = ignored.picture(&view.image, plate);
                    difference((&seen, plate), Some(ignored), &region, parameters)
                }
                None => difference((&view.image, plate), None, &region, parameters),
            }
        }
    };
    match silhouette {
        Ok(silhouette) => Ok(silhouette.without(ignored.map(|ignored| ignored.unknown))),
        Err(reason) => Err(Error::Empty {
            camera: camera.id.clone(),
            reason: match ignored {
                Some(_) => format!("{reason}, besides what is ignored in it"),
                None => reason,
            },
        }),
    }
}

/// The silhouette of what differs from the background; an error says what was seen instead of an object.
fn difference(
    (picture, plate): (&RgbImage, &RgbImage),
    ignored: Option<&Ignored>,
    region: &Region,
    parameters: &Parameters,
) -> Result<Silhouette, String> {
    let hidden = ignored.map(|ignored| &ignored.hidden);
    let unknown = ignored.map(|ignored| &ignored.unknown);
    let all = Cells::new((picture, plate), hidden, region, parameters.cell_px);
    let photometry = Photometry::estimate((picture, plate), hidden, &all);
    let evidence = evidence::of_cells(&all, &photometry, parameters);
    // From here on only where something may be object.
    let Some(part) = evidence::suspicious(&evidence) else {
        return Err(NO_DIFFERENCE.to_owned());
    };
    let (cells, evidence) = (all.cropped(part), cells::cropped(&evidence, part));
    let ratios = evidence::ratios(&cells, &photometry);
    let is_grey = grey::is_grey(&cells, &evidence, &photometry);
    let mut object = if is_grey {
        grey::decide(&cells, &evidence, &ratios, parameters)
    } else {
        segment::decide(&evidence, &ratios, SHARPNESS, parameters)
    };
    // A piece that hangs on what is hidden is no speck: it may go on behind.
    cells.mark_hidden(&mut object, true);
    let tidied = components::tidy(&mut object, &cells, &evidence, parameters);
    cells.mark_hidden(&mut object, false);
    if !object.pixels().contains(&true) {
        return Err(NO_DIFFERENCE.to_owned());
    }
    let (level, contour) = contour::locate((picture, plate), unknown, &cells, &photometry, &object);
    let bounds = facts::bounds(&level, cells.region);
    let facts = Facts {
        blur_px: contour.blur_px,
        difference: Some(DifferenceFacts {
            told_by_outline: is_grey.then(|| grey::told_by_outline(&object, &evidence)),
            ..DifferenceFacts::new(&cells, &object, &photometry, contour, tidied)
        }),
        ..Facts::of_level(picture, &level, bounds)
    };
    Ok(Silhouette {
        bounds,
        facts,
        region: all.region,
        level,
        unknown: None,
    })
}

/// How much cheaper a boundary becomes where the light changes, beside colours.
const SHARPNESS: i32 = 2;
const NO_DIFFERENCE: &str = "the picture does not differ from its background";

impl Silhouette {
    /// The level at a pixel between whole ones; `None` outside the picture, where it is unknown.
    #[cfg(test)]
    fn level_at(&self, x: f64, y: f64) -> Option<f32> {
        let (width, height) = (self.level.width(), self.level.height());
        let inside = x >= -0.5 && y >= -0.5 && x < width as f64 - 0.5 && y < height as f64 - 0.5;
        if !inside {
            return None;
        }
        let (x, y) = (x.max(0.0), y.max(0.0));
        let (x0, y0) = (x as usize, y as usize);
        let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
        let (fx, fy) = ((x - x0 as f64) as f32, (y - y0 as f64) as f32);
        let mix = |y| {
            let (a, b) = (self.level[(x0, y)], self.level[(x1, y)]);
            f32::from(a) * (1.0 - fx) + f32::from(b) * fx
        };
        Some(mix(y0) * (1.0 - fy) + mix(y1) * fy)
    }
}

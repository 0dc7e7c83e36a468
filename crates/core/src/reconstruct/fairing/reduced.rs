//! Silhouettes with larger pixels, for surfaces whose cells are much longer than a pixel: a contour can be met only as
//! closely as the cells allow, and limits count in pixels.

use super::contour::Contour;
use crate::calibration::{Camera, Intrinsics};
use crate::image::Grid;
use crate::reconstruct::hull::Cone;
use nalgebra::Vector2;

/// Most pixels of the pictures along a cell of the hull; where there are more, pixels are put together.
const PIXELS_OF_A_CELL: f64 = 4.0;

/// How many pixels are put together along each axis, for cells and pixels of these sizes on the object, in metres.
pub(super) fn times(cell_size: f64, pixel: f64) -> usize {
    let pixels = cell_size / pixel.max(1e-9);
    if pixels > PIXELS_OF_A_CELL {
        (2.0 * pixels / PIXELS_OF_A_CELL).floor().clamp(1.0, 64.0) as usize
    } else {
        1
    }
}

/// A cone's camera and silhouette with larger pixels.
pub(super) struct Reduced {
    camera: Camera,
    level: Grid<u8>,
    unknown: Option<Grid<u8>>,
}

impl Reduced {
    /// A cone with so many times larger pixels. What does not fill a last row or column is left out.
    pub(super) fn new(cone: &Cone, times: usize) -> Option<Self> {
        let full = cone.camera();
        let lens = &full.intrinsics;
        let (width, height) = (lens.width / times, lens.height / times);
        let scale = times as f64;
        // A pixel's centre is at whole numbers.
        let middle = Vector2::repeat((scale - 1.0) / 2.0);
        let lens = Intrinsics::new(
            width,
            height,
            lens.focal_px / scale,
            (lens.center_px - middle) / scale,
            lens.distortion,
        );
        let block = |grid: &Grid<u8>, of: fn(&mut dyn Iterator<Item = u8>) -> u8| {
            Grid::from_fn(width, height, |x, y| {
                let rows = y * times..(y + 1) * times;
                of(&mut rows
                    .flat_map(|row| grid.row(row)[x * times..(x + 1) * times].iter().copied()))
            })
        };
        Some(Self {
            camera: Camera::new(full.id.clone(), lens.ok()?, full.rig_from_camera),
            level: block(cone.level(), mean),
            unknown: cone.unknown().map(|mask| block(mask, largest)),
        })
    }

    /// The contour of a reduced cone, or of the cone itself where it was not reduced.
    pub(super) fn contour_or<'a>(reduced: Option<&'a Self>, cone: &'a Cone<'_>) -> Contour<'a> {
        match reduced {
            Some(own) => Contour::new(&own.camera, &own.level, own.unknown.as_ref()),
            None => Contour::of(cone),
        }
    }
}

fn mean(values: &mut dyn Iterator<Item = u8>) -> u8 {
    let (sum, count) = values.fold((0_u32, 0_u32), |(sum, count), v| {
        (sum + u32::from(v), count + 1)
    });
    ((sum + count / 2) / count.max(1)) as u8
}

fn largest(values: &mut dyn Iterator<Item = u8>) -> u8 {
    values.max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::Distortion;
    use crate::frame::CameraId;
    use nalgebra::Isometry3;

    #[test]
    fn a_lens_that_cannot_be_reduced_leaves_the_contour_as_it_is() {
        let (focal, middle) = (Vector2::repeat(3.0), Vector2::repeat(19.5));
        let lens = Intrinsics::new(40, 40, focal, middle, Distortion::default()).unwrap();
        let id = CameraId::new("c00").unwrap();
        let camera = Camera::new(id, lens, Isometry3::identity());
        let level = Grid::from_fn(40, 40, |x, y| {
            if (10..30).contains(&x) && (10..30).contains(&y) {
                255
            } else {
                0
            }
        });
        let cone = Cone::new(&camera, &level);
        assert!(Reduced::new(&cone, 4).is_none());
        let bound = |reduced: Option<&Reduced>| Reduced::contour_or(reduced, &cone).points.len();
        assert!(bound(None) >= 76, "{}", bound(None));
        let halved = Reduced::new(&cone, 2).unwrap();
        assert!(bound(Some(&halved)) < 50);
    }
}

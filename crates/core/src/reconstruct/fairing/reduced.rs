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

    pub(super) fn contour(&self) -> Contour<'_> {
        Contour::new(&self.camera, &self.level, self.unknown.as_ref())
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

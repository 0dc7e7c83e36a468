//! Which pixels an object covers, and how much of each at its contour: a z-buffer at the pixels' centres,
//! and 64 samples in the pixels of the contour.

use nalgebra::Point3;
use scand_core::calibration::Camera;
use scand_core::image::{Grid, Mask};
use scand_core::mesh::{Fragment, Mesh, rasterize};

/// Pixels around the object that a layer keeps, so that blur has room.
const MARGIN: f64 = 16.0;
/// Samples a pixel of the contour.
const SAMPLES: usize = 64;

/// The window of a camera's picture that shows the object.
pub(super) struct Layer {
    /// Column and row of the window's first pixel in the picture.
    pub origin: [usize; 2],
    /// The frontmost triangle at each pixel's centre.
    pub fragments: Grid<Fragment>,
    /// The part of each pixel that the object covers.
    pub coverage: Grid<f32>,
    /// The vertices: pixel in the window and depth.
    pub projected: Vec<[f32; 3]>,
}

impl Layer {
    /// Looks at `mesh` with `camera`; `None` where nothing of it is in the picture.
    pub(super) fn new(camera: &Camera, mesh: &Mesh) -> Option<Self> {
        let lens = &camera.intrinsics;
        let project = |p: Point3<f64>| camera.project(p).map(|(q, z)| [q.x, q.y, z]);
        Self::with(mesh, project, lens.width, lens.height)
    }

    /// As [`Layer::new`] with any projection to pixel and depth.
    pub(super) fn with(
        mesh: &Mesh,
        project: impl Fn(Point3<f64>) -> Option<[f64; 3]>,
        width: usize,
        height: usize,
    ) -> Option<Self> {
        let exact: Vec<[f64; 3]> = mesh
            .vertices
            .iter()
            .map(|v| project(v.cast()).unwrap_or([f64::NAN; 3]))
            .collect();
        let range = |a: usize, size: usize| {
            let low = exact.iter().fold(f64::INFINITY, |m, p| m.min(p[a])) - MARGIN;
            let high = exact.iter().fold(f64::NEG_INFINITY, |m, p| m.max(p[a])) + MARGIN;
            let clamped = |v: f64| v.clamp(0.0, size as f64) as usize;
            (clamped(low.floor()), clamped(high.ceil() + 1.0))
        };
        let ((x0, x1), (y0, y1)) = (range(0, width), range(1, height));
        if x0 >= x1 || y0 >= y1 {
            return None;
        }
        // In the window's own coordinates single precision is good to a ten-thousandth of a pixel.
        let shifted = |p: &[f64; 3]| [p[0] - x0 as f64, p[1] - y0 as f64, p[2]];
        let projected: Vec<[f32; 3]> = exact.iter().map(|p| shifted(p).map(|v| v as f32)).collect();
        let fragments = rasterize(&projected, &mesh.triangles, x1 - x0, y1 - y0);
        let coverage = coverage(&fragments, &projected, &mesh.triangles);
        Some(Self {
            origin: [x0, y0],
            fragments,
            coverage,
            projected,
        })
    }

    /// Lets what lies within a radius (metres) of the object's left outline, at half its height, look like the
    /// backdrop.
    pub(super) fn lose(&mut self, camera: &Camera, radius: f64) {
        let (width, height) = (self.coverage.width(), self.coverage.height());
        let covered = |y: usize| self.coverage.row(y).iter().position(|&part| part >= 0.5);
        let rows: Vec<usize> = (0..height).filter(|&y| covered(y).is_some()).collect();
        let Some(&y0) = rows.get(rows.len() / 2) else {
            return;
        };
        let Some(x0) = covered(y0) else {
            return;
        };
        let depth = f64::from(self.fragments[(x0, y0)].depth);
        let depth = if depth.is_finite() {
            depth
        } else {
            camera.center().coords.norm()
        };
        let radius_px = camera.intrinsics.focal_px.x * radius / depth;
        for y in 0..height {
            for x in 0..width {
                let (dx, dy) = (x as f64 - x0 as f64, y as f64 - y0 as f64);
                if dx.hypot(dy) < radius_px {
                    self.coverage[(x, y)] = 0.0;
                }
            }
        }
    }

    /// Sets what a prop covers, whose triangles begin at `first`, to 0; what it hides is not seen.
    pub(super) fn without_prop(&mut self, first: usize) {
        for (part, fragment) in self
            .coverage
            .pixels_mut()
            .iter_mut()
            .zip(self.fragments.pixels())
        {
            if fragment.is_covered() && fragment.triangle as usize >= first {
                *part = 0.0;
            }
        }
    }

    /// The pixels that touch a triangle from `first` on that is in front, as 255, in a picture of the given size.
    pub(super) fn in_front(&self, first: usize, width: usize, height: usize) -> Mask {
        let shows = |f: &Fragment| f.is_covered() && f.triangle as usize >= first;
        let [x0, y0] = self.origin;
        Mask::from_fn(width, height, |x, y| {
            let (x, y) = (x as isize - x0 as isize, y as isize - y0 as isize);
            let mut around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (x + dx, y + dy)));
            match around.any(|(x, y)| self.fragments.get(x, y).is_some_and(shows)) {
                true => 255,
                false => 0,
            }
        })
    }

    /// The silhouette in a picture of the given size.
    pub(super) fn mask(&self, width: usize, height: usize) -> Mask {
        let mut mask = Mask::filled(width, height, 0);
        let [x0, y0] = self.origin;
        for y in 0..self.coverage.height() {
            let row = &mut mask.row_mut(y0 + y)[x0..x0 + self.coverage.width()];
            for (pixel, &part) in row.iter_mut().zip(self.coverage.row(y)) {
                *pixel = (part * 255.0).round() as u8;
            }
        }
        mask
    }
}

/// The part of each pixel that triangles cover: 0 or 1 away from the contour.
fn coverage(
    fragments: &Grid<Fragment>,
    projected: &[[f32; 3]],
    triangles: &[[u32; 3]],
) -> Grid<f32> {
    let mut coverage = fragments.map(|f| if f.is_covered() { 1.0 } else { 0.0 });
    let (slots, count) = contour(fragments);
    let mut samples = vec![0_u64; count];
    let pattern = pattern();
    for triangle in triangles {
        let corners = triangle.map(|v| projected[v as usize]);
        if corners
            .iter()
            .all(|c| c[2] > 0.0 && c[0].is_finite() && c[1].is_finite())
        {
            cover(&slots, &mut samples, corners, &pattern);
        }
    }
    for (part, &slot) in coverage.pixels_mut().iter_mut().zip(slots.pixels()) {
        if slot != NO_SLOT {
            *part = samples[slot as usize].count_ones() as f32 / SAMPLES as f32;
        }
    }
    coverage
}

const NO_SLOT: u32 = u32::MAX;

/// Numbers the pixels that do not all agree with their eight neighbours on whether they are covered.
fn contour(fragments: &Grid<Fragment>) -> (Grid<u32>, usize) {
    let (width, height) = (fragments.width(), fragments.height());
    let covered = fragments.map(Fragment::is_covered);
    let mut count = 0;
    let slots = Grid::from_fn(width, height, |x, y| {
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        let here = covered[(x, y)];
        let mixed = rows
            .clone()
            .any(|y| covered.row(y)[columns.clone()].iter().any(|&c| c != here));
        if !mixed {
            return NO_SLOT;
        }
        count += 1;
        count as u32 - 1
    });
    (slots, count)
}

/// Offsets of the samples from a pixel's centre: each has a column and a row of its own (Hammersley), so
/// that an edge along either axis is placed to 1/128 of a pixel.
fn pattern() -> [[f32; 2]; SAMPLES] {
    std::array::from_fn(|k| {
        let reversed = (k as u32).reverse_bits() >> 26;
        let at = |i: u32| (i as f32 + 0.5) / SAMPLES as f32 - 0.5;
        [at(k as u32), at(reversed)]
    })
}

/// Marks the samples that a triangle covers in the pixels that have a slot.
fn cover(
    slots: &Grid<u32>,
    samples: &mut [u64],
    corners: [[f32; 3]; 3],
    pattern: &[[f32; 2]; SAMPLES],
) {
    let range = |a: usize, size: usize| {
        let low = corners[0][a].min(corners[1][a]).min(corners[2][a]) - 0.5;
        let high = corners[0][a].max(corners[1][a]).max(corners[2][a]) + 0.5;
        let clamped = |v: f32| v.clamp(0.0, size as f32) as usize;
        clamped(low.ceil())..clamped(high.floor() + 1.0)
    };
    let columns = range(0, slots.width());
    for y in range(1, slots.height()) {
        for x in columns.clone() {
            let slot = slots[(x, y)];
            if slot == NO_SLOT || samples[slot as usize] == u64::MAX {
                continue;
            }
            let at = corners.map(|c| [c[0] - x as f32, c[1] - y as f32]);
            let mut bits = 0;
            for (k, &[dx, dy]) in pattern.iter().enumerate() {
                let edge = |a: [f32; 2], b: [f32; 2]| {
                    (a[0] - dx) * (b[1] - dy) - (a[1] - dy) * (b[0] - dx)
                };
                let sides = [edge(at[0], at[1]), edge(at[1], at[2]), edge(at[2], at[0])];
                let inside = sides.iter().all(|s| *s >= 0.0) || sides.iter().all(|s| *s <= 0.0);
                bits |= u64::from(inside) << k;
            }
            samples[slot as usize] |= bits;
        }
    }
}

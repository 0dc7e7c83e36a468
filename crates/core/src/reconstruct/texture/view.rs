//! A camera's view of the surface: its picture, and where each vertex lies in it. Colour cameras and depth
//! cameras' own colour look the same from here on.

use super::super::{DepthView, Scene};
use super::ViewPriority;
use crate::array::{three, two};
use crate::calibration::DepthCamera;
use crate::image::{Mask, RgbImage};
use crate::mesh::Mesh;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use std::borrow::Cow;
use std::sync::Arc;

/// One camera's picture of the surface.
pub(super) struct View<'a> {
    pub image: Cow<'a, RgbImage>,
    /// 128 and up is object.
    pub silhouette: Option<&'a Mask>,
    /// Whether it is a depth camera's colour: coarse, and used where no colour camera sees.
    pub is_depth: bool,
    /// Views of a lower rank go before it.
    pub rank: u8,
    /// The number of its capture.
    pub capture: u16,
    /// The camera's centre in the rig's frame.
    pub center: Point3<f32>,
    /// Focal length in pixels.
    pub focal_px: f32,
    /// For each vertex its pixel and its depth in metres; NaN where it has none.
    pub projected: Vec<[f32; 3]>,
}

/// The views of a scene: colour cameras first, then depth cameras that have colour.
pub(super) fn views<'a>(
    mesh: &Mesh,
    scene: &'a Scene,
    silhouettes: &[&'a Mask],
    order: &ViewPriority,
) -> Vec<View<'a>> {
    let place = |i: usize| {
        let rank = order.ranks.get(i).copied().unwrap_or(0);
        (rank, order.captures.get(i).copied().unwrap_or(0))
    };
    let colors = scene.colors.iter().enumerate().map(|(i, view)| {
        let camera = &view.camera;
        let projected = mesh.vertices.par_iter();
        let (rank, capture) = place(i);
        View {
            image: Cow::Borrowed(&view.image),
            silhouette: silhouettes
                .get(i)
                .copied()
                .filter(|s| s.same_size(&view.image)),
            is_depth: false,
            rank,
            capture,
            center: camera.center().cast(),
            focal_px: camera.intrinsics.focal_px.min() as f32,
            projected: projected.map(|&p| camera.project_for_raster(p)).collect(),
        }
    });
    let depths = scene
        .depths
        .iter()
        .enumerate()
        .filter_map(|(i, view)| depth_view(mesh, view, place(scene.colors.len() + i)));
    colors.chain(depths).filter(|v| has_pixels(v)).collect()
}

fn has_pixels(view: &View) -> bool {
    view.image.width() > 1 && view.image.height() > 1
}

fn depth_view<'a>(
    mesh: &Mesh,
    view: &'a DepthView,
    (rank, capture): (u8, u16),
) -> Option<View<'a>> {
    let camera = &view.camera.camera;
    let vertices = mesh.vertices.par_iter();
    let projected: Vec<_> = vertices.map(|&p| project(&view.camera, p)).collect();
    Some(View {
        image: mean_color(view, &projected)?,
        silhouette: None,
        is_depth: true,
        rank,
        capture,
        center: camera.center().cast(),
        focal_px: camera.intrinsics.focal_px.min() as f32,
        projected,
    })
}

/// Pixel and depth of a point in a depth camera's pictures, NaN where there is none.
fn project(depth: &DepthCamera, p_in_rig: Point3<f32>) -> [f32; 3] {
    let p = depth.camera.camera_from_rig(p_in_rig.cast());
    match depth.response.project(&depth.camera.intrinsics, p) {
        Some(pixel) => [pixel.x as f32, pixel.y as f32, p.z as f32],
        None => [f32::NAN; 3],
    }
}

/// The mean of a burst's different colour pictures, where the object is: a depth camera's are noisy. `None` if it has
/// none.
fn mean_color<'a>(view: &'a DepthView, projected: &[[f32; 3]]) -> Option<Cow<'a, RgbImage>> {
    let colors = view.frames.iter().filter_map(|f| f.color.as_ref());
    let mut pictures: Vec<&Arc<RgbImage>> = colors.collect();
    pictures.dedup_by(|a, b| Arc::ptr_eq(a, b));
    let first: &RgbImage = pictures.first()?;
    pictures.retain(|p| p.same_size(first));
    if pictures.len() == 1 {
        return Some(Cow::Borrowed(first));
    }
    let (width, height) = (first.width(), first.height());
    let (low, high) = bounds(projected, width, height, 4.0);
    let mut mean = RgbImage::filled(width, height, [0; 3]);
    let count = pictures.len() as u32;
    let mut sums = vec![[0_u32; 3]; width];
    for y in low[1]..high[1] {
        sums.fill([0; 3]);
        for picture in &pictures {
            let row = &picture.row(y)[low[0]..high[0]];
            for (sum, pixel) in sums.iter_mut().zip(row) {
                for c in 0..3 {
                    sum[c] += u32::from(pixel[c]);
                }
            }
        }
        let row = &mut mean.row_mut(y)[low[0]..high[0]];
        for (pixel, sum) in row.iter_mut().zip(&sums) {
            *pixel = three(|c| ((sum[c] + count / 2) / count) as u8);
        }
    }
    Some(Cow::Owned(mean))
}

/// The rectangle of whole pixels, first and one past last, that holds all projected points and a margin, cut
/// to the picture; empty if it shows none.
pub(super) fn bounds(
    projected: &[[f32; 3]],
    width: usize,
    height: usize,
    margin: f32,
) -> ([usize; 2], [usize; 2]) {
    let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
    for p in projected {
        for i in 0..2 {
            // A comparison with NaN keeps what was there.
            low[i] = low[i].min(p[i]);
            high[i] = high[i].max(p[i]);
        }
    }
    let size = [width, height];
    let first = [0, 1].map(|i| ((low[i] - margin).floor().max(0.0) as usize).min(size[i]));
    let last = [0, 1].map(|i| ((high[i] + margin).ceil().max(-1.0) + 1.0) as usize);
    let last = [0, 1].map(|i| last[i].clamp(first[i], size[i]));
    (first, last)
}

impl View<'_> {
    /// Whether a pixel and its neighbours lie in the picture.
    pub(super) fn contains(&self, [x, y, z]: [f32; 3]) -> bool {
        // NaN is in no range.
        (1.0..=self.image.width() as f32 - 2.0).contains(&x)
            && (1.0..=self.image.height() as f32 - 2.0).contains(&y)
            && z > 0.0
    }

    /// The picture's colour at a place, interpolated between pixels.
    #[inline]
    pub(super) fn color(&self, x: f32, y: f32) -> Vector3<f32> {
        let right = (self.image.width() - 2) as f32;
        let bottom = (self.image.height() - 2) as f32;
        let (x, y) = (x.clamp(0.0, right), y.clamp(0.0, bottom));
        let (column, row) = (x as usize, y as usize);
        let (fx, fy) = (x - column as f32, y - row as f32);
        let upper = &self.image.row(row)[column..column + 2];
        let lower = &self.image.row(row + 1)[column..column + 2];
        let mut color = Vector3::zeros();
        for channel in 0..3 {
            let [a, b] = two(|i| f32::from(upper[i][channel]));
            let [c, d] = two(|i| f32::from(lower[i][channel]));
            let (top, low) = (a + (b - a) * fx, c + (d - c) * fx);
            color[channel] = top + (low - top) * fy;
        }
        color
    }

    /// The mean colour of the 3 x 3 pixels around a place that the picture [`Self::contains`].
    pub(super) fn mean_color(&self, x: f32, y: f32) -> Vector3<f32> {
        let (column, row) = ((x + 0.5) as usize, (y + 0.5) as usize);
        let mut sum = [0_u32; 3];
        for y in row - 1..=row + 1 {
            for pixel in &self.image.row(y)[column - 1..=column + 1] {
                for c in 0..3 {
                    sum[c] += u32::from(pixel[c]);
                }
            }
        }
        Vector3::from(three(|c| sum[c] as f32 / 9.0))
    }
}

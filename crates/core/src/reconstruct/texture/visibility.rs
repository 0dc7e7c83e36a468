//! What each camera sees of the surface, and where its colours can be trusted. A z-buffer over the object's
//! rectangle tells what is hidden; near the edge of what hides it, or of the silhouette, colours mix.

use super::Parameters;
use super::view::{View, bounds};
use crate::image::Grid;
use crate::mesh::{Fragment, Mesh, rasterize_closed};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// How well a camera sees a vertex.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub(super) enum Visibility {
    /// Not at all, or so close to an edge that light from behind is mixed in.
    Hidden,
    /// At a grazing angle or near an edge: better than nothing.
    Marginal,
    /// Well.
    Safe,
}

/// Cosine of the angle to the normal beyond which a vertex is hidden (84°).
const HIDDEN_BELOW: f32 = 0.1;
/// Cosine of the angle to the normal beyond which a vertex is marginal (73°).
pub(super) const MARGINAL_BELOW: f32 = 0.3;
/// A marginal vertex closer to an edge than this share of the margin is not used. With the default margin of two pixels
/// its mean over 3 x 3 pixels does not touch the edge.
const INNER_MARGIN: f32 = 0.75;
/// Eight directions in which a margin is probed.
const AROUND: [[f32; 2]; 8] = [
    [1.0, 0.0],
    [0.7, 0.7],
    [0.0, 1.0],
    [-0.7, 0.7],
    [-1.0, 0.0],
    [-0.7, -0.7],
    [0.0, -1.0],
    [0.7, -0.7],
];

/// For each view how well it sees each vertex.
pub(super) fn sights(
    mesh: &Mesh,
    normals: &[Vector3<f32>],
    views: &[View],
    parameters: &Parameters,
) -> Vec<Vec<Visibility>> {
    let sights_of = |view: &View| {
        let buffer = DepthBuffer::new(mesh, view, parameters.occlusion_pixels);
        let vertex = |v: usize| {
            let facing = facing(view.center, mesh.vertices[v], normals[v]);
            sight(
                view,
                &buffer,
                view.projected[v],
                facing,
                parameters.edge_margin_px,
            )
        };
        let vertices = (0..mesh.vertices.len()).into_par_iter();
        vertices.map(vertex).collect()
    };
    views.par_iter().map(sights_of).collect()
}

/// Cosine between a surface's normal and the direction to a camera; 0 where there is no direction.
pub(super) fn facing(center: Point3<f32>, p: Point3<f32>, normal: Vector3<f32>) -> f32 {
    let direction = center - p;
    let cosine = normal.dot(&direction) / direction.norm().max(1e-12);
    if cosine.is_finite() { cosine } else { 0.0 }
}

fn sight(
    view: &View,
    buffer: &DepthBuffer,
    projected: [f32; 3],
    facing: f32,
    margin_px: f32,
) -> Visibility {
    if facing < HIDDEN_BELOW || !view.contains(projected) {
        return Visibility::Hidden;
    }
    let [x, y, z] = projected;
    // How much nearer the surface itself may be one pixel further on.
    let slope = (1.0 - facing * facing).max(0.0).sqrt() / facing;
    let rise = 1.5 * slope * z / view.focal_px;
    let texel = z / view.focal_px / buffer.scale;
    let tolerance = texel + rise / buffer.scale;
    if is_outside(view, x, y) || buffer.is_hidden(x, y, z - tolerance) {
        return Visibility::Hidden;
    }
    // An edge within `reach` pixels: the outline of the silhouette, of the model, or of an occluder.
    let edge_within = |reach: f32| {
        let nearest = z - tolerance - rise * reach;
        AROUND.iter().any(|[dx, dy]| {
            let (x, y) = (x + dx * reach, y + dy * reach);
            is_outside(view, x, y) || buffer.is_edge(x, y, nearest)
        })
    };
    let margin_px = margin_px.max(1.0 / buffer.scale);
    let is_marginal = facing < MARGINAL_BELOW || edge_within(margin_px);
    if !is_marginal {
        Visibility::Safe
    } else if edge_within(INNER_MARGIN * margin_px) {
        Visibility::Hidden
    } else {
        Visibility::Marginal
    }
}

/// The nearest whole pixel of a place; some pixel outside for a place far left of or above the picture.
fn nearest(c: f32) -> isize {
    // Casts cut towards zero; `floor` is a call on processors without SSE 4.1.
    ((c + 16.5) as isize).saturating_sub(16)
}

/// Whether the silhouette says that a pixel does not show the object.
fn is_outside(view: &View, x: f32, y: f32) -> bool {
    let level = |s: &Grid<u8>| s.get(nearest(x), nearest(y)).copied();
    view.silhouette
        .and_then(level)
        .is_some_and(|level| level < 128)
}

/// The depth of the nearest surface over the object's rectangle of a picture, at a scale of it.
struct DepthBuffer {
    fragments: Grid<Fragment>,
    origin: [f32; 2],
    scale: f32,
}

impl DepthBuffer {
    fn new(mesh: &Mesh, view: &View, most_pixels: usize) -> Self {
        let (low, high) = bounds(
            &view.projected,
            view.image.width(),
            view.image.height(),
            2.0,
        );
        let size = [0, 1].map(|i| (high[i] - low[i]) as f32);
        let scale = (most_pixels.max(1) as f32 / (size[0] * size[1]).max(1.0))
            .sqrt()
            .min(1.0);
        let origin = low.map(|v| v as f32);
        let shifted: Vec<_> = view
            .projected
            .iter()
            .map(|&[x, y, z]| [(x - origin[0]) * scale, (y - origin[1]) * scale, z])
            .collect();
        let [width, height] = size.map(|s| (s * scale).ceil() as usize);
        Self {
            fragments: rasterize_closed(&shifted, &mesh.triangles, width, height),
            origin,
            scale,
        }
    }

    fn at(&self, x: f32, y: f32) -> Option<&Fragment> {
        let [left, top] = self.origin;
        let place = |c: f32, first: f32| nearest((c - first) * self.scale);
        self.fragments.get(place(x, left), place(y, top))
    }

    /// Whether something is nearer than `z` at a pixel.
    fn is_hidden(&self, x: f32, y: f32, z: f32) -> bool {
        self.at(x, y).is_some_and(|f| f.depth < z)
    }

    /// Whether at a pixel something is nearer than `z`, or nothing is.
    fn is_edge(&self, x: f32, y: f32, z: f32) -> bool {
        self.at(x, y)
            .is_some_and(|f| f.depth < z || !f.is_covered())
    }
}

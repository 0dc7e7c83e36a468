//! Paints a model from the pictures: chooses the camera that sees each face best, evens out exposures, blends
//! seams, and packs an atlas. This file has the order of the steps and their parameters; no geometry changes here.

mod atlas;
mod blend;
mod charts;
mod exposure;
mod labels;
mod outline;
mod specks;
mod unseen;
mod view;
mod visibility;

#[cfg(test)]
mod tests;

use super::{Model, Scene, Texture};
use crate::image::Mask;
use crate::mesh::{self, Mesh, Rings};
use nalgebra::Vector3;
use view::View;
use visibility::Visibility;

/// The colour of what no camera saw.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Unseen {
    /// Grey, so that nobody takes it for something observed.
    #[default]
    Neutral,
    /// The colours around it, continued.
    Continued,
}

/// How a model is painted.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// Largest width and height of the atlas in texels; pictures are scaled down to fit.
    /// Default 4096, range 64 to 16384.
    #[serde(deserialize_with = "crate::range::count::<_, usize, 64, 16384>")]
    pub largest_side: usize,
    /// Distance in pixels from an edge (of the silhouette, or of what hides the surface) at which a picture is trusted.
    /// Nearer pixels are used only where no other camera sees the surface, and those nearer than three quarters of the
    /// distance never, because light from behind mixes in.
    /// Default 2, range 0 to 1000.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 1000>")]
    pub edge_margin_px: f32,
    /// Most pixels, for each camera, of the z-buffer that decides what is hidden.
    /// Default 400000, range 1000 to 100000000.
    #[serde(deserialize_with = "crate::range::count::<_, usize, 1000, 100000000>")]
    pub occlusion_pixels: usize,
    /// Cost of a border between two cameras, relative to the loss from a camera that sees a face less well, which is at
    /// most 1.
    /// Default 1, range 0 to 1000000.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 1000000>")]
    pub smoothness: f32,
    /// Regions of one camera with fewer faces are given to a neighbouring camera that sees them too.
    /// Default 150, range 0 to 1000000000.
    #[serde(deserialize_with = "crate::range::count::<_, usize, 0, 1000000000>")]
    pub smallest_chart_faces: usize,
    /// Half the width of the band in which two cameras are blended, in rings of vertices.
    /// Default 4, range 0 to 1000.
    #[serde(deserialize_with = "crate::range::count::<_, usize, 0, 1000>")]
    pub feather_rings: usize,
    /// Rings of vertices over which a camera's difference to the mean of all cameras is smoothed before it is removed.
    /// With 0 it is not removed.
    /// Default 8, range 0 to 1000.
    #[serde(deserialize_with = "crate::range::count::<_, usize, 0, 1000>")]
    pub level_rings: usize,
    /// Texels between two charts, and by which charts are extended beyond their edge where there is room, so that
    /// smaller mip levels do not bleed. Two charts share what lies between them.
    /// Default 2, range 0 to 64.
    #[serde(deserialize_with = "crate::range::count::<_, usize, 0, 64>")]
    pub gutter_px: usize,
    /// The colour of what no camera saw: `neutral` (grey) or `continued` (from the colours around it).
    /// Default neutral.
    pub unseen: Unseen,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            largest_side: 4096,
            edge_margin_px: 2.0,
            occlusion_pixels: 400_000,
            smoothness: 1.0,
            smallest_chart_faces: 150,
            feather_rings: 4,
            level_rings: 8,
            gutter_px: 2,
            unseen: Unseen::Neutral,
        }
    }
}

/// Everything the steps share: the surface, and each camera's view of it.
struct Surface<'a> {
    mesh: &'a Mesh,
    rings: Rings,
    /// For each triangle those across its three sides.
    across: Vec<[u32; 3]>,
    /// Normals smoothed over a few rings: a hull's own are rough.
    normals: Vec<Vector3<f32>>,
    views: Vec<View<'a>>,
    /// For each view how well it sees each vertex.
    sights: Vec<Vec<Visibility>>,
}

/// What tells views of a scene apart that is fused of several captures: for each colour view, then each depth view.
/// Empty where all are alike.
#[derive(Clone, Copy, Debug, Default)]
pub struct ViewPriority<'a> {
    /// A view paints only what no view of a lower rank sees.
    pub ranks: &'a [u8],
    /// The number of its capture.
    pub captures: &'a [u16],
}

/// Paints `model` from the pictures of `scene`. `silhouettes` are the colour cameras', in their order (128
/// and up is object), or empty; where there is one, nothing is painted from outside it. A triangle that no
/// camera sees is grey, or takes the colours around it, and is marked in [`Texture::seen`].
pub fn paint(
    model: &Model,
    scene: &Scene,
    silhouettes: &[&Mask],
    parameters: &Parameters,
) -> Texture {
    paint_in_order(
        model,
        scene,
        silhouettes,
        &ViewPriority::default(),
        parameters,
    )
}

/// As [`paint`], from views of several captures.
pub fn paint_in_order(
    model: &Model,
    scene: &Scene,
    silhouettes: &[&Mask],
    order: &ViewPriority,
    parameters: &Parameters,
) -> Texture {
    let surface = Surface::new(&model.mesh, scene, silhouettes, order, parameters);
    let even = || {
        let gains = exposure::even_out(&surface);
        let samples = exposure::samples(&surface, &gains);
        (gains, samples)
    };
    let label = || {
        let mut labels = labels::choose(&surface, parameters);
        let specks = specks::find(&surface, &mut labels);
        (labels, specks)
    };
    let ((gains, samples), (labels, specks)) = rayon::join(even, label);
    let blend = || {
        let blend = blend::Blend::new(&surface, &labels, &samples, parameters);
        let vertex_colors = unseen::vertex_colors(&surface, &blend, &samples, parameters.unseen);
        (blend, vertex_colors)
    };
    let lay_out = || charts::Layout::new(&surface, &labels, specks, parameters);
    let ((blend, mut vertex_colors), layout) = rayon::join(blend, lay_out);
    if layout.is_empty() {
        // Where the charts do not fit, nothing has a colour of any camera.
        vertex_colors.fill(unseen::NEUTRAL);
    }
    let painted = atlas::Paint {
        surface: &surface,
        gains: &gains,
        blend: &blend,
        vertex_colors: &vertex_colors,
    };
    let (atlas, corner_uv) =
        rayon::join(|| painted.compose(&layout), || layout.corner_uv(&surface));
    Texture {
        atlas,
        corner_uv,
        vertex_colors: vertex_colors.iter().map(|&c| to_bytes(c)).collect(),
        seen: labels
            .iter()
            .map(|&l| l != labels::UNSEEN && !layout.is_empty())
            .collect(),
    }
}

impl<'a> Surface<'a> {
    fn new(
        mesh: &'a Mesh,
        scene: &'a Scene,
        silhouettes: &[&'a Mask],
        order: &ViewPriority,
        parameters: &Parameters,
    ) -> Self {
        let connect = || {
            let rings = Rings::new(mesh);
            let across = rings.across(mesh);
            let normals = rings.smoothed_normals(mesh, &mesh::vertex_normals(mesh));
            (rings, across, normals)
        };
        let ((rings, across, normals), views) =
            rayon::join(connect, || view::views(mesh, scene, silhouettes, order));
        let sights = visibility::sights(mesh, &normals, &views, parameters);
        Self {
            mesh,
            rings,
            across,
            normals,
            views,
            sights,
        }
    }
}

/// A colour as bytes, sRGB-encoded.
#[inline]
fn to_bytes(color: Vector3<f32>) -> [u8; 3] {
    // The cast saturates, and turns NaN into 0.
    color.map(|c| (c + 0.5) as u8).into()
}

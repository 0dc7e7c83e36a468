//! The model beside the photographs: four cameras around the object, and for each of them the photograph,
//! the model as that camera would see it, and where the model's parts come from.

use super::canvas::EMPTY;
use super::window::Window;
use crate::calibration::Camera;
use crate::image::RgbImage;
use crate::mesh::{Drawn, Eye, Style, View, bounding_box, vertex_paint};
use crate::reconstruct::silhouette::Silhouette;
use crate::reconstruct::{Model, Provenance, Reconstruction, Scene};
use nalgebra::{Point3, center};
use std::f64::consts::TAU;

/// Views that are shown.
pub(super) const VIEWS: usize = 4;
/// A model without colours.
const CLAY: [u8; 3] = [205, 196, 182];

/// The colour of each provenance; told apart by those who do not see red and green (after Okabe and Ito).
pub(super) fn provenance_color(provenance: Provenance) -> [u8; 3] {
    match provenance {
        Provenance::Hull => [158, 166, 178],
        Provenance::Carved => [86, 180, 233],
        Provenance::Restored => [0, 178, 130],
        Provenance::Bridged => [240, 228, 66],
        Provenance::Unseen => [224, 94, 0],
        Provenance::Table => [150, 110, 190],
    }
}

/// One camera's three panels.
pub(super) struct ViewPanels {
    /// The camera's index.
    pub camera: usize,
    /// Its photograph.
    pub photograph: RgbImage,
    /// The model from there.
    pub model: RgbImage,
    /// The model, coloured by provenance.
    pub provenance: RgbImage,
}

/// Up to four cameras around the object, in the order of their ids: as far apart as can be, seen from above.
pub(super) fn choose(scene: &Scene, made: &Reconstruction) -> Vec<usize> {
    let [low, high] = bounding_box(&made.model.mesh.vertices).unwrap_or_default();
    let middle: Point3<f64> = center(&low, &high).cast();
    let azimuth = |camera: &Camera| {
        let towards = camera.center() - middle;
        towards.y.atan2(towards.x)
    };
    let azimuths: Vec<f64> = scene.colors.iter().map(|v| azimuth(&v.camera)).collect();
    let apart = |a: usize, b: usize| {
        let turn = (azimuths[a] - azimuths[b]).rem_euclid(TAU);
        turn.min(TAU - turn)
    };
    let whole = |i: usize| made.silhouettes[i].facts.edge_px.iter().all(|&n| n == 0);
    let mut candidates: Vec<usize> = (0..scene.colors.len()).filter(|&i| whole(i)).collect();
    if candidates.len() < VIEWS {
        candidates = (0..scene.colors.len()).collect();
    }
    let mut chosen: Vec<usize> = candidates.first().copied().into_iter().collect();
    while chosen.len() < VIEWS.min(candidates.len()) {
        let gap = |&i: &usize| chosen.iter().map(|&c| apart(i, c)).fold(TAU, f64::min);
        let left = candidates.iter().copied().filter(|i| !chosen.contains(i));
        // Of equals the first, so that the choice is always the same.
        let next = left.reduce(|best, i| if gap(&i) > gap(&best) { i } else { best });
        chosen.extend(next);
    }
    chosen.sort_unstable();
    chosen
}

/// Draws one camera's panels.
pub(super) fn draw(
    scene: &Scene,
    silhouette: &Silhouette,
    model: &Model,
    camera: usize,
    size: (usize, usize),
) -> ViewPanels {
    let view = &scene.colors[camera];
    let window = Window::around(silhouette.bounds, size);
    let project = |p| window.panel_from_picture(view.camera.project_for_raster(p));
    let [model, provenance] = both(model, &window, view.camera.center().cast(), project);
    ViewPanels {
        camera,
        photograph: window.crop(&view.image),
        model,
        provenance,
    }
}

/// The model in its colours, and by provenance.
pub(super) fn both(
    model: &Model,
    window: &Window,
    eye: Point3<f32>,
    project: impl Fn(Point3<f32>) -> [f32; 3],
) -> [RgbImage; 2] {
    let view = View {
        width: window.width,
        height: window.height,
        eye: Eye::At(eye),
        project,
    };
    let shaded = Style {
        background: EMPTY,
        normals: Some(&model.normals),
        ..Style::default()
    };
    let drawn = Drawn::new(&model.mesh, &view, 2);
    let colors: Vec<_> = model
        .provenance
        .iter()
        .map(|&p| provenance_color(p))
        .collect();
    let provenance = drawn.paint(&shaded, vertex_paint(&model.mesh, &colors));
    let picture = match &model.texture {
        None => drawn.paint(&shaded, |_, _| CLAY),
        Some(texture) => {
            // The photographs have their light already.
            let lit = Style {
                ambient: 0.8,
                ..shaded
            };
            drawn.paint(&lit, |triangle, weights| {
                sample(&texture.atlas, texture.corner_uv[triangle], weights)
            })
        }
    };
    [picture, provenance]
}

/// The atlas at a point of a triangle.
fn sample(atlas: &RgbImage, corners: [[f32; 2]; 3], weights: [f32; 3]) -> [u8; 3] {
    let at = |axis: usize, size: usize| {
        let uv: f32 = (0..3).map(|i| corners[i][axis] * weights[i]).sum();
        (uv * size as f32) as isize
    };
    let (x, y) = (at(0, atlas.width()), at(1, atlas.height()));
    atlas.get(x, y).copied().unwrap_or(CLAY)
}

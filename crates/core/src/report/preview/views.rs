//! The model beside the photographs: four cameras around the object, and for each of them the photograph,
//! the model as that camera would see it, and where the model's parts come from.

use super::canvas::{EMPTY, INK, fill, write};
use super::window::Window;
use crate::calibration::Camera;
use crate::image::RgbImage;
use crate::mesh::{Drawn, ProjectionKind, Style, View, bounding_box, parallel_view, vertex_paint};
use crate::reconstruct::silhouette::Silhouette;
use crate::reconstruct::{Model, Provenance, Reconstruction, Scene};
use nalgebra::{Point3, center};
use std::f64::consts::TAU;

/// Views that are shown.
pub(super) const VIEWS: usize = 4;
/// A model without colours.
const CLAY: [u8; 3] = [205, 196, 182];

/// The colour of each provenance; distinguishable without seeing red and green (after Okabe and Ito). The viewer in
/// `ui` has the same.
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

/// Up to four cameras around the object, in the order of their ids: as far apart as can be, low and high ones
/// in turn, where the frame does not cut the object if there are enough.
pub(super) fn choose(scene: &Scene, made: &Reconstruction) -> Vec<usize> {
    let [low, high] = bounding_box(&made.model.mesh.vertices).unwrap_or_default();
    let middle: Point3<f64> = center(&low, &high).cast();
    let directions: Vec<Direction> = scene
        .colors
        .iter()
        .map(|v| Direction::of(&v.camera, middle))
        .collect();
    let whole = |i: &usize| made.silhouettes[*i].facts.edge_px.iter().all(|&n| n == 0);
    let mut candidates: Vec<usize> = (0..directions.len()).filter(whole).collect();
    if candidates.len() < VIEWS {
        candidates = (0..directions.len()).collect();
    }
    let elevations = || candidates.iter().map(|&i| directions[i].elevation);
    let lowest = elevations().fold(f64::MAX, f64::min);
    let between = 0.5 * (lowest + elevations().fold(f64::MIN, f64::max));
    let mut chosen: Vec<usize> = Vec::new();
    while chosen.len() < VIEWS.min(candidates.len()) {
        let left = || candidates.iter().copied().filter(|i| !chosen.contains(i));
        let wants_high = chosen.len() % 2 == 1;
        let fits = |&i: &usize| (directions[i].elevation > between) == wants_high;
        let gap = |i: usize| {
            let apart = chosen.iter().map(|&c| directions[i].apart(&directions[c]));
            apart.fold(TAU, f64::min)
        };
        // Of equals the first, so that the choice is always the same.
        let farther = |best, i| if gap(i) > gap(best) { i } else { best };
        let next = left().filter(fits).reduce(farther);
        let next = next.or_else(|| left().reduce(farther));
        chosen.extend(next);
    }
    chosen.sort_unstable();
    chosen
}

/// Where a camera is, seen from the object, in radians.
struct Direction {
    azimuth: f64,
    elevation: f64,
}

impl Direction {
    fn of(camera: &Camera, middle: Point3<f64>) -> Self {
        let towards = camera.center() - middle;
        Self {
            azimuth: towards.y.atan2(towards.x),
            elevation: towards.z.atan2(towards.x.hypot(towards.y)),
        }
    }

    /// The turn about the vertical between two.
    fn apart(&self, other: &Self) -> f64 {
        let turn = (self.azimuth - other.azimuth).rem_euclid(TAU);
        turn.min(TAU - turn)
    }
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
    let drawn = drawn(model, &window, view.camera.center().cast(), project);
    let mut shaded = in_color(model, &drawn);
    scale_bar(
        &mut shaded,
        panel_pixels_per_metre(model, &view.camera, &window),
    );
    ViewPanels {
        camera,
        photograph: window.crop(&view.image),
        model: shaded,
        provenance: by_provenance(model, &drawn),
    }
}

/// Pixels of the panel to a metre at the distance of the model's middle.
fn panel_pixels_per_metre(model: &Model, camera: &Camera, window: &Window) -> f64 {
    let [low, high] = bounding_box(&model.mesh.vertices).unwrap_or_default();
    let middle: Point3<f64> = center(&low, &high).cast();
    let distance = nalgebra::distance(&camera.center(), &middle);
    let focal = 0.5 * (camera.intrinsics.focal_px[0] + camera.intrinsics.focal_px[1]);
    focal / distance / window.scale
}

/// Draws a bar of a round length, at most a third of the panel, with its length in millimetres.
fn scale_bar(panel: &mut RgbImage, pixels_per_metre: f64) {
    let longest_mm = 1e3 * panel.width() as f64 / 3.0 / pixels_per_metre;
    let mut round =
        (-1..=4).flat_map(|power| [1.0, 2.0, 5.0].map(|digit| digit * 10f64.powi(power)));
    let Some(length_mm) = round.rfind(|&mm| mm <= longest_mm) else {
        return;
    };
    let wide = (length_mm * 1e-3 * pixels_per_metre).round() as usize;
    let (left, bottom) = (8, panel.height().saturating_sub(10));
    fill(panel, (left, bottom - 3), (wide, 3), INK);
    for end in [left, left + wide - 2.min(wide)] {
        fill(panel, (end, bottom - 7), (2, 7), INK);
    }
    write(
        panel,
        (left + wide + 8, bottom - 14),
        2,
        INK,
        (120, &format!("{length_mm} mm")),
    );
}

/// The model in its colours from the side and a little above, without words: a picture for people.
pub fn picture_of(model: &Model, size: (usize, usize)) -> RgbImage {
    let [low, high] = bounding_box(&model.mesh.vertices).unwrap_or_default();
    let radius = 0.5 * nalgebra::distance(&low, &high);
    let towards_eye = nalgebra::Vector3::new(0.5, -1.0, 0.55).normalize();
    if model.mesh.triangles.is_empty() {
        return RgbImage::filled(size.0, size.1, EMPTY);
    }
    let view = parallel_view(center(&low, &high), radius, towards_eye, size);
    in_color(model, &Drawn::closed(&model.mesh, &view, 2))
}

/// Draws the model in a window, to be painted.
pub(super) fn drawn<'a>(
    model: &'a Model,
    window: &Window,
    eye: Point3<f32>,
    project: impl Fn(Point3<f32>) -> [f32; 3],
) -> Drawn<'a> {
    let view = View {
        width: window.width,
        height: window.height,
        eye: ProjectionKind::At(eye),
        project,
    };
    Drawn::closed(&model.mesh, &view, 2)
}

fn style(model: &Model) -> Style<'_> {
    Style {
        background: EMPTY,
        normals: Some(&model.normals),
        ..Style::default()
    }
}

fn by_provenance(model: &Model, drawn: &Drawn) -> RgbImage {
    let colors = model.provenance.iter().map(|&p| provenance_color(p));
    let colors: Vec<_> = colors.collect();
    drawn.paint(&style(model), vertex_paint(&model.mesh, &colors))
}

/// The model in its texture's colours.
pub(super) fn in_color(model: &Model, drawn: &Drawn) -> RgbImage {
    let Some(texture) = &model.texture else {
        return drawn.paint(&style(model), |_, _| CLAY);
    };
    // The photographs have their light already.
    let lit = Style {
        ambient: 0.8,
        ..style(model)
    };
    drawn.paint(&lit, |triangle, weights| {
        sample(&texture.atlas, texture.corner_uv[triangle], weights)
    })
}

/// The atlas at a point of a triangle.
#[inline]
fn sample(atlas: &RgbImage, corners: [[f32; 2]; 3], weights: [f32; 3]) -> [u8; 3] {
    let at = |axis: usize, size: usize| {
        let uv: f32 = (0..3).map(|i| corners[i][axis] * weights[i]).sum();
        (uv * size as f32) as isize
    };
    let (x, y) = (at(0, atlas.width()), at(1, atlas.height()));
    atlas.get(x, y).copied().unwrap_or(CLAY)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::description::PROVENANCES;

    #[test]
    fn the_viewers_names_and_colours_are_the_previews() {
        let names = include_str!("../../../../../ui/src/provenance.ts");
        let viewer = include_str!("../../../../../ui/src/viewer.ts");
        let quoted = |text: &str| format!("\"{text}\"");
        let known = PROVENANCES.map(|(name, _)| quoted(name)).join(", ");
        assert!(names.contains(&format!("= [{known}] as const;")), "{known}");
        let colors = Provenance::ALL.map(|provenance| {
            let [red, green, blue] = provenance_color(provenance);
            quoted(&format!("#{red:02x}{green:02x}{blue:02x}"))
        });
        let colors = format!("= [{}];", colors.join(", "));
        assert!(viewer.contains(&colors), "{colors}");
        // A number of one is a number of the other.
        let serialized = Provenance::ALL.map(|p| serde_json::to_value(p).unwrap());
        assert_eq!(serialized.to_vec(), PROVENANCES.map(|(name, _)| name));
    }

    #[test]
    fn a_scale_bar_is_as_long_as_it_says() {
        // Half a pixel to a millimetre; a third of the panel is 200 mm.
        let mut panel = RgbImage::filled(300, 200, EMPTY);
        scale_bar(&mut panel, 500.0);
        let bar = panel.row(200 - 12).iter().filter(|&&p| p == INK).count();
        let words = panel.row(200 - 18)[8 + 100 + 8..].contains(&INK);
        assert!(words && panel[(8, 200 - 12)] == INK);
        assert!(
            panel.row(200 - 12)[8..108].iter().all(|&p| p == INK),
            "{bar}"
        );
        assert_eq!(panel[(109, 200 - 12)], EMPTY);
        // Too small for any round length: no bar is better than a wrong one.
        let mut none = RgbImage::filled(300, 200, EMPTY);
        scale_bar(&mut none, 1e9);
        assert!(none.pixels().iter().all(|&p| p == EMPTY));
    }
}

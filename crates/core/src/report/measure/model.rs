//! The model in figures.

use super::UnobservedMeasures;
use crate::mesh::{self, Mesh, bounding_box, check, components};
use crate::reconstruct::restore::EvenWalls;
use crate::reconstruct::uncertainty::UnrequiredPiece;
use crate::reconstruct::{Model, Provenance, Reconstruction, Scene, fairing};
use serde::Serialize;

/// What a person who reads the report of a faired model must know.
const FAIRING_REMARK: &str = "Relief that shows in no outline is not measured: between outlines the hull was made smooth, \
    and a groove or a shallow relief is in the model only where a depth camera read a hollow.";

/// The figures of a model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ModelMeasures {
    /// Whether its surface is that of a solid.
    pub watertight: bool,
    /// What was found in its mesh.
    pub mesh: mesh::Report,
    /// Its lowest and highest corner in the rig's frame, in metres.
    pub bounds: [[f32; 3]; 2],
    /// Edge of a cell of the surfaces it was made of, in metres.
    pub cell_size: f64,
    /// The parts of its surface by where they come from.
    pub provenance: Vec<ProvenanceMeasures>,
    /// The mean of its expected errors over its surface, without the face on the table, in metres.
    pub mean_expected_error: f64,
    /// How much of its surface nothing observed.
    pub unobserved: UnobservedMeasures,
    /// Share of its area that a camera saw; `None` without texture.
    pub textured: Option<f64>,
    /// Its picture; `None` without texture.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub atlas: Option<AtlasMeasures>,
    /// Stray pieces dropped from the hull.
    pub dropped_hull_pieces: usize,
    /// Pieces that carving cut off, dropped.
    pub dropped_carved_pieces: usize,
    /// Places where carving contradicted a colour camera and was undone.
    pub closed_openings: usize,
    /// What became of the inside of walls; `None` where none was made even.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub even_walls: Option<EvenWalls>,
    /// How the fairing of the hull came out; `None` where the model is made of the plain hull.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fairing: Option<fairing::Facts>,
    /// What nothing measured where the hull was faired; `None` where it was not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fairing_remark: Option<&'static str>,
    /// Why the hull was not faired; `None` where it was, or where fairing is switched off.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fairing_refused: Option<String>,
    /// Cubic metres that no silhouette excludes, but that too few cameras see past what they ignore, so that they are
    /// not in the model; `None` where nothing is ignored.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unproved_volume: Option<f64>,
    /// Pieces of it that no silhouette requires, the largest first: each may be an object, or a phantom.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub unrequired_pieces: Vec<UnrequiredPiece>,
    /// Handles of the model that the plain hull has not: what the depth alone opened.
    pub handles_of_depth: u64,
}

/// A model's picture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AtlasMeasures {
    /// Width and height in texels.
    pub size: [usize; 2],
    /// Share of its texels that triangles cover.
    pub used: f64,
    /// How long a texel is on the surface on average where cameras saw it, in metres; `None` where none did.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub texel_size: Option<f64>,
}

/// The part of a surface that has one provenance. Each corner of a triangle stands for a third of it, so that it does
/// not matter how many vertices a part has.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ProvenanceMeasures {
    /// Where it comes from.
    pub provenance: Provenance,
    /// Its share of the surface's area.
    pub share: f64,
    /// The mean of its expected errors over its area in metres; 0 where it has none.
    pub mean_expected_error: f64,
}

impl ModelMeasures {
    pub(super) fn of(scene: &Scene, made: &Reconstruction) -> Self {
        let model = &made.model;
        let mesh = check(&model.mesh);
        let bounds = bounding_box(&model.mesh.vertices).unwrap_or_default();
        Self {
            watertight: mesh.is_watertight(),
            mesh,
            bounds: bounds.map(|corner| corner.into()),
            cell_size: made.cell_size,
            provenance: by_provenance(model).to_vec(),
            mean_expected_error: mean_expected_error(model),
            unobserved: UnobservedMeasures::of(scene, made),
            textured: model
                .texture
                .as_ref()
                .map(|texture| share_of_area(&model.mesh, &texture.seen)),
            atlas: model.texture.as_ref().map(|texture| AtlasMeasures {
                size: [texture.atlas.width(), texture.atlas.height()],
                used: texture.used(),
                texel_size: texture.texel_size(&model.mesh),
            }),
            dropped_hull_pieces: made.dropped_hull_pieces,
            dropped_carved_pieces: made.dropped_carved_pieces,
            closed_openings: made.closed_openings,
            even_walls: made.even_walls,
            fairing: made.fairing.as_ref().and_then(|f| f.as_ref().ok().copied()),
            fairing_remark: matches!(made.fairing, Some(Ok(_))).then_some(FAIRING_REMARK),
            fairing_refused: made
                .fairing
                .as_ref()
                .and_then(|f| f.as_ref().err().map(ToString::to_string)),
            unproved_volume: made.unproved_volume,
            unrequired_pieces: made.unrequired_pieces.clone(),
            handles_of_depth: handles(&made.model.mesh).saturating_sub(handles(&made.hull)),
        }
    }

    /// Share of the surface of one provenance.
    pub fn share(&self, provenance: Provenance) -> f64 {
        let found = self.provenance.iter().find(|p| p.provenance == provenance);
        found.map_or(0.0, |p| p.share)
    }
}

/// Handles of a closed mesh, all of its pieces together.
fn handles(mesh: &Mesh) -> u64 {
    let parts = components(mesh).parts;
    parts.iter().map(|p| p.genus().max(0) as u64).sum()
}

/// A third of a triangle's area in square metres: what each of its corners stands for.
fn third_of_area(mesh: &Mesh, triangle: usize) -> f64 {
    let [a, b, c] = mesh.corners(triangle).map(|p| p.cast::<f64>());
    (b - a).cross(&(c - a)).norm() / 6.0
}

/// The share of a surface's area that the triangles have which `are_wanted`; 0 without area.
fn share_of_area(mesh: &Mesh, are_wanted: &[bool]) -> f64 {
    let (mut all, mut wanted) = (0.0, 0.0);
    for (triangle, &is_wanted) in are_wanted.iter().enumerate() {
        let third = third_of_area(mesh, triangle);
        all += third;
        if is_wanted {
            wanted += third;
        }
    }
    if all > 0.0 { wanted / all } else { 0.0 }
}

/// The mean of a model's expected errors over its surface, without the face on the table: each corner of a triangle
/// stands for a third of it, so that it does not matter how many vertices a part has. 0 without a surface.
fn mean_expected_error(model: &Model) -> f64 {
    let (mut area, mut sum) = (0.0, 0.0);
    for (triangle, corners) in model.mesh.triangles.iter().enumerate() {
        let third = third_of_area(&model.mesh, triangle);
        let vertices = corners.iter().map(|&vertex| vertex as usize);
        for vertex in vertices.filter(|&v| model.provenance[v] != Provenance::Table) {
            area += third;
            sum += third * f64::from(model.expected_error[vertex]);
        }
    }
    if area > 0.0 { sum / area } else { 0.0 }
}

/// The parts of a model's surface, in the order of [`Provenance::ALL`].
pub(crate) fn by_provenance(model: &Model) -> [ProvenanceMeasures; 6] {
    let (mut areas, mut sums) = ([0.0; 6], [0.0; 6]);
    for (triangle, corners) in model.mesh.triangles.iter().enumerate() {
        let third = third_of_area(&model.mesh, triangle);
        for vertex in corners.iter().map(|&vertex| vertex as usize) {
            let part = model.provenance[vertex] as usize;
            areas[part] += third;
            sums[part] += third * f64::from(model.expected_error[vertex]);
        }
    }
    let total: f64 = areas.iter().sum();
    let ratio = |of: f64, to: f64| if to > 0.0 { of / to } else { 0.0 };
    Provenance::ALL.map(|provenance| {
        let (area, sum) = (areas[provenance as usize], sums[provenance as usize]);
        ProvenanceMeasures {
            provenance,
            share: ratio(area, total),
            mean_expected_error: ratio(sum, area),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    /// Right-angled triangles that share no vertex: the length of two sides, where each is from, and its error.
    fn triangles(each: &[(f32, Provenance, f32)]) -> Model {
        let mut model = Model::default();
        for &(side, provenance, error) in each {
            let first = model.mesh.vertices.len() as u32;
            let corners = [[0.0, 0.0], [side, 0.0], [0.0, side]];
            let corners = corners.map(|[x, y]| Point3::new(x, y, 0.0));
            model.mesh.vertices.extend(corners);
            model.mesh.triangles.push([first, first + 1, first + 2]);
            model.provenance.extend([provenance; 3]);
            model.expected_error.extend([error; 3]);
        }
        model
    }

    #[test]
    fn what_cameras_saw_is_a_share_of_the_area_and_not_of_the_triangles() {
        let corner = |side| (side, Provenance::Hull, 0.0);
        let mesh = triangles(&[corner(1.0), corner(0.5)]).mesh;
        assert!((share_of_area(&mesh, &[true, false]) - 0.8).abs() < 1e-9);
        assert_eq!(share_of_area(&mesh, &[true, true]), 1.0);
        assert_eq!(share_of_area(&triangles(&[corner(0.0)]).mesh, &[true]), 0.0);
    }

    #[test]
    fn a_part_of_the_surface_is_a_share_of_its_area_and_not_of_its_vertices() {
        let mut model = triangles(&[
            (1.0, Provenance::Hull, 1e-3),
            (0.5, Provenance::Restored, 6e-3),
        ]);
        // A corner with another error stands for a third of its triangle, as each other one.
        model.expected_error[0] = 4e-3;
        let parts = by_provenance(&model);
        let of = |provenance: Provenance| {
            let part = parts[provenance as usize];
            assert_eq!(part.provenance, provenance);
            [part.share, 1e3 * part.mean_expected_error]
        };
        let near = |[a, b]: [f64; 2], [c, d]: [f64; 2]| {
            assert!((a - c).abs() < 1e-6 && (b - d).abs() < 1e-6, "{a} {b}");
        };
        near(of(Provenance::Hull), [0.8, 2.0]);
        near(of(Provenance::Restored), [0.2, 6.0]);
        near(of(Provenance::Table), [0.0, 0.0]);
        near(of_nothing(), [0.0, 0.0]);
    }

    /// Share and mean error of a part of a model without a surface.
    fn of_nothing() -> [f64; 2] {
        let [part, ..] = by_provenance(&Model::default());
        [part.share, part.mean_expected_error]
    }

    #[test]
    fn the_mean_expected_error_is_that_of_the_surface_and_not_of_its_vertices() {
        // A triangle of half a square metre, one of an eighth, and one on the table.
        let model = triangles(&[
            (1.0, Provenance::Hull, 1e-3),
            (0.5, Provenance::Restored, 6e-3),
            (2.0, Provenance::Table, 50e-3),
        ]);
        assert!((mean_expected_error(&model) - 2e-3).abs() < 1e-9);
        assert_eq!(mean_expected_error(&Model::default()), 0.0);
    }
}

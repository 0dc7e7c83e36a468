//! Measures how much of a model's surface nothing observed: places that neither an outline nor a reading determines.

use crate::calibration::Volume;
use crate::mesh::Mesh;
use crate::reconstruct::hull::UpDirections;
use crate::reconstruct::uncertainty::{Readings, beneath, may_be_lid};
use crate::reconstruct::{Model, Provenance, Reconstruction, Scene};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::Serialize;

/// Metres beneath the hull from which on a surface that a depth camera read there shows that the hull's is none.
const SEEN_THROUGH: f64 = 0.01;
/// Cells within which a vertex lies on the volume's side.
const ON_SIDE_CELLS: f64 = 0.5;

/// Shares of the model's area, without the face on the table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct UnobservedMeasures {
    /// Of the parts that nothing saw, because they lie in concave regions or because the volume cuts the object there.
    pub guessed: f64,
    /// Of those of them that the volume bounds, above the table: no outline shows that the object ends there.
    pub cut_by_volume: f64,
    /// Of the parts of the hull that face up and that no depth camera read: each may be the lid over a hollow.
    pub lids: f64,
    /// Of the parts of the hull that a depth camera saw through: it read the surface more than a centimetre beneath.
    pub seen_through: f64,
    /// Cubic metres between the lids and the table: no more can be hollow beneath them.
    pub under_lids: f64,
}

impl UnobservedMeasures {
    pub(super) fn of(scene: &Scene, made: &Reconstruction) -> Self {
        let read = scene.depths.iter().zip(&made.depths);
        let readings: Vec<Readings> = read
            .map(|(view, found)| Readings {
                camera: &view.camera,
                depth: &found.enhanced,
                regions: &found.regions,
            })
            .collect();
        let within = ON_SIDE_CELLS * made.cell_size;
        let is_on_side = |p| is_on_side(&scene.volume, p, within);
        Self::of_model(&made.model, &readings, &made.up, is_on_side)
    }

    /// `is_on_side` says whether a point lies on a side of the volume.
    fn of_model(
        model: &Model,
        readings: &[Readings],
        up: &UpDirections,
        is_on_side: impl Fn(Point3<f64>) -> bool + Sync,
    ) -> Self {
        let place = |vertex: usize| match model.provenance[vertex] {
            Provenance::Table => Place::Table,
            Provenance::Unseen if is_on_side(model.mesh.vertices[vertex].cast()) => Place::Cut,
            Provenance::Unseen => Place::Guessed,
            Provenance::Hull => of_hull(model, vertex, up, readings),
            _ => Place::Observed,
        };
        let count = model.mesh.vertices.len();
        let height = |p: Point3<f32>, up: Vector3<f32>| f64::from(p.coords.dot(&up));
        let tables: Vec<f64> = up
            .all()
            .iter()
            .map(|up| {
                let heights = model.mesh.vertices.iter().map(|p| height(*p, *up));
                heights.fold(f64::INFINITY, f64::min)
            })
            .collect();
        let places: Vec<Place> = (0..count).into_par_iter().map(place).collect();
        let [
            mut whole,
            mut guessed,
            mut cut_by_volume,
            mut lids,
            mut seen_through,
            mut under_lids,
        ] = [0.0; 6];
        for (triangle, corners) in model.mesh.triangles.iter().enumerate() {
            let normal = normal(&model.mesh, triangle);
            let third = normal.norm() / 3.0;
            for vertex in corners.map(|vertex| vertex as usize) {
                match places[vertex] {
                    Place::Table => continue,
                    Place::Guessed => guessed += third,
                    Place::Cut => cut_by_volume += third,
                    Place::Lid(number) => {
                        lids += third;
                        let up = up.all()[number];
                        let depth = height(model.mesh.vertices[vertex], up) - tables[number];
                        under_lids += depth * normal.dot(&up.cast()).max(0.0) / 3.0;
                    }
                    Place::SeenThrough => seen_through += third,
                    Place::Observed => {}
                }
                whole += third;
            }
        }
        let share = |part: f64| if whole > 0.0 { part / whole } else { 0.0 };
        Self {
            guessed: share(guessed + cut_by_volume),
            cut_by_volume: share(cut_by_volume),
            lids: share(lids),
            seen_through: share(seen_through),
            under_lids,
        }
    }
}

#[derive(Clone, Copy)]
enum Place {
    Table,
    Guessed,
    Cut,
    /// It faces the direction of this number.
    Lid(usize),
    SeenThrough,
    Observed,
}

/// What depth cameras saw of a vertex of the hull.
fn of_hull(model: &Model, vertex: usize, up: &UpDirections, readings: &[Readings]) -> Place {
    let (p, normal) = (model.mesh.vertices[vertex].cast(), model.normals[vertex]);
    if let Some(number) = may_be_lid(p, normal, up, readings) {
        return Place::Lid(number);
    }
    match beneath(p, normal, readings) {
        Some(way) if way > SEEN_THROUGH => Place::SeenThrough,
        _ => Place::Observed,
    }
}

/// Whether a point lies on one of the volume's sides or on its top, to within so many metres.
fn is_on_side(volume: &Volume, p: Point3<f64>, within: f64) -> bool {
    let (above, below) = (p - volume.min, volume.max - p);
    above.xy().min().min(below.min()) < within
}

/// A triangle's normal, as long as its area.
fn normal(mesh: &Mesh, triangle: usize) -> Vector3<f64> {
    let [a, b, c] = mesh.corners(triangle).map(|p| p.cast::<f64>());
    0.5 * (b - a).cross(&(c - a))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    /// Squares of 1 m in a row: on the table, a guess, one that faces up and one that faces sideways.
    #[test]
    fn what_stands_on_the_table_does_not_count_and_only_what_faces_up_may_be_a_lid() {
        let mut model = Model::default();
        let squares: [(Provenance, Vector3<f32>); 5] = [
            (Provenance::Table, -Vector3::z()),
            (Provenance::Unseen, Vector3::x()),
            (Provenance::Hull, Vector3::z()),
            (Provenance::Hull, Vector3::x()),
            (Provenance::Bridged, Vector3::z()),
        ];
        for (index, (provenance, normal)) in squares.into_iter().enumerate() {
            let (x, first) = (index as f32, 4 * index as u32);
            let corners = [[x, 0.0], [x + 1.0, 0.0], [x + 1.0, 1.0], [x, 1.0]];
            let height = if normal.z > 0.0 { 0.5 } else { 0.0 };
            let corners = corners.map(|[x, y]| Point3::new(x, y, height));
            model.mesh.vertices.extend(corners);
            let [a, b, c, d] = [0, 1, 2, 3].map(|i| first + i);
            model.mesh.triangles.extend([[a, b, c], [a, c, d]]);
            model.normals.extend([normal; 4]);
            model.provenance.extend([provenance; 4]);
        }
        let up = UpDirections::default();
        let found = UnobservedMeasures::of_model(&model, &[], &up, |_| false);
        let figures = [found.guessed, found.lids, found.under_lids];
        for (figure, expected) in figures.into_iter().zip([0.25, 0.25, 0.5]) {
            assert!((figure - expected).abs() < 1e-9, "{found:?}");
        }
        // A guess is one all the same where the volume bounds it; what is known, or stands on the table, is not cut.
        let found = UnobservedMeasures::of_model(&model, &[], &up, |_| true);
        assert!((found.guessed - 0.25).abs() < 1e-9 && found.cut_by_volume == found.guessed);
        assert_eq!(
            UnobservedMeasures::of_model(&Model::default(), &[], &up, |_| false),
            UnobservedMeasures::default()
        );
    }

    #[test]
    fn the_volume_has_four_sides_and_a_top_and_stands_on_the_table() {
        let volume = Volume::new(Point3::new(-1.0, -1.0, 0.0), Point3::new(1.0, 1.0, 2.0)).unwrap();
        let on_side = |x, y, z| is_on_side(&volume, Point3::new(x, y, z), 0.01);
        assert!(on_side(-0.995, 0.0, 1.0) && on_side(0.0, 0.995, 1.0) && on_side(0.0, 0.0, 1.995));
        assert!(!on_side(0.0, 0.0, 0.005) && !on_side(0.98, -0.98, 1.98));
    }

    /// A square of 1 cm that faces up, before the readings of a depth camera above it.
    #[test]
    fn where_the_surface_was_read_far_beneath_the_hull_is_seen_through() {
        use crate::reconstruct::uncertainty::testing::Above;
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
        let corners = corners.map(|[x, y]| Point3::new(5e-3 * x, 5e-3 * y, 0.0));
        let mut model = Model::default();
        model.mesh.vertices = corners.to_vec();
        model.mesh.triangles = vec![[0, 1, 2], [0, 2, 3]];
        model.normals = vec![Vector3::z(); 4];
        model.provenance = vec![Provenance::Hull; 4];
        let found = |depth| {
            let above = Above::reads(depth, 0.0, 0.0);
            let up = UpDirections::default();
            let found = UnobservedMeasures::of_model(&model, &above.readings(), &up, |_| false);
            [found.lids, found.seen_through]
        };
        assert_eq!(found(0.8), [0.0, 0.0]);
        assert_eq!(found(0.805), [0.0, 0.0]);
        assert_eq!(found(0.83), [0.0, 1.0]);
        // What is read before it hides it.
        assert_eq!(found(0.7), [1.0, 0.0]);
    }
}

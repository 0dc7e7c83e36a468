//! The expected error of what depth cameras carved. It starts from the error that the readings alone suggest, and is
//! larger where the depth bends or ends, and smaller over holes in the depth. In the depth's shadows it is larger where
//! the wall is thicker than walls that were read, and smaller near a surface that was read. Restoration decides by the
//! readings' own error, so this comes after it.

use super::readings::Readings;
use crate::mesh::Bvh;
use crate::reconstruct::hull::Hull;
use crate::reconstruct::{Model, Provenance};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Pixels of a depth camera by which a surface is expected to be off where the depth bends or ends.
const OF_BEND_PX: f64 = 0.35;
/// By how many pixels' width the depth bends where all of that is expected; where it bends less, a share of it is.
const BENT_PX: f64 = 3.0;
/// Share that is expected of the noise that a hole in the depth has, which is chosen for the worst holes.
const OF_HOLE: f64 = 0.3;
/// The surface that closes a hole is expected to be off by this share of the hull's thickness behind it, of which at
/// most so many pixels' widths count.
const OF_BEHIND: f64 = 0.08;
const MOST_BEHIND_PX: f64 = 20.0;
/// In the depth's shadows: share that is expected of what a wall is thicker than those that were read.
const OF_EXCESS: f64 = 0.8;
/// Quantile of the hull's thickness behind what was read that counts as the thickness of the object's walls, and the
/// most places at which it is measured.
const WALL_QUANTILE: f64 = 0.1;
const MOST_PLACES: usize = 1000;
/// In the depth's shadows: share that is expected of the geometric mean of that error and the way to the nearest
/// surface that was read.
const OF_BOTH: f64 = 0.5;
/// Pixels of a depth camera by which a surface that was read may be off.
const READ_PX: f64 = 0.5;

/// States the expected error of what depth cameras carved, from that which `model` has of their readings. `readings`
/// are those of all depth cameras.
pub(super) fn state(model: &mut Model, hull: &Hull, readings: &[Readings]) {
    if readings.is_empty() {
        return;
    }
    let inside = Inside {
        hull,
        readings,
        read: Bvh::new(&model.part(Provenance::Restored)),
        wall: thickness_of_walls(model, hull),
    };
    let of_vertex = |v: usize| {
        let (p, normal) = (model.mesh.vertices[v].cast(), model.normals[v]);
        let of_readings = f64::from(model.expected_error[v]);
        inside.stated(model.provenance[v], p, normal, of_readings) as f32
    };
    model.expected_error = (0..model.mesh.vertices.len())
        .into_par_iter()
        .map(of_vertex)
        .collect();
}

struct Inside<'a> {
    hull: &'a Hull<'a>,
    readings: &'a [Readings<'a>],
    /// The surface that readings made.
    read: Bvh,
    /// What [`thickness_of_walls`] finds.
    wall: Option<f64>,
}

/// How thick the object's walls are, in metres: a low quantile of the hull's thickness behind what readings made, for
/// thick parts are no walls. `None` where readings made nothing.
fn thickness_of_walls(model: &Model, hull: &Hull) -> Option<f64> {
    let vertices = 0..model.mesh.vertices.len();
    let read: Vec<usize> = vertices
        .filter(|&v| model.provenance[v] == Provenance::Restored)
        .collect();
    let each = read.len().div_ceil(MOST_PLACES).max(1);
    let behind = |&v: &usize| {
        let (p, normal) = (model.mesh.vertices[v].cast(), model.normals[v]);
        behind(hull, p, normal)
    };
    let mut found: Vec<f64> = read.par_iter().step_by(each).map(behind).collect();
    found.sort_by(f64::total_cmp);
    found
        .get((WALL_QUANTILE * found.len() as f64) as usize)
        .copied()
}

/// How thick the hull is behind a point of a surface with a unit outward normal, in metres.
fn behind(hull: &Hull, p: Point3<f64>, normal: Vector3<f32>) -> f64 {
    let inwards = -normal.cast::<f64>();
    hull.thickness(p, inwards, hull.pixel_footprint(p))
}

/// How the depth camera that a place faces most sees it, in metres.
struct Sight {
    /// How long a pixel is there.
    pixel: f64,
    /// How much the depth bends there; infinite where it ends.
    bend: f64,
    /// What may remain of the depth's bias, across the surface.
    bias: f64,
}

impl Inside<'_> {
    /// The expected error of a vertex (with its unit outward normal) for which readings alone suggest `of_readings`.
    fn stated(
        &self,
        from: Provenance,
        p: Point3<f64>,
        normal: Vector3<f32>,
        of_readings: f64,
    ) -> f64 {
        match from {
            Provenance::Hull | Provenance::Table => of_readings,
            Provenance::Carved | Provenance::Unseen => self.shadowed(p, normal, of_readings),
            Provenance::Restored => match self.sight(p, normal) {
                Some(sight) => of_readings.hypot(sight.of_bend()),
                None => of_readings,
            },
            Provenance::Bridged => match self.sight(p, normal) {
                Some(sight) => self.bridged(p, normal, of_readings, &sight),
                None => of_readings,
            },
        }
    }

    /// How the depth camera that a place faces most sees it; `None` where no camera that it faces has depth.
    fn sight(&self, p: Point3<f64>, normal: Vector3<f32>) -> Option<Sight> {
        let seen = self.readings.iter().filter_map(|readings| {
            let across = readings.across(p, normal);
            let bend = readings.bend(p).filter(|_| across > 0.0)?;
            Some((across, f64::from(bend), readings))
        });
        let (across, bend, readings) = seen.max_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(Sight {
            pixel: readings.camera.camera.pixel_footprint(p),
            bend,
            bias: readings.regions.bias.remaining * across,
        })
    }

    /// Of the surface that closes a hole in the depth: the true one may run anywhere in the hull behind it.
    fn bridged(
        &self,
        p: Point3<f64>,
        normal: Vector3<f32>,
        of_readings: f64,
        sight: &Sight,
    ) -> f64 {
        let bias = sight.bias.min(of_readings);
        let noise = (of_readings * of_readings - bias * bias).sqrt();
        let inwards = -normal.cast::<f64>();
        let behind = self.hull.reach(p, inwards, self.hull.pixel_footprint(p));
        let behind = behind.min(MOST_BEHIND_PX * sight.pixel);
        (OF_HOLE * noise)
            .hypot(bias)
            .hypot(sight.of_bend())
            .hypot(OF_BEHIND * behind)
    }

    /// Of a surface that no reading faces. If the wall is as thin as those that were read, the true surface lies deeper
    /// by the rest. But it is joined to a surface that was read, so that near there it cannot be much deeper.
    fn shadowed(&self, p: Point3<f64>, normal: Vector3<f32>, of_readings: f64) -> f64 {
        let excess = match self.wall {
            Some(wall) => (behind(self.hull, p, normal) - wall).max(0.0),
            None => 0.0,
        };
        let of_wall = of_readings.hypot(OF_EXCESS * excess);
        // Farther ways make no difference.
        let farthest = of_wall / OF_BOTH.powi(2);
        let Some(read) = self.read.closest_point_within(p, farthest) else {
            return of_wall;
        };
        let joined = self.readings.iter().map(|r| {
            let way = read.distance + READ_PX * r.camera.camera.pixel_footprint(p);
            let of_both = OF_BOTH * (of_wall * way).sqrt();
            of_both.min(way).hypot(r.regions.bias.remaining)
        });
        joined.fold(0.0, f64::max).min(of_wall)
    }
}

impl Sight {
    /// By how much the surface is expected to be off because the depth bends or ends.
    fn of_bend(&self) -> f64 {
        OF_BEND_PX * self.pixel * (self.bend / (BENT_PX * self.pixel)).min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Above, SIDE};
    use super::*;
    use crate::calibration::Volume;
    use crate::mesh::Mesh;

    /// A pixel of the camera above is so long at the origin.
    const PIXEL: f64 = 0.8 / 575.0;
    const MIDDLE: usize = SIDE / 2;

    /// A model of two triangles that face up: one at the origin from `from`, and one `beside` metres along x that was
    /// restored. All of them state `error`.
    fn model(from: Provenance, beside: f32, error: f32) -> Model {
        let corners =
            |x: f32| [[0.0, 0.0], [1e-4, 0.0], [0.0, 1e-4]].map(move |[dx, y]| [x + dx, y]);
        let places = [corners(0.0), corners(beside)].concat();
        let vertices = places.into_iter().map(|[x, y]| Point3::new(x, y, 0.0));
        Model {
            mesh: Mesh {
                vertices: vertices.collect(),
                triangles: vec![[0, 1, 2], [3, 4, 5]],
            },
            normals: vec![Vector3::z(); 6],
            provenance: [[from; 3], [Provenance::Restored; 3]].concat(),
            expected_error: vec![error; 6],
            ..Model::default()
        }
    }

    /// What a place at the origin, 4 mm above the hull's far side, states that said 2 mm before.
    fn stated(from: Provenance, above: &Above, beside: f32) -> f64 {
        let (low, high) = (Point3::new(-0.1, -0.1, -0.004), Point3::new(0.1, 0.1, 0.01));
        let hull = Hull::new(Vec::new(), Volume::new(low, high).unwrap(), 0);
        let mut model = model(from, beside, 2e-3);
        state(&mut model, &hull, &above.readings());
        f64::from(model.expected_error[0])
    }

    fn is(found: f64, expected: f64) -> bool {
        (found - expected).abs() < 1e-3 * expected
    }

    #[test]
    fn where_the_depth_bends_more_is_stated_and_most_where_it_ends() {
        let mut above = Above::reads(0.8, 0.0, 0.0);
        assert!(is(stated(Provenance::Restored, &above, 0.05), 2e-3));
        above.depth.depth[(MIDDLE + 2, MIDDLE)] += (1.5 * PIXEL) as f32;
        let bent = stated(Provenance::Restored, &above, 0.05);
        assert!(is(bent, 2e-3_f64.hypot(0.5 * OF_BEND_PX * PIXEL)), "{bent}");
        above.depth.depth[(MIDDLE + 2, MIDDLE)] = 0.0;
        let ends = stated(Provenance::Restored, &above, 0.05);
        assert!(is(ends, 2e-3_f64.hypot(OF_BEND_PX * PIXEL)), "{ends}");
    }

    #[test]
    fn what_closes_a_hole_is_nearer_than_its_noise_but_not_than_a_bias() {
        let flat = |remaining| {
            stated(
                Provenance::Bridged,
                &Above::reads(0.8, 0.0, remaining),
                0.05,
            )
        };
        let sure = flat(0.0);
        assert!((0.6e-3..1.9e-3).contains(&sure), "{sure}");
        let biased = flat(1.9e-3);
        assert!(biased > 1.9e-3, "{biased}");
    }

    #[test]
    fn in_a_shadow_less_is_stated_near_what_was_read() {
        let above = Above::reads(0.8, 0.0, 0.0);
        let joined = OF_BOTH * (2e-3 * (0.5e-3 + READ_PX * PIXEL)).sqrt();
        for from in [Provenance::Carved, Provenance::Unseen] {
            let near = stated(from, &above, 0.5e-3);
            assert!(is(near, joined), "{near}");
            assert!(is(stated(from, &above, 0.05), 2e-3));
        }
        let biased = Above::reads(0.8, 0.0, 1e-3);
        let near = stated(Provenance::Carved, &biased, 0.5e-3);
        assert!(is(near, joined.hypot(1e-3)), "{near}");
    }

    #[test]
    fn in_a_shadow_more_is_stated_where_the_wall_is_thicker_than_what_was_read() {
        let volume = Volume::new(Point3::new(-0.1, -0.1, -0.02), Point3::new(0.1, 0.1, 0.01));
        let hull = Hull::new(Vec::new(), volume.unwrap(), 0);
        let above = Above::reads(0.8, 0.0, 0.0);
        let stated = |read_at: f32| {
            let mut model = model(Provenance::Unseen, 0.09, 2e-3);
            for vertex in &mut model.mesh.vertices[3..] {
                vertex.z = read_at;
            }
            state(&mut model, &hull, &above.readings());
            f64::from(model.expected_error[0])
        };
        // The hull reaches 20 mm down from the shadow, and 5 mm from what was read.
        let thicker = stated(-0.015);
        let expected = 2e-3_f64.hypot(OF_EXCESS * 15e-3);
        assert!((thicker - expected).abs() < 0.1 * expected, "{thicker}");
        assert!(is(stated(0.0), 2e-3));
        assert!(is(stated(0.005), 2e-3));
    }

    #[test]
    fn without_a_depth_camera_all_stays() {
        let hull = Hull::new(
            Vec::new(),
            Volume::new(Point3::origin(), [0.1; 3].into()).unwrap(),
            0,
        );
        let mut carved = model(Provenance::Carved, 1e-3, 2e-3);
        state(&mut carved, &hull, &[]);
        assert_eq!(carved.expected_error, [2e-3; 6]);
    }
}

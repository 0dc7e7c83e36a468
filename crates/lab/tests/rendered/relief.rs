//! Tests how much fairing keeps of a relief that stands in profile: rings of ribs around a column, in close-ups of
//! cameras that look along the rings.

use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use scand_core::calibration::{Camera, Distortion, Intrinsics};
use scand_core::evaluate::sample;
use scand_core::frame::CameraId;
use scand_core::mesh::Mesh;
use scand_lab::SimulatedColorCamera;
use std::f64::consts::TAU;

/// Width, height and focal length of the pictures, in pixels; at the column a pixel is an eighth of a millimetre.
const WIDTH: usize = 1280;
const HEIGHT: usize = 960;
const FOCAL_PX: f64 = 7600.0;
/// Metres from a camera to the column's middle.
const DISTANCE: f64 = 0.95;
/// Cameras that look along the rings, an odd number so that no two face each other, and those that look down at the
/// column's top.
const LEVEL_CAMERAS: usize = 13;
const HIGH_CAMERAS: usize = 4;

/// One of the cameras.
fn station(number: usize) -> SimulatedColorCamera {
    let (place, places, elevation) = match number.checked_sub(LEVEL_CAMERAS) {
        None => (number, LEVEL_CAMERAS, 0.03_f64),
        Some(high) => (high, HIGH_CAMERAS, 0.8),
    };
    let turn = TAU * place as f64 / places as f64;
    let along = Vector3::new(
        elevation.cos() * turn.cos(),
        elevation.cos() * turn.sin(),
        elevation.sin(),
    );
    let middle = Point3::new(0.0, 0.0, 0.045);
    let eye = middle + along * DISTANCE;
    let pose = Isometry3::face_towards(&eye, &middle, &-Vector3::z());
    let center = Vector2::new((WIDTH as f64 - 1.0) / 2.0, (HEIGHT as f64 - 1.0) / 2.0);
    let focal = Vector2::repeat(FOCAL_PX);
    let lens = Intrinsics::new(WIDTH, HEIGHT, focal, center, Distortion::default()).unwrap();
    let camera = Camera::new(CameraId::new(&format!("c{number:02}")).unwrap(), lens, pose);
    SimulatedColorCamera {
        actual: camera.clone(),
        calibrated: camera,
    }
}

/// Height of the ribs in metres, from their feet to their tops: that of the wave which the column's mean radius makes
/// over a rib, 3 mm of the column's height, without the outermost rib on each side.
fn height_of_ribs(mesh: &Mesh) -> f64 {
    const PARTS: usize = 24;
    let mut parts = [(0.0, 0.0); PARTS];
    for sample in sample(mesh, 400_000) {
        let p = sample.point;
        if (0.012..0.036).contains(&p.z) {
            let phase = ((p.z - 0.009) / 0.003).fract();
            let (radii, count) = &mut parts[(phase * PARTS as f64) as usize % PARTS];
            *radii += p.x.hypot(p.y);
            *count += 1.0;
        }
    }
    let (mut cosine, mut sine) = (0.0, 0.0);
    for (part, (radii, count)) in parts.into_iter().enumerate() {
        let angle = TAU * (part as f64 + 0.5) / PARTS as f64;
        cosine += radii / count * angle.cos();
        sine += radii / count * angle.sin();
    }
    4.0 / PARTS as f64 * cosine.hypot(sine)
}

#[test]
fn the_height_of_ribs_is_measured_from_foot_to_top() {
    // Rings of a column whose radius is a wave of 0.8 mm, ten to a rib.
    const AROUND: u32 = 60;
    let rings = 0..=120_u32;
    let vertex = |ring: u32, place: u32| {
        let z = 0.009 + 0.0003 * f64::from(ring);
        let radius = 0.034 + 0.0004 * (1.0 - (TAU * f64::from(ring) / 10.0).cos());
        let turn = TAU * f64::from(place) / f64::from(AROUND);
        Point3::new(radius * turn.cos(), radius * turn.sin(), z).cast::<f32>()
    };
    let vertices = rings.flat_map(|ring| (0..AROUND).map(move |place| vertex(ring, place)));
    let quads = (0..120).flat_map(|ring| (0..AROUND).map(move |place| (ring, place)));
    let triangles = quads.flat_map(|(ring, place)| {
        let beside = (place + 1) % AROUND;
        let at = |ring: u32, place: u32| ring * AROUND + place;
        let [a, b] = [at(ring, place), at(ring, beside)];
        let [c, d] = [at(ring + 1, beside), at(ring + 1, place)];
        [[a, b, c], [a, c, d]]
    });
    let mesh = Mesh {
        vertices: vertices.collect(),
        triangles: triangles.collect(),
    };
    let height = height_of_ribs(&mesh);
    assert!((0.72e-3..0.81e-3).contains(&height), "{height}");
}

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;
    use scand_core::image::Mask;
    use scand_core::reconstruct::fairing::fair_hull;
    use scand_core::reconstruct::hull::{self, Cone, Hull};
    use scand_lab::{Options, Shape, Simulation};

    #[test]
    fn ribs_that_stand_in_profile_keep_four_fifths_of_their_height() {
        let simulation = Simulation::new(Options {
            spacing_mm: 0.5,
            ..Options::small(Shape::Relief)
        })
        .unwrap();
        let stations: Vec<_> = (0..LEVEL_CAMERAS + HIGH_CAMERAS).map(station).collect();
        let masks: Vec<Mask> = stations.iter().map(|s| simulation.mask(0, s)).collect();
        let pairs = stations.iter().zip(&masks);
        let cones = pairs.map(|(s, mask)| Cone::new(&s.calibrated, mask));
        let hull = Hull::new(cones.collect(), simulation.rig().volume, 2);
        // A rib is as long as nine cells.
        let parameters = hull::Parameters {
            resolution: 400.0,
            ..hull::Parameters::default()
        };
        let lattice = hull::lattice(&hull, &parameters).unwrap();
        let plain = hull::extract(&hull, &lattice, &parameters).unwrap();
        let plain = plain.surface.mesh;
        let faired = fair_hull(&hull, &lattice, &plain, &parameters).unwrap();
        let solid = hull::extract_solid(&faired.solid, &lattice, &parameters).unwrap();
        let [truth, of_hull, found] =
            [simulation.truth(), &plain, &solid.surface.mesh].map(height_of_ribs);
        println!(
            "shown: ribs of {:.3} mm are {:.3} mm high on the hull, {:.3} mm on the faired one; {:?}",
            1e3 * truth,
            1e3 * of_hull,
            1e3 * found,
            faired.facts
        );
        assert!(truth > 0.6e-3, "{truth}");
        assert!(found >= 0.8 * truth, "{found} of {truth}");
    }
}

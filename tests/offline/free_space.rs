//! What depth takes off where silhouettes claim too much: below the rim of a tray, and in the corners of steps. All
//! colour cameras look down from 46 degrees, so that silhouettes fill the space below the rim, and the corners.

use crate::reconstruction::run;
use nalgebra::{Point3, Vector3};
use scand::evaluate::load::LoadedModel;
use scand::evaluate::{self, evaluate};
use scand::mesh::{Bvh, Mesh};
use scand::reconstruct::{Method, Reconstruction};
use scand_lab::{Options, Response, Shape, Simulation};

/// A shape before eight colour cameras above it and a depth camera, whose view is so far from straight down. The
/// recording states that the depth's bias is at most a millimetre.
fn seen_from_above(shape: Shape, depth_slant_deg: f64) -> Simulation {
    let mut options = from_above(shape, depth_slant_deg);
    options.depth.response = Response::Written;
    Simulation::new(options).unwrap()
}

/// The same, where the recording says nothing of the depth's bias.
fn from_above(shape: Shape, depth_slant_deg: f64) -> Options {
    let mut options = Options::small(shape);
    (options.width, options.height) = (640, 480);
    (options.cameras, options.low_cameras) = (8, Some(0));
    options.depth_slant_deg = depth_slant_deg;
    options
}

/// The hull, and the model that depth had a part in.
fn hull_and_hybrid(simulated: &Simulation) -> [Reconstruction; 2] {
    let scene = simulated.scene(0);
    [Method::Hull, Method::Hybrid].map(|method| run(&scene, method))
}

/// How far a model is off.
#[derive(Debug)]
struct Off {
    /// Cubic centimetres by which it is too large.
    excess_cm3: f64,
    /// Mean distance to it from where the truth is concave, in millimetres.
    concave_mm: f64,
    /// How far its deepest vertex lies within the truth, in millimetres.
    within_mm: f64,
}

impl Off {
    fn of(found: &Reconstruction, truth: &Mesh) -> Self {
        let model = LoadedModel {
            mesh: found.model.mesh.clone(),
            ..LoadedModel::default()
        };
        let parameters = evaluate::Parameters {
            samples: 20_000,
            ..evaluate::Parameters::default()
        };
        let evaluation = evaluate(&model, truth, &parameters).unwrap();
        Self {
            excess_cm3: evaluation.model.volume_cm3 - evaluation.truth.volume_cm3,
            concave_mm: evaluation.whole.concave.unwrap().distances.mean_mm,
            within_mm: 1e3 * deepest_within(&found.model.mesh, truth),
        }
    }
}

/// How far the deepest vertex of a model lies within a solid, in metres; 0 where none does.
fn deepest_within(model: &Mesh, solid: &Mesh) -> f64 {
    let bvh = Bvh::new(solid);
    let depth = |vertex: &Point3<f32>| {
        let p = vertex.cast::<f64>();
        match is_within(&bvh, solid, p) {
            true => bvh.closest_point(p).unwrap().distance,
            false => 0.0,
        }
    };
    model.vertices.iter().map(depth).fold(0.0, f64::max)
}

/// Whether a point lies within a closed surface: along either of two rays, the first triangle shows its back.
fn is_within(bvh: &Bvh, solid: &Mesh, p: Point3<f64>) -> bool {
    let rays = [
        Vector3::new(0.31, 0.17, 0.93),
        Vector3::new(-0.47, 0.71, -0.52),
    ];
    rays.iter().all(|ray| {
        bvh.raycast(p, *ray, 10.0).is_some_and(|hit| {
            let [a, b, c] = solid.corners(hit.triangle).map(|v| v.cast::<f64>());
            (b - a).cross(&(c - a)).dot(ray) > 0.0
        })
    })
}

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;

    /// Three pixels of the depth camera, in millimetres: so ragged is the outline of what it reads.
    const MOST_WITHIN_MM: f64 = 4.0;

    /// The hull and the model that depth had a part in, and how far each is off. Depth took nothing off the truth, of
    /// which the hull itself may lack a little at edges that fairing rounded.
    fn without_and_with_depth(simulated: &Simulation) -> ([Reconstruction; 2], [Off; 2]) {
        let models = hull_and_hybrid(simulated);
        let off = models
            .each_ref()
            .map(|found| Off::of(found, simulated.truth()));
        println!("shown: {:?}: {off:?}", simulated.options().shape);
        let most_mm = MOST_WITHIN_MM.max(off[0].within_mm + 0.5);
        assert!(off[1].within_mm < most_mm, "{off:?}");
        (models, off)
    }

    /// With depth, a model's excess volume and its distance from the concave part are below these shares of the hull's.
    fn assert_gain([hull, hybrid]: &[Off; 2], excess_share: f64, concave_share: f64) {
        assert!(
            hybrid.excess_cm3 < excess_share * hull.excess_cm3
                && hybrid.concave_mm < concave_share * hull.concave_mm,
            "{hull:?} {hybrid:?}"
        );
    }

    #[test]
    fn below_the_rim_of_a_tray_depth_takes_off_what_silhouettes_fill() {
        let simulated = seen_from_above(Shape::Tray, 65.0);
        let ([_, hybrid], off) = without_and_with_depth(&simulated);
        let free_space: usize = hybrid.depths[0].regions.free_space().iter().sum();
        println!("shown: {free_space} pixels of free space");
        assert!(free_space >= 100, "{free_space}");
        assert_gain(&off, 0.75, 0.5);
    }

    #[test]
    fn a_bias_that_the_recording_does_not_state_takes_nothing_off_a_tray() {
        for bias_mm in [-8.0, 0.0, 8.0] {
            let mut options = from_above(Shape::Tray, 65.0);
            options.depth.bias_mm = bias_mm;
            let simulated = Simulation::new(options).unwrap();
            let (_, [hull_off, hybrid_off]) = without_and_with_depth(&simulated);
            assert!(
                hybrid_off.excess_cm3 <= hull_off.excess_cm3,
                "{bias_mm} mm: {hull_off:?} {hybrid_off:?}"
            );
        }
    }

    #[test]
    fn the_corners_of_steps_are_as_deep_as_depth_reads_them() {
        let simulated = seen_from_above(Shape::Steps, 40.0);
        let (_, off) = without_and_with_depth(&simulated);
        assert_gain(&off, 0.6, 0.2);
    }

    #[test]
    fn what_shows_no_free_space_keeps_its_hull_bit_for_bit() {
        // A depth camera above the tray sees nothing of what is below it; the others are convex.
        for (shape, slant_deg) in [
            (Shape::Tray, 4.0),
            (Shape::Egg, 65.0),
            (Shape::Box, 65.0),
            (Shape::Prism, 65.0),
        ] {
            let simulated = seen_from_above(shape, slant_deg);
            let [hull, hybrid] = hull_and_hybrid(&simulated);
            let count = hybrid.depths[0].regions.count;
            assert_eq!(count, 0, "{shape:?} at {slant_deg} degrees");
            assert!(hybrid.model.mesh == hull.model.mesh, "{shape:?}");
        }
    }
}

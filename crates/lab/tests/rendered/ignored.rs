//! What a recording says is to be ignored: a prop before the object neither carves it nor counts as a fault of a
//! camera.

use crate::poses::{moved, posed};
use nalgebra::{Point3, Vector3};
use scand_core::image::Mask;
use scand_core::mesh::Bvh;
use scand_core::reconstruct::{Method, NoProgress, Parameters, Reconstruction, Scene, reconstruct};
use scand_core::report::{Measurements, measure};
use scand_lab::{CaptureFault, Options, Shape, Simulation};

fn with_prop(change: impl FnOnce(&mut Options)) -> Simulation {
    let options = posed(Shape::Box, "upright,turn:40", |o| {
        o.cameras = 11;
        o.width = 640;
        o.height = 480;
        o.faults.prop_mm = vec![CaptureFault {
            capture: 1,
            amount: 26.0,
        }];
        o.faults.props_ignored = true;
        change(o);
    });
    Simulation::new(options).unwrap()
}

fn made(scene: &Scene) -> (Reconstruction, Measurements) {
    let parameters = Parameters {
        method: Method::Hull,
        ..Parameters::default()
    };
    let made = reconstruct(scene, &parameters, &NoProgress).unwrap();
    let measured = measure(scene, &made, Method::Hull);
    (made, measured)
}

fn without(mut scene: Scene) -> Scene {
    for view in &mut scene.colors {
        view.ignored = None;
    }
    scene
}

/// How much of the truth's surface lies farther than `most` metres outside a model.
fn cut_off(simulation: &Simulation, made: &Reconstruction, most: f64) -> f64 {
    let truth = moved(simulation.truth(), &simulation.rig_from_object(1));
    let bvh = Bvh::new(&made.hull);
    let outside = |v: &&Point3<f32>| {
        let p: Point3<f64> = v.cast();
        let up = Vector3::new(0.013, 0.017, 1.0).normalize();
        let (mut from, mut crossings) = (p, 0);
        while let Some(hit) = bvh.raycast(from, up, 10.0) {
            crossings += 1;
            from += up * (hit.t + 1e-7);
        }
        let far = bvh.closest_point(p).is_none_or(|near| near.distance > most);
        crossings % 2 == 0 && far
    };
    let above = truth.vertices.iter().filter(|v| v.z > 0.003);
    above.clone().filter(outside).count() as f64 / above.count() as f64
}

#[test]
fn a_mask_that_ignores_nothing_changes_nothing() {
    let simulation = with_prop(|o| {
        o.width = 320;
        o.height = 240;
    });
    let plain = without(simulation.scene(0));
    let mut scene = plain.clone();
    for view in &mut scene.colors {
        view.ignored = Some(Mask::filled(320, 240, 127));
    }
    let ((a, _), (b, measured)) = (made(&plain), made(&scene));
    assert_eq!(a.hull, b.hull);
    assert_eq!(a.model.mesh, b.model.mesh);
    assert_eq!(measured.model.unproved_volume, Some(0.0));
}

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;

    #[test]
    fn a_prop_that_is_ignored_cuts_nothing_off_and_blames_nobody() {
        for masks in [false, true] {
            let simulation = with_prop(|o| o.masks = masks);
            let scene = simulation.scene(1);
            let (known, figures) = made(&scene);
            let (blind, blamed) = made(&without(scene));
            let (kept, lost) = (
                cut_off(&simulation, &known, 1e-3),
                cut_off(&simulation, &blind, 1e-3),
            );
            assert!(lost > 0.03, "masks {masks}: the prop cuts off {lost}");
            assert!(kept < 0.002, "masks {masks}: {kept} is cut off");
            let worst = |of: &Measurements| {
                of.colors
                    .iter()
                    .map(|c| c.consistency.missing)
                    .fold(0.0, f64::max)
            };
            assert!(
                worst(&figures) < 0.004,
                "masks {masks}: {}",
                worst(&figures)
            );
            assert!(worst(&blamed) > 0.01, "masks {masks}: {}", worst(&blamed));
            assert!(figures.common_shift_share < 0.005);
            assert_eq!(figures.moved, None);
            let counted = figures
                .colors
                .iter()
                .filter(|c| c.silhouette.unknown_px.is_some());
            assert_eq!(counted.count(), 11);
            // A part of the prop's own inside, and little else.
            let unproved = figures.model.unproved_volume.unwrap();
            assert!(
                unproved < 0.026_f64.powi(2) * 0.024,
                "masks {masks}: {unproved}"
            );
            assert_eq!(blamed.model.unproved_volume, None);
        }
    }
}

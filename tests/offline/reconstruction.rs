//! The whole reconstruction on the simulated rig, where the truth is known. Accuracy is the share of either surface
//! that lies within a millimetre of the other, as an F-score over vertices and face centres.

use nalgebra::Point3;
use scand::calibration::{Camera, Intrinsics};
use scand::description::Description;
use scand::image::{Grid, RgbImage};
use scand::mesh::{self, Bvh, Mesh};
use scand::output::{glb, ply};
use scand::reconstruct::hull::Fairing;
use scand::reconstruct::{
    DepthFrame, DepthView, Method, NoProgress, Parameters, Provenance, Reconstruction, Scene,
    reconstruct, restore,
};
use scand_lab::{Options, Shape, Simulation};
use std::sync::Arc;

fn simulation(shape: Shape, change: impl FnOnce(&mut Options)) -> Simulation {
    let mut options = Options {
        width: 960,
        height: 720,
        ..Options::small(shape)
    };
    change(&mut options);
    Simulation::new(options).unwrap()
}

/// The model that a method makes of a scene, which must be a closed surface.
pub fn run(scene: &Scene, method: Method) -> Reconstruction {
    let parameters = Parameters {
        method,
        ..Parameters::default()
    };
    let reconstruction = reconstruct(scene, &parameters, &NoProgress).unwrap();
    let report = mesh::check(&reconstruction.model.mesh);
    assert!(report.is_watertight(), "{report:?}");
    reconstruction
}

/// Share of a mesh's vertices and face centres above the table that lie within a millimetre of the other.
fn share_within_a_millimetre(of: &Mesh, other: &Bvh) -> f64 {
    let centers = (0..of.triangles.len()).map(|t| {
        let [a, b, c] = of.corners(t);
        Point3::from((a.coords + b.coords + c.coords) / 3.0)
    });
    let points: Vec<_> = of
        .vertices
        .iter()
        .copied()
        .chain(centers)
        .filter(|p| p.z > 1.5e-3)
        .collect();
    let near = points.iter().filter(|p| {
        other
            .closest_point(p.cast())
            .is_some_and(|c| c.distance < 1e-3)
    });
    near.count() as f64 / points.len() as f64
}

fn f_score(model: &Mesh, truth: &Mesh) -> f64 {
    let precision = share_within_a_millimetre(model, &Bvh::new(truth));
    let recall = share_within_a_millimetre(truth, &Bvh::new(model));
    2.0 * precision * recall / (precision + recall)
}

#[test]
fn a_cup_is_hollow_and_a_hull_alone_is_not() {
    let simulated = simulation(Shape::Cup, |_| {});
    let scene = simulated.scene(0);
    let hybrid = run(&scene, Method::Hybrid);
    let (hull, depth_hull) = (run(&scene, Method::Hull), run(&scene, Method::DepthHull));
    let score = |r: &Reconstruction| f_score(&r.model.mesh, simulated.truth());
    let scores = [score(&hybrid), score(&hull), score(&depth_hull)];
    println!(
        "F at 1 mm: hybrid {:.3}, hull {:.3}, depth hull {:.3}",
        scores[0], scores[1], scores[2]
    );
    assert!(scores[0] > 0.85 && scores[1] < 0.75, "{scores:?}");
    assert!(hybrid.model.provenance.contains(&Provenance::Restored));
    assert_eq!(mesh::check(&hybrid.model.mesh).components, 1);
}

#[test]
fn what_no_camera_saw_is_said_to_be_far_off() {
    let simulated = simulation(Shape::Vase, |_| {});
    let model = run(&simulated.scene(0), Method::Hybrid).model;
    let truth = Bvh::new(simulated.truth());
    let (mut actual, mut expected, mut count) = (0.0, 0.0, 0.0);
    for (v, &position) in model.mesh.vertices.iter().enumerate() {
        if model.provenance[v] == Provenance::Unseen {
            actual += truth.closest_point(position.cast()).unwrap().distance;
            expected += f64::from(model.expected_error[v]);
            count += 1.0;
        }
    }
    let (actual, expected) = (1e3 * actual / count, 1e3 * expected / count);
    println!("{count} vertices: {actual:.2} mm, expected {expected:.2} mm");
    assert!(count > 1000.0 && actual > 4.0, "{count}: {actual} mm");
    assert!(
        (0.33..3.0).contains(&(expected / actual)),
        "{expected} of {actual} mm"
    );
}

#[test]
fn a_ball_is_exact() {
    let simulated = simulation(Shape::Ball, |_| {});
    let found = run(&simulated.scene(0), Method::Hybrid);
    let score = f_score(&found.model.mesh, simulated.truth());
    println!("F at 1 mm {score:.3}");
    assert!(score >= 0.97, "{score}");
}

#[test]
fn a_ring_keeps_its_hole() {
    let simulated = simulation(Shape::Torus, |_| {});
    let found = run(&simulated.scene(0), Method::Hybrid);
    assert_eq!(mesh::check(&found.model.mesh).genus, Some(1));
}

#[test]
fn simplified_models_stay_closed() {
    let simulated = simulation(Shape::Cup, |o| (o.width, o.height) = (480, 360));
    let parameters = Parameters {
        vertices: 8400,
        ..Parameters::default()
    };
    let model = reconstruct(&simulated.scene(0), &parameters, &NoProgress)
        .unwrap()
        .model;
    assert!(mesh::check(&model.mesh).is_watertight());
    assert!(
        (8000..=8400).contains(&model.mesh.vertices.len()),
        "{}",
        model.mesh.vertices.len()
    );
    assert_eq!(model.provenance.len(), model.mesh.vertices.len());
}

#[test]
fn sixty_six_views_that_say_nothing_new_change_no_vertex_of_a_hull() {
    let simulated = simulation(Shape::Mug, |o| {
        (o.width, o.height) = (320, 240);
        o.masks = true;
    });
    let once = simulated.scene(0);
    let mut often = once.clone();
    often.colors = (0..6).flat_map(|_| once.colors.clone()).collect();
    assert_eq!(often.colors.len(), 66);
    let made = |scene: &Scene| {
        let mut parameters = Parameters {
            method: Method::Hull,
            ..Parameters::default()
        };
        parameters.hull.fairing = Fairing::None;
        parameters.hull.resolution = 80.0;
        reconstruct(scene, &parameters, &NoProgress).unwrap()
    };
    // More cameras than a cell has bits for: several share one.
    let (once, often) = (made(&once), made(&often));
    assert_eq!(once.model.mesh, often.model.mesh);
    assert_eq!(once.model.provenance, often.model.provenance);
}

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;

    /// Each body with either bias, each place of the depth cameras with either bias.
    #[test]
    fn depth_takes_nothing_off_a_convex_body_from_wherever_and_with_whatever_bias() {
        let slants_deg = [0.0, 10.0, 25.0, 45.0];
        for (number, shape) in [Shape::Egg, Shape::Box, Shape::Prism]
            .into_iter()
            .enumerate()
        {
            for (place, slant_deg) in slants_deg.into_iter().enumerate() {
                let bias_mm = [-8.0, 8.0][(number + place) % 2];
                let simulated = simulation(shape, |o| {
                    (o.width, o.height) = (640, 480);
                    o.masks = true;
                    o.depth_cameras = 2;
                    o.depth_slant_deg = slant_deg;
                    o.depth.bias_mm = bias_mm;
                });
                let found = run(&simulated.scene(0), Method::Hybrid);
                let regions: Vec<_> = found.depths.iter().map(|d| d.regions.count).collect();
                let what = format!("{shape:?} at {slant_deg} degrees with {bias_mm} mm");
                assert_eq!(regions, [0, 0], "{what}");
                let is_hull = |p: &Provenance| matches!(p, Provenance::Hull | Provenance::Table);
                assert!(found.model.provenance.iter().all(is_hull), "{what}");
                let faired = found
                    .fairing
                    .as_ref()
                    .and_then(|faired| faired.as_ref().ok());
                let held = faired.and_then(|facts| facts.held_by_depth_area);
                assert!(held.is_none_or(|area| area == 0.0), "{what}: {held:?}");
            }
        }
    }

    #[test]
    fn a_convex_object_is_its_hull_bit_for_bit_whatever_the_depth_says() {
        for shape in [Shape::Ball, Shape::Egg, Shape::Box] {
            for (bias_mm, misregistration_px) in [(0.0, 0.0), (5.0, 1.0)] {
                let simulated = simulation(shape, |o| {
                    o.depth.bias_mm = bias_mm;
                    o.depth.misregistration_px = misregistration_px;
                });
                let scene = simulated.scene(0);
                let (hybrid, hull) = (run(&scene, Method::Hybrid), run(&scene, Method::Hull));
                assert_eq!(hybrid.depths[0].regions.count, 0, "{shape:?} {bias_mm} mm");
                assert!(
                    hybrid.model.mesh == hull.model.mesh,
                    "{shape:?} {bias_mm} mm"
                );
            }
        }
    }

    /// Lets a depth camera read all that is higher than 20 mm within 18 mm of the middle by 6 mm too near.
    fn read_too_near(view: &mut DepthView) {
        let camera = view.camera.clone();
        for frame in &mut view.frames {
            let readings = &frame.readings;
            frame.readings = Grid::from_fn(readings.width(), readings.height(), |x, y| {
                let reading = readings[(x, y)];
                let depth = camera.response.depth(reading);
                let pixel = nalgebra::Point2::new(x as f64, y as f64);
                let point = depth.and_then(|depth| camera.point(pixel, depth));
                let is_top = point.is_some_and(|p| p.z > 0.02 && p.x.hypot(p.y) < 0.018);
                if is_top { reading - 6 } else { reading }
            });
        }
    }

    #[test]
    fn where_depth_reads_the_object_in_front_of_the_faired_hull_the_hull_stays() {
        // No outline shows that a box's top is flat: over it the plain hull is a roof, some millimetres high.
        let scene = simulation(Shape::Box, |o| o.masks = true).scene(0);
        let mut altered = scene.clone();
        read_too_near(&mut altered.depths[0]);
        let held = |found: &Reconstruction| match &found.fairing {
            Some(Ok(facts)) => facts.held_by_depth_area,
            other => panic!("{other:?}"),
        };
        let height = |found: &Reconstruction| {
            let vertices = found.model.mesh.vertices.iter();
            let middle = vertices.filter(|v| v.x.hypot(v.y) < 5e-3);
            middle.map(|v| v.z).fold(0.0, f32::max)
        };
        let as_it_is = run(&scene, Method::Hybrid);
        assert_eq!(held(&as_it_is), Some(0.0));
        let found = run(&altered, Method::Hybrid);
        let area = held(&found).unwrap();
        assert!((1e-4..3e-3).contains(&area), "{area}");
        let heights = [height(&as_it_is), height(&found)];
        assert!(heights[1] > heights[0] + 2e-3, "{heights:?}");
        // What is made of outlines alone stays as it is.
        let hull = run(&altered, Method::Hull);
        assert_eq!(held(&hull), None);
        assert!(hull.model.mesh == as_it_is.model.mesh);
    }

    #[test]
    fn thin_walls_are_not_perforated_and_a_handle_stays_open() {
        for (shape, genus) in [(Shape::Cup, 0), (Shape::Mug, 1)] {
            // Coarser triangles would slit the walls of the truth itself.
            let simulated = simulation(shape, |o| o.spacing_mm = 1.2);
            let found = run(&simulated.scene(0), Method::Hybrid);
            let report = mesh::check(&found.model.mesh);
            assert_eq!(
                (report.components, report.genus),
                (1, Some(genus)),
                "{shape:?}"
            );
        }
    }

    #[test]
    fn eight_millimetres_of_hidden_bias_perforate_nothing() {
        let outcome = |bias_mm: f64| {
            let simulated = simulation(Shape::Bowl, |o| o.depth.bias_mm = bias_mm);
            let found = run(&simulated.scene(0), Method::Hybrid);
            let report = mesh::check(&found.model.mesh);
            assert_eq!(
                (report.components, report.genus),
                (1, Some(0)),
                "{bias_mm} mm"
            );
            let truth = mesh::check(simulated.truth());
            assert!(
                (0.5..2.0).contains(&(report.volume / truth.volume)),
                "{bias_mm} mm: {report:?}"
            );
            (report.volume, f_score(&found.model.mesh, simulated.truth()))
        };
        let (without, with) = (outcome(0.0), outcome(8.0));
        println!("volume, F at 1 mm: {without:?} without bias, {with:?} with 8 mm");
        assert!(
            (with.0 / without.0 - 1.0).abs() < 0.05,
            "{} m³ against {}",
            with.0,
            without.0
        );
        assert!(
            with.1 > without.1 - 0.03,
            "{} against {}",
            with.1,
            without.1
        );
    }

    /// A depth view of half the width and height: every second pixel.
    fn halved(view: &DepthView) -> DepthView {
        let lens = &view.camera.camera.intrinsics;
        let (width, height) = (lens.width / 2, lens.height / 2);
        let (focal, center) = (lens.focal_px / 2.0, lens.center_px / 2.0);
        let smaller = Intrinsics::new(width, height, focal, center, lens.distortion).unwrap();
        let half_color = |color: &Arc<RgbImage>| {
            Arc::new(Grid::from_fn(width, height, |x, y| color[(2 * x, 2 * y)]))
        };
        let frame = |frame: &DepthFrame| DepthFrame {
            readings: Grid::from_fn(width, height, |x, y| frame.readings[(2 * x, 2 * y)]),
            color: frame.color.as_ref().map(half_color),
        };
        let mut halved = DepthView {
            camera: view.camera.clone(),
            frames: view.frames.iter().map(frame).collect(),
        };
        let camera = &view.camera.camera;
        halved.camera.camera = Camera::new(camera.id.clone(), smaller, camera.rig_from_camera);
        halved
    }

    #[test]
    fn sixty_six_colour_and_sixty_six_depth_views_spoil_nothing() {
        let made = |cameras: usize, depth_cameras: usize| {
            let simulated = simulation(Shape::Bowl, |o| {
                (o.width, o.height) = (320, 240);
                o.masks = true;
                (o.cameras, o.depth_cameras) = (cameras, depth_cameras);
                o.depth.frames = 2;
            });
            let mut scene = simulated.scene(0);
            scene.depths = scene.depths.iter().map(halved).collect();
            assert_eq!(
                (scene.colors.len(), scene.depths.len()),
                (cameras, depth_cameras)
            );
            let found = run(&scene, Method::Hybrid);
            let report = mesh::check(&found.model.mesh);
            assert_eq!((report.components, report.genus), (1, Some(0)));
            let share = report.volume / mesh::check(simulated.truth()).volume;
            (f_score(&found.model.mesh, simulated.truth()), share)
        };
        let (few, many) = (made(11, 1), made(66, 66));
        println!("F at 1 mm and share of the volume: {few:?}, with 66 views of each kind {many:?}");
        // The deepest error of so many would carve through the wall.
        assert!(many.0 > few.0 - 0.02 && many.1 > 0.95, "{few:?} {many:?}");
    }

    #[test]
    fn without_depth_the_model_is_the_hull() {
        let simulated = simulation(Shape::Cup, |_| {});
        let mut scene = simulated.scene(0);
        let hull = run(&scene, Method::Hull).model.mesh;
        for frame in &mut scene.depths[0].frames {
            frame.readings.pixels_mut().fill(0);
        }
        assert!(run(&scene, Method::Hybrid).model.mesh == hull);
        scene.depths.clear();
        assert!(run(&scene, Method::Hybrid).model.mesh == hull);
    }

    #[test]
    fn the_papers_own_form_restores_a_cup_and_stands_a_hidden_bias() {
        for bias_mm in [0.0, 8.0] {
            let simulated = simulation(Shape::Cup, |o| o.depth.bias_mm = bias_mm);
            let parameters = Parameters {
                restoration: restore::Parameters {
                    form: restore::Form::Coating,
                    ..restore::Parameters::default()
                },
                ..Parameters::default()
            };
            let found = reconstruct(&simulated.scene(0), &parameters, &NoProgress).unwrap();
            let report = mesh::check(&found.model.mesh);
            let score = f_score(&found.model.mesh, simulated.truth());
            println!("{bias_mm} mm: F at 1 mm {score:.3}, {report:?}");
            assert!(report.is_watertight(), "{report:?}");
            assert_eq!(
                (report.components, report.genus),
                (1, Some(0)),
                "{bias_mm} mm"
            );
            assert!(score > 0.9, "{bias_mm} mm: {score}");
            // Its steep walls are not read: the lid over them is no surface of readings.
            assert!(found.model.provenance.contains(&Provenance::Carved));
        }
    }

    #[test]
    fn the_same_bytes_whatever_the_number_of_threads() {
        let simulated = simulation(Shape::Cup, |o| (o.width, o.height) = (480, 360));
        let scene = simulated.scene(0);
        let bytes = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            let model = pool.install(|| run(&scene, Method::Hybrid)).model;
            let glb =
                glb::encode(&model, &Description::default(), &glb::Parameters::default()).unwrap();
            (glb, ply::encode(&model, &Description::default()).unwrap())
        };
        let one = bytes(1);
        for threads in [2, 3, 8] {
            assert!(bytes(threads) == one, "{threads} threads");
        }
    }
}

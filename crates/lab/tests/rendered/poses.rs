//! One object in several poses: where the truth says it is, what the cameras see of it, and what happens to it.

use nalgebra::Isometry3;
use scand_core::calibration::Camera;
use scand_core::image::Mask;
use scand_core::mesh::{Mesh, rasterize, vertex_normals};
use scand_lab::{
    CaptureFault, Exchange, Options, OtherObject, Pose, Shape, SimulatedColorCamera, Simulation,
    poses_json,
};

pub(crate) fn posed(shape: Shape, poses: &str, change: impl FnOnce(&mut Options)) -> Options {
    let mut options = Options::small(shape);
    options.cameras = 5;
    options.depth.frames = 1;
    options.poses = poses.split(',').map(|p| p.parse().unwrap()).collect();
    options.subject = Some("17".to_owned());
    change(&mut options);
    options
}

pub(crate) fn moved(mesh: &Mesh, to: &Isometry3<f64>) -> Mesh {
    let vertices = mesh.vertices.iter();
    Mesh {
        vertices: vertices.map(|v| (to * v.cast::<f64>()).cast()).collect(),
        triangles: mesh.triangles.clone(),
    }
}

/// The pixels whose centres a mesh covers.
fn covered(camera: &Camera, mesh: &Mesh) -> Vec<bool> {
    let lens = &camera.intrinsics;
    let project = |v: &nalgebra::Point3<f32>| {
        let (q, z) = camera.project(v.cast()).unwrap();
        [q.x as f32, q.y as f32, z as f32]
    };
    let projected: Vec<_> = mesh.vertices.iter().map(project).collect();
    let fragments = rasterize(&projected, &mesh.triangles, lens.width, lens.height);
    fragments.pixels().iter().map(|f| f.is_covered()).collect()
}

/// Pixels where a mask and what a mesh covers differ, over those that the mesh covers.
fn disagreement(camera: &Camera, mask: &Mask, mesh: &Mesh) -> f64 {
    let covered = covered(camera, mesh);
    let differ = mask.pixels().iter().zip(&covered);
    let differ = differ.filter(|(m, c)| (**m >= 128) != **c).count();
    differ as f64 / covered.iter().filter(|c| **c).count() as f64
}

#[test]
fn silhouettes_are_those_of_the_truth_where_the_poses_say_it_is() {
    for (shape, poses) in [
        (Shape::Mug, "upright,flip,side:35,turn:90,any"),
        (Shape::Box, "side,any,upright"),
        (Shape::Egg, "flip,upright,side"),
    ] {
        let simulation = Simulation::new(posed(shape, poses, |_| {})).unwrap();
        let count = simulation.options().captures;
        assert_eq!(count, poses.split(',').count());
        for index in 0..count {
            let pose = simulation.rig_from_object(index);
            let mesh = moved(simulation.truth(), &pose);
            let lowest = mesh.vertices.iter().fold(1.0, |low: f32, v| low.min(v.z));
            assert!(lowest.abs() < 2e-5, "{shape:?} {index} begins at {lowest}");
            for station in &simulation.rig().colors {
                let mask = simulation.mask(index, station);
                let differ = disagreement(&station.actual, &mask, &mesh);
                assert!(differ < 0.012, "{shape:?} {index}: {differ}");
            }
        }
        let still = moved(simulation.truth(), &simulation.rig_from_object(0));
        let station = &simulation.rig().colors[0];
        let mask = simulation.mask(1, station);
        let differ = disagreement(&station.actual, &mask, &still);
        assert!(differ > 0.02, "{shape:?} did not move: {differ}");
    }
}

#[test]
fn a_pattern_moves_with_the_object_and_light_does_not() {
    let options = posed(Shape::Box, "upright,turn:180", |o| {
        o.textured = true;
        o.color.full_well = 0.0;
        o.color.exposure_drift = 0.0;
        o.width = 640;
        o.height = 480;
    });
    let simulation = Simulation::new(options).unwrap();
    // Points of the top face, well inside.
    let points: Vec<nalgebra::Point3<f64>> = (0..400)
        .map(|k| {
            let (i, j) = (f64::from(k % 20) - 9.5, f64::from(k / 20) - 9.5);
            nalgebra::Point3::new(i * 0.0022, j * 0.0022, 0.040)
        })
        .collect();
    let seen = |index, moved_by| seen_by_last(&simulation, index, &points, &moved_by);
    let first = seen(0, nalgebra::Isometry3::identity());
    let there = correlation(&first, &seen(1, simulation.rig_from_object(1)));
    let elsewhere = correlation(&first, &seen(1, nalgebra::Isometry3::identity()));
    assert!(there > 0.8, "{there}");
    assert!(elsewhere < 0.5, "{elsewhere}");
}

/// What the last camera sees, in capture `index`, of points that were moved: green, from 0 to 255.
fn seen_by_last(
    simulation: &Simulation,
    index: usize,
    points: &[nalgebra::Point3<f64>],
    moved_by: &Isometry3<f64>,
) -> Vec<f64> {
    let scene = simulation.scene(index);
    let view = scene.colors.last().unwrap();
    let at = |p: &nalgebra::Point3<f64>| {
        let (q, _) = view.camera.project(moved_by * p).unwrap();
        f64::from(view.image[(q.x.round() as usize, q.y.round() as usize)][1])
    };
    points.iter().map(at).collect()
}

/// How alike an egg looks after a turn about its axis, from where it then stands: correlation of what the last camera
/// sees of it.
fn likeness_after_a_turn(paint: fn(&mut Options)) -> f64 {
    let options = posed(Shape::Egg, "upright,turn:70", |o| {
        paint(o);
        o.color.full_well = 0.0;
        o.color.exposure_drift = 0.0;
        o.width = 640;
        o.height = 480;
    });
    let simulation = Simulation::new(options).unwrap();
    let truth = simulation.truth();
    let eye = simulation.rig().colors.last().unwrap().actual.center();
    let vertices = truth.vertices.iter().map(|v| v.cast::<f64>());
    let facing = vertices.zip(vertex_normals(truth)).filter(|(v, normal)| {
        let to_eye = (eye - v).normalize();
        normal.cast::<f64>().dot(&to_eye) > 0.4
    });
    let points: Vec<nalgebra::Point3<f64>> = facing.map(|(v, _)| v).collect();
    let seen = |index, moved_by| seen_by_last(&simulation, index, &points, &moved_by);
    // Where the axis went.
    let moved = simulation.rig_from_object(1).translation;
    let moved = Isometry3::from_parts(moved, nalgebra::UnitQuaternion::identity());
    correlation(&seen(0, Isometry3::identity()), &seen(1, moved))
}

#[test]
fn rings_look_the_same_after_a_turn_and_a_pattern_does_not() {
    let rings = likeness_after_a_turn(|o| o.rings = true);
    let pattern = likeness_after_a_turn(|o| o.textured = true);
    assert!(rings > 0.85 && pattern < rings - 0.2, "{rings}, {pattern}");
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (ma, mb) = (mean(a), mean(b));
    let product = |f: &dyn Fn(usize) -> f64| (0..a.len()).map(f).sum::<f64>();
    let ab = product(&|k| (a[k] - ma) * (b[k] - mb));
    let (aa, bb) = (
        product(&|k| (a[k] - ma).powi(2)),
        product(&|k| (b[k] - mb).powi(2)),
    );
    ab / (aa * bb).sqrt()
}

#[test]
fn a_chip_is_out_of_later_captures_and_another_object_is_in_its_own_alone() {
    let options = posed(Shape::TwoPits, "upright,upright,upright", |o| {
        o.faults.chip_mm = vec![CaptureFault {
            capture: 2,
            amount: 14.0,
        }];
        o.faults.exchanged = vec![Exchange {
            capture: 1,
            with: OtherObject::Taller(10.0),
        }];
    });
    let simulation = Simulation::new(options).unwrap();
    let taller = simulation
        .truth()
        .vertices
        .iter()
        .fold(0.0_f32, |h, v| h.max(v.z));
    let share = |index: usize| {
        let pose = simulation.rig_from_object(index);
        let mesh = moved(simulation.truth(), &pose);
        let stations = simulation.rig().colors.iter();
        let each = stations.map(|s| disagreement(&s.actual, &simulation.mask(index, s), &mesh));
        each.fold(0.0, f64::max)
    };
    assert!(taller > 0.05);
    let shares = [0, 1, 2].map(share);
    assert!(shares[0] < 0.004, "{shares:?}");
    assert!(shares[1] > 0.03, "{shares:?}");
    assert!(
        shares[2] > 3.0 * shares[0] && shares[2] < 0.06,
        "{shares:?}"
    );
}

#[test]
fn a_prop_hides_a_part_of_the_object_from_some_cameras() {
    let with = posed(Shape::Mug, "upright,turn:90", |o| {
        o.cameras = 11;
        o.faults.prop_mm = vec![CaptureFault {
            capture: 1,
            amount: 25.0,
        }];
    });
    let simulation = Simulation::new(with).unwrap();
    let hidden = |index: usize| {
        let mesh = moved(simulation.truth(), &simulation.rig_from_object(index));
        let stations = simulation.rig().colors.iter();
        let hides = |s: &&SimulatedColorCamera| {
            let mask = simulation.mask(index, s);
            let covered = covered(&s.actual, &mesh);
            let lost = mask.pixels().iter().zip(&covered);
            lost.filter(|(m, c)| **c && **m < 128).count() > 40
        };
        stations.filter(hides).count()
    };
    assert_eq!(hidden(0), 0);
    let count = hidden(1);
    assert!((1..8).contains(&count), "{count}");
}

#[test]
fn a_lost_piece_is_lost_in_the_first_picture_alone() {
    let options = posed(Shape::Cup, "upright,turn:0", |o| {
        o.faults.lost_piece_mm = vec![CaptureFault {
            capture: 1,
            amount: 10.0,
        }];
    });
    let simulation = Simulation::new(options).unwrap();
    let mesh = moved(simulation.truth(), &simulation.rig_from_object(1));
    let stations = simulation.rig().colors.iter();
    let differ: Vec<bool> = stations
        .map(|s| disagreement(&s.actual, &simulation.mask(1, s), &mesh) > 0.01)
        .collect();
    assert_eq!(differ, [true, false, false, false, false]);
}

#[test]
fn the_poses_are_written_as_matrices_from_the_first_capture_on() {
    let simulation = Simulation::new(posed(Shape::Mug, "flip,side:35", |_| {})).unwrap();
    let truth = poses_json(&simulation);
    assert_eq!(truth["object"], "mug");
    assert_eq!(truth["poses"], serde_json::json!(["flip", "side:35"]));
    assert_eq!(
        truth["rig_from_object"][0][2],
        serde_json::json!([0.0, 0.0, 1.0, 0.0])
    );
    let pose = simulation.rig_from_object(1).to_homogeneous();
    assert_eq!(
        truth["rig_from_object"][1][0][3],
        serde_json::json!(pose[(0, 3)])
    );
    assert_eq!(
        simulation.capture(1).unwrap().trigger.subject.as_deref(),
        Some("17")
    );
}

#[test]
fn what_cannot_be_is_refused_in_words() {
    let refused = |change: &dyn Fn(&mut Options)| {
        let mut options = posed(Shape::Cup, "upright,flip", |_| {});
        change(&mut options);
        Simulation::new(options).unwrap_err().to_string()
    };
    let fault = |capture, amount| vec![CaptureFault { capture, amount }];
    let first = refused(&|o| o.faults.chip_mm = fault(0, 6.0));
    assert!(first.contains("of capture 0"), "{first}");
    let absent = refused(&|o| o.faults.prop_mm = fault(2, 6.0));
    assert!(absent.contains("a capture from 0 to 1"), "{absent}");
    let handle = refused(&|o| {
        o.faults.exchanged = vec![Exchange {
            capture: 1,
            with: OtherObject::HandleUp(3.0),
        }];
    });
    assert!(handle.contains("only a mug"), "{handle}");
    for wrong in ["lying", "turn", "flip:3", "side:x", "turn:400"] {
        assert!(wrong.parse::<Pose>().is_err(), "{wrong}");
    }
    for word in ["upright", "flip", "side", "side:35", "turn:-90", "any"] {
        assert_eq!(word.parse::<Pose>().unwrap().to_string(), word);
    }
    for word in ["mug", "fruit-bowl", "bigger:1", "taller:3", "handle-up:3"] {
        assert_eq!(word.parse::<OtherObject>().unwrap().to_string(), word);
    }
    assert!("wider:1".parse::<OtherObject>().is_err());
    assert!("bigger:90".parse::<OtherObject>().is_err());
}

#[test]
fn a_calibration_with_errors_is_not_the_rig() {
    let options = posed(Shape::Cup, "upright,flip", |o| {
        o.cameras = 40;
        o.faults.calibration_px = 0.15;
        o.faults.calibration_scale_percent = 0.4;
    });
    let simulation = Simulation::new(options).unwrap();
    let errors = simulation.rig().colors.iter().flat_map(|s| {
        let error = s.calibrated.intrinsics.center_px - s.actual.intrinsics.center_px;
        [error.x, error.y]
    });
    let squares: Vec<f64> = errors.map(|e| e * e).collect();
    let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    assert!((0.12..0.18).contains(&rms), "{rms}");
    for station in &simulation.rig().colors {
        let ratio =
            station.calibrated.center().coords.norm() / station.actual.center().coords.norm();
        assert!((ratio - 1.004).abs() < 1e-9, "{ratio}");
    }
}

//! Tests whether the stated errors of a calibration are right: sessions with known truth, noisy corners, and boards
//! that are bent and stretched like real prints. All errors are compared with their stated deviations. They take
//! minutes and are run by `make calibration-trial`.

use super::synthetic::{Random, Truth, color_lens, looking, placements};
use super::{Fit, Parameters, TermStatus, fit};
use crate::calibration::{Board, BoardShape, Camera, Distortion, Intrinsics};
use nalgebra::{Isometry3, Matrix6, Point3, UnitQuaternion, Vector2, Vector3, Vector6};
use std::collections::BTreeMap;

/// How a board is printed and glued: standard deviations of its bends in metres, and of its stretch.
const BEND: f64 = 2.5e-4;
const STRETCH: f64 = 3e-4;
/// Kinds of parameters, as errors are counted.
type Errors = BTreeMap<&'static str, Vec<f64>>;

/// A lens of 640 x 480 pixels.
fn small_lens() -> Intrinsics {
    let distortion = Distortion {
        radial: [-0.11, 0.08, -0.01, 0.0, 0.0, 0.0],
        tangential: [5e-4, -3e-4],
    };
    let (focal, center) = (Vector2::new(660.0, 661.0), Vector2::new(322.0, 236.0));
    Intrinsics::new(640, 480, focal, center, distortion).unwrap()
}

/// Cameras in a ring around a table.
fn ring(count: usize, lens: Intrinsics) -> Vec<Camera> {
    let middle = Point3::new(0.0, 0.0, 0.08);
    let camera = |k: usize| {
        // Within a half circle, so that each shares the board with its neighbours.
        let angle = k as f64 / count as f64 * std::f64::consts::PI;
        let height = if k.is_multiple_of(2) { 0.5 } else { 0.8 };
        let from = Point3::new(0.7 * angle.cos(), 0.7 * angle.sin(), height);
        looking(&format!("c{k:02}"), lens, from, middle)
    };
    (0..count).map(camera).collect()
}

/// A session of a seed: its truth and its fit.
fn session(seed: u64, cameras: &[Camera], board: Board, count: usize) -> (Truth, Fit) {
    let mut random = Random(seed.wrapping_mul(7919));
    let mut truth = Truth::new(
        board,
        cameras.to_vec(),
        placements(&board, count, &mut random),
    );
    // Every fourth board is as it should be.
    if !seed.is_multiple_of(4) {
        let mut terms = [BEND, BEND, STRETCH];
        terms.iter_mut().for_each(|term| *term *= random.normal());
        truth.shape = BoardShape::of_terms(terms);
    }
    let session = truth.session(0.1, &mut random);
    let found = fit(&session, &Parameters::default()).unwrap();
    (truth, found)
}

/// Each error of a fit divided by its stated uncertainty, by kind of parameter.
fn normalized(truth: &Truth, fit: &Fit, all: &mut Errors) {
    let table = fit.table.trim_start_matches('p').parse().unwrap();
    let fit_from_truth = truth.fit_from_truth(table);
    let mut add =
        |kind, error: f64, deviation: f64| all.entry(kind).or_default().push(error / deviation);
    for (found, true_one) in fit.cameras.iter().zip(&truth.cameras) {
        let (a, b, u) = (
            found.camera.intrinsics,
            true_one.intrinsics,
            found.uncertainty,
        );
        let center = fit_from_truth * true_one.center() - found.camera.center();
        let turn =
            found.camera.rig_from_camera.inverse() * fit_from_truth * true_one.rig_from_camera;
        let turn = turn.rotation.scaled_axis().map(f64::to_degrees);
        for i in 0..2 {
            add("focal length", a.focal_px[i] - b.focal_px[i], u.focal_px[i]);
            add(
                "centre of the picture",
                a.center_px[i] - b.center_px[i],
                u.center_px[i],
            );
        }
        for i in 0..3 {
            add("place", center[i], u.position[i]);
            add("turn", turn[i], u.rotation_degrees[i]);
        }
    }
    for (term, true_one) in fit.shape.terms().iter().zip(truth.shape.terms()) {
        add("shape of the board", term.value - true_one, term.deviation);
    }
    let seen = seen_off(truth, fit, fit_from_truth);
    for (camera, off) in fit.cameras.iter().zip(seen) {
        let stated = camera.projection.as_ref().unwrap().at_object;
        add("at the object", off, stated);
    }
}

/// The points for which the fit states how far off its cameras see them, as the truth has them.
fn stated_points(fit: &Fit, fit_from_truth: Isometry3<f64>) -> Vec<Point3<f64>> {
    let volume = fit.volume.expect("all cameras share a volume");
    let part = |k: usize| (k as f64 + 0.5) / 5.0;
    let at = |k: usize| Vector3::new(part(k % 5), part(k / 5 % 5), part(k / 25));
    let inside = |k| volume.min + (volume.max - volume.min).component_mul(&at(k));
    (0..125)
        .map(|k| fit_from_truth.inverse() * inside(k))
        .collect()
}

/// How far each camera sees points of the volume from where they are, as a root mean square in metres at the object,
/// once the rig is laid on the truth as well as it can be.
fn seen_off(truth: &Truth, fit: &Fit, fit_from_truth: Isometry3<f64>) -> Vec<f64> {
    let points = stated_points(fit, fit_from_truth);
    let off = |pose: &Isometry3<f64>| -> Vec<Vec<Vector2<f64>>> {
        let of = |(found, true_one): (&super::FittedCamera, &Camera)| {
            let error = |p: &Point3<f64>| {
                let (seen, depth) = true_one.project(*p)?;
                let (predicted, _) = found.camera.project(pose * p)?;
                Some((predicted - seen) * (depth / true_one.intrinsics.focal_px.x))
            };
            points.iter().filter_map(error).collect()
        };
        fit.cameras.iter().zip(&truth.cameras).map(of).collect()
    };
    let moved = |pose: &Isometry3<f64>, step: Vector6<f64>| {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
        Isometry3::new(Vector3::new(step[3], step[4], step[5]), Vector3::zeros()) * turn * pose
    };
    let mut pose = fit_from_truth;
    for _ in 0..3 {
        let now: Vec<Vector2<f64>> = off(&pose).concat();
        let by = |k: usize| -> Vec<Vector2<f64>> {
            let mut step = Vector6::zeros();
            step[k] = 1e-6;
            let after = off(&moved(&pose, step)).concat();
            after
                .iter()
                .zip(&now)
                .map(|(a, b)| (a - b) / 1e-6)
                .collect()
        };
        let columns: Vec<Vec<Vector2<f64>>> = (0..6).map(by).collect();
        let dot = |a: &[Vector2<f64>], b: &[Vector2<f64>]| {
            a.iter().zip(b).map(|(a, b)| a.dot(b)).sum::<f64>()
        };
        let normal = Matrix6::from_fn(|i, k| dot(&columns[i], &columns[k]));
        let right = Vector6::from_fn(|i, _| dot(&columns[i], &now));
        pose = moved(&pose, -normal.cholesky().unwrap().solve(&right));
    }
    let rms = |own: &Vec<Vector2<f64>>| {
        (own.iter().map(|v| v.norm_squared()).sum::<f64>() / own.len() as f64).sqrt()
    };
    off(&pose).iter().map(rms).collect()
}

/// Of each kind: the part of the errors within 2.5 stated deviations, and their root mean square.
fn told(all: &Errors) -> Vec<(&'static str, usize, f64, f64)> {
    let of = |(kind, errors): (&&'static str, &Vec<f64>)| {
        let within = errors.iter().filter(|e| e.abs() <= 2.5).count();
        let squares: f64 = errors.iter().map(|e| e * e).sum();
        let count = errors.len() as f64;
        (
            *kind,
            errors.len(),
            within as f64 / count,
            (squares / count).sqrt(),
        )
    };
    all.iter().map(of).collect()
}

fn hold(sessions: u64, cameras: &[Camera], board: Board, count: usize) {
    let mut all = Errors::new();
    let mut unheld = 0;
    for seed in 1..=sessions {
        let (truth, found) = session(seed, cameras, board, count);
        // At some placement no camera may have seen the board, but no view may be thrown out.
        let thrown_out = found.left_out_share();
        assert_eq!(thrown_out.left_out, 0, "{seed}: {:?}", found.left_out);
        unheld += found
            .shape
            .terms()
            .iter()
            .filter(|t| t.fate == TermStatus::NotHeld)
            .count();
        normalized(&truth, &found, &mut all);
    }
    let told = told(&all);
    for (kind, count, within, rms) in &told {
        println!(
            "{kind}: {count} errors, {:.1} % within 2.5 of what is stated, rms {rms:.2}",
            1e2 * within
        );
    }
    println!("terms of the shape that were needed and not held: {unheld}");
    for (kind, _, within, rms) in told {
        assert!(
            within >= 0.95 && (0.6..1.5).contains(&rms),
            "{kind}: {within} {rms}"
        );
    }
    assert!(unheld <= 1, "{unheld}");
}

#[test]
#[ignore = "twenty sessions take a minute or more: make calibration-trial"]
fn errors_are_as_large_as_is_stated() {
    hold(
        20,
        &ring(3, small_lens()),
        Board::checkerboard(9, 6, 0.025).unwrap(),
        14,
    );
}

#[test]
#[ignore = "forty sessions of nine cameras take minutes: make calibration-trial"]
fn errors_are_as_large_as_is_stated_of_a_large_rig() {
    hold(
        40,
        &ring(9, color_lens()),
        Board::checkerboard(11, 8, 0.025).unwrap(),
        24,
    );
}

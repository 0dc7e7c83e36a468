//! Fits of sessions whose truth is known.

use super::synthetic::{Random, Truth, apart, placements, rig};
use super::*;
use crate::calibration::Board;
use nalgebra::{Point3, Vector3};

fn checkerboard() -> Board {
    Board::checkerboard(11, 8, 0.025).unwrap()
}

fn truth(board: Board, count: usize, seed: u64) -> Truth {
    let placements = placements(&board, count, &mut Random(seed));
    Truth::new(board, rig(), placements)
}

/// Mean and largest distance, in pixels, of points of the volume from where they truly are seen by each camera, once
/// they are triangulated from what the other cameras truly see.
fn prediction(truth: &Truth, fit: &Fit) -> (f64, f64) {
    let mut all = Vec::new();
    let mut random = Random(99);
    for _ in 0..60 {
        let p = Point3::new(
            random.between(-0.1, 0.1),
            random.between(-0.1, 0.1),
            random.between(0.0, 0.2),
        );
        let seen: Vec<_> = truth
            .cameras
            .iter()
            .map(|c| c.project(p).unwrap().0)
            .collect();
        for left_out in 0..truth.cameras.len() {
            let (mut a, mut b) = (nalgebra::Matrix3::zeros(), Vector3::zeros());
            for (i, camera) in fit
                .cameras
                .iter()
                .enumerate()
                .filter(|(i, _)| *i != left_out)
            {
                let ray = camera.camera.ray(seen[i]).unwrap();
                let weight = (camera.camera.intrinsics.focal_px.x
                    / (camera.camera.center() - p).norm())
                .powi(2);
                let across = (nalgebra::Matrix3::identity() - ray * ray.transpose()) * weight;
                a += across;
                b += across * camera.camera.center().coords;
            }
            let found = Point3::from(a.try_inverse().unwrap() * b);
            let (pixel, _) = fit.cameras[left_out].camera.project(found).unwrap();
            all.push(apart(pixel, seen[left_out]));
        }
    }
    (
        all.iter().sum::<f64>() / all.len() as f64,
        all.iter().copied().fold(0.0, f64::max),
    )
}

/// Errors of a fitted rig over their stated standard deviations: of fx, fy, cx, cy and the centres' coordinates, in the
/// frame of the table's placement.
fn normalized_errors(truth: &Truth, fit: &Fit) -> Vec<f64> {
    let table = fit
        .placements
        .iter()
        .position(|p| p.name == fit.table)
        .unwrap();
    let fit_from_truth = truth.fit_from_truth(table);
    let mut all = Vec::new();
    for (found, true_one) in fit.cameras.iter().zip(&truth.cameras) {
        let (a, b, u) = (
            found.camera.intrinsics,
            true_one.intrinsics,
            found.uncertainty,
        );
        let center = fit_from_truth * true_one.center() - found.camera.center();
        for i in 0..2 {
            all.push((a.focal_px[i] - b.focal_px[i]) / u.focal_px[i]);
            all.push((a.center_px[i] - b.center_px[i]) / u.center_px[i]);
        }
        all.extend((0..3).map(|i| center[i] / u.position[i]));
    }
    all
}

#[test]
fn a_rig_of_twelve_cameras_is_found_again() {
    let truth = truth(checkerboard(), 20, 1);
    let session = truth.session(0.1, &mut Random(7));
    let fit = fit(&session, &Parameters::default()).unwrap();
    assert_eq!(
        (fit.cameras.len(), fit.table.as_str(), fit.table_is_lowest),
        (12, "p00", true)
    );
    assert!(fit.left_out.is_empty(), "{:?}", fit.left_out);
    // 0.1 px in each of two coordinates.
    assert!(
        (fit.figures.rms_px - 0.1414).abs() < 0.003,
        "{:?}",
        fit.figures
    );
    assert!(fit.held_out.unwrap().ratio < 1.05, "{:?}", fit.held_out);
    for (found, true_one) in fit.cameras.iter().zip(&truth.cameras) {
        let ratio = found
            .camera
            .intrinsics
            .focal_px
            .component_div(&true_one.intrinsics.focal_px);
        assert!(
            ratio.iter().all(|r| (r - 1.0).abs() < 5e-4),
            "{}: {ratio}",
            true_one.id
        );
    }
    let (mean, worst) = prediction(&truth, &fit);
    assert!(mean < 0.02 && worst < 0.06, "{mean} {worst}");
    let errors = normalized_errors(&truth, &fit);
    let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
    let largest = errors.iter().fold(0.0, |m: f64, e| m.max(e.abs()));
    assert!(
        (0.6..1.4).contains(&rms) && largest < 4.5,
        "{rms} {largest}"
    );
}

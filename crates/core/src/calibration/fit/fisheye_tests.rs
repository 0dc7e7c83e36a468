//! Tests from which strength on a fisheye lens is named as beyond the lens models.

use super::reason::ReasonKind;
use super::session::{Corner, Session, SessionCamera, View};
use super::synthetic::Random;
use super::{Limits, Parameters, fit, judge};
use crate::calibration::{Board, CalibrationLevel, Face};
use crate::frame::CameraId;
use nalgebra::{Isometry3, Point2, Translation3, UnitQuaternion, Vector3};
use std::collections::BTreeMap;

const SIZE: [usize; 2] = [640, 480];

/// Where an equidistant fisheye lens sees a direction: pixels go with the angle from its axis.
fn seen(focal_px: f64, p: &Vector3<f64>) -> Point2<f64> {
    let across = p.x.hypot(p.y).max(1e-12);
    let radius = focal_px * across.atan2(p.z);
    Point2::new(319.5 + radius * p.x / across, 239.5 + radius * p.y / across)
}

/// What a camera by itself sees of a board that is shown in all parts of its picture, which is as wide as these
/// degrees.
fn session(wide_degrees: f64, noise_px: f64, seed: u64) -> Session {
    let mut random = Random(seed);
    let board = Board::checkerboard(9, 6, 0.025).unwrap();
    let focal_px = SIZE[0] as f64 / wide_degrees.to_radians();
    let mut views = Vec::new();
    while views.len() < 16 {
        let angle = |side: usize| 0.42 * SIZE[side] as f64 / focal_px;
        let at = [0, 1].map(|k| random.between(-angle(k), angle(k)));
        let away = random.between(1.2, 2.2) * 0.2 / (0.5 * wide_degrees.to_radians());
        let sight = UnitQuaternion::from_scaled_axis(Vector3::new(-at[1], at[0], 0.0));
        let to = random.between(0.0, std::f64::consts::TAU);
        let tilt = Vector3::new(to.cos(), to.sin(), 0.0) * random.between(0.2, 0.6);
        let turn = Vector3::z() * random.between(-3.0, 3.0);
        let rotation =
            sight * UnitQuaternion::from_scaled_axis(tilt) * UnitQuaternion::from_scaled_axis(turn);
        let middle = rotation * Vector3::new(0.1, 0.0625, 0.0);
        let shift = sight * Vector3::z() * away - middle;
        let pose = Isometry3::from_parts(Translation3::from(shift), rotation);
        let corner = |(column, row): (usize, usize)| {
            let p = pose * board.corner_position(column, row);
            let mut pixel = seen(focal_px, &p.coords);
            pixel += nalgebra::Vector2::new(random.normal(), random.normal()) * noise_px;
            let is_inside = (2.0..638.0).contains(&pixel.x) && (2.0..478.0).contains(&pixel.y);
            is_inside.then_some(Corner { column, row, pixel })
        };
        let all = (0..6).flat_map(|row| (0..9).map(move |column| (column, row)));
        if let Some(corners) = all.map(corner).collect() {
            views.push(View {
                camera: 0,
                placement: views.len(),
                face: Face::Front,
                corners,
            });
        }
    }
    Session {
        board,
        cameras: vec![SessionCamera {
            id: CameraId::new("wide").unwrap(),
            size: SIZE,
            known: None,
            start: None,
        }],
        placements: (0..views.len()).map(|i| format!("p{i:02}")).collect(),
        views,
    }
}

/// What the fit says about lenses of these degrees, for each noise and seed.
fn told(wide_degrees: f64, noises_px: &[f64], seeds: u64) -> Vec<Told> {
    let of = |noise_px: f64, seed: u64| {
        let fit = fit(
            &session(wide_degrees, noise_px, seed),
            &Parameters::default(),
        )
        .unwrap();
        let judged = judge(&fit, &[], &BTreeMap::new(), &Limits::default());
        let mut reasons = judged.reasons.iter();
        let focal_px = fit.cameras[0].camera.intrinsics.focal_px.x;
        Told {
            is_named: reasons.any(|r| r.kind == ReasonKind::BeyondLensModel),
            is_doubted: judged.level >= CalibrationLevel::Doubtful,
            focal_off: focal_px * wide_degrees.to_radians() / SIZE[0] as f64 - 1.0,
        }
    };
    let all = noises_px
        .iter()
        .flat_map(|&noise| (0..seeds).map(move |seed| (noise, seed)));
    let told: Vec<Told> = all.map(|(noise, seed)| of(noise, seed)).collect();
    let count = |is: fn(&Told) -> bool| told.iter().filter(|t| is(t)).count();
    let off = |told: &[&Told]| told.iter().map(|t| t.focal_off.abs()).fold(0.0, f64::max);
    let trusted: Vec<&Told> = told.iter().filter(|t| !t.is_doubted).collect();
    println!(
        "{wide_degrees}°: {} sessions, {} named, {} doubted, focal lengths up to {:.2} % off; of those that are not \
         doubted, {:.2} %",
        told.len(),
        count(|t| t.is_named),
        count(|t| t.is_doubted),
        100.0 * off(&told.iter().collect::<Vec<_>>()),
        100.0 * off(&trusted)
    );
    told
}

/// What the fit says about a lens.
struct Told {
    is_named: bool,
    is_doubted: bool,
    /// By what part its focal length is wrong.
    focal_off: f64,
}

#[test]
fn a_fisheye_lens_is_named_and_a_lens_that_its_model_fits_is_not() {
    assert!(told(70.0, &[0.03, 0.2], 4).iter().all(|t| !t.is_named));
    assert!(told(120.0, &[0.1], 4).iter().all(|t| t.is_named));
    assert!(told(140.0, &[0.1], 4).iter().all(|t| t.is_named));
}

/// Checks what is said of lenses of these degrees: those that the model fits are not named, and those beyond it are not
/// trusted.
fn check(fitted: &[f64], beyond: &[f64]) {
    for &wide in fitted {
        let sound = told(wide, &[0.03, 0.1, 0.2], 6);
        assert!(sound.iter().all(|t| !t.is_named));
    }
    for &wide in beyond {
        let beyond = told(wide, &[0.03, 0.1, 0.2], 6);
        // Where only the middle of the picture was used, the lens model fits it.
        let is_right = |t: &Told| t.focal_off.abs() < 0.005;
        assert!(beyond.iter().all(|t| t.is_doubted || is_right(t)));
    }
}

#[test]
#[ignore = "fourteen lenses take two minutes: make calibration-trial"]
fn the_wider_a_fisheye_lens_the_less_it_is_trusted() {
    check(&[50.0, 60.0, 70.0, 80.0], &[]);
    // Between the two, what is said may be either.
    for wide in [90.0, 100.0, 110.0] {
        told(wide, &[0.03, 0.1, 0.2], 6);
    }
    check(&[], &[120.0, 130.0, 140.0, 150.0, 160.0, 170.0, 180.0]);
}

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;

    #[test]
    fn a_moderate_lens_is_not_named_and_a_fisheye_lens_is_not_trusted() {
        check(&[80.0], &[120.0, 150.0, 180.0]);
    }
}

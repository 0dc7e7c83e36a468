//! The rules of depth enhancement as a whole, on bursts built in memory.

use super::*;
use crate::calibration::{Camera, DepthCamera, DepthResponse, Distortion, Intrinsics};
use crate::image::RgbImage;
use crate::reconstruct::DepthFrame;
use nalgebra::{Isometry3, Vector2};
use std::sync::Arc;

/// A burst of `frames` frames of `width` x `height` pixels; `reading` gives millimetres.
fn view(
    (width, height): (usize, usize),
    frames: usize,
    color: &Arc<RgbImage>,
    reading: impl Fn(usize, usize, usize) -> u16,
) -> DepthView {
    let lens = Intrinsics::new(
        width,
        height,
        Vector2::new(575.8, 575.8),
        Vector2::new(width as f64 / 2.0, height as f64 / 2.0),
        Distortion::default(),
    );
    let id = CameraId::new("kinect").unwrap();
    let camera = Camera::new(id, lens.unwrap(), Isometry3::identity());
    let frame = |k| DepthFrame {
        readings: Grid::from_fn(width, height, |x, y| reading(k, x, y)),
        color: Some(color.clone()),
    };
    DepthView {
        camera: DepthCamera {
            camera,
            response: DepthResponse::default(),
        },
        frames: (0..frames).map(frame).collect(),
    }
}

fn grey(width: usize, height: usize) -> Arc<RgbImage> {
    Arc::new(Grid::filled(width, height, [128; 3]))
}

fn everywhere(width: usize, height: usize) -> Mask {
    Grid::filled(width, height, 255)
}

#[test]
fn no_frames_and_no_readings_are_no_error() {
    for frames in [0, 1, 3] {
        let view = view((20, 10), frames, &grey(20, 10), |_, _, _| 0);
        let out = enhance(&view, &everywhere(20, 10), &Parameters::default()).unwrap();
        assert!(out.kind.pixels().iter().all(|&k| k == DepthKind::None));
        assert!(out.depth.pixels().iter().all(|&z| z == 0.0));
        assert_eq!(out.facts.empty, 200);
    }
}

#[test]
fn an_empty_region_has_no_depth() {
    let view = view((20, 10), 3, &grey(20, 10), |_, _, _| 800);
    let out = enhance(&view, &Grid::filled(20, 10, 0), &Parameters::default()).unwrap();
    assert!(out.depth.pixels().iter().all(|&z| z == 0.0));
    assert_eq!(out.facts.region, 0);
}

#[test]
fn wrong_sizes_name_camera_found_and_expected() {
    let mut view = view((20, 10), 3, &grey(20, 10), |_, _, _| 800);
    let parameters = Parameters::default();
    let error = enhance(&view, &everywhere(10, 20), &parameters).unwrap_err();
    let text = error.to_string();
    assert!(text.contains("kinect") && text.contains("10x20") && text.contains("20x10"));
    view.frames[1].readings = Grid::filled(7, 8, 0);
    let error = enhance(&view, &everywhere(20, 10), &parameters).unwrap_err();
    assert!(
        error.to_string().contains("depth frame 1 is 7x8"),
        "{error}"
    );
}

/// Noise that is new in every frame, in whole readings of a sensor with fine steps.
fn noise(k: usize, x: usize, y: usize) -> f32 {
    let mut h = (k as u64) << 40 | (x as u64) << 20 | y as u64;
    let mut sum = 0.0;
    for _ in 0..4 {
        h = (h ^ (h >> 31)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        sum += (h >> 40) as f32 / (1u64 << 24) as f32 - 0.5;
    }
    sum * 1.73
}

/// Root mean square distance from 0.8 m of what a burst of `frames` gives.
fn error_of(frames: usize, parameters: &Parameters) -> f32 {
    let mut view = view((64, 48), frames, &grey(64, 48), |k, x, y| {
        (8000.0 + 20.0 * noise(k, x, y)).round() as u16
    });
    view.camera.response.slope = 1e-4;
    let out = enhance(&view, &everywhere(64, 48), parameters).unwrap();
    let squares = out.depth.pixels().iter().map(|z| (z - 0.8).powi(2));
    (squares.sum::<f32>() / (64.0 * 48.0)).sqrt()
}

#[test]
fn noise_new_in_each_frame_falls_as_the_root_of_their_number() {
    let methods = [
        Method::Plate,
        Method::MeanThenBilateral,
        Method::BilateralThenMean,
    ];
    for method in methods {
        let parameters = Parameters {
            method,
            ..Parameters::default()
        };
        let ratio = error_of(2, &parameters) / error_of(18, &parameters);
        assert!(
            (2.4..3.6).contains(&ratio),
            "{method:?}: {ratio} instead of 3"
        );
    }
}

#[test]
fn every_method_fills_what_has_surroundings_and_keeps_planes() {
    let tilted = |x: usize| 1.0 / (1.2e-3 - 2e-6 * x as f32);
    let view = view((64, 48), 3, &grey(64, 48), |_, x, y| {
        let hole = (30..36).contains(&x) && (20..25).contains(&y);
        if hole { 0 } else { tilted(x).round() as u16 }
    });
    for (method, limit) in [(Method::Plate, 5e-4), (Method::BilateralThenMean, 2e-3)] {
        let parameters = Parameters {
            method,
            ..Parameters::default()
        };
        let out = enhance(&view, &everywhere(64, 48), &parameters).unwrap();
        assert_eq!((out.facts.filled, out.facts.empty), (30, 0));
        for y in 20..25 {
            for x in 30..36 {
                assert_eq!(out.kind[(x, y)], DepthKind::Filled);
                let error = out.depth[(x, y)] - tilted(x) * 1e-3;
                assert!(error.abs() < limit, "{method:?} {x} {y}: {error}");
                assert!(out.sigma[(x, y)] > out.sigma[(5, 5)]);
            }
        }
    }
}

#[test]
fn readings_outside_the_region_do_not_count() {
    let view = view(
        (40, 30),
        3,
        &grey(40, 30),
        |_, x, _| if x < 20 { 800 } else { 1200 },
    );
    let region = Grid::from_fn(40, 30, |x, _| if x < 20 { 255 } else { 0 });
    for method in [
        Method::Plate,
        Method::MeanThenBilateral,
        Method::BilateralThenMean,
    ] {
        let parameters = Parameters {
            method,
            ..Parameters::default()
        };
        let out = enhance(&view, &region, &parameters).unwrap();
        for y in 0..30 {
            for x in 0..40 {
                let expected = if x < 20 { 0.8 } else { 0.0 };
                assert!(
                    (out.depth[(x, y)] - expected).abs() < 1e-5,
                    "{method:?} {x} {y}"
                );
            }
        }
    }
}

#[test]
fn without_a_picture_depth_is_what_a_flat_one_makes_of_it() {
    let flat = view((50, 40), 4, &grey(50, 40), |k, x, y| {
        let lost = (x * 31 + y * 17 + k * 7) % 11 == 0;
        let near = if x > 30 { 780.0 } else { 820.0 };
        if lost {
            0
        } else {
            (near + 2.0 * noise(k, x, y)) as u16
        }
    });
    let mut without = flat.clone();
    for frame in &mut without.frames {
        frame.color = None;
    }
    for method in [
        Method::Plate,
        Method::MeanThenBilateral,
        Method::BilateralThenMean,
    ] {
        let parameters = Parameters {
            method,
            ..Parameters::default()
        };
        let depth = |view: &DepthView| {
            let enhanced = enhance(view, &everywhere(50, 40), &parameters).unwrap();
            enhanced.depth
        };
        assert!(depth(&without) == depth(&flat), "{method:?}");
    }
}

#[test]
fn the_same_bytes_for_any_number_of_threads() {
    let view = view((50, 40), 8, &grey(50, 40), |k, x, y| {
        let floor = if (x / 9 + y / 7) % 3 == 0 { 0.0 } else { 820.0 };
        let near = if x > 30 { -40.0 } else { 0.0 };
        let lost = (x * 31 + y * 17 + k * 7) % 11 == 0 || floor == 0.0;
        if lost {
            0
        } else {
            (floor + near + 2.0 * noise(k, x, y)) as u16
        }
    });
    for method in [
        Method::Plate,
        Method::MeanThenBilateral,
        Method::BilateralThenMean,
    ] {
        let parameters = Parameters {
            method,
            ..Parameters::default()
        };
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            pool.unwrap()
                .install(|| enhance(&view, &everywhere(50, 40), &parameters).unwrap())
        };
        let (one, four) = (run(1), run(4));
        let bits = |out: &EnhancedDepth| -> Vec<(u32, u32)> {
            let pairs = out.depth.pixels().iter().zip(out.sigma.pixels());
            pairs.map(|(z, s)| (z.to_bits(), s.to_bits())).collect()
        };
        assert_eq!(bits(&one), bits(&four));
        assert_eq!(one.facts, four.facts);
    }
}

#[test]
fn the_defaults_are_the_papers_where_it_gives_numbers() {
    let p = Parameters::default();
    assert_eq!(
        (p.levels, p.half_width_px, p.spread_limit_mm),
        (4, 10, 30.0)
    );
    assert_eq!((p.spatial_sigma_px, p.range_sigma), (3.0, 0.1));
}

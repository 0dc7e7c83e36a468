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
        color: color.clone(),
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

#[test]
fn parameters_out_of_range_are_refused_by_name() {
    let view = view((20, 10), 1, &grey(20, 10), |_, _, _| 800);
    let parameters = Parameters {
        spread_limit_mm: f32::NAN,
        ..Parameters::default()
    };
    let error = enhance(&view, &everywhere(20, 10), &parameters).unwrap_err();
    assert!(error.to_string().contains("depth.spread_limit_mm is NaN"));
}

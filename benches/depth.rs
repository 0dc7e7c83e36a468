//! Times depth enhancement on a synthetic burst: 30 frames of 640x480 with a bowl of 150x150 pixels in it.

use divan::Bencher;
use nalgebra::{Isometry3, Vector2};
use scand::calibration::{Camera, DepthCamera, DepthResponse, Distortion, Intrinsics};
use scand::frame::CameraId;
use scand::image::{Grid, Mask};
use scand::reconstruct::depth::{Method, Parameters, enhance};
use scand::reconstruct::{DepthFrame, DepthView};
use std::sync::Arc;

const WIDTH: usize = 640;
const HEIGHT: usize = 480;

fn main() {
    divan::main();
}

/// A bowl on a table: a rim of 75 px radius, holes on its steep left side, noise of 1 mm.
fn reading(k: usize, x: usize, y: usize) -> u16 {
    let (dx, dy) = (x as f32 - 320.0, y as f32 - 240.0);
    let r = dx.hypot(dy);
    let hash = (k * 7919 + x * 104_729 + y * 1_299_709) % 1009;
    let noise = (hash as f32 / 1009.0 - 0.5) * 3.5;
    if (60.0..70.0).contains(&r) && dx < -20.0 {
        return 0;
    }
    let depth = if r < 75.0 {
        880.0 - r * r / 70.0
    } else {
        900.0
    };
    (depth + noise).round() as u16
}

fn burst() -> (DepthView, Mask) {
    let center = Vector2::new(319.5, 239.5);
    let focal = Vector2::new(575.8, 575.8);
    let lens = Intrinsics::new(WIDTH, HEIGHT, focal, center, Distortion::default());
    let camera = Camera::new(
        CameraId::new("depth").expect("a good name"),
        lens.expect("a good lens"),
        Isometry3::identity(),
    );
    let color = Arc::new(Grid::from_fn(WIDTH, HEIGHT, |x, y| {
        [(x / 9 * 40 % 256) as u8, (y / 7 * 50 % 256) as u8, 128]
    }));
    let frame = |k| DepthFrame {
        readings: Grid::from_fn(WIDTH, HEIGHT, |x, y| reading(k, x, y)),
        color: Some(Arc::clone(&color)),
    };
    let view = DepthView {
        camera: DepthCamera {
            camera,
            response: DepthResponse::default(),
        },
        frames: (0..30).map(frame).collect(),
    };
    let region = Grid::from_fn(WIDTH, HEIGHT, |x, y| {
        let inside = (x as f32 - 320.0).hypot(y as f32 - 240.0) < 78.0;
        if inside { 255 } else { 0 }
    });
    (view, region)
}

fn run(bencher: Bencher, method: Method) {
    let (view, region) = burst();
    let parameters = Parameters {
        method,
        ..Parameters::default()
    };
    bencher.bench_local(|| enhance(&view, &region, &parameters));
}

/// The default: the mean of the frames, filled, and a weak plate.
#[divan::bench]
fn plate(bencher: Bencher) {
    run(bencher, Method::Plate);
}

/// The mean of the frames through the pyramid once.
#[divan::bench]
fn mean_then_bilateral(bencher: Bencher) {
    run(bencher, Method::MeanThenBilateral);
}

/// The paper's: every frame through the pyramid.
#[divan::bench]
fn bilateral_then_mean(bencher: Bencher) {
    run(bencher, Method::BilateralThenMean);
}

//! Compares the simulated depth sensor with figures of real ones.

use super::*;
use scand_core::image::Grid;

/// Readings in millimetres of an empty table from `distance` metres, a little at a slant, so that its
/// disparity falls on all parts of a step.
fn empty_table(distance: f64, frames: usize) -> Vec<Grid<u16>> {
    let mut options = Options::small(Shape::Ball);
    options.cameras = 2;
    options.faults.empty_table = true;
    // The camera aims at half the ball's height.
    options.depth_distance = distance - 0.03;
    options.depth_slant_deg = 8.0;
    options.depth.frames = frames;
    let scene = Simulation::new(options).unwrap().scene(0);
    let frames = scene.depths.into_iter().flat_map(|view| view.frames);
    frames.map(|frame| frame.readings).collect()
}

/// For each pixel that has at least half of its readings: all of them.
fn bursts(frames: &[Grid<u16>]) -> Vec<Vec<f64>> {
    let count = frames[0].pixels().len();
    let burst = |k: usize| {
        let readings = frames.iter().map(|f| f64::from(f.pixels()[k]));
        readings.filter(|r| *r > 0.0).collect::<Vec<f64>>()
    };
    (0..count)
        .map(burst)
        .filter(|b| b.len() * 2 >= frames.len())
        .collect()
}

fn variance(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)
}

/// Noise over frames and steps as measured on real table tops (standard deviation at 0.6 to 0.8, 0.9, 1.1
/// and 1.3 m; steps at 0.7, 1 and 1.4 m), in millimetres.
#[test]
fn noise_and_steps_are_those_of_a_real_sensor() {
    for (distance, low, high) in [
        (0.6, 0.4, 0.7),
        (0.7, 0.4, 0.7),
        (0.8, 0.4, 0.7),
        (0.9, 0.8, 1.0),
        (1.1, 1.2, 1.8),
        (1.3, 1.7, 2.2),
    ] {
        let bursts = bursts(&empty_table(distance, 30));
        assert!(bursts.len() > 2000, "{} pixels", bursts.len());
        let mean = bursts.iter().map(|b| variance(b)).sum::<f64>() / bursts.len() as f64;
        let deviation = mean.sqrt();
        println!("{distance} m: {deviation:.2} mm over frames");
        assert!(
            (low - 0.03..=high + 0.03).contains(&deviation),
            "{distance} m: {deviation} mm"
        );
        let spread = |b: &&Vec<f64>| {
            b.iter().fold(0.0, |m: f64, &v| m.max(v)) - b.iter().fold(1e9, |m: f64, &v| m.min(v))
                > 30.0
        };
        assert!(bursts.iter().filter(spread).count() * 1000 <= bursts.len());
    }
    for (distance, low, high) in [(0.7, 1.0, 2.0), (1.0, 2.0, 3.0), (1.4, 5.0, 6.0)] {
        let mut levels: Vec<u16> = empty_table(distance, 4)
            .iter()
            .flat_map(|f| f.pixels().to_vec())
            .filter(|r| *r > 0)
            .collect();
        levels.sort_unstable();
        levels.dedup();
        let steps = (levels.len() - 1) as f64;
        let step = f64::from(levels[levels.len() - 1] - levels[0]) / steps;
        assert!(
            (low..=high).contains(&step),
            "{distance} m: a step of {step} mm"
        );
    }
}

#[test]
fn noise_grows_with_the_square_of_the_distance_and_a_pattern_stays() {
    let spread = |distance: f64| {
        let bursts = bursts(&empty_table(distance, 30));
        let within = bursts.iter().map(|b| variance(b)).sum::<f64>() / bursts.len() as f64;
        let means: Vec<f64> = bursts
            .iter()
            .map(|b| b.iter().sum::<f64>() / b.len() as f64)
            .collect();
        (within.sqrt(), variance(&means).sqrt())
    };
    let (near, far) = (spread(0.7), spread(1.4));
    assert!(
        (far.0 / near.0 / 4.0 - 1.0).abs() < 0.15,
        "{near:?} {far:?}"
    );
    // Thirty frames leave 0.18 of their noise in a mean; the fixed pattern is more.
    assert!(near.1 > 0.3 * near.0, "{near:?}");
}

#[test]
fn a_perfect_sensor_reads_the_exact_depth_to_a_millimetre() {
    let mut options = Options::small(Shape::Bowl);
    options.depth = DepthSensor::perfect();
    for response in [Response::Ideal, Response::Written] {
        options.depth.response = response;
        let simulation = Simulation::new(options.clone()).unwrap();
        let exact = simulation.exact_depth(0);
        let view = simulation.scene(0).depths.remove(0);
        let (mut compared, mut wrong) = (0, 0);
        for (reading, z) in view.frames[0].readings.pixels().iter().zip(exact.pixels()) {
            if z.is_finite() {
                let read = view.camera.response.depth(*reading).unwrap();
                compared += 1;
                wrong += usize::from((read - f64::from(*z)).abs() > 0.6e-3);
            }
        }
        assert!(compared > 2000, "{compared}");
        assert!(
            wrong * 500 < compared,
            "{response:?}: {wrong} of {compared}"
        );
    }
}

#[test]
fn bias_and_displacement_are_there_and_the_calibration_does_not_know() {
    let mut options = Options::small(Shape::Box);
    options.depth = DepthSensor::perfect();
    options.depth.bias_mm = 5.0;
    options.depth.misregistration_px = 2.0;
    let simulation = Simulation::new(options).unwrap();
    let exact = simulation.exact_depth(0);
    let view = simulation.scene(0).depths.remove(0);
    assert_eq!(
        view.camera.response,
        scand_core::calibration::DepthResponse::default()
    );
    let readings = &view.frames[0].readings;
    let mut biases = Vec::new();
    let (mut sums, mut seen) = ([0.0; 4], [0.0; 2]);
    for y in 0..480 {
        for x in 0..640 {
            let (z, read) = (f64::from(exact[(x, y)]), f64::from(readings[(x, y)]) * 1e-3);
            let is_top = |z: f64| (0.70..0.80).contains(&z);
            if is_top(z) && is_top(read) {
                biases.push(read - z);
            }
            for (k, is_seen) in [is_top(z), is_top(read)].into_iter().enumerate() {
                if is_seen {
                    sums[2 * k] += x as f64;
                    sums[2 * k + 1] += y as f64;
                    seen[k] += 1.0;
                }
            }
        }
    }
    biases.sort_by(f64::total_cmp);
    let bias = biases[biases.len() / 2];
    assert!((bias - 0.005).abs() < 4e-4, "{bias}");
    let moved = [
        sums[2] / seen[1] - sums[0] / seen[0],
        sums[3] / seen[1] - sums[1] / seen[0],
    ];
    assert!(
        (moved[0] - 1.6).abs() < 0.3 && (moved[1] - 1.2).abs() < 0.3,
        "{moved:?}"
    );
}

#[test]
fn a_material_that_is_read_too_near_moves_the_object_and_not_the_table() {
    let read = |object_bias_mm: f64| {
        let mut options = Options::small(Shape::Box);
        options.depth = DepthSensor::perfect();
        options.depth.object_bias_mm = object_bias_mm;
        let simulation = Simulation::new(options).unwrap();
        let exact = simulation.exact_depth(0);
        let mut view = simulation.scene(0).depths.remove(0);
        (view.frames.remove(0).readings, exact)
    };
    let ((right, exact), (near, _)) = (read(0.0), read(-6.0));
    let (mut object, mut table) = ([0; 2], [0; 2]);
    let pixels = right.pixels().iter().zip(near.pixels()).zip(exact.pixels());
    for ((&right, &near), z) in pixels.filter(|((right, near), _)| **right > 0 && **near > 0) {
        let (counts, expected) = match z.is_finite() {
            true => (&mut object, 6),
            false => (&mut table, 0),
        };
        counts[0] += 1;
        // A reading is a whole number of millimetres.
        counts[1] += usize::from((i32::from(right) - i32::from(near) - expected).abs() > 1);
    }
    for [all, wrong] in [object, table] {
        assert!(all > 1000 && 50 * wrong < all, "{wrong} of {all}");
    }
}

#[test]
fn steep_walls_and_the_projectors_shadow_have_no_readings() {
    let options = Options::small(Shape::Cup);
    let simulation = Simulation::new(options).unwrap();
    let camera = simulation.rig().depths[0].actual.camera.clone();
    let bvh = scand_core::mesh::Bvh::new(simulation.truth());
    let view = simulation.scene(0).depths.remove(0);
    let read = |x: usize, y: usize| {
        view.frames
            .iter()
            .filter(|f| f.readings[(x, y)] > 0)
            .count()
    };
    let (mut steep, mut flat) = ([0, 0], [0, 0]);
    for y in (140..340).step_by(2) {
        for x in (220..420).step_by(2) {
            let pixel = nalgebra::Point2::new(x as f64, y as f64);
            let ray = camera.ray(pixel).unwrap();
            let Some(hit) = bvh.raycast(camera.center(), ray, 2.0) else {
                continue;
            };
            let [a, b, c] = simulation
                .truth()
                .corners(hit.triangle)
                .map(|c| c.cast::<f64>());
            let cosine = (b - a).cross(&(c - a)).normalize().dot(&ray).abs();
            let p = camera.center() + ray * hit.t;
            let inner = p.x.hypot(p.y) < 0.022;
            if cosine < 0.2 {
                steep = [steep[0] + read(x, y), steep[1] + view.frames.len()];
            } else if inner && cosine > 0.9 {
                flat = [flat[0] + read(x, y), flat[1] + view.frames.len()];
            }
        }
    }
    assert!(steep[1] > 1000 && steep[0] * 50 < steep[1], "{steep:?}");
    assert!(flat[1] > 1000 && flat[0] * 10 > flat[1] * 4, "{flat:?}");
    // The table beside the cup, on the side away from the projector.
    let axis = camera.rig_from_camera.rotation * nalgebra::Vector3::x();
    let behind = nalgebra::Point3::origin() - axis * 0.045;
    let (pixel, _) = camera.project(behind).unwrap();
    assert_eq!(read(pixel.x.round() as usize, pixel.y.round() as usize), 0);
    let before = nalgebra::Point3::origin() + axis * 0.060;
    let (pixel, _) = camera.project(before).unwrap();
    assert!(read(pixel.x.round() as usize, pixel.y.round() as usize) > 5);
}

//! Compares the simulated rig with closed forms.

use super::*;
use nalgebra::{Point2, Vector2};
use scand_core::calibration::Camera;
use scand_core::image::Mask;

/// The simulation of a shape with pictures of `width` pixels and nothing else out of the ordinary.
fn simulation(shape: Shape, width: usize) -> Simulation {
    Simulation::new(Options {
        shape,
        width,
        height: width * 3 / 4,
        cameras: 4,
        spacing_mm: 1.0,
        ..Options::default()
    })
    .unwrap()
}

/// Where the mask is half covered between the centre and `direction`, in pixels from `center`.
fn contour_at(mask: &Mask, center: Point2<f64>, direction: Vector2<f64>) -> f64 {
    let at = |p: Point2<f64>| {
        let (x, y) = (p.x.floor(), p.y.floor());
        let (u, v) = (p.x - x, p.y - y);
        let value = |dx: usize, dy: usize| f64::from(mask[(x as usize + dx, y as usize + dy)]);
        (value(0, 0) * (1.0 - u) + value(1, 0) * u) * (1.0 - v)
            + (value(0, 1) * (1.0 - u) + value(1, 1) * u) * v
    };
    // The area of the profile is steadier than one crossing of it.
    let (step, start, end) = (0.01, 0.0, 0.45 * mask.height() as f64);
    let samples = ((end - start) / step) as usize;
    let sum: f64 = (0..samples)
        .map(|k| at(center + direction * (start + (k as f64 + 0.5) * step)))
        .sum();
    start + sum / 255.0 * step
}

/// Distance along `direction` from the projected centre to the outline of a sphere, found by the tangent
/// condition on the camera's rays.
fn outline_at(camera: &Camera, center: Point2<f64>, direction: Vector2<f64>) -> f64 {
    let middle = nalgebra::Point3::new(0.0, 0.0, 0.03);
    let misses = |t: f64| {
        let ray = camera.ray(center + direction * t).unwrap();
        (middle - camera.center()).cross(&ray).norm() > 0.03
    };
    let (mut low, mut high) = (0.0, 400.0);
    for _ in 0..60 {
        let t = 0.5 * (low + high);
        if misses(t) { high = t } else { low = t }
    }
    low
}

#[test]
fn the_silhouette_of_a_ball_is_its_outline_to_hundredths_of_a_pixel() {
    let simulation = simulation(Shape::Ball, 960);
    let masks = simulation.masks();
    let mut worst = 0.0_f64;
    let mut squares = (0.0, 0.0);
    for (station, mask) in simulation.rig().colors.iter().zip(&masks) {
        let middle = nalgebra::Point3::new(0.0, 0.0, 0.03);
        let (center, _) = station.actual.project(middle).unwrap();
        for k in 0..90 {
            let angle = f64::from(k) * 0.0698;
            let direction = Vector2::new(angle.cos(), angle.sin());
            let measured = contour_at(mask, center, direction);
            let error = measured - outline_at(&station.actual, center, direction);
            worst = worst.max(error.abs());
            squares = (squares.0 + error * error, squares.1 + 1.0);
        }
    }
    let rms = f64::sqrt(squares.0 / squares.1);
    println!("outline of a ball: rms {rms:.4} px, worst {worst:.4} px");
    assert!(rms < 0.03, "rms {rms} px");
    assert!(worst < 0.1, "worst {worst} px");
}

#[test]
fn the_handle_of_a_mug_leaves_a_hole_in_a_mask() {
    let simulation = simulation(Shape::Mug, 640);
    let holes = simulation
        .masks()
        .iter()
        .filter(|mask| has_hole(mask))
        .count();
    assert!(holes > 0);
}

/// Whether background is enclosed: not all of it is reached from the corner.
fn has_hole(mask: &Mask) -> bool {
    let mut reached = mask.map(|&m| m >= 128);
    let mut stack = vec![(0_isize, 0_isize)];
    while let Some((x, y)) = stack.pop() {
        if reached.get(x, y) == Some(&false) {
            reached[(x as usize, y as usize)] = true;
            stack.extend([(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)]);
        }
    }
    reached.pixels().iter().any(|r| !r)
}

#[test]
fn a_camera_that_cuts_the_object_off_shows_it_at_its_edge() {
    let mut options = simulation(Shape::Bowl, 320).options().clone();
    options.faults.cut_off = vec![CameraFault {
        camera: "c01".into(),
        amount: 0.3,
    }];
    let masks = Simulation::new(options).unwrap().masks();
    let touches = |mask: &Mask| (0..mask.height()).any(|y| mask[(0, y)] >= 128);
    let touching: Vec<bool> = masks.iter().map(touches).collect();
    assert_eq!(touching, [false, true, false, false]);
}

#[test]
fn exact_depth_is_that_of_a_ray_to_the_surface() {
    let simulation = simulation(Shape::Bowl, 320);
    let depth = simulation.exact_depth(0);
    let bvh = scand_core::mesh::Bvh::new(simulation.truth());
    let camera = &simulation.rig().depths[0].actual.camera;
    let (mut compared, mut different) = (0, 0);
    for y in (0..480).step_by(7) {
        for x in (0..640).step_by(7) {
            let ray = camera.ray(Point2::new(x as f64, y as f64)).unwrap();
            let hit = bvh.raycast(camera.center(), ray, 10.0);
            let cosine = ray.dot(&(camera.rig_from_camera * nalgebra::Vector3::z()));
            match hit {
                Some(hit) => {
                    compared += 1;
                    let error = hit.t * cosine - f64::from(depth[(x, y)]);
                    different += usize::from(error.abs() > 1e-5);
                }
                None => different += usize::from(depth[(x, y)].is_finite()),
            }
        }
    }
    assert!(compared > 200, "{compared}");
    assert!(different <= 1, "{different} of {compared}");
}

/// A small session of a shape, with a burst of `frames`.
fn small(shape: Shape, frames: usize) -> Options {
    let mut options = Options::small(shape);
    options.cameras = 4;
    options.depth.frames = frames;
    options
}

#[test]
fn a_session_is_the_same_whatever_the_number_of_threads() {
    let frames = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let simulation = Simulation::new(small(Shape::Mug, 3)).unwrap();
            (simulation.backgrounds(), simulation.capture(0).unwrap())
        })
    };
    let (one, many) = (frames(1), frames(5));
    assert!(one == many);
    let mut other = small(Shape::Mug, 3);
    other.seed = 2;
    let other = Simulation::new(other).unwrap();
    assert!(other.backgrounds() != one.0);
}

#[test]
fn a_scene_holds_what_the_frames_hold() {
    let mut options = small(Shape::Bowl, 4);
    options.color.encoding = Encoding::Rgb;
    options.depth.color_every = 2;
    let simulation = Simulation::new(options).unwrap();
    let (scene, capture) = (simulation.scene(0), simulation.capture(0).unwrap());
    assert_eq!(scene.colors.len(), 4);
    assert_eq!(scene.depths[0].frames.len(), 4);
    let colors = capture
        .frames
        .iter()
        .filter(|f| f.stream == scand_core::frame::Stream::DepthColor);
    assert_eq!(colors.count(), 2);
    let c02 = &scene.colors[2];
    let frame = capture
        .frames
        .iter()
        .find(|f| f.camera == c02.camera.id)
        .unwrap();
    let scand_core::frame::Picture::Raw { data, .. } = &frame.picture else {
        panic!("not raw");
    };
    assert_eq!(data, c02.image.pixels().as_flattened());
}

#[test]
fn the_object_stands_out_of_its_background_and_its_shadow_does_less() {
    let simulation = Simulation::new(small(Shape::Cup, 1)).unwrap();
    let masks = simulation.masks();
    for (view, mask) in simulation.scene(0).colors.iter().zip(&masks) {
        let scand_core::reconstruct::SilhouetteSource::Background(plate) = &view.silhouette else {
            panic!("no background");
        };
        let difference = |at: (usize, usize)| {
            let (a, b) = (view.image[at], plate[at]);
            (0..3)
                .map(|c| (f64::from(a[c]) - f64::from(b[c])).abs())
                .sum::<f64>()
        };
        let all = (0..320 * 240).map(|k| (k % 320, k / 320));
        let (inside, outside): (Vec<_>, Vec<_>) = all.partition(|&at| mask[at] == 255);
        let mean = |of: &[(usize, usize)]| {
            of.iter().map(|&at| difference(at)).sum::<f64>() / of.len() as f64
        };
        assert!(mean(&inside) > 120.0, "{}", mean(&inside));
        assert!(mean(&outside) < 20.0, "{}", mean(&outside));
    }
}

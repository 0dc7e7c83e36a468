//! Tests finding regions on renderings whose regions are known.

use super::*;
use crate::calibration::{Camera, DepthCamera, DepthResponse, Distortion, Intrinsics};
use crate::frame::CameraId;
use crate::mesh::{Mesh, vertex_normals};
use crate::reconstruct::depth::{Facts, SensorNoise};
use crate::reconstruct::{DepthFrame, testing};
use nalgebra::{Isometry3, Point3, Vector2, Vector3};

fn overhead() -> DepthCamera {
    let lens = Intrinsics::new(
        160,
        120,
        Vector2::repeat(150.0),
        Vector2::new(79.5, 59.5),
        Distortion::default(),
    )
    .unwrap();
    let pose = Isometry3::face_towards(
        &Point3::new(0.0, 0.0, 0.8),
        &Point3::origin(),
        &Vector3::y(),
    );
    let camera = Camera::new(CameraId::new("kinect").unwrap(), lens, pose);
    DepthCamera {
        camera,
        response: DepthResponse::default(),
    }
}

/// A box of 0.2 x 0.2 x 0.1 m on the table.
fn block() -> Mesh {
    let vertices = (0..8u8)
        .map(|i| {
            let at = |bit: u8| if i >> bit & 1 == 1 { 0.1 } else { -0.1 };
            Point3::new(at(0), at(1), if i >> 2 == 1 { 0.1 } else { 0.0 })
        })
        .collect();
    let quads = [
        [0, 4, 6, 2],
        [1, 3, 7, 5],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 2, 3, 1],
        [4, 5, 7, 6],
    ];
    let triangles = quads
        .iter()
        .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]])
        .collect();
    Mesh {
        vertices,
        triangles,
    }
}

#[test]
fn the_front_is_the_top_and_the_way_out_the_bottom() {
    let (mesh, camera) = (block(), overhead());
    assert!(crate::mesh::check(&mesh).is_watertight());
    let front = HullRenderings::render(&mesh, &vertex_normals(&mesh), &camera, 0.3);
    let middle = (80, 60);
    assert!(
        (front.depth[middle] - 0.7).abs() < 1e-4,
        "{}",
        front.depth[middle]
    );
    assert!(
        (front.exit[middle] - 0.8).abs() < 1e-4,
        "{}",
        front.exit[middle]
    );
    assert!(front.is_front[middle]);
    assert!(front.depth[(0, 0)].is_infinite() && !front.is_front[(0, 0)]);
}

#[test]
fn a_camera_whose_recording_states_no_bias_may_be_off_by_ten_millimetres() {
    let mut camera = overhead();
    let stated = |camera: &DepthCamera| stated_bias(camera, &Parameters::default());
    assert!((stated(&camera) - 10e-3).abs() < 1e-9);
    camera.response.uncertainty = 2e-3;
    assert!((stated(&camera) - 2e-3).abs() < 1e-9);
}

/// What is found of the block on a table whose height is `table`, in a volume whose floor is at `floor`, if all depth
/// is off by `off_mm`.
fn found_on_table(table: f64, floor: f64, off_mm: i32) -> (Bias, Option<OutlineOffset>) {
    let (mesh, mut camera) = (block(), overhead());
    // As seen from the camera, nothing moves.
    let front = HullRenderings::render(&mesh, &vertex_normals(&mesh), &camera, 0.3);
    let pose = Isometry3::translation(0.0, 0.0, table) * camera.camera.rig_from_camera;
    camera.camera = Camera::new(camera.camera.id, camera.camera.intrinsics, pose);
    let true_mm = |depth: f32| {
        if depth.is_finite() {
            1e3 * depth
        } else {
            800.0
        }
    };
    let read = |&depth: &f32| (true_mm(depth).round() as i32 + off_mm) as u16;
    let frame = DepthFrame {
        readings: front.depth.map(read),
        color: None,
    };
    let view = DepthView {
        camera,
        frames: vec![frame],
    };
    let (low, high) = ([-0.2, -0.2, floor], [0.2, 0.2, floor + 0.2]);
    let volume = Volume::new(Point3::from(low), Point3::from(high)).unwrap();
    let object = front.object_pixels(6);
    let bias = Bias::estimate(&view, &volume, &object, &Parameters::default(), || None);
    let outline = outline_offset(&view, &front, &bias);
    (bias, outline)
}

#[test]
fn the_table_is_found_wherever_the_rigs_frame_has_it() {
    for off_mm in [0, -6] {
        let (here, outline) = found_on_table(0.0, 0.0, off_mm);
        assert_eq!(here.source, BiasSource::Table);
        assert!((here.found - 1e-3 * f64::from(off_mm)).abs() < 1e-6);
        assert!(outline.is_some());
        for height in [0.1, -0.3] {
            let (moved, of_moved) = found_on_table(height, height, off_mm);
            assert_eq!(moved.source, BiasSource::Table);
            assert!((moved.found - here.found).abs() < 1e-6, "{moved:?}");
            assert_eq!(of_moved, outline);
        }
    }
}

#[test]
fn a_floor_that_is_off_the_table_at_zero_hides_no_table_and_makes_no_bias() {
    for floor in [-0.04, -2.5e-3, 2.5e-3, 0.025, 0.04] {
        let (bias, outline) = found_on_table(0.0, floor, 0);
        assert_eq!(bias.source, BiasSource::Table, "{floor}");
        assert!(bias.found.abs() < 1e-6, "{floor}: {bias:?}");
        assert!(outline.is_some(), "{floor}");
    }
}

/// The bias that is found without a table if all is read at one depth; the block's top is at 0.7 m.
fn bias_by_hull(read: f32) -> Bias {
    let (mesh, camera) = (block(), overhead());
    let all = |value: f32| Grid::filled(160, 120, value);
    let depth = EnhancedDepth {
        depth: all(read),
        kind: Grid::filled(160, 120, DepthKind::Measured),
        sigma: all(1e-3),
        noise: SensorNoise {
            per_square_depth: 0.0,
            jitter_px: 0.0,
            fixed_per_square_depth: 0.0,
            median_deviation: 0.0,
        },
        facts: Facts::default(),
    };
    let object = Mask::filled(160, 120, 255);
    let view = DepthView {
        camera,
        frames: Vec::new(),
    };
    let (low, high) = (Point3::new(-0.2, -0.2, 0.05), Point3::new(0.2, 0.2, 0.2));
    let volume = Volume::new(low, high).unwrap();
    let render = || HullRenderings::render(&mesh, &vertex_normals(&mesh), &view.camera, 0.3);
    let parameters = Parameters::default();
    bias(render, &view, &depth, &volume, &object, &parameters)
}

#[test]
fn without_a_table_only_readings_in_front_of_what_contains_the_object_are_a_bias() {
    let ahead = bias_by_hull(0.695);
    assert_eq!(ahead.source, BiasSource::Hull);
    assert!((ahead.metres + 5e-3).abs() < 1e-5, "{ahead:?}");
    assert!(ahead.remaining < 1e-3 && !ahead.is_excess_of_hull());
    // Behind it, the hull may be too large.
    let behind = bias_by_hull(0.705);
    assert_eq!((behind.source, behind.metres), (BiasSource::Hull, 0.0));
    assert!((behind.found - 5e-3).abs() < 1e-5, "{behind:?}");
    assert!(behind.remaining >= behind.found && behind.is_excess_of_hull());
}

#[test]
fn where_the_hull_is_steep_a_region_grows_over_readings_within_the_hull_alone() {
    const SIDE: usize = 40;
    let is_hollow = |x: usize, y: usize| (10..30).contains(&x) && (10..30).contains(&y);
    // Two strips along the hollow's borders. In the right one nothing was read, and in the upper half of the left one
    // what lies behind the hull, such as the table.
    let (left, right) = (10..13, 27..30);
    let is_behind = |x: usize, y: usize| left.contains(&x) && y < 20;
    let (mut depth, seen) = testing::evidence(0.7, Grid::filled(SIDE, SIDE, 0));
    let mut front = seen.front;
    let behind = front.exit[(0, 0)] + 0.01;
    depth.depth = Grid::from_fn(SIDE, SIDE, |x, y| match is_hollow(x, y) {
        true if is_behind(x, y) => behind,
        true => 0.72,
        false => 0.7,
    });
    depth.kind = Grid::from_fn(SIDE, SIDE, |x, y| {
        match is_hollow(x, y) && right.contains(&x) {
            true => DepthKind::Filled,
            false => DepthKind::Measured,
        }
    });
    front.is_front = Grid::from_fn(SIDE, SIDE, |x, _| !left.contains(&x) && !right.contains(&x));
    let object = Mask::filled(SIDE, SIDE, 255);
    let found = find(front, &depth, seen.bias, &object, &Parameters::default());
    assert_eq!(found.count, 1);
    for (x, y) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y))) {
        let belongs = is_hollow(x, y) && !right.contains(&x) && !is_behind(x, y);
        assert_eq!(found.contains(x, y), belongs, "{x} {y}");
    }
}

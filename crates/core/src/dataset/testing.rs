//! Cameras and a model for the tests of this room.

use super::undistort::{Pinhole, View};
use crate::calibration::{Camera, Distortion, Intrinsics};
use crate::frame::CameraId;
use crate::image::{Mask, RgbImage};
use crate::mesh::{shapes, vertex_normals};
use crate::reconstruct::{Model, Provenance};
use nalgebra::{Isometry3, Point3, Vector2, Vector3};

/// A camera at `eye` that looks at (0, 0, 0.1).
pub(super) fn camera_at(name: &str, eye: [f64; 3], d: &[f64]) -> Camera {
    let eye = Point3::from(eye);
    let ahead = Point3::new(0.0, 0.0, 0.1) - eye;
    // Looks along z, with y down.
    let rig_from_camera = Isometry3::face_towards(&eye, &(eye + ahead), &-Vector3::z());
    let distortion = Distortion::from_model("plumb_bob", d).unwrap();
    let lens = Intrinsics::new(
        240,
        180,
        Vector2::new(260.0, 262.0),
        Vector2::new(121.5, 88.25),
        distortion,
    );
    Camera::new(CameraId::new(name).unwrap(), lens.unwrap(), rig_from_camera)
}

/// A camera with a strong lens, which pulls the picture's corners inwards.
pub(super) fn distorted_camera() -> Camera {
    camera_at("left", [0.5, 0.1, 0.3], &[0.12, 0.05, 1e-3, -8e-4, 0.0])
}

/// A picture whose red grows with x and green with y.
pub(super) fn picture_of_places(camera: &Camera) -> RgbImage {
    let lens = &camera.intrinsics;
    RgbImage::from_fn(lens.width, lens.height, |x, y| [x as u8, y as u8, 0])
}

/// A ball of radius 5 cm.
pub(super) fn ball() -> Model {
    let mut mesh = shapes::sphere(0.05, 3);
    for vertex in &mut mesh.vertices {
        vertex.z += 0.1;
    }
    let count = mesh.vertices.len();
    Model {
        normals: vertex_normals(&mesh),
        provenance: vec![Provenance::Hull; count],
        expected_error: vec![1e-4; count],
        captures: Vec::new(),
        texture: None,
        mesh,
    }
}

/// Two views of the ball from neighbouring places.
pub(super) fn two_views() -> Vec<View> {
    let view = |name: &str, eye: [f64; 3]| {
        let camera = camera_at(name, eye, &[0.0; 5]);
        let pinhole = Pinhole::of(&camera.intrinsics);
        View {
            camera: camera.id,
            pinhole,
            rig_from_camera: camera.rig_from_camera,
            picture: RgbImage::filled(pinhole.width, pinhole.height, [7, 8, 9]),
            mask: Some(Mask::filled(pinhole.width, pinhole.height, 255)),
        }
    };
    vec![
        view("left", [0.5, 0.1, 0.3]),
        view("right", [0.5, -0.1, 0.3]),
    ]
}

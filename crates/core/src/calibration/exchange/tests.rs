//! Tests that the files that scand writes for other programs can be read back, that their files can be read, and that
//! errors name what is wrong.

use super::*;
use crate::calibration::{Distortion, Intrinsics};
use crate::frame::CameraId;
use nalgebra::{Isometry3, Point2, Vector2, Vector3};

fn camera(name: &str, radial: [f64; 6], x: f64) -> Camera {
    let distortion = Distortion {
        radial,
        tangential: [1e-4, -2e-4],
    };
    let (focal, center) = (Vector2::new(5179.0, 5181.5), Vector2::new(1280.2, 955.0));
    let lens = Intrinsics::new(2560, 1920, focal, center, distortion).unwrap();
    let pose = Isometry3::new(Vector3::new(x, 0.3, 1.0), Vector3::new(0.1, x, -0.4));
    Camera::new(CameraId::new(name).unwrap(), lens, pose)
}

fn import(name: &str, text: &str) -> Result<RigCalibration, FileError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, text).unwrap();
    RigCalibration::import(&path)
}

#[test]
fn a_lens_goes_through_ros_without_a_loss() {
    for radial in [
        [0.0; 6],
        [-0.05, 0.08, 0.01, 0.0, 0.0, 0.0],
        [0.1, 0.2, 0.0, 0.3, 0.1, 0.05],
    ] {
        let camera = camera("c00", radial, 0.2);
        let read = import("c00.yaml", &to_ros(&camera, None)).unwrap();
        let (found, _) = read.cameras.values().next().unwrap();
        assert_eq!(found.intrinsics, camera.intrinsics);
        assert_eq!(found.id, camera.id);
    }
}

#[test]
fn a_rig_goes_through_kalibr_with_its_poses() {
    let cameras = [
        camera("c00", [-0.05, 0.08, 0.0, 0.0, 0.0, 0.0], 0.0),
        camera("c01", [-0.05, 0.08, 0.0, 0.0, 0.0, 0.0], 0.3),
        camera("c02", [-0.05, 0.08, 0.02, 0.0, 0.0, 0.0], 0.6),
    ];
    let text = to_kalibr(&collect(cameras.to_vec()).unwrap());
    let read = import("camchain.yml", &text).unwrap();
    for camera in &cameras {
        let (found, _) = &read.cameras[&camera.id];
        let expected = cameras[0].rig_from_camera.inverse() * camera.rig_from_camera;
        assert!(
            (found.rig_from_camera.translation.vector - expected.translation.vector).norm() < 1e-12
        );
        assert!(found.rig_from_camera.rotation.angle_to(&expected.rotation) < 1e-7);
    }
    assert_eq!(
        read.cameras[&cameras[1].id].0.intrinsics,
        cameras[1].intrinsics
    );
    // k3 is folded into the other terms, to far less than a corner can be seen.
    assert_eq!(text.matches("# the nearest lens").count(), 1);
    let found = &read.cameras[&cameras[2].id].0.intrinsics;
    for pixel in [
        Point2::new(0.0, 0.0),
        Point2::new(2559.0, 1919.0),
        Point2::new(1300.0, 700.0),
    ] {
        let n = cameras[2].intrinsics.unproject(pixel).unwrap();
        let off = (found.project(n.x, n.y, 1.0).unwrap() - pixel).norm();
        assert!(off < 0.01, "{off}");
    }
}

#[test]
fn files_as_others_write_them_are_read() {
    let ros = "# from a tool\nimage_width: 640\nimage_height: 480\ncamera_name: narrow_stereo\ncamera_matrix:\n  rows: 3\n  \
        cols: 3\n  data: [532.795, 0.00000, 342.458,\n         0.00000, 532.919, 233.901,\n         0.00000, 0.00000, \
        1.00000]\ndistortion_model: \"plumb_bob\"\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.281, 0.025, \
        0.001, -0.0001, 0.163]\n";
    let read = import("left.yaml", ros).unwrap();
    let lens = read.cameras.values().next().unwrap().0.intrinsics;
    assert_eq!(lens.focal_px, Vector2::new(532.795, 532.919));
    assert_eq!(lens.distortion.radial[2], 0.163);
    let kalibr = "cam0:\n  cam_overlaps: [1]\n  camera_model: pinhole\n  distortion_coeffs: [-0.2, 0.1, 1.0e-04, \
        -0.0003]\n  distortion_model: radtan\n  intrinsics: [458.6, 457.3, 367.2, 248.4]\n  resolution: [752, 480]\n  \
        rostopic: /cam0/image_raw\ncam1:\n  T_cn_cnm1:\n  - [1.0, 0.0, 0.0, -0.11]\n  - [0.0, 1.0, 0.0, 0.0]\n  - [0.0, \
        0.0, 1.0, 0.0]\n  - [0.0, 0.0, 0.0, 1.0]\n  camera_model: pinhole\n  distortion_coeffs: [-0.2, 0.1, 0.0, 0.0]\n  \
        distortion_model: radtan\n  intrinsics: [458.6, 457.3, 367.2, 248.4]\n  resolution: [752, 480]\n";
    let read = import("camchain.yaml", kalibr).unwrap();
    let second = &read.cameras[&CameraId::new("cam1").unwrap()].0;
    assert!((second.center().x - 0.11).abs() < 1e-12);
}

#[test]
fn what_readings_mean_is_a_comment_that_readers_pass_over() {
    let response = DepthResponse {
        slope: 0.00104,
        intercept: -0.018,
        ..DepthResponse::default()
    };
    let kinect = camera("kinect", [0.0; 6], 0.0);
    let ros = to_ros(&kinect, Some(&response));
    let mut rig = RigCalibration::default();
    let entry = (kinect.clone(), Some(response));
    rig.cameras.insert(kinect.id.clone(), entry);
    for (name, text) in [("kinect.yaml", ros), ("camchain.yaml", to_kalibr(&rig))] {
        assert!(
            text.contains("# a reading r is 0.00104 * r + -0.018 metres"),
            "{text}"
        );
        let read = import(name, &text).unwrap();
        let (found, _) = read.cameras.values().next().unwrap();
        assert_eq!(found.intrinsics, kinect.intrinsics);
    }
}

#[test]
fn what_is_wrong_is_named() {
    let ros = to_ros(&camera("c00", [0.0; 6], 0.0), None);
    let kalibr = to_kalibr(
        &collect(vec![
            camera("c00", [0.0; 6], 0.0),
            camera("c01", [0.0; 6], 0.1),
        ])
        .unwrap(),
    );
    for (text, named) in [
        (ros.replace("plumb_bob", "fisheye"), "fisheye"),
        (
            ros.replace("image_width: 2560", "image_width: -3"),
            "picture size -3",
        ),
        (
            ros.replace("camera_name: c00", "camera_name: C 0"),
            "camera_name",
        ),
        (
            ros.replace("5179.0, 0.0,", "5179.0,"),
            "camera_matrix.data has 8 values, expected 9",
        ),
        (
            kalibr.replace("radtan", "equidistant"),
            "cam0: camera_model is \"pinhole\" with \"equidistant\"",
        ),
        (
            kalibr.replace("0.0, 0.0, 0.0, 1.0]", "0.0, 0.0, 1.0]"),
            "T_cn_cnm1 has 15 values",
        ),
        (
            kalibr.replace("resolution: [2560, 1920]", "resolution: big"),
            "resolution is \"big\"",
        ),
        // A lens whose distortion cannot be read is not one without distortion.
        (
            ros.replace("cols: 5\n  data: [", "cols: 5\n  data: none # ["),
            "distortion_coefficients.data is \"none\", expected a list of numbers",
        ),
        (
            ros.replace("cols: 5\n  data: [", "cols: 5\n  values: ["),
            "distortion_coefficients.data is missing",
        ),
        (
            ros.replace(
                "distortion_model: plumb_bob",
                "distortion_model: [plumb_bob]",
            ),
            "expected numbers",
        ),
        (
            ros.replace("distortion_model: plumb_bob", "distortion_model: [5]"),
            "distortion_model is a list, expected one value",
        ),
        (
            kalibr.replace("  distortion_model: radtan\n", ""),
            "cam0: cam0.distortion_model is missing",
        ),
        (
            kalibr.replace("distortion_model: radtan", "distortion_model: [1]"),
            "cam0: cam0.distortion_model is a list",
        ),
        ("a: b: [".to_owned(), "neither a ROS"),
        ("word".to_owned(), "line 1: expected NAME: VALUE"),
        ("a: [1, x]".to_owned(), "line 1: expected numbers"),
    ] {
        let message = import("x.yaml", &text).unwrap_err().to_string();
        assert!(
            message.contains(named) && message.contains("x.yaml"),
            "{message}"
        );
    }
}

#[test]
fn a_file_without_a_distortion_has_a_lens_without_one() {
    let ros = "image_width: 640\nimage_height: 480\ncamera_name: left\ncamera_matrix:\n  rows: 3\n  cols: 3\n  \
        data: [532.0, 0.0, 342.0, 0.0, 532.0, 233.0, 0.0, 0.0, 1.0]\n";
    let kalibr = "cam0:\n  camera_model: pinhole\n  intrinsics: [532.0, 532.0, 342.0, 233.0]\n  resolution: [640, 480]\n";
    for text in [ros, kalibr] {
        let read = import("left.yaml", text).unwrap();
        let (found, _) = read.cameras.values().next().unwrap();
        assert_eq!(found.intrinsics.distortion, Distortion::default());
    }
}

#[test]
fn a_folder_of_files_is_one_rig() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["c00", "c01"] {
        let text = to_ros(&camera(name, [0.0; 6], 0.0), None);
        std::fs::write(folder.path().join(format!("{name}.yaml")), text).unwrap();
    }
    assert_eq!(
        RigCalibration::import(folder.path()).unwrap().cameras.len(),
        2
    );
    std::fs::write(
        folder.path().join("c02.yaml"),
        to_ros(&camera("c01", [0.0; 6], 0.0), None),
    )
    .unwrap();
    let message = RigCalibration::import(folder.path())
        .unwrap_err()
        .to_string();
    assert!(message.contains("camera c01 appears twice"), "{message}");
}

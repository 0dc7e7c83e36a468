//! nerfstudio's `transforms.json`: poses from the camera's frame into the world's, in OpenGL's convention (x right, y
//! up, looking along -z), the world with z up. A picture's corner is (0, 0), as with COLMAP.

use super::points::Point;
use super::undistort::View;
use super::{File, Kind, ply};
use nalgebra::{Matrix4, Vector4};
use serde_json::{Value, json};

/// The files that describe the pictures.
pub(super) fn describe(views: &[View], points: &[Point]) -> Vec<File> {
    let frames: Vec<Value> = views.iter().map(frame).collect();
    let mut transforms = json!({ "camera_model": "OPENCV", "frames": frames });
    let mut files = Vec::new();
    if !points.is_empty() {
        transforms["ply_file_path"] = "points.ply".into();
        files.push(File {
            path: "points.ply".into(),
            bytes: ply::encode(points),
        });
    }
    files.push(File {
        path: "transforms.json".into(),
        bytes: format!("{transforms:#}\n").into_bytes(),
    });
    files
}

fn frame(view: &View) -> Value {
    let camera = &view.pinhole;
    let name = view.picture_name();
    let mut frame = json!({
        "file_path": format!("images/{name}"),
        "w": camera.width,
        "h": camera.height,
        "fl_x": camera.focal_px.x,
        "fl_y": camera.focal_px.y,
        "cx": camera.center_px.x + 0.5,
        "cy": camera.center_px.y + 0.5,
        "k1": 0.0,
        "k2": 0.0,
        "p1": 0.0,
        "p2": 0.0,
        "transform_matrix": rows(world_from_camera(view)),
    });
    if view.mask.is_some() {
        frame["mask_path"] = format!("masks/{}", Kind::Nerfstudio.mask_name(&name)).into();
    }
    frame
}

fn world_from_camera(view: &View) -> Matrix4<f64> {
    let turn = Matrix4::from_diagonal(&Vector4::new(1.0, -1.0, -1.0, 1.0));
    view.rig_from_camera.to_homogeneous() * turn
}

fn rows(matrix: Matrix4<f64>) -> Vec<Vec<f64>> {
    matrix
        .row_iter()
        .map(|row| row.iter().copied().collect())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::testing::{ball, two_views};
    use super::super::{files, points};
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn a_reader_of_the_file_projects_points_where_the_calibration_does() {
        let views = two_views();
        let points = points(&ball(), &views);
        let files = files(Kind::Nerfstudio, &views, &points).unwrap();
        let read: Value = serde_json::from_slice(&files.last().unwrap().bytes).unwrap();
        for (frame, view) in read["frames"].as_array().unwrap().iter().zip(&views) {
            let number = |name: &str| frame[name].as_f64().unwrap();
            let row = |i: usize| frame["transform_matrix"][i].as_array().unwrap().iter();
            let numbers = (0..4).flat_map(row).map(|n| n.as_f64().unwrap());
            let world_from_camera = Matrix4::from_row_iterator(numbers);
            let camera_from_world = world_from_camera.try_inverse().unwrap();
            for point in &points {
                // The camera looks along -z and has y up.
                let p: Point3<f64> = camera_from_world.transform_point(&point.position);
                let x = number("fl_x") * p.x / -p.z + number("cx") - 0.5;
                let y = number("fl_y") * -p.y / -p.z + number("cy") - 0.5;
                let expected = view.project(point.position).unwrap();
                assert!((x - expected.x).hypot(y - expected.y) < 0.1);
            }
            for path in ["file_path", "mask_path"] {
                let path = frame[path].as_str().unwrap();
                assert!(files.iter().any(|f| f.path == path), "{path}");
            }
        }
        assert_eq!(read["ply_file_path"], "points.ply");
    }
}

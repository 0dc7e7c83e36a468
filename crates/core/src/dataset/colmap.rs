//! COLMAP's sparse model as text (`cameras.txt`, `images.txt`, `points3D.txt`). COLMAP counts a picture's corner as
//! (0, 0), and so the first pixel's centre as (0.5, 0.5).

use super::File;
use super::points::Point;
use super::undistort::View;
use std::fmt::Write;

/// What a point's mean error of reprojection is called where none was measured.
const NO_ERROR: &str = "-1";

/// The files that describe the pictures.
pub(super) fn describe(views: &[View], points: &[Point]) -> Vec<File> {
    let file = |name: &str, text: String| File {
        path: format!("sparse/0/{name}"),
        bytes: text.into_bytes(),
    };
    vec![
        file("cameras.txt", cameras(views)),
        file("images.txt", images(views, points)),
        file("points3D.txt", points_3d(views, points)),
    ]
}

fn cameras(views: &[View]) -> String {
    let mut text = String::from("# CAMERA_ID MODEL WIDTH HEIGHT fx fy cx cy\n");
    for (number, view) in (1..).zip(views) {
        let camera = &view.pinhole;
        let [fx, fy] = camera.focal_px.into();
        let [cx, cy] = camera.center_px.add_scalar(0.5).into();
        let (width, height) = (camera.width, camera.height);
        let _ = writeln!(
            text,
            "{number} PINHOLE {width} {height} {fx} {fy} {cx} {cy}"
        );
    }
    text
}

fn images(views: &[View], points: &[Point]) -> String {
    let mut text = String::from(
        "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, from the rig's frame into the camera's\n# X Y POINT3D_ID ...\n",
    );
    let mut seen = vec![String::new(); views.len()];
    for (point, number) in points.iter().zip(1..) {
        for (view, pixel) in &point.seen {
            let (x, y) = (pixel.x + 0.5, pixel.y + 0.5);
            let _ = write!(seen[*view], "{x} {y} {number} ");
        }
    }
    for ((number, view), seen) in (1..).zip(views).zip(seen) {
        let camera_from_rig = view.rig_from_camera.inverse();
        let [x, y, z, w] = camera_from_rig.rotation.coords.into();
        let [tx, ty, tz] = camera_from_rig.translation.vector.into();
        let name = view.picture_name();
        let _ = writeln!(
            text,
            "{number} {w} {x} {y} {z} {tx} {ty} {tz} {number} {name}"
        );
        let _ = writeln!(text, "{}", seen.trim_end());
    }
    text
}

fn points_3d(views: &[View], points: &[Point]) -> String {
    let mut text = String::from(
        "# POINT3D_ID X Y Z R G B ERROR (-1: not measured), then IMAGE_ID POINT2D_IDX ...\n",
    );
    // Which of a picture's points is next.
    let mut next = vec![0; views.len()];
    for (number, point) in (1..).zip(points) {
        let ([x, y, z], [r, g, b]) = (point.position.into(), point.color);
        let _ = write!(text, "{number} {x} {y} {z} {r} {g} {b} {NO_ERROR}");
        for (view, _) in &point.seen {
            let _ = write!(text, " {} {}", view + 1, next[*view]);
            next[*view] += 1;
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::testing::{ball, camera_at, two_views};
    use super::super::{Kind, files, points};
    use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion};
    use std::collections::BTreeMap;

    #[test]
    fn a_reader_of_the_files_projects_points_where_the_calibration_does() {
        let views = two_views();
        let points = points(&ball(), &views);
        let files = files(Kind::Colmap, &views, &points).unwrap();
        let text = |path: &str| -> String {
            let file = files.iter().find(|f| f.path == path).unwrap();
            String::from_utf8(file.bytes.clone()).unwrap()
        };
        let rows = |path: &str| -> Vec<Vec<String>> {
            let text = text(path);
            let lines = text.lines().filter(|line| !line.starts_with('#'));
            lines
                .map(|l| l.split(' ').map(str::to_owned).collect())
                .collect()
        };
        let numbers =
            |row: &[String]| -> Vec<f64> { row.iter().map(|n| n.parse().unwrap()).collect() };
        let cameras = rows("sparse/0/cameras.txt");
        let images = rows("sparse/0/images.txt");
        let points_3d: BTreeMap<String, Vec<f64>> = rows("sparse/0/points3D.txt")
            .iter()
            .map(|row| (row[0].clone(), numbers(&row[1..4])))
            .collect();
        let eyes = [("left", [0.5, 0.1, 0.3]), ("right", [0.5, -0.1, 0.3])];
        let mut observations = 0;
        for (i, (name, eye)) in eyes.into_iter().enumerate() {
            let calibrated = camera_at(name, eye, &[0.0; 5]);
            let camera = numbers(&cameras[i][2..]);
            let (image, seen) = (&images[2 * i], &images[2 * i + 1]);
            assert_eq!(
                (image[0].as_str(), image[9].as_str()),
                (cameras[i][0].as_str(), format!("{name}.png").as_str())
            );
            let q = numbers(&image[1..8]);
            let rotation = UnitQuaternion::from_quaternion(Quaternion::new(q[0], q[1], q[2], q[3]));
            let camera_from_rig =
                Isometry3::from_parts(Translation3::new(q[4], q[5], q[6]), rotation);
            for observed in seen.chunks_exact(3) {
                let point = Point3::from_slice(&points_3d[&observed[2]]);
                let p = camera_from_rig * point;
                let read = [
                    camera[2] * p.x / p.z + camera[4],
                    camera[3] * p.y / p.z + camera[5],
                ];
                let written = numbers(&observed[..2]);
                let (expected, _) = calibrated.project(point).unwrap();
                for axis in 0..2 {
                    assert!((read[axis] - written[axis]).abs() < 1e-6);
                    // The corner of the picture is half a pixel before the first pixel's centre.
                    assert!((read[axis] - 0.5 - expected[axis]).abs() < 0.1);
                }
                observations += 1;
            }
        }
        assert!(observations > 100, "{observations}");
        // Tracks lead back to the same points.
        for row in rows("sparse/0/points3D.txt") {
            for track in row[8..].chunks_exact(2) {
                let [image, index] = [0, 1].map(|k: usize| track[k].parse::<usize>().unwrap());
                assert_eq!(images[2 * (image - 1) + 1][3 * index + 2], row[0]);
            }
        }
        assert!(files.iter().any(|f| f.path == "masks/left.png.png"));
    }
}

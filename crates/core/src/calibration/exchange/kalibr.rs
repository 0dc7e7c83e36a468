//! Reads and writes Kalibr's camchain: all cameras of a rig in one file, each with its pose relative to the one before
//! it, in metres.

use super::response_comment;
use super::yaml::{Tree, exactly, is_there, side, word, word_or};
use crate::calibration::{Camera, Distortion, Intrinsics, RigCalibration};
use crate::frame::CameraId;
use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix3, Point2, Rotation3, Translation3, UnitQuaternion, Vector2,
};
use std::fmt::Write;

/// A rig's cameras as a camchain. Its `radtan` lens has k1, k2, p1 and p2 alone: a lens with more terms is fitted by
/// the nearest one that has no more, and a comment says how far that is off. What a depth camera's readings mean
/// becomes a comment.
pub fn to_kalibr(calibration: &RigCalibration) -> String {
    let mut text = String::new();
    let mut before: Option<&Camera> = None;
    for (k, (camera, response)) in calibration.cameras.values().enumerate() {
        let (lens, off) = radtan(&camera.intrinsics);
        let _ = writeln!(text, "cam{k}:");
        if let Some(response) = response {
            text += &response_comment("  ", response);
        }
        if off > 0.0 {
            let _ = writeln!(
                text,
                "  # the nearest lens with k1, k2, p1, p2 alone; at most {off:.4} px off"
            );
        }
        let [k1, k2, ..] = lens.distortion.radial;
        let [p1, p2] = lens.distortion.tangential;
        let (f, c) = (lens.focal_px, lens.center_px);
        let _ = write!(
            text,
            "  camera_model: pinhole\n  distortion_coeffs: [{k1:?}, {k2:?}, {p1:?}, {p2:?}]\n  distortion_model: radtan\n  \
             intrinsics: [{:?}, {:?}, {:?}, {:?}]\n  resolution: [{}, {}]\n  rostopic: /color/{}/image\n",
            f.x, f.y, c.x, c.y, lens.width, lens.height, camera.id
        );
        if let Some(before) = before {
            let pose = camera.rig_from_camera.inverse() * before.rig_from_camera;
            text += "  T_cn_cnm1:\n";
            for row in pose.to_homogeneous().row_iter() {
                let _ = writeln!(
                    text,
                    "  - [{:?}, {:?}, {:?}, {:?}]",
                    row[0], row[1], row[2], row[3]
                );
            }
        }
        before = Some(camera);
    }
    text
}

/// The nearest lens with k1, k2, p1 and p2 alone, and by how many pixels it is off at most within the picture.
fn radtan(lens: &Intrinsics) -> (Intrinsics, f64) {
    if lens.distortion.radial[2..] == [0.0; 4] {
        return (*lens, 0.0);
    }
    const STEPS: usize = 24;
    let at = |k: usize, side: usize| (k % (STEPS + 1)) as f64 / STEPS as f64 * (side - 1) as f64;
    let pixels = (0..(STEPS + 1) * (STEPS + 1))
        .map(|k| Point2::new(at(k, lens.width), at(k / (STEPS + 1), lens.height)));
    let seen: Vec<_> = pixels
        .filter_map(|p| Some((p, lens.unproject(p)?)))
        .collect();
    let (f, c) = (lens.focal_px, lens.center_px);
    // Linear in fx, fy, cx, cy and f times k1, k2, p1, p2, where f's ratio is kept: two rounds set it right.
    let mut focal = f;
    let mut found = *lens;
    for _ in 0..4 {
        let mut rows = DMatrix::zeros(2 * seen.len(), 8);
        let mut values = DVector::zeros(2 * seen.len());
        for (k, (pixel, n)) in seen.iter().enumerate() {
            let (x, y, r2) = (n.x, n.y, n.norm_squared());
            let terms = [
                [x * r2, x * r2 * r2, 2.0 * x * y, r2 + 2.0 * x * x],
                [y * r2, y * r2 * r2, r2 + 2.0 * y * y, 2.0 * x * y],
            ];
            for a in 0..2 {
                let row = 2 * k + a;
                rows[(row, a)] = n[a];
                rows[(row, 2 + a)] = 1.0;
                for (t, term) in terms[a].iter().enumerate() {
                    rows[(row, 4 + t)] = focal[a] * term;
                }
                values[row] = pixel[a];
            }
        }
        let Ok(s) = rows.svd(true, true).solve(&values, 1e-14) else {
            return (*lens, f64::NAN);
        };
        focal = Vector2::new(s[0], s[1]);
        let distortion = Distortion {
            radial: [s[4], s[5], 0.0, 0.0, 0.0, 0.0],
            tangential: [s[6], s[7]],
        };
        let center = Vector2::new(s[2], s[3]);
        match Intrinsics::new(lens.width, lens.height, focal, center, distortion) {
            Ok(lens) => found = lens,
            Err(_) => return (*lens, (f - c).norm()),
        }
    }
    let off = seen.iter().map(|(pixel, n)| {
        found
            .project(n.x, n.y, 1.0)
            .map_or(f64::INFINITY, |p| (p - pixel).norm())
    });
    (found, off.fold(0.0, f64::max))
}

/// Reads the cameras, their poses in the frame of the first.
pub(super) fn cameras(tree: &Tree) -> Result<Vec<Camera>, String> {
    let mut cameras: Vec<Camera> = Vec::new();
    for k in 0.. {
        let name = format!("cam{k}");
        if !tree.contains_key(&format!("{name}.intrinsics")) {
            break;
        }
        let before = cameras.last().map(|c| c.rig_from_camera);
        cameras.push(camera(tree, &name, before).map_err(|e| format!("{name}: {e}"))?);
    }
    match cameras.is_empty() {
        true => Err(
            "the file is neither a ROS camera_info (it has no camera_matrix) nor a Kalibr camchain (it has no cam0)"
                .into(),
        ),
        false => Ok(cameras),
    }
}

fn camera(tree: &Tree, name: &str, before: Option<Isometry3<f64>>) -> Result<Camera, String> {
    let of = |what: &str| format!("{name}.{what}");
    let model = word(tree, &of("camera_model"))?;
    let distortion_model = match is_there(tree, &of("distortion_coeffs")) {
        true => word(tree, &of("distortion_model"))?,
        false => word_or(tree, &of("distortion_model"), "none")?,
    };
    if model != "pinhole" || !["radtan", "none"].contains(&distortion_model) {
        return Err(format!(
            "camera_model is {model:.40?} with {distortion_model:.40?}, expected pinhole with radtan or none"
        ));
    }
    let [fx, fy, cx, cy] = exactly(tree, &of("intrinsics"))?;
    let [width, height] = exactly(tree, &of("resolution"))?;
    let distortion = match distortion_model {
        "none" => Distortion::default(),
        _ => {
            let d: [f64; 4] = exactly(tree, &of("distortion_coeffs"))?;
            Distortion::from_model("plumb_bob", &d).map_err(|e| e.to_string())?
        }
    };
    let (focal, center) = (Vector2::new(fx, fy), Vector2::new(cx, cy));
    let lens = Intrinsics::new(side(width)?, side(height)?, focal, center, distortion)
        .and_then(Intrinsics::checked);
    let pose = match before {
        None => Isometry3::identity(),
        Some(before) => before * pose(&exactly(tree, &of("T_cn_cnm1"))?)?.inverse(),
    };
    let topic = word(tree, &of("rostopic")).unwrap_or_default();
    // Ours say which camera it is; others are called as the file calls them.
    let own = topic
        .split('/')
        .nth(2)
        .filter(|_| topic.starts_with("/color/") || topic.starts_with("/depth/"));
    let id = CameraId::new(own.unwrap_or(name)).map_err(|e| e.to_string())?;
    Ok(Camera::new(id, lens.map_err(|e| e.to_string())?, pose))
}

/// A pose from the rows of its matrix.
fn pose(m: &[f64; 16]) -> Result<Isometry3<f64>, String> {
    let rotation = Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
    let off = (rotation * rotation.transpose() - Matrix3::identity()).norm();
    if off > 1e-3 || rotation.determinant() < 0.0 || m[12..] != [0.0, 0.0, 0.0, 1.0] {
        return Err("T_cn_cnm1 is not a rigid motion".into());
    }
    let rotation =
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    Ok(Isometry3::from_parts(
        Translation3::new(m[3], m[7], m[11]),
        rotation,
    ))
}

//! Reads and writes ROS's `camera_info`, one file for each camera, as camera_info_manager and
//! camera_calibration_parsers do.

use super::response_comment;
use super::yaml::{Tree, exactly, is_there, list, side, word, word_or};
use crate::calibration::{Camera, DepthResponse, Distortion, Intrinsics};
use crate::frame::CameraId;
use nalgebra::{Isometry3, Vector2};

/// A camera's lens as ROS keeps it; what a depth camera's readings mean becomes a comment.
pub fn to_ros(camera: &Camera, response: Option<&DepthResponse>) -> String {
    let lens = &camera.intrinsics;
    let (f, c) = (lens.focal_px, lens.center_px);
    let (model, mut d) = lens.distortion.to_model();
    // ROS has no empty model.
    let model = if model.is_empty() { "plumb_bob" } else { model };
    d.resize(d.len().max(5), 0.0);
    let comment = response.map_or_else(String::new, |r| response_comment("", r));
    format!(
        "{comment}image_width: {}\nimage_height: {}\ncamera_name: {}\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [{:?}, 0.0, \
         {:?}, 0.0, {:?}, {:?}, 0.0, 0.0, 1.0]\ndistortion_model: {model}\ndistortion_coefficients:\n  rows: 1\n  cols: \
         {}\n  data: {d:?}\nrectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, \
         1.0]\nprojection_matrix:\n  rows: 3\n  cols: 4\n  data: [{:?}, 0.0, {:?}, 0.0, 0.0, {:?}, {:?}, 0.0, 0.0, 0.0, \
         1.0, 0.0]\n",
        lens.width,
        lens.height,
        camera.id,
        f.x,
        c.x,
        f.y,
        c.y,
        d.len(),
        f.x,
        c.x,
        f.y,
        c.y,
    )
}

/// Reads a camera.
pub(super) fn camera(tree: &Tree) -> Result<Camera, String> {
    let number = |name: &str| {
        let text = word(tree, name)?;
        text.parse()
            .map_err(|_| format!("{name} is {text:.40?}, expected a number"))
    };
    let (width, height) = (
        side(number("image_width")?)?,
        side(number("image_height")?)?,
    );
    let k: [f64; 9] = exactly(tree, "camera_matrix.data")?;
    if k[1] != 0.0 {
        return Err(format!("camera_matrix has a skew of {}, expected 0", k[1]));
    }
    // Old files of ROS do not name the model, which was the only one.
    let model = word_or(tree, "distortion_model", "plumb_bob")?;
    let d: &[f64] = match is_there(tree, "distortion_coefficients") {
        true => list(tree, "distortion_coefficients.data")?,
        false => &[],
    };
    let distortion = Distortion::from_model(model, d).map_err(|e| e.to_string())?;
    let (focal, center) = (Vector2::new(k[0], k[4]), Vector2::new(k[2], k[5]));
    let lens =
        Intrinsics::new(width, height, focal, center, distortion).and_then(Intrinsics::checked);
    let lens = lens.map_err(|e| e.to_string())?;
    let id = CameraId::new(word(tree, "camera_name")?).map_err(|e| format!("camera_name: {e}"))?;
    Ok(Camera::new(id, lens, Isometry3::identity()))
}

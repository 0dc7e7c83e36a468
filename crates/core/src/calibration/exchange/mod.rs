//! Calibrations in the formats of ROS (`camera_info`) and Kalibr (camchain), both YAML. What such a file cannot
//! hold is written as a comment or refused, never dropped.

mod kalibr;
mod ros;
mod yaml;

pub use kalibr::to_kalibr;
pub use ros::to_ros;

use super::file::read_text;
use super::{Camera, DepthResponse, FileError, RigCalibration};
use std::path::Path;

impl RigCalibration {
    /// Reads cameras from a calibration file of ours, from a ROS `camera_info` or Kalibr camchain YAML file (`.yaml`,
    /// `.yml`), or from a folder of such YAML files. Of ROS's the poses are not known and are those of the rig's frame;
    /// Kalibr's are in the frame of its first camera.
    ///
    /// # Errors
    /// As [`Self::load`]; or if a folder has no such file, or names a camera twice, or if a YAML file has a distortion
    /// that cannot be read. One without any is of a lens without distortion.
    pub fn import(path: &Path) -> Result<Self, FileError> {
        if path.is_dir() {
            return import_folder(path);
        }
        if !is_yaml(path) {
            return Self::load(path);
        }
        let parse = |message: String| FileError::Parse {
            path: path.into(),
            message,
        };
        let text = read_text(path)?;
        let tree = yaml::read(&text).map_err(parse)?;
        let cameras: Vec<Camera> = match tree.contains_key("camera_matrix.data") {
            true => vec![ros::camera(&tree).map_err(parse)?],
            false => kalibr::cameras(&tree).map_err(parse)?,
        };
        collect(cameras).map_err(parse)
    }
}

/// A comment line with what the formats of other programs cannot hold.
fn response_comment(indent: &str, response: &DepthResponse) -> String {
    let (slope, intercept) = (response.slope, response.intercept);
    format!(
        "{indent}# a reading r is {slope:?} * r + {intercept:?} metres deep, its lateral scale at z metres the polynomial \
         {:?}\n",
        response.scale
    )
}

fn is_yaml(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == "yaml" || e == "yml")
}

fn import_folder(folder: &Path) -> Result<RigCalibration, FileError> {
    let failed = |cause| FileError::Read {
        path: folder.into(),
        cause,
    };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if is_yaml(&path) {
            files.push(path);
        }
    }
    files.sort();
    let mut cameras = Vec::new();
    for file in &files {
        let read = RigCalibration::import(file)?;
        cameras.extend(read.cameras.into_values().map(|(camera, _)| camera));
    }
    let found = if cameras.is_empty() {
        Err("the folder has no YAML file with a camera".to_owned())
    } else {
        collect(cameras)
    };
    found.map_err(|message| FileError::Parse {
        path: folder.into(),
        message,
    })
}

fn collect(cameras: Vec<Camera>) -> Result<RigCalibration, String> {
    let mut rig = RigCalibration::default();
    for camera in cameras {
        let id = camera.id.clone();
        if rig.cameras.insert(id.clone(), (camera, None)).is_some() {
            return Err(format!("camera {id} appears twice"));
        }
    }
    Ok(rig)
}

#[cfg(test)]
mod tests;

//! A rig's calibration as a TOML file, with a section for each camera.

use super::camera::check_distance;
use super::{
    CalibrationLevel, CalibrationVerdict, Camera, DepthResponse, Distortion, Intrinsics, Volume,
};
use crate::frame::CameraId;
use crate::storage;
use nalgebra::Vector2;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Why a calibration file is refused.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum FileError {
    /// It cannot be read.
    #[error("calibration {}: {cause}", path.display())]
    Read {
        path: PathBuf,
        cause: std::io::Error,
    },
    /// It is not what it should be.
    #[error("calibration {}: {message}", path.display())]
    Parse {
        path: PathBuf,
        /// Line or camera, field, what was found and expected.
        message: String,
    },
}

/// Cameras by their ids, as a file holds them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RigCalibration {
    /// Each camera, and the response of those that measure depth.
    pub cameras: BTreeMap<CameraId, (Camera, Option<DepthResponse>)>,
    /// The box that is reconstructed, where the file proposes one.
    pub volume: Option<Volume>,
    /// What it is worth, where that is known.
    pub verdict: Option<CalibrationVerdict>,
    /// Standard deviation, in millimetres at the object, with which the cameras see points of the volume, if it is
    /// known.
    pub at_object_mm: Option<f64>,
}

/// The file's format.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Contents {
    /// 1.
    format: u32,
    /// `good`, `accepted`, `doubtful` or `refused`.
    verdict: Option<CalibrationLevel>,
    /// Why it is not good.
    #[serde(default)]
    reasons: Vec<String>,
    /// How well the cameras see points of the volume.
    at_object_mm: Option<f64>,
    cameras: BTreeMap<String, CameraEntry>,
    volume: Option<VolumeEntry>,
}

/// Two corners in metres of the rig's frame.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct VolumeEntry {
    min: [f64; 3],
    max: [f64; 3],
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraEntry {
    /// Width and height in pixels.
    size: [usize; 2],
    /// fx, fy in pixels.
    focal_px: [f64; 2],
    /// cx, cy in pixels.
    center_px: [f64; 2],
    /// `plumb_bob`, `rational_polynomial` or empty.
    #[serde(default)]
    distortion_model: String,
    /// The model's coefficients.
    #[serde(default)]
    distortion: Vec<f64>,
    /// Of the camera's centre in the rig's frame, metres.
    translation: [f64; 3],
    /// Quaternion x, y, z, w: from the camera's frame to the rig's.
    rotation: [f64; 4],
    /// Only for depth cameras.
    response: Option<ResponseEntry>,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct ResponseEntry {
    slope: f64,
    intercept: f64,
    scale: Vec<f64>,
    range: Option<[f64; 2]>,
    #[serde(default)]
    uncertainty: f64,
}

/// Largest calibration file, in bytes.
const LONGEST_FILE: u64 = 4 << 20;

/// Says what a file is that is not a calibration of scand, as far as its name or its first bytes show that.
fn refuse_other_kinds(path: &Path) -> Result<(), FileError> {
    use std::io::Read;
    let mut start = [0; 4];
    let read = std::fs::File::open(path).and_then(|mut file| file.read(&mut start));
    let is_recording = read.is_ok_and(|read| start[..read] == *b"\x89MCA");
    let ending = path
        .extension()
        .unwrap_or_default()
        .to_string_lossy()
        .to_lowercase();
    let message = if is_recording {
        "is a recording, expected a calibration (TOML): scand info RECORDING --calibration FILE.toml writes that of a \
         recording to a file"
    } else if ["yaml", "yml"].contains(&ending.as_str()) {
        "is YAML, expected TOML: from files of Kalibr and ROS, scand takes lenses alone. Make a calibration with them: scand \
         calibrate SESSION.mcap --fix-intrinsics FILE.yaml --out calibration.toml"
    } else {
        return Ok(());
    };
    Err(FileError::Parse {
        path: path.into(),
        message: message.into(),
    })
}

/// A file's text, if it is no longer than a calibration can be.
pub(super) fn read_text(path: &Path) -> Result<String, FileError> {
    let failed = |cause| FileError::Read {
        path: path.into(),
        cause,
    };
    storage::read_text(path, LONGEST_FILE).map_err(failed)
}

impl RigCalibration {
    /// Reads a file.
    ///
    /// # Errors
    /// If it cannot be read, or a camera in it cannot be; the message names line or camera and field.
    pub fn load(path: &Path) -> Result<Self, FileError> {
        Ok(Self::load_with_text(path)?.0)
    }

    /// Reads a file, and gives with it the text that was read: the file may be another one a moment later.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn load_with_text(path: &Path) -> Result<(Self, String), FileError> {
        refuse_other_kinds(path)?;
        let text = read_text(path)?;
        Ok((Self::parse(path, &text)?, text))
    }

    /// Reads the text of a file, which is called `path` in messages.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, FileError> {
        let parse = |message: String| FileError::Parse {
            path: path.into(),
            message,
        };
        let contents: Contents =
            toml::from_str(text).map_err(|e| parse(e.to_string().trim_end().into()))?;
        if contents.format != 1 {
            return Err(parse(format!("format is {}, expected 1", contents.format)));
        }
        let at_object_mm = contents.at_object_mm;
        if let Some(found) = at_object_mm.filter(|mm| !(0.0..=1e6).contains(mm)) {
            let expected = "0 to 1000000 mm";
            return Err(parse(format!(
                "at_object_mm is {found}, expected {expected}"
            )));
        }
        if contents.cameras.is_empty() {
            return Err(parse(
                "cameras is empty, expected a section [cameras.ID] for each camera".into(),
            ));
        }
        let camera = |(name, entry): (String, CameraEntry)| {
            let camera = entry
                .camera(&name)
                .map_err(|e| parse(format!("camera {name}: {e}")))?;
            check_distance(&camera.0.rig_from_camera)
                .map_err(|e| parse(format!("camera {name}: {e}")))?;
            Ok((camera.0.id.clone(), camera))
        };
        let volume = contents
            .volume
            .map(|v| Volume::new(v.min.into(), v.max.into()).map_err(|e| parse(e.to_string())));
        let reasons = contents.reasons;
        Ok(Self {
            at_object_mm,
            volume: volume.transpose()?,
            verdict: contents
                .verdict
                .map(|level| CalibrationVerdict { level, reasons }),
            cameras: contents
                .cameras
                .into_iter()
                .map(camera)
                .collect::<Result<_, _>>()?,
        })
    }
}

impl RigCalibration {
    /// The text of a file that [`Self::load`] reads back.
    pub fn to_toml(&self) -> String {
        let mut text = "format = 1\n".to_owned();
        if let Some(verdict) = &self.verdict {
            text += &verdict_toml(verdict);
        }
        if let Some(at_object_mm) = self.at_object_mm {
            text += &format!("at_object_mm = {at_object_mm:?}\n");
        }
        for (id, (camera, response)) in &self.cameras {
            let lens = &camera.intrinsics;
            let (model, d) = lens.distortion.to_model();
            let pose = &camera.rig_from_camera;
            // Numbers are written with as many digits as they need to be read back the same.
            text += &format!(
                "\n[cameras.{id}]\nsize = [{}, {}]\nfocal_px = {:?}\ncenter_px = {:?}\n\
                 distortion_model = {model:?}\ndistortion = {d:?}\ntranslation = {:?}\nrotation = {:?}\n",
                lens.width,
                lens.height,
                lens.focal_px.as_slice(),
                lens.center_px.as_slice(),
                pose.translation.vector.as_slice(),
                pose.rotation.coords.as_slice(),
            );
            if let Some(response) = response {
                text += &response_toml(id, response);
            }
        }
        if let Some(volume) = &self.volume {
            let [min, max] = [volume.min, volume.max].map(|p| p.coords);
            text += &format!(
                "\n[volume]\nmin = {:?}\nmax = {:?}\n",
                min.as_slice(),
                max.as_slice()
            );
        }
        text
    }
}

fn verdict_toml(verdict: &CalibrationVerdict) -> String {
    let reason = |words: &String| format!("    {},\n", toml::Value::from(words.as_str()));
    let reasons: String = verdict.reasons.iter().map(reason).collect();
    let open = if reasons.is_empty() { "" } else { "\n" };
    format!(
        "verdict = {:?}\nreasons = [{open}{reasons}]\n",
        verdict.level.name()
    )
}

fn response_toml(id: &CameraId, response: &DepthResponse) -> String {
    let DepthResponse {
        slope,
        intercept,
        scale,
        range,
        uncertainty,
    } = response;
    let range = range.map_or_else(String::new, |range| format!("range = {range:?}\n"));
    format!(
        "\n[cameras.{id}.response]\nslope = {slope:?}\nintercept = {intercept:?}\nscale = {scale:?}\n\
         {range}uncertainty = {uncertainty:?}\n"
    )
}

impl CameraEntry {
    fn camera(
        self,
        name: &str,
    ) -> Result<(Camera, Option<DepthResponse>), Box<dyn std::error::Error>> {
        let distortion = Distortion::from_model(&self.distortion_model, &self.distortion)?;
        let (focal, center) = (Vector2::from(self.focal_px), Vector2::from(self.center_px));
        let lens =
            Intrinsics::new(self.size[0], self.size[1], focal, center, distortion)?.checked()?;
        let pose = Camera::pose(self.translation, self.rotation)?;
        let response = self.response.map(ResponseEntry::response).transpose()?;
        Ok((Camera::new(CameraId::new(name)?, lens, pose), response))
    }
}

impl ResponseEntry {
    fn response(self) -> Result<DepthResponse, Box<dyn std::error::Error>> {
        let mut scale = [0.0; 5];
        if self.scale.is_empty() || self.scale.len() > scale.len() {
            return Err(format!(
                "response.scale has {} values, expected 1 to 5",
                self.scale.len()
            )
            .into());
        }
        scale[..self.scale.len()].copy_from_slice(&self.scale);
        let (slope, intercept) = (self.slope, self.intercept);
        let response = DepthResponse {
            slope,
            intercept,
            scale,
            range: self.range,
            uncertainty: self.uncertainty,
        };
        Ok(response.checked()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<RigCalibration, FileError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("calibration.toml");
        std::fs::write(&path, text).unwrap();
        RigCalibration::load(&path)
    }

    const ONE: &str = "format = 1\n[cameras.c00]\nsize = [640, 480]\nfocal_px = [500.0, 501.0]\n\
        center_px = [319.5, 239.5]\ndistortion_model = \"plumb_bob\"\ndistortion = [0.1, 0.01, 0.001, 0.002]\n\
        translation = [0.1, 0.2, 0.3]\nrotation = [0.0, 0.0, 0.0, 1.0]\n";

    #[test]
    fn what_is_written_is_read_to_the_last_bit() {
        let calibration = read(&format!(
            "{ONE}[cameras.kinect]\nsize = [640, 480]\nfocal_px = [520.0, 521.0]\ncenter_px = [319.5, 239.5]\n\
             distortion_model = \"\"\ndistortion = []\ntranslation = [0.1, 0.2, 2.0]\n\
             rotation = [0.6, 0.0, 0.0, 0.8]\n[cameras.kinect.response]\nslope = 0.00104\nintercept = -0.018\n\
             scale = [1.012, -0.009]\nrange = [0.5, 2.0]\nuncertainty = 0.001\n\
             [volume]\nmin = [-0.1, -0.1, 0.0]\nmax = [0.1, 0.1, 0.2]\n"
        ))
        .unwrap();
        let cameras: Vec<_> = calibration.cameras.values().collect();
        let (color, kinect) = (cameras[0], cameras[1]);
        assert_eq!(color.0.intrinsics.focal_px, Vector2::new(500.0, 501.0));
        let distortion = color.0.intrinsics.distortion;
        assert_eq!(distortion.radial[..2], [0.1, 0.01]);
        assert_eq!(distortion.tangential, [0.001, 0.002]);
        assert_eq!(color.1, None);
        let pose = Camera::pose([0.1, 0.2, 2.0], [0.6, 0.0, 0.0, 0.8]).unwrap();
        assert_eq!(kinect.0.rig_from_camera, pose);
        let response = DepthResponse {
            slope: 0.00104,
            intercept: -0.018,
            scale: [1.012, -0.009, 0.0, 0.0, 0.0],
            range: Some([0.5, 2.0]),
            uncertainty: 0.001,
        };
        assert_eq!(kinect.1, Some(response));
        assert_eq!(calibration.volume.unwrap().max.z, 0.2);
        assert_eq!(calibration.verdict, None);
        assert_eq!(read(&calibration.to_toml()).unwrap(), calibration);
        for reasons in [
            vec![],
            vec!["a \"quoted\"\nreason".to_owned(), "0.7°".to_owned()],
        ] {
            let level = CalibrationLevel::Doubtful;
            let judged = RigCalibration {
                verdict: Some(CalibrationVerdict { level, reasons }),
                at_object_mm: Some(0.041),
                ..calibration.clone()
            };
            assert_eq!(read(&judged.to_toml()).unwrap(), judged);
        }
    }

    #[test]
    fn a_file_is_given_with_the_text_that_was_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("calibration.toml");
        let text = format!("# of a rig\n{ONE}");
        std::fs::write(&path, &text).unwrap();
        let (read, own) = RigCalibration::load_with_text(&path).unwrap();
        assert_eq!(read, RigCalibration::parse(&path, &text).unwrap());
        assert_eq!(own, text);
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (from, to, named) in [
            ("500.0", "nan", "camera c00: focal length"),
            ("c00", "C00", "C00"),
            ("format = 1", "format = 2", "format is 2"),
            ("format = 1", "format = 1\nverdict = \"fine\"", "fine"),
            ("size", "sise", "sise"),
            (
                "format = 1",
                "format = 1\nat_object_mm = nan",
                "at_object_mm is NaN",
            ),
            (
                "format = 1",
                "format = 1\nat_object_mm = inf",
                "at_object_mm is inf",
            ),
            (
                "format = 1",
                "format = 1\nat_object_mm = -0.1",
                "at_object_mm is -0.1",
            ),
            (
                &ONE[ONE.find("[cameras").unwrap()..],
                "[cameras]\n",
                "cameras is empty",
            ),
            ("plumb_bob", "fisheye", "fisheye"),
            ("0.0, 1.0]", "0.0, 2.0]", "rotation"),
        ] {
            let message = read(&ONE.replace(from, to)).unwrap_err().to_string();
            assert!(
                message.contains(named) && message.contains("calibration.toml"),
                "{message}"
            );
        }
    }
}

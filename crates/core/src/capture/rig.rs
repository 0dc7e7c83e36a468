//! The rig as it was at a trigger: the newest calibration, pose, response, setting and volume with a log time at or
//! before the trigger.

use super::error::{Error, until};
use crate::calibration::{
    Camera, DepthCamera, DepthResponse, RigCalibration, Volume, check_distance,
};
use crate::frame::{CameraId, CameraSettings, Timestamp};
use crate::recording::{ColorPart, DepthPart, MessageRef, Pose, Recording, Topic};
use nalgebra::Isometry3;
use std::collections::BTreeMap;

/// Reads the rig of one moment out of a recording.
pub struct RigAt<'a> {
    recording: &'a Recording,
    time: Timestamp,
    poses: BTreeMap<String, (MessageRef, Pose)>,
}

impl<'a> RigAt<'a> {
    /// Finds the newest pose of each of `cameras`.
    ///
    /// # Errors
    /// If a pose cannot be read.
    pub fn new<'c>(
        recording: &'a Recording,
        time: Timestamp,
        cameras: impl Iterator<Item = &'c CameraId>,
    ) -> Result<Self, Error> {
        let mut wanted: Vec<&str> = cameras.map(CameraId::as_str).collect();
        let mut poses = BTreeMap::new();
        for message in recording.messages_until(&Topic::Tf, time).iter().rev() {
            if wanted.is_empty() {
                break;
            }
            // Of two poses of one camera in a message the last one counts.
            for pose in recording.poses(message)?.into_iter().rev() {
                if wanted.contains(&pose.child.as_str()) {
                    wanted.retain(|id| *id != pose.child);
                    poses.insert(pose.child.clone(), (*message, pose));
                }
            }
        }
        Ok(Self {
            recording,
            time,
            poses,
        })
    }

    /// The newest message of a topic at the rig's time.
    pub fn newest(&self, topic: &Topic) -> Option<MessageRef> {
        self.recording
            .messages_until(topic, self.time)
            .last()
            .copied()
    }

    fn needed(&self, topic: &Topic) -> Result<MessageRef, Error> {
        self.newest(topic).ok_or_else(|| Error::NothingYet {
            path: self.recording.path().into(),
            topic: topic.to_string(),
            trigger: self.time,
            first: self.recording.messages(topic).first().map(|m| m.log_time()),
        })
    }

    fn camera(&self, id: &CameraId, calibration: &Topic) -> Result<Camera, Error> {
        let message = self.needed(calibration)?;
        let lens = self.recording.intrinsics(calibration, &message)?;
        Ok(Camera::new(id.clone(), lens, self.pose(id)?))
    }

    fn pose(&self, id: &CameraId) -> Result<Isometry3<f64>, Error> {
        let bad = |problem: String| Error::Pose {
            path: self.recording.path().into(),
            camera: id.clone(),
            problem,
        };
        let Some((_, pose)) = self.poses.get(id.as_str()) else {
            return Err(bad(format!("there is none{}", until(self.time))));
        };
        if pose.parent != "rig" {
            let parent: String = pose.parent.chars().take(40).collect();
            return Err(bad(format!("its parent is {parent:?}, expected \"rig\"")));
        }
        let Some(rotation) = pose.rotation_xyzw else {
            return Err(bad("it has no rotation".into()));
        };
        let pose = Camera::pose(pose.translation, rotation).map_err(|e| bad(e.to_string()))?;
        check_distance(&pose).map_err(bad)?;
        Ok(pose)
    }

    /// A colour camera.
    ///
    /// # Errors
    /// If a message that is needed is missing, damaged or wrong.
    pub fn color(&self, id: &CameraId) -> Result<Camera, Error> {
        self.camera(id, &Topic::Color(id.clone(), ColorPart::Calibration))
    }

    /// How a colour camera was set; the defaults where nothing says.
    ///
    /// # Errors
    /// If a message that is needed is missing, damaged or wrong.
    pub fn settings(&self, id: &CameraId) -> Result<CameraSettings, Error> {
        let topic = Topic::Color(id.clone(), ColorPart::Settings);
        match self.newest(&topic) {
            Some(message) => Ok(self.recording.settings(&topic, &message)?),
            None => Ok(CameraSettings::default()),
        }
    }

    /// A depth camera with its response.
    ///
    /// # Errors
    /// If a message that is needed is missing, damaged or wrong.
    pub fn depth(&self, id: &CameraId) -> Result<DepthCamera, Error> {
        let camera = self.camera(id, &Topic::Depth(id.clone(), DepthPart::Calibration))?;
        let topic = Topic::Depth(id.clone(), DepthPart::Response);
        let response = match self.newest(&topic) {
            Some(message) => self.recording.response(&topic, &message)?,
            None => DepthResponse::default(),
        };
        Ok(DepthCamera { camera, response })
    }

    /// The box that bounds the object.
    ///
    /// # Errors
    /// If a message that is needed is missing, damaged or wrong.
    pub fn volume(&self) -> Result<Volume, Error> {
        Ok(self.recording.volume(&self.needed(&Topic::Volume)?)?)
    }

    /// All of it, for a recording's colour and depth cameras that are calibrated, with the volume if there is one.
    ///
    /// # Errors
    /// If a message is damaged or wrong, or a pose is missing.
    pub fn calibration(recording: &'a Recording, time: Timestamp) -> Result<RigCalibration, Error> {
        let (mut colors, mut depths) = (Vec::new(), Vec::new());
        for topic in recording.topics() {
            match topic {
                Topic::Color(id, ColorPart::Calibration) => colors.push(id.clone()),
                Topic::Depth(id, DepthPart::Calibration) => depths.push(id.clone()),
                _ => {}
            }
        }
        let rig = Self::new(recording, time, colors.iter().chain(&depths))?;
        let mut found = RigCalibration {
            verdict: recording.calibration_record()?.map(|record| record.verdict),
            ..RigCalibration::default()
        };
        for id in colors {
            found.cameras.insert(id.clone(), (rig.color(&id)?, None));
        }
        for id in depths {
            let depth = rig.depth(&id)?;
            let camera = (depth.camera, Some(depth.response));
            found.cameras.insert(id, camera);
        }
        if rig.newest(&Topic::Volume).is_some() {
            found.volume = Some(rig.volume()?);
        }
        Ok(found)
    }
}

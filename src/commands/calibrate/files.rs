//! Writes the other files of a calibration: a report, and calibrations for ROS and Kalibr.

use super::report_pictures::pictures;
use crate::calibrate::{Outcome, Rejected};
use crate::calibration::RigCalibration;
use crate::calibration::exchange::{to_kalibr, to_ros};
use crate::calibration::fit::{Limits, scale_words};
use crate::capture::Placements;
use crate::commands::{check_folder_of, refuse_to_replace};
use crate::frame::CameraId;
use crate::report::{CalibrationPage, calibration_page};
use crate::storage::{check_writable, write_atomically};
use anyhow::Context;
use std::path::{Path, PathBuf};

#[derive(Debug, clap::Args)]
pub(super) struct FileArgs {
    /// Write a report with pictures into this HTML file
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Write ROS camera_info files into this folder, ID.yaml for each camera
    #[arg(long, value_name = "FOLDER")]
    ros: Option<PathBuf>,
    /// Write a Kalibr camchain into this file
    #[arg(long, value_name = "FILE.yaml")]
    kalibr: Option<PathBuf>,
}

impl FileArgs {
    /// Refuses to replace files that are there, those of these cameras among them.
    pub(super) fn refuse_to_replace<'a>(
        &self,
        cameras: impl IntoIterator<Item = &'a CameraId>,
        force: bool,
    ) -> anyhow::Result<()> {
        refuse_to_replace("--report", self.report.as_deref(), force)?;
        refuse_to_replace("--kalibr", self.kalibr.as_deref(), force)?;
        let Some(folder) = &self.ros else {
            return Ok(());
        };
        cameras
            .into_iter()
            .try_for_each(|id| refuse_to_replace("--ros", Some(&ros_file(folder, id)), force))
    }

    /// Finds out before the work whether the files can be written.
    pub(super) fn check_folders(&self) -> anyhow::Result<()> {
        for (option, file) in [("--report", &self.report), ("--kalibr", &self.kalibr)] {
            if let Some(file) = file {
                check_folder_of(file).with_context(|| {
                    format!("nothing was done: give another file with {option}")
                })?;
            }
        }
        match &self.ros {
            Some(folder) if folder.is_dir() => check_writable(folder),
            Some(folder) => check_folder_of(folder),
            None => Ok(()),
        }
        .context("nothing was done: give another folder with --ros")
    }

    /// Writes the report, whatever the verdict.
    pub(super) fn write_report(
        &self,
        recordings: &[Placements],
        outcome: &Outcome,
        limits: &Limits,
    ) -> anyhow::Result<()> {
        let Some(path) = &self.report else {
            return Ok(());
        };
        let name = |recording: &Placements| {
            let name = recording.path().file_name().unwrap_or_default();
            name.to_string_lossy().into_owned()
        };
        let Outcome {
            detections, depth, ..
        } = outcome;
        let depths: Vec<_> = depth
            .planes
            .iter()
            .map(|(id, fit)| (id.clone(), fit))
            .collect();
        let lost: Vec<String> = detections.lost.iter().chain(&depth.lost).cloned().collect();
        let sources: Vec<String> = recordings.iter().map(name).collect();
        let told = |r: &Rejected| (r.camera.clone(), r.placement.clone(), r.reason.clone());
        let rejected: Vec<_> = detections.rejected.iter().map(told).collect();
        let page = CalibrationPage {
            fit: &outcome.fit,
            judgement: &outcome.judgement,
            limits,
            missing: &outcome.missing,
            placements: &detections.session.placements,
            rejected: &rejected,
            pictures: &pictures(recordings, outcome),
            lost: &lost,
            warnings: &detections.warnings,
            depths: &depths,
            depth_words: &depth.words,
            scale: &scale_words(&outcome.scale, &outcome.fit.board),
            sources: &sources,
        };
        Ok(write_atomically(path, calibration_page(&page).as_bytes())?)
    }

    /// Whether the calibration is wanted for others.
    pub(super) fn exports(&self) -> bool {
        self.ros.is_some() || self.kalibr.is_some()
    }

    /// Writes the calibration for others.
    pub(super) fn write_exports(&self, calibration: &RigCalibration) -> anyhow::Result<()> {
        if let Some(folder) = &self.ros {
            std::fs::create_dir_all(folder)
                .with_context(|| format!("cannot create {}", folder.display()))?;
            for (id, (camera, response)) in &calibration.cameras {
                let text = to_ros(camera, response.as_ref());
                write_atomically(&ros_file(folder, id), text.as_bytes())?;
            }
        }
        if let Some(path) = &self.kalibr {
            write_atomically(path, to_kalibr(calibration).as_bytes())?;
        }
        Ok(())
    }
}

fn ros_file(folder: &Path, id: &CameraId) -> PathBuf {
    folder.join(format!("{id}.yaml"))
}

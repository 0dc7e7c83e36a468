//! Fits what the depth cameras' readings mean: from the boards' planes or from a table.

use super::Error;
use super::detections::placement_names;
use crate::calibration::fit::{Fit, FittedCamera};
use crate::calibration::response::{
    DepthTable, PaperFit, PlaneFit, PlaneParameters, PlaneView, fit_plane, mean_readings,
};
use crate::calibration::{Board, DepthResponse};
use crate::capture::Placements;
use crate::frame::CameraId;
use crate::image::Grid;
use nalgebra::Isometry3;
use std::collections::BTreeMap;
use std::path::Path;

/// Where the depth cameras' responses come from.
#[derive(Debug)]
pub enum DepthMethod {
    /// The planes of the boards that they saw.
    Plane(PlaneParameters),
    /// A table of measurements, as in the paper.
    Table(Box<Table>),
    /// Nowhere.
    None,
}

/// What a table says, and the response that it makes.
#[derive(Clone, Debug)]
pub struct Table {
    /// The paper's lines and quartic.
    pub fit: PaperFit,
    response: DepthResponse,
}

impl Table {
    /// Reads a table and fits a response to it.
    ///
    /// # Errors
    /// If it cannot be read, or no response be fitted to it.
    pub fn load(path: &Path) -> Result<Self, Error> {
        let failed = |cause| Error::Response {
            path: path.into(),
            cause,
        };
        let fit = PaperFit::of(&DepthTable::load(path).map_err(Error::Table)?).map_err(failed)?;
        let response = fit.response().map_err(failed)?;
        Ok(Self { fit, response })
    }
}

/// What was found of the depth cameras.
#[derive(Debug, Default)]
pub struct Depth {
    /// The response of each camera that saw enough boards.
    pub planes: BTreeMap<CameraId, PlaneFit>,
    /// What the table says, for all cameras.
    pub table: Option<Table>,
    /// Cameras without a response, and why.
    pub unfitted: BTreeMap<CameraId, String>,
    /// What a person should know.
    pub words: Vec<String>,
    /// What could not be read.
    pub lost: Vec<String>,
}

/// Fits the responses of all depth cameras that were fitted.
pub(super) fn respond(
    method: DepthMethod,
    recordings: &[Placements],
    fit: &Fit,
    depth_cameras: &[CameraId],
) -> Depth {
    let mut depth = Depth::default();
    match method {
        DepthMethod::Plane(parameters) => {
            let fitted = fit
                .cameras
                .iter()
                .filter(|c| depth_cameras.contains(&c.camera.id));
            for camera in fitted {
                depth.add_planes(recordings, fit, camera, &parameters);
            }
        }
        DepthMethod::Table(table) => depth.table = Some(*table),
        DepthMethod::None => {}
    }
    depth
}

impl Depth {
    /// The response of a camera; `None` where nothing was found.
    pub(super) fn response(&self, id: &CameraId) -> Option<DepthResponse> {
        let plane = self.planes.get(id).map(|fit| fit.response);
        plane.or_else(|| self.table.as_ref().map(|table| table.response))
    }

    /// What the verdict is held against.
    pub(super) fn found(&self) -> BTreeMap<CameraId, Result<f64, String>> {
        let worst = |fit: &PlaneFit| fit.bias.iter().map(|b| b.bias.abs()).fold(0.0, f64::max);
        let fitted = self.planes.iter().map(|(id, fit)| (id, Ok(worst(fit))));
        let unfitted = self.unfitted.iter().map(|(id, why)| (id, Err(why.clone())));
        let all = fitted.chain(unfitted);
        all.map(|(id, found)| (id.clone(), found)).collect()
    }

    fn add_planes(
        &mut self,
        recordings: &[Placements],
        fit: &Fit,
        camera: &FittedCamera,
        parameters: &PlaneParameters,
    ) {
        let id = &camera.camera.id;
        let views = self.views(recordings, fit, camera);
        let views: Vec<PlaneView<'_>> = views
            .iter()
            .map(|(placement, camera_from_face, readings)| PlaneView {
                placement,
                camera_from_face: *camera_from_face,
                readings,
            })
            .collect();
        match fit_plane(&camera.camera.intrinsics, &fit.board, &views, parameters) {
            Ok(found) => {
                let left_out = found.left_out.iter();
                let words = left_out.map(|(name, why)| {
                    format!("depth of {id}: placement {name} is left out: {why}")
                });
                self.words.extend(words);
                self.planes.insert(id.clone(), found);
            }
            Err(error) => {
                self.unfitted.insert(id.clone(), error.to_string());
            }
        }
    }

    /// The burst of each placement that was fitted, its mean taken, with the pose of the face that it shows.
    fn views(
        &mut self,
        recordings: &[Placements],
        fit: &Fit,
        camera: &FittedCamera,
    ) -> Vec<(String, Isometry3<f64>, Grid<f32>)> {
        let mut views = Vec::new();
        for (recording, names) in recordings.iter().zip(placement_names(recordings)) {
            let all = recording.readings();
            for burst in all.iter().filter(|b| b.camera == camera.camera.id) {
                let name = names.get(&burst.placement).cloned().unwrap_or_default();
                let Some(placement) = fit.placements.iter().find(|p| p.name == name) else {
                    continue;
                };
                match recording.depth(burst).map(|frames| mean_readings(&frames)) {
                    Ok(Some(readings)) => {
                        let pose =
                            camera.camera.rig_from_camera.inverse() * placement.rig_from_board;
                        views.push((name, seen(&fit.board, pose, fit.front_from_back), readings));
                    }
                    Ok(None) => {}
                    Err(error) => self.lost.push(error.to_string()),
                }
            }
        }
        views
    }
}

/// The pose of the face that a camera sees, from the front's in the camera's frame.
fn seen(board: &Board, front: Isometry3<f64>, front_from_back: Isometry3<f64>) -> Isometry3<f64> {
    let eye = front.inverse() * nalgebra::Point3::origin();
    match board.two_sided && eye.z > 0.0 {
        true => front * front_from_back,
        false => front,
    }
}

//! What the depth cameras' readings mean: from the boards' planes, from a table, or not asked.

use super::sight::placement_names;
use crate::calibration::fit::{Fit, FittedCamera};
use crate::calibration::response::{
    DepthTable, PaperFit, PlaneFit, PlaneParameters, PlaneView, fit_plane, mean_readings,
};
use crate::calibration::{Board, DepthResponse};
use crate::frame::CameraId;
use crate::image::Grid;
use crate::job::Placements;
use anyhow::Context;
use clap::builder::ArgPredicate;
use nalgebra::Isometry3;
use std::collections::BTreeMap;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(super) struct DepthArgs {
    /// Where the depth cameras' response comes from: the boards' planes, a table of measurements as in the paper, or
    /// nowhere
    #[arg(
        long,
        value_enum,
        default_value_t = Method::Plane,
        default_value_if("depth_table", ArgPredicate::IsPresent, "paper")
    )]
    depth_response: Method,
    /// Table, which asks for --depth-response paper: lines of distance (m), reading and, if you like, the width of a target
    #[arg(long, value_name = "FILE", required_if_eq("depth_response", "paper"))]
    depth_table: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Method {
    Plane,
    Paper,
    None,
}

/// What a table says, and the response that it makes.
pub(super) struct Table {
    fit: PaperFit,
    response: DepthResponse,
}

impl DepthArgs {
    /// The table that was given, if one was.
    ///
    /// # Errors
    /// If it cannot be used.
    pub(super) fn table(&self) -> anyhow::Result<Option<Table>> {
        let Some(path) = &self.depth_table else {
            return Ok(None);
        };
        let shown = path.display();
        anyhow::ensure!(
            self.depth_response == Method::Paper,
            "--depth-table {shown}: only --depth-response paper takes a table"
        );
        let fit = PaperFit::of(&DepthTable::load(path)?);
        let fit = fit.with_context(|| format!("depth table {shown}"))?;
        let response = fit.response();
        let response = response.with_context(|| format!("depth table {shown}"))?;
        Ok(Some(Table { fit, response }))
    }
}

/// What was found of the depth cameras.
#[derive(Default)]
pub(super) struct Depth {
    pub(super) planes: BTreeMap<CameraId, PlaneFit>,
    pub(super) table: Option<Table>,
    /// Cameras without a response, and why.
    pub(super) unfitted: BTreeMap<CameraId, String>,
    /// What a person should know.
    pub(super) words: Vec<String>,
    /// What could not be read.
    pub(super) lost: Vec<String>,
}

/// Fits the responses of all depth cameras that were fitted.
pub(super) fn respond(
    args: &DepthArgs,
    table: Option<Table>,
    recordings: &[Placements],
    fit: &Fit,
    depth_cameras: &[CameraId],
    parameters: &PlaneParameters,
) -> Depth {
    let mut depth = Depth {
        table,
        ..Depth::default()
    };
    if args.depth_response == Method::Plane {
        let fitted = fit
            .cameras
            .iter()
            .filter(|c| depth_cameras.contains(&c.camera.id));
        for camera in fitted {
            depth.add_planes(recordings, fit, camera, parameters);
        }
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

    /// All that is missing, in words.
    pub(super) fn losses(&self) -> Vec<String> {
        let unfitted = self.unfitted.iter();
        let unfitted =
            unfitted.map(|(id, why)| format!("depth camera {id} has no response: {why}"));
        self.lost.iter().cloned().chain(unfitted).collect()
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

    /// Lines for a person.
    pub(super) fn text(&self) -> Vec<String> {
        let mut lines: Vec<String> = self
            .planes
            .iter()
            .map(|(id, fit)| plane_line(id, fit))
            .collect();
        if let Some(Table { fit, .. }) = &self.table {
            let [constant, slope] = [0, 1].map(|k| fit.depth.coefficients[k]);
            let [from, to] = fit.range;
            lines.push(format!(
                "depth by the paper's table: reading = {slope:.4}·D + {constant:.3} (R² {:.6}), from {from} to {to} m",
                fit.depth.r_squared
            ));
            if let Some(scale) = &fit.scale {
                lines.push(format!(
                    "width by the paper's table: L = {:.4}·D + {:.3} (R² {:.4}), P of degree 4 (R² {:.6})",
                    scale.line.coefficients[1],
                    scale.line.coefficients[0],
                    scale.line.r_squared,
                    scale.compensation.r_squared
                ));
            }
        }
        lines.extend(self.words.iter().cloned());
        lines
    }

    /// The same for programs.
    pub(super) fn json(&self) -> serde_json::Value {
        let plane = |fit: &PlaneFit| {
            let r = &fit.response;
            serde_json::json!({
                "method": "plane", "slope": r.slope, "intercept": r.intercept, "scale": r.scale, "range": r.range,
                "uncertainty": r.uncertainty, "bias": fit.bias, "views": fit.views,
                "left_out": fit.left_out, "correction": fit.correction,
            })
        };
        let mut all: serde_json::Map<_, _> = self
            .planes
            .iter()
            .map(|(id, fit)| (id.to_string(), plane(fit)))
            .collect();
        if let Some(Table { fit, .. }) = &self.table {
            let scale = fit.scale.as_ref().map(|scale| {
                serde_json::json!({
                    "line": scale.line.coefficients, "line_r_squared": scale.line.r_squared, "errors": scale.errors,
                    "quartic": scale.compensation.coefficients,
                    "quartic_r_squared": scale.compensation.r_squared,
                })
            });
            let paper = serde_json::json!({
                "method": "paper", "line": fit.depth.coefficients, "r_squared": fit.depth.r_squared,
                "range": fit.range, "widths": scale,
            });
            all.insert("table".to_owned(), paper);
        }
        all.into()
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

fn plane_line(id: &CameraId, fit: &PlaneFit) -> String {
    let r = &fit.response;
    let before = fit
        .bias
        .iter()
        .map(|b| b.bias_before.abs())
        .fold(0.0, f64::max);
    let at = |pick: fn(f64, f64) -> f64, start: f64| {
        fit.views.iter().map(|v| v.distance).fold(start, pick)
    };
    let correction = match fit.correction.pays {
        true => format!(
            "; a smooth correction a pixel would take {:.2} to {:.2} mm at 1 m",
            1e3 * fit.correction.held_out,
            1e3 * fit.correction.held_out_corrected
        ),
        false => String::new(),
    };
    format!(
        "depth of {id}: z = {:.6}·r {:+.4} m, scale {:.4} {:+.4}·z, from {} boards at {:.2} to {:.2} m; bias at most \
         {:.2} mm ({:.1} mm without){correction}",
        r.slope,
        r.intercept,
        r.scale[0],
        r.scale[1],
        fit.views.len(),
        at(f64::min, f64::MAX),
        at(f64::max, 0.0),
        1e3 * r.uncertainty,
        1e3 * before,
    )
}

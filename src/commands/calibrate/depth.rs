//! The options of a calibration that concern depth cameras, and its results for them as text and as JSON.

use crate::calibrate::{Depth, DepthMethod, Table};
use crate::calibration::response::{PlaneFit, PlaneParameters};
use crate::frame::CameraId;
use crate::words::count;
use clap::builder::ArgPredicate;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(super) struct DepthArgs {
    /// What the depth cameras' response is fitted to: the boards' planes, a table of measurements as in the paper, or
    /// nothing
    #[arg(
        long,
        value_enum,
        default_value_t = Method::Plane,
        default_value_if("depth_table", ArgPredicate::IsPresent, "paper")
    )]
    depth_response: Method,
    /// Table for --depth-response paper: lines of distance (m), reading and, if you like, the width of a target
    #[arg(long, value_name = "FILE", required_if_eq("depth_response", "paper"))]
    depth_table: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Method {
    Plane,
    Paper,
    None,
}

impl DepthArgs {
    /// Where the responses come from; reads the table, if one was given.
    ///
    /// # Errors
    /// If it cannot be used.
    pub(super) fn method(&self, plane: PlaneParameters) -> anyhow::Result<DepthMethod> {
        match (self.depth_response, &self.depth_table) {
            (Method::Paper, Some(path)) => Ok(DepthMethod::Table(Table::load(path)?.into(), plane)),
            (_, Some(path)) => anyhow::bail!(
                "--depth-table {}: only --depth-response paper takes a table",
                path.display()
            ),
            (Method::Plane, None) => Ok(DepthMethod::Plane(plane)),
            (Method::Paper | Method::None, None) => Ok(DepthMethod::None),
        }
    }
}

/// All that is missing, in words.
pub(super) fn losses(depth: &Depth) -> Vec<String> {
    let unfitted = depth.unfitted_words().map(|(_, words)| words);
    depth.lost.iter().cloned().chain(unfitted).collect()
}

/// Lines for a person.
pub(super) fn text(depth: &Depth) -> Vec<String> {
    let mut lines: Vec<String> = depth
        .planes
        .iter()
        .map(|(id, fit)| plane_line(id, fit))
        .collect();
    if let Some(Table { fit, .. }) = &depth.table {
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
    lines.extend(depth.words.iter().cloned());
    lines
}

/// The same for programs.
pub(super) fn json(depth: &Depth) -> serde_json::Value {
    let plane = |fit: &PlaneFit| {
        let r = &fit.response;
        serde_json::json!({
            "method": "plane", "slope": r.slope, "intercept": r.intercept, "scale": r.scale, "range": r.range,
            "uncertainty": r.uncertainty, "bias": fit.bias, "views": fit.views,
            "unread": fit.unread, "left_out": fit.left_out, "change": fit.change, "correction": fit.correction,
            "misfit": fit.misfit,
        })
    };
    let mut all: serde_json::Map<_, _> = depth
        .planes
        .iter()
        .map(|(id, fit)| (id.to_string(), plane(fit)))
        .collect();
    if let Some(Table { fit, .. }) = &depth.table {
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
            "; a smooth correction of each pixel would reduce {:.2} to {:.2} mm at 1 m",
            1e3 * fit.correction.held_out,
            1e3 * fit.correction.held_out_corrected
        ),
        false => String::new(),
    };
    let most = match r.has_known_uncertainty() {
        true => format!("at most {:.2} mm", 1e3 * r.uncertainty),
        false => "unknown".to_owned(),
    };
    format!(
        "depth of {id}: z = {:.6}·r {:+.4} m, scale {:.4} {:+.4}·z, from {} at {:.2} to {:.2} m; bias {most} \
         ({:.1} mm without){correction}",
        r.slope,
        r.intercept,
        r.scale[0],
        r.scale[1],
        count(fit.views.len(), "board"),
        at(f64::min, f64::MAX),
        at(f64::max, 0.0),
        1e3 * before,
    )
}

//! Judges a fit, in words. The limits are parameters; nothing is estimated here.

use super::result::{Fit, FittedCamera, FittedPlacement};
use crate::frame::CameraId;
use crate::number;
use std::collections::BTreeMap;

/// When a calibration is good.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Root mean square residual, in pixels, up to which a calibration is good. Default 0.25.
    #[serde(deserialize_with = "number::within::<_, _, 0, 100>")]
    pub good_px: f64,
    /// Up to which it is accepted. Default 0.4.
    #[serde(deserialize_with = "number::within::<_, _, 0, 100>")]
    pub accepted_px: f64,
    /// Beyond which it is refused. Default 0.6.
    #[serde(deserialize_with = "number::within::<_, _, 0, 100>")]
    pub refused_px: f64,
    /// How many times the fit's residual that of placements held out may be.
    /// Default 1.3, range 1 to 1000.
    #[serde(deserialize_with = "number::within::<_, _, 1, 1000>")]
    pub held_out_ratio: f64,
    /// Part of a camera's picture in which the board should have been seen.
    /// Default 0.2, range 0 to 1.
    #[serde(deserialize_with = "number::within::<_, _, 0, 1>")]
    pub coverage: f64,
    /// Fewest views of a camera with which nothing is amiss.
    /// Default 6, range 0 to 1000.
    #[serde(deserialize_with = "number::count::<_, _, 0, 1000>")]
    pub views: usize,
    /// Largest bias, in millimetres at any distance, that a depth camera's readings may be left with.
    /// Default 1, range 0 to 1000.
    #[serde(deserialize_with = "number::within::<_, _, 0, 1000>")]
    pub depth_bias_mm: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            good_px: 0.25,
            accepted_px: 0.4,
            refused_px: 0.6,
            held_out_ratio: 1.3,
            coverage: 0.2,
            views: 6,
            depth_bias_mm: 1.0,
        }
    }
}

impl Limits {
    /// Refuses values that contradict each other.
    ///
    /// # Errors
    /// If there is one: its field, what it is, and what was expected.
    pub fn checked(&self) -> Result<(), String> {
        let not_below = |field: &str, found: f64, least: f64| match found >= least {
            true => Ok(()),
            false => Err(format!("{field} is {found}, expected {least} to 100")),
        };
        not_below("accepted_px", self.accepted_px, self.good_px)?;
        not_below("refused_px", self.refused_px, self.accepted_px)
    }
}

/// What a calibration is worth.
#[derive(serde::Serialize, Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// Nothing is amiss.
    Good,
    /// Good enough to work with.
    Accepted,
    /// To be used if there is no other.
    Doubtful,
    /// Not to be used.
    Refused,
}

/// A level with its reasons.
#[derive(serde::Serialize, Clone, Debug, PartialEq)]
pub struct Judgement {
    /// What it is worth.
    pub level: Level,
    /// Why it is not good.
    pub reasons: Vec<String>,
    /// The camera with the largest residual, and that in pixels.
    pub worst_camera: Option<(String, f64)>,
    /// The placement with the largest residual, and that in pixels.
    pub worst_placement: Option<(String, f64)>,
}

/// Judges a fit, and of each depth camera the largest bias in metres that its response leaves, or why it has none.
pub fn judge(
    fit: &Fit,
    depths: &BTreeMap<CameraId, Result<f64, String>>,
    limits: &Limits,
) -> Judgement {
    let by_rms = |rms: f64| match rms {
        r if r <= limits.good_px => Level::Good,
        r if r <= limits.accepted_px => Level::Accepted,
        r if r <= limits.refused_px => Level::Doubtful,
        _ => Level::Refused,
    };
    let mut found: Vec<(Level, String)> = Vec::new();
    let rms = fit.figures.rms_px;
    found.push((
        by_rms(rms),
        format!("rms {rms:.3} px, expected at most {}", limits.good_px),
    ));
    for camera in &fit.cameras {
        let (id, rms) = (&camera.camera.id, camera.figures.rms_px);
        // A single camera is one of many: it makes a calibration doubtful and does not refuse it.
        let level = by_rms(rms).min(Level::Doubtful);
        found.push((
            level,
            format!(
                "camera {id}: rms {rms:.3} px, expected at most {}",
                limits.good_px
            ),
        ));
        if camera.views < limits.views {
            let words = format!(
                "camera {id}: {} views, expected {} or more",
                camera.views, limits.views
            );
            found.push((Level::Accepted, words));
        }
        if camera.coverage < limits.coverage {
            let words = format!(
                "camera {id}: the board was seen in {:.0} % of its picture, expected {:.0} % or more",
                100.0 * camera.coverage,
                100.0 * limits.coverage
            );
            found.push((Level::Accepted, words));
        }
    }
    match &fit.held_out {
        Some(held_out) if held_out.ratio > limits.held_out_ratio => found.push((
            Level::Doubtful,
            format!(
                "placements that were held out are predicted {:.2} times worse than they are fitted, expected at \
                 most {}",
                held_out.ratio, limits.held_out_ratio
            ),
        )),
        Some(_) => {}
        None => found.push((Level::Accepted, "too few placements to hold any out".into())),
    }
    if let Some(camera) = fit
        .left_out
        .iter()
        .find(|l| l.placement.is_none() && l.camera.is_some())
    {
        let id = camera
            .camera
            .as_ref()
            .map(ToString::to_string)
            .unwrap_or_default();
        found.push((
            Level::Doubtful,
            format!("camera {id} is not calibrated: {}", camera.reason),
        ));
    }
    found.extend(
        depths
            .iter()
            .filter_map(|(id, found)| Some((Level::Doubtful, depth_reason(id, found, limits)?))),
    );
    if !fit.table_is_lowest && fit.cameras.len() > 1 {
        let words = format!(
            "no placement lies flat below all others: the rig's frame lies on {}, which may not be the table",
            fit.table
        );
        found.push((Level::Accepted, words));
    }
    found.retain(|(level, _)| *level > Level::Good);
    let worst = |name: String, rms: f64| (name, rms);
    let cameras = fit
        .cameras
        .iter()
        .map(|c: &FittedCamera| worst(c.camera.id.to_string(), c.figures.rms_px));
    let placements = fit
        .placements
        .iter()
        .map(|p: &FittedPlacement| worst(p.name.clone(), p.figures.rms_px));
    Judgement {
        level: found
            .iter()
            .map(|(level, _)| *level)
            .max()
            .unwrap_or(Level::Good),
        reasons: found.into_iter().map(|(_, words)| words).collect(),
        worst_camera: cameras.max_by(|a, b| a.1.total_cmp(&b.1)),
        worst_placement: placements.max_by(|a, b| a.1.total_cmp(&b.1)),
    }
}

/// What is amiss with a depth camera's response, if anything is.
fn depth_reason(id: &CameraId, found: &Result<f64, String>, limits: &Limits) -> Option<String> {
    match found {
        Err(why) => Some(format!("depth camera {id} has no response: {why}")),
        Ok(bias) if 1e3 * bias > limits.depth_bias_mm => Some(format!(
            "depth camera {id}: a bias of {:.2} mm is left, expected at most {}",
            1e3 * bias,
            limits.depth_bias_mm
        )),
        Ok(_) => None,
    }
}

//! Prints the summary of a calibration: a table and a verdict for people, JSON for programs.

use super::depth;
use crate::calibrate::Outcome;
use crate::calibration::fit::{Fit, FittedCamera, FittedPlacement, Projection, scale_words};
use crate::words::count;
use std::path::Path;

/// All that there is to say of a calibration.
pub(super) struct Summary<'a> {
    pub(super) outcome: &'a Outcome,
    pub(super) written: Option<&'a Path>,
}

impl Summary<'_> {
    /// The table and the verdict.
    pub(super) fn text(&self) -> String {
        let (fit, session) = (&self.outcome.fit, &self.outcome.detections.session);
        let mut lines = vec![format!(
            "board {}: {}, {}, {}",
            fit.board,
            count(session.placements.len(), "placement"),
            count(session.views.len(), "view"),
            count(session.cameras.len(), "camera")
        )];
        let share = fit.left_out_share();
        if share.left_out > 0 {
            lines.push(format!(
                "left out: {} of {} views ({:.0} %)",
                share.left_out,
                share.read,
                100.0 * share.part()
            ));
        }
        let without = self.outcome.detections.rejected.len();
        if without > 0 {
            lines.push(format!(
                "no board that can be used: {without} of {}",
                count(without + session.views.len(), "picture")
            ));
        }
        lines.push(
            "camera        views  rms px  median    max  seen %  focal px         ±  place ± mm  turn ± °  at object ± mm"
                .into(),
        );
        for camera in &fit.cameras {
            let (figures, uncertainty) = (&camera.figures, &camera.uncertainty);
            let largest = |of: [f64; 3]| of.into_iter().fold(0.0, f64::max);
            lines.push(format!(
                "{:<12} {:>6}  {:>6.3}  {:>6.3} {:>6.2}  {:>6.0}  {:>8.2}  {:>8.3}  {:>10.3}  {:>8.4}  {:>14}",
                camera.camera.id,
                camera.views,
                figures.rms_px,
                figures.median_px,
                figures.max_px,
                100.0 * camera.coverage,
                camera.camera.intrinsics.focal_px.x,
                uncertainty.focal_px[0],
                1e3 * largest(uncertainty.position),
                largest(uncertainty.rotation_degrees),
                camera.projection.as_ref().map_or_else(|| "-".to_owned(), at_object),
            ));
        }
        if let Some(at_object) = fit.at_object() {
            lines.push(format!(
                "points in the volume are seen to {:.3} mm (one standard deviation, all cameras)",
                1e3 * at_object
            ));
        }
        let left_out = fit.left_out.iter();
        lines.extend(left_out.map(|l| format!("left out: {}: {}", l.subject(), l.reason)));
        let false_corners: usize = fit.cameras.iter().map(|c| c.false_corners).sum();
        if false_corners > 0 {
            lines.push(format!(
                "left out: {} found in a wrong place",
                count(false_corners, "corner")
            ));
        }
        lines.extend(self.outcome.missing.iter().map(|m| format!("missing: {m}")));
        lines.extend(depth::text(&self.outcome.depth));
        lines.extend(scale_words(&self.outcome.scale, &fit.board));
        if let Some(volume) = &fit.volume {
            let [min, max] =
                [volume.min, volume.max].map(|p| p.coords.map(|c| (c * 1e3).round() / 1e3));
            lines.push(format!(
                "all cameras see from {:?} to {:?} m",
                min.as_slice(),
                max.as_slice()
            ));
        }
        lines.push(format!("the rig's frame lies on placement {}", fit.table));
        lines.push(self.verdict());
        lines.extend(
            self.outcome
                .judgement
                .reasons
                .iter()
                .map(|reason| format!("  {}", reason.words)),
        );
        lines.extend(
            self.written
                .map(|path| format!("written: {}", path.display())),
        );
        lines.join("\n")
    }

    fn verdict(&self) -> String {
        let worth = self.outcome.judgement.level.name();
        let worst = |what: &str, worst: &Option<(String, f64)>| {
            worst
                .as_ref()
                .map(|(name, rms)| format!(", worst {what} {name} ({rms:.3} px)"))
                .unwrap_or_default()
        };
        let held_out = self.outcome.fit.held_out.map(|h| {
            format!(
                ", held out {:.3} px ({:.2} times)",
                h.figures.rms_px, h.ratio
            )
        });
        format!(
            "{worth}: rms {:.3} px{}{}{}",
            self.outcome.fit.figures.rms_px,
            held_out.unwrap_or_default(),
            worst("camera", &self.outcome.judgement.worst_camera),
            worst("placement", &self.outcome.judgement.worst_placement),
        )
    }

    /// The same for programs.
    pub(super) fn json(&self) -> serde_json::Value {
        let (fit, detections) = (&self.outcome.fit, &self.outcome.detections);
        let losses = depth::losses(&self.outcome.depth);
        let lost: Vec<String> = detections.lost.iter().cloned().chain(losses).collect();
        let cameras: serde_json::Map<_, _> = fit
            .cameras
            .iter()
            .map(|c| (c.camera.id.to_string(), camera(fit, c)))
            .collect();
        let placement = |p: &FittedPlacement| {
            let pose = &p.rig_from_board;
            serde_json::json!({
                "name": p.name, "cameras": p.cameras, "figures": p.figures,
                "translation": pose.translation.vector.as_slice(), "rotation": pose.rotation.coords.as_slice(),
            })
        };
        serde_json::json!({
            "board": fit.board.to_string(),
            "verdict": self.outcome.judgement,
            "figures": fit.figures,
            "held_out": fit.held_out,
            "cameras": cameras,
            "placements": fit.placements.iter().map(placement).collect::<Vec<_>>(),
            "depth": depth::json(&self.outcome.depth),
            "shape": fit.shape,
            "at_object": fit.at_object(),
            "scale": self.outcome.scale,
            "table": fit.table,
            "volume": fit.volume.map(|v| serde_json::json!({
                "min": v.min.coords.as_slice(), "max": v.max.coords.as_slice(),
            })),
            "findings": self.outcome.findings,
            "left_out": fit.left_out,
            "left_out_views": fit.left_out_share(),
            "rejected": detections.rejected,
            "lost": lost,
            "warnings": detections.warnings,
            "missing": self.outcome.missing,
            "written": self.written,
        })
    }
}

fn at_object(projection: &Projection) -> String {
    format!("{:.3}", 1e3 * projection.at_object)
}

fn camera(fit: &Fit, camera: &FittedCamera) -> serde_json::Value {
    let (lens, pose) = (&camera.camera.intrinsics, &camera.camera.rig_from_camera);
    let (model, coefficients) = lens.distortion.to_model();
    serde_json::json!({
        "size": [lens.width, lens.height],
        "focal_px": lens.focal_px.as_slice(),
        "center_px": lens.center_px.as_slice(),
        "distortion_model": model,
        "distortion": coefficients,
        "translation": pose.translation.vector.as_slice(),
        "rotation": pose.rotation.coords.as_slice(),
        "uncertainty": camera.uncertainty,
        "projection": camera.projection,
        "figures": camera.figures,
        "views": camera.views,
        "coverage": camera.coverage,
        "false_corners": camera.false_corners,
        "left_out_views": fit.left_out_share_of(camera),
    })
}

//! The placements: a plot of each camera's view of each placement, in which a bumped camera shows, and their figures.

use super::{CalibrationPage, by_rms};
use crate::calibration::fit::Figures;
use crate::markup::escaped;
use std::collections::BTreeMap;
use std::fmt::Write;

/// Sizes on the page: of a cell, of the space for names, and of the plot above the cells.
const CELL: [f64; 2] = [22.0, 16.0];
const LEFT: f64 = 96.0;
const PLOT: f64 = 110.0;
const NAMES: f64 = 64.0;

/// What became of a camera's view of a placement.
#[derive(Clone, Copy, Debug, PartialEq)]
enum View {
    /// Used, with its root mean square residual in pixels.
    Used(f64),
    LeftOut,
    Unfound,
}

/// A plot of the residuals over the placements, with each camera's views below it.
pub(super) fn plot(html: &mut String, page: &CalibrationPage<'_>) {
    let fit = page.fit;
    let views = views(page);
    let rows = fit.cameras.len() as f64;
    let width = LEFT + CELL[0] * page.placements.len() as f64 + 8.0;
    let height = PLOT + CELL[1] * rows + NAMES;
    let _ = write!(
        html,
        "<h2>Residuals over the placements</h2>\n<p>Above: the root mean square residual of each placement. Below: each \
         camera's views, coloured by theirs; <b class=\"bad\">&times;</b> is a view that was left out, &middot; a picture in \
         which no board was found. A camera that was bumped shows crosses, or another colour, from there on.</p>\n\
         <div class=\"wide\"><svg width=\"{width:.0}\" height=\"{height:.0}\" viewBox=\"0 0 {width:.0} {height:.0}\">"
    );
    bars(html, page, width);
    for (row, camera) in fit.cameras.iter().enumerate() {
        let y = PLOT + CELL[1] * row as f64;
        let id = escaped(camera.camera.id.as_str());
        let _ = write!(html, "<text x=\"4\" y=\"{:.1}\">{id}</text>", y + 12.0);
        for (column, placement) in page.placements.iter().enumerate() {
            let x = LEFT + CELL[0] * column as f64;
            if let Some(view) = views.get(&(camera.camera.id.as_str(), placement.as_str())) {
                cell(
                    html,
                    page,
                    [x, y],
                    *view,
                    &format!("{id}, {}", escaped(placement)),
                );
            }
        }
    }
    let y = PLOT + CELL[1] * rows + 8.0;
    for (column, placement) in page.placements.iter().enumerate() {
        let x = LEFT + CELL[0] * (column as f64 + 0.3);
        // The end of a name tells placements apart.
        let skipped = placement.chars().count().saturating_sub(10);
        let short: String = placement.chars().skip(skipped).collect();
        let _ = write!(
            html,
            "<text x=\"{x:.1}\" y=\"{y:.1}\" transform=\"rotate(60 {x:.1} {y:.1})\">{}</text>",
            escaped(&short)
        );
    }
    *html += "</svg></div>\n";
}

/// What became of each view, by camera and placement.
fn views<'a>(page: &CalibrationPage<'a>) -> BTreeMap<(&'a str, &'a str), View> {
    let fit = page.fit;
    let mut views = BTreeMap::new();
    for (camera, placement, _) in page.rejected {
        views.insert((camera.as_str(), placement.as_str()), View::Unfound);
    }
    for left_out in &fit.left_out {
        for camera in &left_out.views {
            let placement = left_out.placement.as_deref().unwrap_or_default();
            views.insert((camera.as_str(), placement), View::LeftOut);
        }
    }
    for view in &fit.residuals {
        let camera = fit.cameras[view.camera].camera.id.as_str();
        let placement = fit.placements[view.placement].name.as_str();
        let rms = Figures::of(view.lengths()).rms_px;
        views.insert((camera, placement), View::Used(rms));
    }
    views
}

fn cell(html: &mut String, page: &CalibrationPage<'_>, [x, y]: [f64; 2], view: View, whose: &str) {
    let (w, h) = (CELL[0] - 2.0, CELL[1] - 2.0);
    match view {
        View::Used(rms) => {
            let color = match by_rms(rms, page.limits) {
                "good" => "#7cc48f",
                "fair" => "#d9c84a",
                "poor" => "#e08a3c",
                _ => "#c01616",
            };
            // The larger within its level, the darker.
            let part = (rms / page.limits.refused_px.max(1e-6)).min(1.0);
            let _ = write!(
                html,
                "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{w}\" height=\"{h}\" fill=\"{color}\" fill-opacity=\"{:.2}\">\
                 <title>{whose}: {rms:.3} px</title></rect>",
                0.35 + 0.65 * part
            );
        }
        View::LeftOut => {
            let _ = write!(
                html,
                "<path d=\"M{:.1} {:.1}l10 10m0 -10l-10 10\" stroke=\"#c01616\" stroke-width=\"2.5\"><title>{whose}: left \
                 out</title></path>",
                x + 5.0,
                y + 2.0
            );
        }
        View::Unfound => {
            let _ = write!(
                html,
                "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"1.6\" fill=\"#888\"><title>{whose}: no board found</title></circle>",
                x + 0.5 * w,
                y + 0.5 * h
            );
        }
    }
}

/// A bar a placement, with the limits as lines.
fn bars(html: &mut String, page: &CalibrationPage<'_>, width: f64) {
    let of = |name: &String| page.fit.placements.iter().find(|p| p.name == *name);
    let found: Vec<Option<f64>> = (page.placements.iter())
        .map(|name| of(name).map(|p| p.figures.rms_px))
        .collect();
    let largest = found.iter().flatten().copied().fold(1e-3, f64::max);
    let top = 1.15 * largest;
    let y = |rms: f64| (PLOT - 12.0) * (1.0 - rms / top) + 4.0;
    let _ = write!(
        html,
        "<line x1=\"{LEFT}\" y1=\"{0:.1}\" x2=\"{width:.0}\" y2=\"{0:.1}\" stroke=\"#999\"/><text x=\"4\" \
         y=\"{1:.1}\">{largest:.3} px</text><text x=\"4\" y=\"{2:.1}\">0</text>",
        y(0.0),
        y(largest) + 4.0,
        y(0.0) + 4.0
    );
    for limit in [
        page.limits.good_px,
        page.limits.accepted_px,
        page.limits.refused_px,
    ] {
        if limit < top {
            let _ = write!(
                html,
                "<line x1=\"{LEFT}\" y1=\"{0:.1}\" x2=\"{width:.0}\" y2=\"{0:.1}\" stroke=\"#b35900\" \
                 stroke-dasharray=\"4 3\"/>",
                y(limit)
            );
        }
    }
    for (column, (name, rms)) in page.placements.iter().zip(&found).enumerate() {
        let x = LEFT + CELL[0] * column as f64;
        if let Some(rms) = rms {
            let _ = write!(
                html,
                "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{}\" height=\"{:.1}\" fill=\"#27c\"><title>{}: {rms:.3} px</title>\
                 </rect>",
                x + 3.0,
                y(*rms),
                CELL[0] - 8.0,
                y(0.0) - y(*rms),
                escaped(name)
            );
        }
    }
}

/// The placements' figures.
pub(super) fn table(html: &mut String, page: &CalibrationPage<'_>) {
    *html += "<h2>Placements</h2>\n<div class=\"wide\"><table><tr><th>placement</th><th>cameras</th><th>corners</th><th>rms \
              px</th><th>median</th><th>largest</th><th>middle, m</th></tr>\n";
    for placement in &page.fit.placements {
        let f = &placement.figures;
        let board = &page.fit.board;
        let first = board.corner_position(0, 0);
        let last = board.corner_position(board.columns - 1, board.rows - 1);
        let middle = placement.rig_from_board * nalgebra::center(&first, &last);
        let is_table = if placement.name == page.fit.table {
            " (table)"
        } else {
            ""
        };
        let _ = writeln!(
            html,
            "<tr><td>{}{is_table}</td><td>{}</td><td>{}</td><td class=\"{}\">{:.3}</td><td>{:.3}</td><td>{:.2}</td>\
             <td>{:.3}, {:.3}, {:.3}</td></tr>",
            escaped(&placement.name),
            placement.cameras,
            f.corners,
            by_rms(f.rms_px, page.limits),
            f.rms_px,
            f.median_px,
            f.max_px,
            middle.x,
            middle.y,
            middle.z,
        );
    }
    *html += "</table></div>\n";
}

//! The cameras: their figures as a table, and a picture for each with the board's positions and the residuals.

use super::{ARROW_PX, CalibrationPage, by_rms};
use crate::calibration::fit::{Fit, FittedCamera};
use crate::markup::escaped;
use std::fmt::Write;

/// Width of a camera's picture on the page, in its pixels.
const WIDTH: f64 = 320.0;
/// Cells along each side for which it is shown whether the board was there, as coverage counts them.
const CELLS: usize = 10;
/// Length on the page of an arrow for a residual of [`ARROW_PX`], which is a cell's width, and of the longest.
const ARROW: f64 = WIDTH / CELLS as f64;
const LONGEST_ARROW: f64 = 64.0;
/// Height below a picture for the scale of its arrows.
const SCALE_HEIGHT: f64 = 18.0;
/// Most arrows a camera: thousands hide each other.
const MOST_ARROWS: usize = 1500;

pub(super) fn table(html: &mut String, page: &CalibrationPage<'_>) {
    *html += "<h2>Cameras</h2>\n<div class=\"wide\"><table><tr><th>camera</th><th>views</th><th>rms px</th><th>median</th><th>largest</th>\
              <th>false corners</th><th>seen %</th><th>focal px</th><th>&plusmn;</th><th>centre px</th>\
              <th>&plusmn;</th><th>place &plusmn; mm</th><th>turn &plusmn; &deg;</th><th>at the object &plusmn; mm</th></tr>\n";
    for camera in &page.fit.cameras {
        row(html, camera, page);
    }
    *html += "</table></div>\n";
}

fn row(html: &mut String, camera: &FittedCamera, page: &CalibrationPage<'_>) {
    let (f, u, lens) = (
        &camera.figures,
        &camera.uncertainty,
        &camera.camera.intrinsics,
    );
    let largest = |of: &[f64]| of.iter().copied().fold(0.0, f64::max);
    let at_object = match &camera.projection {
        Some(projection) => format!("{:.3}", 1e3 * projection.at_object),
        None => "&ndash;".to_owned(),
    };
    let ok = |is_ok: bool| if is_ok { "" } else { "poor" };
    let _ = writeln!(
        html,
        "<tr><td>{}</td><td class=\"{}\">{}</td><td class=\"{}\">{:.3}</td><td>{:.3}</td><td>{:.2}</td><td>{}</td>\
         <td class=\"{}\">{:.0}</td><td>{:.2}, {:.2}</td><td>{:.2}</td><td>{:.2}, {:.2}</td><td>{:.2}</td><td>{:.3}</td>\
         <td>{:.4}</td><td>{}</td></tr>",
        escaped(camera.camera.id.as_str()),
        ok(camera.views >= page.limits.views),
        camera.views,
        by_rms(f.rms_px, page.limits),
        f.rms_px,
        f.median_px,
        f.max_px,
        camera.false_corners,
        ok(camera.coverage >= page.limits.coverage),
        100.0 * camera.coverage,
        lens.focal_px.x,
        lens.focal_px.y,
        largest(&u.focal_px),
        lens.center_px.x,
        lens.center_px.y,
        largest(&u.center_px),
        1e3 * largest(&u.position),
        largest(&u.rotation_degrees),
        at_object,
    );
}

/// A picture a camera: cells where the board was seen, and the residuals as arrows.
pub(super) fn pictures(html: &mut String, fit: &Fit) {
    let _ = write!(
        html,
        "<h2>What each camera saw</h2>\n<p>Grey: where the board was. Arrows: from where a corner was seen to where it is \
         predicted, many times too long, the same for all cameras: {ARROW_PX} px are as long as a cell is wide.</p>\n<div \
         class=\"pictures\">"
    );
    for index in 0..fit.cameras.len() {
        picture(html, fit, index);
    }
    *html += "</div>\n";
}

fn picture(html: &mut String, fit: &Fit, index: usize) {
    let camera = &fit.cameras[index];
    let lens = &camera.camera.intrinsics;
    let scale = WIDTH / lens.width as f64;
    let height = lens.height as f64 * scale;
    let of_camera = fit.residuals.iter().filter(|view| view.camera == index);
    let corners: Vec<_> = of_camera.flat_map(|view| &view.corners).collect();
    let enlarged = ARROW / ARROW_PX;
    let whole = height + SCALE_HEIGHT;
    let _ = write!(
        html,
        "<figure><svg width=\"{WIDTH}\" height=\"{whole:.0}\" viewBox=\"0 0 {WIDTH} {whole:.1}\">"
    );
    let (w, h) = (WIDTH / CELLS as f64, height / CELLS as f64);
    let mut seen = [[false; CELLS]; CELLS];
    for (pixel, _) in &corners {
        let cell = |v: f64, side: usize| (v.max(0.0) / side as f64 * CELLS as f64) as usize;
        let (i, j) = (cell(pixel.x, lens.width), cell(pixel.y, lens.height));
        seen[j.min(CELLS - 1)][i.min(CELLS - 1)] = true;
    }
    for (j, row) in seen.iter().enumerate() {
        for (i, _) in row.iter().enumerate().filter(|(_, seen)| **seen) {
            let (x, y) = (i as f64 * w, j as f64 * h);
            let _ = write!(
                html,
                "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{w:.1}\" height=\"{h:.1}\" fill=\"#dde4ea\"/>"
            );
        }
    }
    let every = corners.len().div_ceil(MOST_ARROWS).max(1);
    let mut path = String::new();
    for (pixel, residual) in corners.iter().step_by(every) {
        let (x, y) = ((pixel.x + 0.5) * scale, (pixel.y + 0.5) * scale);
        let length = residual.norm() * enlarged;
        let arrow = residual * (enlarged * (LONGEST_ARROW / length.max(LONGEST_ARROW)));
        let _ = write!(path, "M{x:.1} {y:.1}l{:.1} {:.1}", arrow.x, arrow.y);
    }
    let _ = writeln!(
        html,
        "<path d=\"{path}\" stroke=\"#c01616\" stroke-width=\"0.8\" fill=\"none\"/><path d=\"M0 {height:.1}H{WIDTH}\" \
         stroke=\"#ccc\"/><path d=\"M6 {0:.1}h{ARROW}\" stroke=\"#c01616\" stroke-width=\"1.3\"/><text x=\"{1:.0}\" \
         y=\"{2:.1}\">{ARROW_PX} px</text></svg><figcaption><b>{3}</b>: {4} corners in {5} views</figcaption></figure>",
        height + 9.0,
        ARROW + 12.0,
        height + 13.0,
        escaped(camera.camera.id.as_str()),
        corners.len(),
        camera.views,
    );
}

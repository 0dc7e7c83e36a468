//! How well each camera's lines of sight are known over its picture, where objects stand.

use crate::calibration::fit::{Fit, FittedCamera, Projection};
use crate::markup::escaped;
use std::fmt::Write;

/// Width of a map on the page, in its pixels.
const WIDTH: f64 = 320.0;

/// A map for each camera, in one scale of colours.
pub(super) fn maps(html: &mut String, fit: &Fit) {
    let known: Vec<(&FittedCamera, &Projection)> = fit
        .cameras
        .iter()
        .filter_map(|camera| Some((camera, camera.projection.as_ref()?)))
        .collect();
    let values = known.iter().flat_map(|(_, p)| p.map_px.iter().flatten());
    let most = values.copied().fold(0.0, f64::max);
    if most <= 0.0 {
        return;
    }
    *html += "<h2>How well lines of sight are known</h2>\n<p>One standard deviation over each picture, in thousandths of a \
              pixel, of points as far away as the middle of the volume. The darker, the less is known; a large value in a \
              corner means that the board should be shown there. The colours are the same for all cameras.</p>\n<div \
              class=\"pictures\">";
    for (camera, projection) in known {
        map(html, camera, projection, most);
    }
    *html += "</div>\n";
}

fn map(html: &mut String, camera: &FittedCamera, projection: &Projection, most: f64) {
    let lens = &camera.camera.intrinsics;
    let [columns, rows] = Projection::MAP;
    let height = lens.height as f64 * WIDTH / lens.width as f64;
    let (w, h) = (WIDTH / columns as f64, height / rows as f64);
    let _ = write!(
        html,
        "<figure><svg width=\"{WIDTH}\" height=\"{height:.0}\" viewBox=\"0 0 {WIDTH} {height:.1}\">"
    );
    for (index, value) in projection.map_px.iter().enumerate() {
        let (x, y) = ((index % columns) as f64 * w, (index / columns) as f64 * h);
        let (shade, words) = match value {
            Some(px) => (0.8 * px / most, format!("{:.0}", 1e3 * px)),
            None => (0.0, "&ndash;".to_owned()),
        };
        let _ = write!(
            html,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{w:.1}\" height=\"{h:.1}\" fill=\"#d08020\" \
             fill-opacity=\"{shade:.2}\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{words}</text>",
            x + 0.5 * w,
            y + 0.5 * h + 4.0,
        );
    }
    let _ = writeln!(
        html,
        "</svg><figcaption><b>{}</b>: {:.3} px at the object</figcaption></figure>",
        escaped(camera.camera.id.as_str()),
        projection.rms_px,
    );
}

//! The depth cameras: bias by distance, before and after, and each board against its plane.

use super::CalibrationPage;
use crate::calibration::fit::Limits;
use crate::calibration::response::PlaneFit;
use crate::markup::escaped;
use crate::words::count;
use std::fmt::Write;

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 220.0;
const LEFT: f64 = 54.0;
const BOTTOM: f64 = 26.0;

pub(super) fn section(html: &mut String, page: &CalibrationPage<'_>) {
    if page.depths.is_empty() && page.depth_words.is_empty() {
        return;
    }
    *html += "<h2>Depth</h2>\n";
    for (id, fit) in page.depths {
        let r = &fit.response;
        let _ = writeln!(
            html,
            "<p><b>{}</b>: z = {:.6}&middot;r {:+.4} m, lateral scale {:.4} {:+.4}&middot;z, from {}.</p>",
            escaped(id.as_str()),
            r.slope,
            r.intercept,
            r.scale[0],
            r.scale[1],
            count(fit.views.len(), "board")
        );
        chart(html, fit);
        table(html, fit, page.limits);
        correction(html, fit);
    }
    if !page.depth_words.is_empty() {
        *html += "<ul>";
        for words in page.depth_words {
            let _ = write!(html, "<li>{}</li>", escaped(words));
        }
        *html += "</ul>\n";
    }
}

/// Each board's bias over its distance, and the steps' means.
fn chart(html: &mut String, fit: &PlaneFit) {
    let biases = fit
        .views
        .iter()
        .map(|v| v.bias)
        .chain(fit.bias.iter().map(|b| b.bias));
    let most = biases.map(f64::abs).fold(2e-4, f64::max) * 1.2;
    let distances = fit
        .views
        .iter()
        .map(|v| v.distance)
        .chain(fit.bias.iter().map(|b| b.distance));
    let (near, far) = distances.fold((f64::MAX, 0.0_f64), |(a, b), d| (a.min(d), b.max(d)));
    let span = (far - near).max(0.05);
    let x = |d: f64| LEFT + (d - near + 0.05 * span) / (1.1 * span) * (WIDTH - LEFT - 8.0);
    let y = |b: f64| 0.5 * (HEIGHT - BOTTOM) * (1.0 - b / most);
    let _ = write!(
        html,
        "<svg width=\"{WIDTH}\" height=\"{HEIGHT}\" viewBox=\"0 0 {WIDTH} {HEIGHT}\"><line x1=\"{LEFT}\" y1=\"{0:.1}\" \
         x2=\"{WIDTH}\" y2=\"{0:.1}\" stroke=\"#999\"/>",
        y(0.0)
    );
    for bias in [most / 1.2, 0.0, -most / 1.2] {
        let _ = write!(
            html,
            "<text x=\"4\" y=\"{:.1}\">{:+.2} mm</text>",
            y(bias) + 4.0,
            1e3 * bias
        );
    }
    for d in [near, 0.5 * (near + far), far] {
        let _ = write!(
            html,
            "<text x=\"{:.1}\" y=\"{:.1}\">{d:.2} m</text>",
            x(d) - 16.0,
            HEIGHT - 8.0
        );
    }
    for view in &fit.views {
        let _ = write!(
            html,
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3.5\" fill=\"#27c\"><title>{}: {:+.2} mm at {:.2} m, {:.0}&deg;</title>\
             </circle>",
            x(view.distance),
            y(view.bias),
            escaped(&view.placement),
            1e3 * view.bias,
            view.distance,
            view.tilt_degrees
        );
    }
    let points: Vec<String> = fit
        .bias
        .iter()
        .map(|b| format!("{:.1},{:.1}", x(b.distance), y(b.bias)))
        .collect();
    let _ = write!(
        html,
        "<polyline points=\"{}\" fill=\"none\" stroke=\"#c01616\"/></svg>\n<p>Blue: boards; red: the mean by distance, after the \
         fit.</p>\n",
        points.join(" ")
    );
}

fn table(html: &mut String, fit: &PlaneFit, limits: &Limits) {
    *html += "<table><tr><th>distance m</th><th>boards</th><th>pixels</th><th>bias mm</th><th>before mm</th>\
              <th>spread mm</th></tr>\n";
    for b in &fit.bias {
        let fine = 1e3 * b.bias.abs() <= limits.depth_bias_mm;
        let class = if fine { "good" } else { "bad" };
        let _ = writeln!(
            html,
            "<tr><td>{:.2}</td><td>{}</td><td>{}</td><td class=\"{class}\">{:+.2}</td><td>{:+.1}</td><td>{:.2}</td></tr>",
            b.distance,
            b.views,
            b.pixels,
            1e3 * b.bias,
            1e3 * b.bias_before,
            1e3 * b.spread
        );
    }
    *html += "</table>\n";
}

fn correction(html: &mut String, fit: &PlaneFit) {
    let c = &fit.correction;
    let verdict = if c.pays {
        "would help"
    } else {
        "would not help"
    };
    let _ = writeln!(
        html,
        "<p>A smooth correction of each pixel {verdict}: on boards held out {:.2} mm without it, {:.2} mm with it, at 1 \
         m.</p>",
        1e3 * c.held_out,
        1e3 * c.held_out_corrected
    );
}

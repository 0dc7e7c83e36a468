//! The rig: from above and to scale, and which cameras share how many views.

use crate::calibration::fit::Fit;
use crate::markup::escaped;
use nalgebra::{Point2, Point3, Vector3};
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use std::fmt::Write;

/// Side of the pictures on the page.
const SIDE: f64 = 560.0;
const MARGIN: f64 = 46.0;

/// Maps the rig's x and y into the picture: y up, to scale.
struct Plan {
    middle: [f64; 2],
    per_metre: f64,
}

impl Plan {
    fn of(points: &[Point3<f64>]) -> Self {
        let bound = |a: usize, pick: fn(f64, f64) -> f64, start| {
            points
                .iter()
                .map(|p| p[a])
                .filter(|v| v.is_finite())
                .fold(start, pick)
        };
        let low = [0, 1].map(|a| bound(a, f64::min, f64::MAX));
        let high = [0, 1].map(|a| bound(a, f64::max, f64::MIN));
        let span = (0..2).map(|a| high[a] - low[a]).fold(0.05, f64::max);
        Self {
            middle: [0, 1].map(|a| 0.5 * (low[a] + high[a])),
            per_metre: (SIDE - 2.0 * MARGIN) / span,
        }
    }

    fn at(&self, p: Point3<f64>) -> Point2<f64> {
        let off = [p.x - self.middle[0], p.y - self.middle[1]].map(|v| v * self.per_metre);
        Point2::new(0.5 * SIDE + off[0], 0.5 * SIDE - off[1])
    }
}

fn polygon(html: &mut String, plan: &Plan, corners: &[Point3<f64>], style: &str) {
    let points: Vec<String> = corners
        .iter()
        .map(|&p| plan.at(p))
        .map(|q| format!("{:.1},{:.1}", q.x, q.y))
        .collect();
    let _ = write!(html, "<polygon points=\"{}\" {style}/>", points.join(" "));
}

/// Cameras, boards and the volume from above.
pub(super) fn top_view(html: &mut String, fit: &Fit) {
    let centers: Vec<Point3<f64>> = fit.cameras.iter().map(|c| c.camera.center()).collect();
    let outline = fit.board.outline();
    let corners = [
        [outline.min[0], outline.min[1]],
        [outline.max[0], outline.min[1]],
        outline.max,
        [outline.min[0], outline.max[1]],
    ];
    let boards = fit
        .placements
        .iter()
        .map(|placement| corners.map(|[x, y]| placement.rig_from_board * Point3::new(x, y, 0.0)));
    let boards: Vec<[Point3<f64>; 4]> = boards.collect();
    let all: Vec<Point3<f64>> = centers
        .iter()
        .chain(boards.iter().flatten())
        .copied()
        .collect();
    let plan = Plan::of(&all);
    let _ = write!(
        html,
        "<h2>The rig from above, to scale</h2>\n<svg width=\"{SIDE}\" height=\"{SIDE}\" viewBox=\"0 0 {SIDE} {SIDE}\">"
    );
    for board in &boards {
        polygon(
            html,
            &plan,
            board,
            "fill=\"#8aa\" fill-opacity=\"0.12\" stroke=\"#8aa\"",
        );
    }
    if let Some(volume) = &fit.volume {
        let (a, b) = (volume.min, volume.max);
        let rectangle = [a, Point3::new(b.x, a.y, a.z), b, Point3::new(a.x, b.y, a.z)];
        let style = "fill=\"none\" stroke=\"#17702f\" stroke-dasharray=\"5 3\"";
        polygon(html, &plan, &rectangle, style);
    }
    axes(html, &plan);
    for camera in &fit.cameras {
        let camera = &camera.camera;
        let lens = &camera.intrinsics;
        let reach = 34.0 / plan.per_metre;
        let edge = |x: f64| {
            let side = (x - lens.center_px.x) / lens.focal_px.x;
            let ray = camera.rig_from_camera.rotation * Vector3::new(side, 0.0, 1.0).normalize();
            camera.center() + ray * reach
        };
        let wedge = [camera.center(), edge(0.0), edge(lens.width as f64)];
        polygon(
            html,
            &plan,
            &wedge,
            "fill=\"#27c\" fill-opacity=\"0.35\" stroke=\"#27c\"",
        );
        let q = plan.at(camera.center());
        let id = escaped(camera.id.as_str());
        let z = camera.center().z;
        let _ = write!(
            html,
            "<text x=\"{:.1}\" y=\"{:.1}\"><title>{id}, {z:.3} m above the table</title>{id}</text>",
            q.x + 4.0,
            q.y - 4.0
        );
    }
    scale_bar(html, &plan);
    *html += "</svg>\n<p>Blue: cameras and where they look. Grey: the boards. Dashed: what all cameras see. Red and \
              green: the rig's x and y, from its origin.</p>\n";
}

fn axes(html: &mut String, plan: &Plan) {
    let origin = plan.at(Point3::origin());
    for (axis, color) in [
        (Point3::new(0.1, 0.0, 0.0), "#c01616"),
        (Point3::new(0.0, 0.1, 0.0), "#17702f"),
    ] {
        let end = plan.at(axis);
        let _ = write!(
            html,
            "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"{color}\" stroke-width=\"2\"/>",
            origin.x, origin.y, end.x, end.y
        );
    }
}

fn scale_bar(html: &mut String, plan: &Plan) {
    let lengths = [0.01, 0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 5.0];
    let fitting = lengths
        .into_iter()
        .rfind(|l| l * plan.per_metre < 0.4 * SIDE);
    let length = fitting.unwrap_or(0.01);
    let (x, y) = (14.0, SIDE - 12.0);
    let end = x + length * plan.per_metre;
    let _ = write!(
        html,
        "<path d=\"M{x} {}V{y}H{end:.1}v-5\" fill=\"none\" stroke=\"#222\"/><text x=\"{:.1}\" y=\"{}\">{length} m</text>",
        y - 5.0,
        end + 5.0,
        y + 3.0
    );
}

/// Views that each pair of cameras shares: one line a pair, the wider the more.
pub(super) fn graph(html: &mut String, fit: &Fit) {
    let shared = shared_views(fit);
    let places = around(fit);
    let _ = write!(
        html,
        "<h2>Views that cameras share</h2>\n<svg width=\"{SIDE}\" height=\"{SIDE}\" viewBox=\"0 0 {SIDE} {SIDE}\">"
    );
    for (&[a, b], &count) in &shared {
        let is_link = fit.links.iter().any(|l| *l == [a, b] || *l == [b, a]);
        let color = if is_link { "#27c" } else { "#aab4bd" };
        let (p, q) = (places[a], places[b]);
        let width = 0.6 + 0.5 * (count as f64).min(16.0);
        let _ = write!(
            html,
            "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"{color}\" stroke-width=\"{width:.1}\" \
             stroke-opacity=\"0.55\"><title>{} and {}: {count}</title></line>",
            p.x,
            p.y,
            q.x,
            q.y,
            escaped(fit.cameras[a].camera.id.as_str()),
            escaped(fit.cameras[b].camera.id.as_str())
        );
        if is_link {
            let m = nalgebra::center(&p, &q);
            let _ = write!(
                html,
                "<text x=\"{:.1}\" y=\"{:.1}\">{count}</text>",
                m.x, m.y
            );
        }
    }
    for (camera, place) in fit.cameras.iter().zip(&places) {
        let _ = write!(
            html,
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"5\" fill=\"#27c\"/><text x=\"{:.1}\" y=\"{:.1}\">{}</text>",
            place.x,
            place.y,
            place.x + 7.0,
            place.y - 6.0,
            escaped(camera.camera.id.as_str())
        );
    }
    *html += "</svg>\n<p>Blue: the links by which the cameras were joined, with the number of placements that both \
              saw. A camera with a single thin line depends on few views.</p>\n";
}

fn shared_views(fit: &Fit) -> BTreeMap<[usize; 2], usize> {
    let mut of_placement: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for view in &fit.residuals {
        of_placement
            .entry(view.placement)
            .or_default()
            .push(view.camera);
    }
    let mut shared = BTreeMap::new();
    for cameras in of_placement.values() {
        for (k, &a) in cameras.iter().enumerate() {
            for &b in &cameras[k + 1..] {
                *shared.entry([a.min(b), a.max(b)]).or_default() += 1;
            }
        }
    }
    shared
}

/// Places on a circle in the order in which the cameras stand around the rig.
fn around(fit: &Fit) -> Vec<Point2<f64>> {
    let count = fit.cameras.len();
    let sum = fit
        .cameras
        .iter()
        .map(|c| c.camera.center().coords)
        .sum::<Vector3<f64>>();
    let middle = sum / count.max(1) as f64;
    let angle = |k: usize| {
        let off = fit.cameras[k].camera.center().coords - middle;
        off.y.atan2(off.x)
    };
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|&a, &b| angle(a).total_cmp(&angle(b)));
    let mut places = vec![Point2::origin(); count];
    for (rank, &k) in order.iter().enumerate() {
        let at = TAU * rank as f64 / count.max(1) as f64 - PI;
        let r = 0.5 * SIDE - MARGIN;
        places[k] = Point2::new(0.5 * SIDE + r * at.cos(), 0.5 * SIDE - r * at.sin());
    }
    places
}

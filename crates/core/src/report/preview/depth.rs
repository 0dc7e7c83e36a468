//! A depth camera's panels: its picture, its readings, the enhanced depth, how far this lies behind the hull, the
//! region that was restored, and the model as the camera would see it.

use super::canvas::{EMPTY, blend, ramp};
use super::views::{drawn, in_color, provenance_color};
use super::window::Window;
use crate::image::{Grid, PixelRect, RgbImage};
use crate::reconstruct::depth::DepthKind;
use crate::reconstruct::{DepthResult, DepthView, Model, Provenance};

/// Near to far.
const DEPTH_RAMP: [[u8; 3]; 6] = [
    [253, 231, 37],
    [122, 209, 81],
    [34, 168, 132],
    [42, 120, 142],
    [65, 68, 135],
    [68, 1, 84],
];
/// From in front of the hull over on it to behind.
const DIFFERENCE_RAMP: [[u8; 3]; 5] = [
    [40, 90, 220],
    [130, 165, 225],
    [225, 225, 225],
    [240, 150, 90],
    [190, 25, 35],
];
/// The border of a region.
const BORDER: [u8; 3] = [255, 255, 255];

/// One depth camera's panels, each with its caption.
pub(super) type DepthPanels = Vec<(String, RgbImage)>;

/// Draws one depth camera's panels.
pub(super) fn draw(
    view: &DepthView,
    result: &DepthResult,
    model: &Model,
    size: (usize, usize),
) -> DepthPanels {
    let window = Window::around(object(result), size);
    let (near, far) = range(result);
    let color = view.frames.first().and_then(|f| f.color.as_deref());
    let photograph = |x, y| color.and_then(|c| c.get(x, y).copied()).unwrap_or(EMPTY);
    let depth = |metres: f32| {
        if metres > 0.0 {
            ramp(&DEPTH_RAMP, (metres - near) / (far - near))
        } else {
            EMPTY
        }
    };
    let reading = |x, y| {
        let raw = view.frames.first().and_then(|f| f.readings.get(x, y));
        let metres = raw.and_then(|&r| view.camera.response.depth(r));
        depth(metres.unwrap_or(0.0) as f32)
    };
    let enhanced = |x, y| depth(result.enhanced.depth.get(x, y).copied().unwrap_or(0.0));
    let limit = limit(&result.regions.difference);
    let labels = &result.regions.labels;
    let difference = |x, y| match result.regions.difference.get(x, y) {
        Some(f) if f.is_finite() => ramp(&DIFFERENCE_RAMP, 0.5 + 0.5 * f / limit),
        _ => EMPTY,
    };
    let restored = |x: isize, y: isize| {
        let under = photograph(x, y);
        match labels.get(x, y) {
            Some(&label) if label > 0 => {
                let measured = result.enhanced.kind.get(x, y) == Some(&DepthKind::Measured);
                let kind = if measured {
                    Provenance::Restored
                } else {
                    Provenance::Bridged
                };
                blend(under, provenance_color(kind), 0.6)
            }
            _ => blend(under, EMPTY, 0.35),
        }
    };
    let with_border = |mut panel: RgbImage| {
        outline(&mut panel, &window, labels);
        panel
    };
    let project = |p| window.panel_from_picture(view.camera.project_for_raster(p));
    let drawn = drawn(model, &window, view.camera.camera.center().cast(), project);
    let millimetres = |metres: f32| format!("{:.0}", 1e3 * metres);
    vec![
        (
            format!("{} sees", view.camera.camera.id),
            window.nearest(photograph),
        ),
        ("one frame of its depth".to_owned(), window.nearest(reading)),
        (
            format!("enhanced, {} to {} mm", millimetres(near), millimetres(far)),
            window.nearest(enhanced),
        ),
        (
            format!("behind the hull, +-{} mm", millimetres(limit)),
            with_border(window.nearest(difference)),
        ),
        (
            restored_caption(result),
            with_border(window.nearest(restored)),
        ),
        ("the model from there".to_owned(), in_color(model, &drawn)),
    ]
}

fn restored_caption(result: &DepthResult) -> String {
    let free_space = result.regions.free_space().len();
    match (result.regions.count.saturating_sub(free_space), free_space) {
        (0, 0) => "no concave region".to_owned(),
        (1, 0) => "restored region".to_owned(),
        (n, 0) => format!("{n} restored regions"),
        (n, free) => format!("{n} restored, {free} free space"),
    }
}

/// The pixels that the hull covers; the whole picture where it covers none.
fn object(result: &DepthResult) -> PixelRect {
    let depth = &result.regions.front.depth;
    let mut rect: Option<PixelRect> = None;
    for y in 0..depth.height() {
        let row = depth.row(y);
        let Some(x0) = row.iter().position(|d| d.is_finite()) else {
            continue;
        };
        let x1 = row.iter().rposition(|d| d.is_finite()).unwrap_or(x0) + 1;
        let r = rect.get_or_insert(PixelRect {
            x0,
            y0: y,
            x1,
            y1: y,
        });
        *r = PixelRect {
            x0: r.x0.min(x0),
            y0: r.y0,
            x1: r.x1.max(x1),
            y1: y + 1,
        };
    }
    rect.unwrap_or_else(|| PixelRect::whole(depth.width(), depth.height()))
}

/// The nearest and the farthest of the enhanced depth, and never the same.
fn range(result: &DepthResult) -> (f32, f32) {
    let depths = result.enhanced.depth.pixels().iter().filter(|&&d| d > 0.0);
    let (near, far) = depths.fold((f32::MAX, 0f32), |(n, f), &d| (n.min(d), f.max(d)));
    if near < far { (near, far) } else { (0.0, 1.0) }
}

/// A round number of metres that most of the difference is within.
fn limit(difference: &Grid<f32>) -> f32 {
    let finite = difference.pixels().iter().filter(|f| f.is_finite());
    let greatest = finite.fold(0f32, |most, f| most.max(f.abs()));
    let steps = [0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5];
    steps
        .into_iter()
        .find(|&s| 0.9 * greatest <= s)
        .unwrap_or(1.0)
}

/// Draws the regions' borders two pixels wide.
fn outline(panel: &mut RgbImage, window: &Window, labels: &Grid<u16>) {
    let (columns, rows) = window.samples(1);
    let label = |x: usize, y: usize| labels.get(columns[x], rows[y]).copied().unwrap_or(0);
    let of_panel = Grid::from_fn(panel.width(), panel.height(), label);
    for y in 1..panel.height() {
        for x in 1..panel.width() {
            let here = of_panel[(x, y)];
            if here != of_panel[(x - 1, y)] || here != of_panel[(x, y - 1)] {
                for (bx, by) in [(x, y), (x - 1, y), (x, y - 1), (x - 1, y - 1)] {
                    panel[(bx, by)] = BORDER;
                }
            }
        }
    }
}

//! Every camera's silhouette with the model's outline over it.

use super::canvas::{EMPTY, blend, frame};
use super::window::Window;
use crate::image::{Grid, RgbImage};
use crate::mesh::{Mesh, rasterize_mesh};
use crate::reconstruct::ColorView;
use crate::reconstruct::silhouette::Silhouette;

/// What is object.
const OBJECT: [u8; 3] = [118, 128, 145];
/// The model's outline.
const OUTLINE: [u8; 3] = [255, 214, 0];
/// What is object and not model.
const UNCOVERED: [u8; 3] = [235, 45, 60];
/// What is not looked at.
const UNKNOWN: [u8; 3] = [70, 62, 52];
/// What is model and not object.
const BESIDE: [u8; 3] = [70, 130, 255];

/// Draws one camera's silhouette under the outline of a `coarse` model; `alarm` frames it.
pub(super) fn draw(
    view: &ColorView,
    silhouette: &Silhouette,
    coarse: &Mesh,
    size: (usize, usize),
    alarm: Option<[u8; 3]>,
) -> RgbImage {
    let window = Window::around(silhouette.bounds, size);
    let project = |p| window.panel_from_picture(view.camera.project_for_raster(p));
    let model = rasterize_mesh(coarse, project, size.0, size.1).map(|f| f.is_covered());
    let (columns, rows) = window.samples(2);
    let mut picture = RgbImage::from_fn(size.0, size.1, |x, y| {
        let level = level(silhouette, &columns[2 * x..][..2], &rows[2 * y..][..2]);
        let object = blend(EMPTY, OBJECT, level);
        let is_unknown = is_unknown(silhouette, columns[2 * x], rows[2 * y]);
        match (model[(x, y)], is_edge(&model, x, y)) {
            (_, true) => OUTLINE,
            _ if is_unknown => UNKNOWN,
            (false, _) => blend(object, UNCOVERED, 0.9 * level),
            (true, _) => blend(object, BESIDE, 0.8 * (1.0 - level)),
        }
    });
    if let Some(color) = alarm {
        frame(&mut picture, 3, color);
    }
    picture
}

/// The part of a panel's pixel that is silhouette, from samples in two columns and two rows of the picture.
fn level(silhouette: &Silhouette, columns: &[isize], rows: &[isize]) -> f32 {
    let mut sum = 0.0;
    for &y in rows {
        for &x in columns {
            let level = silhouette.level.get(x, y);
            sum += level.map_or(0.0, |&l| f32::from(l) / 255.0);
        }
    }
    0.25 * sum
}

/// Whether the silhouette says nothing of a pixel.
fn is_unknown(silhouette: &Silhouette, x: isize, y: isize) -> bool {
    let mask = silhouette.unknown.as_ref();
    mask.and_then(|mask| mask.get(x, y))
        .is_some_and(|&m| m >= 128)
}

/// Whether a covered pixel has a neighbour that is not.
fn is_edge(model: &Grid<bool>, x: usize, y: usize) -> bool {
    let (x, y) = (x as isize, y as isize);
    let free = |dx, dy| model.get(x + dx, y + dy) == Some(&false);
    model[(x as usize, y as usize)] && (free(-1, 0) || free(1, 0) || free(0, -1) || free(0, 1))
}

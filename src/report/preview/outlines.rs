//! Every camera's silhouette with the model's outline over it.

use super::canvas::{EMPTY, blend, frame};
use super::window::Window;
use crate::image::{Grid, RgbImage};
use crate::mesh::{Mesh, rasterize_mesh};
use crate::reconstruct::ColorView;
use crate::reconstruct::silhouette::Silhouette;
use nalgebra::{Point3, Vector3};

/// What is object.
const OBJECT: [u8; 3] = [118, 128, 145];
/// The model's outline.
const OUTLINE: [u8; 3] = [255, 214, 0];
/// What is object and not model.
const UNCOVERED: [u8; 3] = [235, 45, 60];
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
    let mut picture = RgbImage::from_fn(size.0, size.1, |x, y| {
        let level = level(silhouette, &window, x, y);
        let object = blend(EMPTY, OBJECT, level);
        match (model[(x, y)], is_edge(&model, x, y)) {
            (_, true) => OUTLINE,
            (false, _) => blend(object, UNCOVERED, 0.9 * level),
            (true, _) => blend(object, BESIDE, 0.8 * (1.0 - level)),
        }
    });
    if let Some(color) = alarm {
        frame(&mut picture, 3, color);
    }
    picture
}

/// The part of a panel's pixel that is silhouette, from four samples.
fn level(silhouette: &Silhouette, window: &Window, x: usize, y: usize) -> f32 {
    let mut sum = 0.0;
    for (dx, dy) in [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)] {
        let (px, py) = window.picture_from_panel(x as f64 + dx, y as f64 + dy);
        let level = silhouette
            .level
            .get(px.round() as isize, py.round() as isize);
        sum += level.map_or(0.0, |&l| f32::from(l) / 255.0);
    }
    0.25 * sum
}

/// Whether a covered pixel has a neighbour that is not.
fn is_edge(model: &Grid<bool>, x: usize, y: usize) -> bool {
    let (x, y) = (x as isize, y as isize);
    let free = |dx, dy| model.get(x + dx, y + dy) == Some(&false);
    model[(x as usize, y as usize)] && (free(-1, 0) || free(1, 0) || free(0, -1) || free(0, 1))
}

/// A mesh with the vertices of each cell of a grid of edge `cell` merged into their mean: enough for an
/// outline, and drawn in a fraction of the time. Not manifold.
pub(super) fn coarse(mesh: &Mesh, cell: f32) -> Mesh {
    let key = |v: &Point3<f32>| {
        let at = |c: f32| ((c / cell).floor() as i64 + (1 << 20)) as u64 & 0x1f_ffff;
        at(v.x) << 42 | at(v.y) << 21 | at(v.z)
    };
    let keys = mesh.vertices.iter().zip(0u32..);
    let mut order: Vec<(u64, u32)> = keys.map(|(v, i)| (key(v), i)).collect();
    order.sort_unstable();
    let mut of_vertex = vec![0u32; mesh.vertices.len()];
    let mut vertices = Vec::new();
    for group in order.chunk_by(|a, b| a.0 == b.0) {
        let mut sum = Vector3::zeros();
        for &(_, vertex) in group {
            sum += mesh.vertices[vertex as usize].coords;
            of_vertex[vertex as usize] = vertices.len() as u32;
        }
        vertices.push(Point3::from(sum / group.len() as f32));
    }
    let merged = mesh
        .triangles
        .iter()
        .map(|t| t.map(|v| of_vertex[v as usize]));
    let triangles = merged
        .filter(|[a, b, c]| a != b && b != c && c != a)
        .collect();
    Mesh {
        vertices,
        triangles,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    #[test]
    fn a_coarse_ball_has_the_same_outline_and_few_vertices() {
        let ball = shapes::sphere(0.05, 5);
        let few = coarse(&ball, 0.005);
        assert!(few.vertices.len() * 5 < ball.vertices.len());
        let area = |mesh: &Mesh| {
            let project = |p: Point3<f32>| [60.0 + 1000.0 * p.x, 60.0 + 1000.0 * p.y, 1.0 + p.z];
            let drawn = rasterize_mesh(mesh, project, 120, 120);
            drawn.pixels().iter().filter(|f| f.is_covered()).count() as f64
        };
        assert!(
            (area(&few) / area(&ball) - 1.0).abs() < 0.03,
            "{}",
            area(&few) / area(&ball)
        );
    }
}

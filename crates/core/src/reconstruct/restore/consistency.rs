//! A restored model must still cover every silhouette. If a colour camera saw the object where it would now look
//! through an opening, the carving was too deep there and is undone.

use super::Template;
use crate::calibration::Volume;
use crate::image::Grid;
use crate::mesh::{Mesh, rasterize_closed};
use crate::reconstruct::hull::{Carving, Cone};
use crate::reconstruct::surface::UndecidedConstraints;
use nalgebra::{Point2, Point3, Vector3};
use rayon::prelude::*;

/// Longest side of the pictures in which coverage is checked, in pixels.
const CHECKED_SIDE: f64 = 640.0;

/// Undoes in `depths` (a grid for each of `carvings`, from which they were made) what opened `carved`, the
/// surface of the template carved by them, to the sight of a colour camera. Returns how many rays were closed.
pub(super) fn close_openings(
    template: &Template,
    carved: &Mesh,
    carvings: &[Carving],
    depths: &mut [Grid<f32>],
    cell_size: f64,
) -> usize {
    let open: Vec<Point3<f64>> = template
        .hull
        .cones()
        .par_iter()
        .flat_map_iter(|cone| openings(cone, template, carved, carvings, cell_size))
        .collect();
    for &p in &open {
        for (carving, depth) in carvings.iter().zip(&mut *depths) {
            if carving.carved_depth(p).is_some_and(|off| off > 0.0) {
                keep(p, carving, depth, cell_size);
            }
        }
    }
    open.len()
}

/// For each pixel of a silhouette that the carved surface no longer covers: the point of the hull on its ray
/// that was carved least.
fn openings<'a>(
    cone: &'a Cone,
    template: &'a Template,
    carved: &Mesh,
    carvings: &'a [Carving],
    cell_size: f64,
) -> impl Iterator<Item = Point3<f64>> + 'a {
    let lens = &cone.camera().intrinsics;
    let scale = (CHECKED_SIDE / lens.width.max(lens.height) as f64).min(1.0);
    let [width, height] = [lens.width, lens.height].map(|n| (n as f64 * scale) as usize);
    let project = |v: &Point3<f32>| {
        let [x, y, z] = cone.camera().project_for_raster(*v);
        [x * scale as f32, y * scale as f32, z]
    };
    let projected: Vec<_> = carved.vertices.iter().map(project).collect();
    let covered = rasterize_closed(&projected, &carved.triangles, width, height);
    let pixels = (0..height).flat_map(move |y| (0..width).map(move |x| (x, y)));
    pixels
        .filter(move |&(x, y)| !covered[(x, y)].is_covered())
        .filter_map(move |(x, y)| {
            let pixel = Point2::new(x as f64 / scale, y as f64 / scale);
            if !cone.is_well_inside(pixel) {
                return None;
            }
            least_carved(
                cone.camera().center(),
                cone.camera().ray(pixel)?,
                template,
                carvings,
                cell_size,
            )
        })
}

/// The point of the hull on a ray that lies least before a carving's surface; `None` where the ray misses
/// the hull or meets a point that nothing carves.
fn least_carved(
    origin: Point3<f64>,
    direction: Vector3<f64>,
    template: &Template,
    carvings: &[Carving],
    cell_size: f64,
) -> Option<Point3<f64>> {
    let volume = template.hull.volume();
    let reach = (volume.max - volume.min).norm();
    let middle = (nalgebra::center(&volume.min, &volume.max) - origin).dot(&direction);
    let start = middle - 0.5 * reach;
    let (enters, leaves) = within(&volume, origin, direction)?;
    let first = ((enters - start) / cell_size).floor().max(0.0) as usize;
    let last = ((leaves.min(middle + 0.5 * reach) - start) / cell_size).ceil();
    let mut least: Option<(f64, Point3<f64>)> = None;
    for step in first..last.max(0.0) as usize {
        let p = origin + direction * (start + step as f64 * cell_size);
        if template.solid.value(p, UndecidedConstraints::MAX) <= 0.0 {
            continue;
        }
        // The carving that took most off the point is the one that would have to be undone most.
        let taken = carvings.iter().filter_map(|c| c.carved_depth(p));
        let off = taken.max_by(f64::total_cmp).filter(|off| *off > 0.0)?;
        if least.is_none_or(|(least, _)| off < least) {
            least = Some((off, p));
        }
    }
    least.map(|(_, p)| p)
}

/// Where a ray enters and leaves the volume, as lengths along it; `None` where it misses it.
fn within(volume: &Volume, origin: Point3<f64>, direction: Vector3<f64>) -> Option<(f64, f64)> {
    let (mut enters, mut leaves) = (f64::NEG_INFINITY, f64::INFINITY);
    for axis in 0..3 {
        let to = |face: &Point3<f64>| (face[axis] - origin[axis]) / direction[axis];
        let (a, b) = (to(&volume.min), to(&volume.max));
        // Along a face both are infinite, or not a number and of no account.
        enters = enters.max(a.min(b));
        leaves = leaves.min(a.max(b));
    }
    (enters <= leaves).then_some((enters, leaves))
}

/// Keeps a carving from taking off a point: the pixels around carve no further than before it.
fn keep(p: Point3<f64>, carving: &Carving, depth: &mut Grid<f32>, cell_size: f64) {
    let Some((pixel, z)) = carving.camera().project(p) else {
        return;
    };
    let (x0, y0) = (pixel.x.floor() as isize, pixel.y.floor() as isize);
    for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let (x, y) = (x0 + dx, y0 + dy);
        if depth.get(x, y).is_some_and(|&d| d != 0.0) {
            let kept = &mut depth[(x as usize, y as usize)];
            *kept = kept.min((z - cell_size) as f32);
        }
    }
}

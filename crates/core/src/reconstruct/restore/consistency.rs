//! A restored model must still cover every silhouette. If a colour camera saw the object where it would now look
//! through an opening, the carving was too deep there and is undone. Where depth sees far behind all that could close
//! the opening, and few rays are open, the silhouette is ragged: it is not undone, or a fin would stand in the hollow.

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

/// A carving may be off by this many of the depth camera's pixels beside a step: what is farther than that from its
/// surface was seen to be empty.
const MISPLACED_PX: isize = 2;

/// Rays of each colour camera, on average, through what depth saw to be empty that a ragged silhouette may explain. Of
/// more, the depth camera is displaced.
const RAGGED_RAYS: usize = 4;

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
    let closed = to_close(&open, template.hull.cones().len(), carvings, cell_size);
    for &p in &closed {
        for (carving, depth) in carvings.iter().zip(&mut *depths) {
            if carving.carved_depth(p).is_some_and(|off| off > 0.0) {
                keep(p, carving, depth, cell_size);
            }
        }
    }
    closed.len()
}

/// Those of the points at which rays of `cameras` colour cameras are `open` that are to be closed.
fn to_close(
    open: &[Point3<f64>],
    cameras: usize,
    carvings: &[Carving],
    cell_size: f64,
) -> Vec<Point3<f64>> {
    let is_doubtful = |p: &Point3<f64>| carvings.iter().all(|c| may_be_undone(*p, c, cell_size));
    let (doubtful, empty): (Vec<_>, Vec<_>) = open.iter().copied().partition(is_doubtful);
    if empty.len() <= RAGGED_RAYS * cameras {
        doubtful
    } else {
        open.to_vec()
    }
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

/// Whether a carving leaves a point, or takes it off beside what it leaves: with its surface displaced by
/// [`MISPLACED_PX`] it would not.
fn may_be_undone(p: Point3<f64>, carving: &Carving, cell_size: f64) -> bool {
    if carving.carved_depth(p).is_none_or(|off| off <= 0.0) {
        return true;
    }
    let Some((pixel, z)) = carving.camera().project(p) else {
        return true;
    };
    (-MISPLACED_PX..=MISPLACED_PX).any(|dy| {
        (-MISPLACED_PX..=MISPLACED_PX).any(|dx| {
            let beside = Point2::new(pixel.x + dx as f64, pixel.y + dy as f64);
            carving
                .depth_at(beside)
                .is_none_or(|depth| depth - z <= cell_size)
        })
    })
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reconstruct::restore::testing::{SIDE, camera};

    #[test]
    fn what_depth_saw_empty_far_around_is_not_filled_up_again() {
        let camera = camera(0.8);
        // A wall's top at 0.7 m on the left, a floor at 0.8 m on the right.
        let first_of_floor = SIDE / 2;
        let depth = Grid::from_fn(
            SIDE,
            SIDE,
            |x, _| if x < first_of_floor { 0.7 } else { 0.8 },
        );
        let carving = Carving::new(&camera, depth, 1e-3);
        let undone = |x: f64, depth: f64| {
            let ray = camera.camera.ray(Point2::new(x, 5.0)).unwrap();
            may_be_undone(camera.camera.center() + ray * depth, &carving, 1e-3)
        };
        let floor = first_of_floor as f64;
        // Beside the wall it may be that the wall is misplaced; over the floor something would stand in free space.
        assert!(undone(floor + 0.9, 0.702));
        assert!(!undone(floor + 2.5, 0.702));
        // What is hardly carved may be undone anywhere.
        assert!(undone(floor + 2.5, 0.7995));
    }

    #[test]
    fn a_few_rays_over_what_depth_saw_empty_stay_open_and_a_strip_of_them_is_closed() {
        let camera = camera(0.8);
        let depth = Grid::filled(SIDE, SIDE, 0.8);
        let carvings = [Carving::new(&camera, depth, 1e-3)];
        let above =
            camera.camera.center() + camera.camera.ray(Point2::new(5.0, 5.0)).unwrap() * 0.7;
        let closed = |rays: usize| to_close(&vec![above; rays], 2, &carvings, 1e-3).len();
        assert_eq!(closed(2 * RAGGED_RAYS), 0);
        assert_eq!(closed(2 * RAGGED_RAYS + 1), 2 * RAGGED_RAYS + 1);
    }
}

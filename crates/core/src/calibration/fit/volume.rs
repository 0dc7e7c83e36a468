//! Proposes the volume: the space that all cameras see, from the table upwards.

use crate::calibration::{Camera, Volume};
use nalgebra::{Point3, Vector3};

/// Cells along the longest edge of the space that is looked at.
const CELLS: usize = 40;

/// The largest box found by growth around the middle of what all cameras see within `space`, with its floor at z = 0
/// where that is seen. `None` if there is no such point.
pub(super) fn proposed(cameras: &[&Camera], space: [Point3<f64>; 2]) -> Option<Volume> {
    let extent = space[1] - space[0];
    let step = extent.max() / CELLS as f64;
    let counts: [usize; 3] = std::array::from_fn(|i| ((extent[i] / step).ceil() as usize).max(1));
    let at = |cell: [usize; 3]| {
        let offset = Vector3::from_fn(|i, _| (cell[i] as f64 + 0.5) * step);
        space[0] + offset
    };
    let seen_by_all = |p: Point3<f64>| {
        cameras.iter().all(|camera| {
            let pixel = camera.project(p);
            pixel.is_some_and(|(pixel, _)| camera.intrinsics.contains(pixel))
        })
    };
    let [nx, ny, nz] = counts;
    let index = |c: [usize; 3]| (c[2] * ny + c[1]) * nx + c[0];
    let all: Vec<[usize; 3]> = (0..nz)
        .flat_map(|z| (0..ny).flat_map(move |y| (0..nx).map(move |x| [x, y, z])))
        .collect();
    let seen: Vec<bool> = all.iter().map(|&c| seen_by_all(at(c))).collect();
    let visible: Vec<_> = all.iter().filter(|&&c| seen[index(c)]).collect();
    let n = visible.len().max(1) as f64;
    let mean = visible.iter().map(|&&c| at(c).coords).sum::<Vector3<f64>>() / n;
    let distance = |c: &[usize; 3]| (at(*c).coords - mean).norm();
    let start = **visible
        .iter()
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
    let (min, max) = grown(start, counts, |c| seen[index(c)]);
    let low = at(min) - Vector3::repeat(step / 2.0);
    let high = at(max) + Vector3::repeat(step / 2.0);
    Volume::new(low, high).ok()
}

/// Grows a box from a cell by whole faces, as long as all cells of the face are `inside`.
fn grown(
    start: [usize; 3],
    counts: [usize; 3],
    inside: impl Fn([usize; 3]) -> bool,
) -> ([usize; 3], [usize; 3]) {
    let (mut min, mut max) = (start, start);
    loop {
        let before = (min, max);
        for axis in 0..3 {
            if max[axis] + 1 < counts[axis] && face(min, max, axis, max[axis] + 1).all(&inside) {
                max[axis] += 1;
            }
            if min[axis] > 0 && face(min, max, axis, min[axis] - 1).all(&inside) {
                min[axis] -= 1;
            }
        }
        if before == (min, max) {
            return before;
        }
    }
}

/// The cells of a box's cross-section at `at` along an axis.
fn face(
    min: [usize; 3],
    max: [usize; 3],
    axis: usize,
    at: usize,
) -> impl Iterator<Item = [usize; 3]> {
    let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
    (min[a]..=max[a]).flat_map(move |i| {
        (min[b]..=max[b]).map(move |j| {
            let mut cell = [0; 3];
            (cell[axis], cell[a], cell[b]) = (at, i, j);
            cell
        })
    })
}

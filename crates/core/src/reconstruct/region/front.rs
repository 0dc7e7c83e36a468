//! The hull as a depth camera sees it: the front surface S (equations 3 and 4), its depth Ds, and where a
//! ray first leaves the hull again.

use crate::calibration::DepthCamera;
use crate::image::{Grid, Mask};
use crate::mesh::{Fragment, Mesh, rasterize};
use crate::statistics::lower_median;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Renderings of the hull, of the size of the depth camera's pictures.
#[derive(Clone, Debug)]
pub struct HullRenderings {
    /// Depth of the nearest surface in metres; infinite where the hull is not.
    pub depth: Grid<f32>,
    /// Depth at which a ray first leaves the hull; infinite where the hull is not.
    pub exit: Grid<f32>,
    /// Whether the nearest surface belongs to the front surface S.
    pub is_front: Grid<bool>,
}

impl HullRenderings {
    /// Renders a hull with the vertex normals `normals`; `threshold` is T of equation 4.
    pub fn render(
        hull: &Mesh,
        normals: &[Vector3<f32>],
        camera: &DepthCamera,
        threshold: f32,
    ) -> Self {
        let (width, height) = (
            camera.camera.intrinsics.width,
            camera.camera.intrinsics.height,
        );
        let vertices = hull.vertices.par_iter();
        let projected: Vec<_> = vertices.map(|&v| camera.project_for_raster(v)).collect();
        let eye = camera.camera.center().cast();
        let away = || -> Vec<[u32; 3]> {
            let triangles = hull.triangles.iter().copied();
            triangles.filter(|t| faces_away(&projected, t)).collect()
        };
        let ((nearest, exit), in_front) = rayon::join(
            || {
                rayon::join(
                    || rasterize(&projected, &hull.triangles, width, height),
                    || rasterize(&projected, &away(), width, height).map(|f: &Fragment| f.depth),
                )
            },
            || front_vertices(hull, normals, eye, threshold),
        );
        let is_front = nearest.map(|fragment| {
            fragment.is_covered()
                && hull.triangles[fragment.triangle as usize]
                    .iter()
                    .filter(|&&v| in_front[v as usize])
                    .count()
                    >= 2
        });
        Self {
            depth: nearest.map(|f| f.depth),
            exit,
            is_front,
        }
    }

    /// The pixels that the object can cover: the hull's image, grown by `margin_px`. 255 and 0.
    pub fn object_pixels(&self, margin_px: usize) -> Mask {
        let mut mask = self.depth.map(|d| if d.is_finite() { 255 } else { 0 });
        for _ in 0..margin_px {
            mask = super::segment::dilate(&mask);
        }
        mask
    }

    /// Whether the hull's outline passes within two pixels.
    pub fn is_near_outline(&self, x: usize, y: usize) -> bool {
        let (x, y) = (x as isize, y as isize);
        (y - 2..=y + 2)
            .any(|y| (x - 2..=x + 2).any(|x| self.depth.get(x, y).is_some_and(|d| d.is_infinite())))
    }

    /// The most that the depth changes from a pixel to one beside it, in metres; infinite beside an outline.
    pub fn largest_change(&self, x: usize, y: usize) -> f32 {
        largest_change(x as isize, y as isize, |x, y| {
            self.depth.get(x, y).copied().unwrap_or(f32::INFINITY)
        })
    }

    /// Slope of the front surface in metres a pixel, from whichever neighbours are part of it.
    pub fn slope(&self, x: usize, y: usize) -> f32 {
        let here = self.depth[(x, y)];
        let to = |dx: isize, dy: isize| {
            let there = self.depth.get(x as isize + dx, y as isize + dy).copied();
            there.filter(|d| d.is_finite()).map(|d| (d - here).abs())
        };
        // The smaller of two sides: a step on one side is a contour and not a slope.
        let along = |a: Option<f32>, b: Option<f32>| match (a, b) {
            (Some(a), Some(b)) => a.min(b),
            (a, b) => a.or(b).unwrap_or(0.0),
        };
        along(to(-1, 0), to(1, 0)).hypot(along(to(0, -1), to(0, 1)))
    }
}

/// The most that a depth changes from a pixel to one beside it, in metres; infinite where that has none.
pub(super) fn largest_change(x: isize, y: isize, depth: impl Fn(isize, isize) -> f32) -> f32 {
    let here = depth(x, y);
    let beside = [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)];
    let change = beside.map(|(x, y)| (depth(x, y) - here).abs());
    change.into_iter().fold(0.0, f32::max)
}

/// Equations 3 and 4: vertices where the median of n·d over the vertex and its neighbours exceeds
/// `threshold`, with d the unit vector from the vertex to the depth camera at `eye`.
pub fn front_vertices(
    mesh: &Mesh,
    normals: &[Vector3<f32>],
    eye: Point3<f32>,
    threshold: f32,
) -> Vec<bool> {
    let facing = |(v, n): (&Point3<f32>, &Vector3<f32>)| {
        let towards = (eye - v).try_normalize(1e-12);
        n.dot(&towards.unwrap_or_else(Vector3::zeros))
    };
    let facing: Vec<f32> = mesh.vertices.iter().zip(normals).map(facing).collect();
    // All vertices' values one after the other: each vertex's own, then those of its neighbours.
    let mut starts = vec![0; facing.len() + 1];
    for &v in mesh.triangles.as_flattened() {
        starts[v as usize + 1] += 1;
    }
    for v in 0..facing.len() {
        starts[v + 1] += starts[v] + 1;
    }
    let mut values = vec![0.0; starts[facing.len()]];
    let mut next = starts.clone();
    for (&own, next) in facing.iter().zip(&mut next) {
        values[*next] = own;
        *next += 1;
    }
    for t in &mesh.triangles {
        // Each edge is met from both of its triangles; taking it in one direction lists a neighbour once.
        for i in 0..3 {
            let next = &mut next[t[i] as usize];
            values[*next] = facing[t[(i + 1) % 3] as usize];
            *next += 1;
        }
    }
    let of_vertex = |range: &[usize]| {
        let median = lower_median(&mut values[range[0]..range[1]]);
        median.is_some_and(|median| median > threshold)
    };
    starts.windows(2).map(of_vertex).collect()
}

/// Whether a triangle shows its back: seen from outside it is counter-clockwise, which in a picture with y
/// down has a negative area.
fn faces_away(projected: &[[f32; 3]], triangle: &[u32; 3]) -> bool {
    let [a, b, c] = triangle.map(|v| projected[v as usize]);
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0.0
}

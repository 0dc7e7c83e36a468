//! Computes bounding boxes, volumes and areas, summed in double precision.

use super::Mesh;
use nalgebra::{Point3, Vector3};

/// The lowest and the highest corner of the box around `points`; `None` of no points.
pub fn bounding_box(points: &[Point3<f32>]) -> Option<[Point3<f32>; 2]> {
    let first = *points.first()?;
    Some(
        points
            .iter()
            .fold([first; 2], |[low, high], p| [low.inf(p), high.sup(p)]),
    )
}

/// Signed volume (cubic metres; positive where triangles are counter-clockwise from outside) and area (square
/// metres) of a mesh. Triangles that name a missing vertex or hold a number that is not finite count nothing.
pub fn volume_and_total_area(mesh: &Mesh) -> (f64, f64) {
    let sound = |t: &&[u32; 3]| t.iter().all(|&v| (v as usize) < mesh.vertices.len());
    let each = mesh.triangles.iter().filter(sound);
    each.map(|t| volume_and_area(mesh, t))
        .fold((0.0, 0.0), |sum, one| (sum.0 + one.0, sum.1 + one.1))
}

/// What one triangle with existing vertices adds to volume and area.
pub(super) fn volume_and_area(mesh: &Mesh, triangle: &[u32; 3]) -> (f64, f64) {
    // Relative to a vertex of the mesh: far from the origin the parts would cancel badly.
    let origin = mesh.vertices[0].coords.cast::<f64>();
    let [a, b, c] = triangle.map(|v| mesh.vertices[v as usize].coords.cast::<f64>() - origin);
    let cross: Vector3<f64> = (b - a).cross(&(c - a));
    let (volume, area) = (a.dot(&b.cross(&c)) / 6.0, cross.norm() / 2.0);
    if volume.is_finite() && area.is_finite() {
        (volume, area)
    } else {
        (0.0, 0.0)
    }
}

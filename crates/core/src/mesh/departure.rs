//! How far a mesh is from the points that it stands for.

use super::{Bvh, Mesh};
use nalgebra::Point3;
use rayon::prelude::*;

/// For each vertex of a mesh the mean distance, in metres, between the triangles around it and those of `points` that
/// they are nearest to; 0 where these are none.
pub fn mean_departures(mesh: &Mesh, points: &[Point3<f32>]) -> Vec<f32> {
    let tree = Bvh::new(mesh);
    let nearest: Vec<_> = points
        .par_iter()
        .map(|p| tree.closest_point(p.cast()))
        .collect();
    let mut sums = vec![(0.0, 0u32); mesh.vertices.len()];
    for found in nearest.into_iter().flatten() {
        for corner in mesh.triangles[found.triangle] {
            let (sum, count) = &mut sums[corner as usize];
            *sum += found.distance;
            *count += 1;
        }
    }
    let mean = |(sum, count): (f64, u32)| (sum / f64::from(count.max(1))) as f32;
    sums.into_iter().map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    #[test]
    fn the_corners_of_the_nearest_triangle_depart_and_no_others() {
        let cube = shapes::cube(1.0);
        // Two points over one triangle of the upper side.
        let points = [1.25, 1.75].map(|z| Point3::new(0.5, 0.2, z));
        let departures = mean_departures(&cube, &points);
        let departing = departures.iter().filter(|&&d| (d - 0.5).abs() < 1e-6);
        assert_eq!(departing.count(), 3);
        assert_eq!(departures.iter().filter(|&&d| d == 0.0).count(), 5);
        let own = mean_departures(&cube, &cube.vertices);
        assert!(own.iter().all(|&d| d < 1e-6), "{own:?}");
    }
}

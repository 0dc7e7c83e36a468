//! Points spread evenly over a surface: the same ones on every run.

use crate::mesh::Mesh;
use nalgebra::Point3;

/// A point of a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Where it is.
    pub point: Point3<f64>,
    /// Index of the triangle it lies on.
    pub triangle: usize,
    /// Weights of the triangle's three corners, of sum 1.
    pub weights: [f64; 3],
}

/// The sequence R3 (Roberts 2018, "The unreasonable effectiveness of quasirandom sequences"): powers of the
/// inverse of the root of x⁴ = x + 1.
const STEPS: [f64; 3] = [0.819_172_513, 0.671_043_607, 0.549_700_478];

/// `count` points of equal shares of the area, in the order of the triangles; none where there is no area.
/// One point falls into each of `count` equal stretches of the summed area, so large and small triangles get
/// what is theirs to within one point.
pub fn sample(mesh: &Mesh, count: usize) -> Vec<Sample> {
    let mut ends = Vec::with_capacity(mesh.triangles.len());
    let mut total = 0.0;
    for t in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corners(t).map(|p| p.cast::<f64>());
        total += (b - a).cross(&(c - a)).norm() / 2.0;
        ends.push(total);
    }
    if !(total > 0.0 && total.is_finite()) {
        return Vec::new();
    }
    let mut triangle = 0;
    let at = |i: usize| {
        let [along, u, v] = STEPS.map(|step| (0.5 + step * (i + 1) as f64).fract());
        let area = (i as f64 + along) / count as f64 * total;
        while triangle + 1 < ends.len() && ends[triangle] <= area {
            triangle += 1;
        }
        place(mesh, triangle, u, v)
    };
    (0..count).map(at).collect()
}

/// The unit square folded onto the triangle.
fn place(mesh: &Mesh, triangle: usize, u: f64, v: f64) -> Sample {
    let (u, v) = if u + v > 1.0 {
        (1.0 - u, 1.0 - v)
    } else {
        (u, v)
    };
    let weights = [1.0 - u - v, u, v];
    let corners = mesh.corners(triangle).map(|p| p.coords.cast::<f64>());
    let point = corners[0] * weights[0] + corners[1] * weights[1] + corners[2] * weights[2];
    Sample {
        point: point.into(),
        triangle,
        weights,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    #[test]
    fn samples_lie_on_the_surface_in_proportion_to_area() {
        let mut mesh = shapes::cube(0.5);
        mesh.vertices.iter_mut().for_each(|v| v.z *= 3.0);
        let samples = sample(&mesh, 14_000);
        let on = |axis: usize, at: f64| {
            let near = |s: &&Sample| (s.point[axis] - at).abs() < 1e-9;
            samples.iter().filter(near).count()
        };
        // Faces of 3, 3, 3, 3, 1 and 1 of an area of 14.
        for (axis, at, wanted) in [
            (0, 0.5, 3000),
            (1, -0.5, 3000),
            (2, 1.5, 1000),
            (2, -1.5, 1000),
        ] {
            let found = on(axis, at);
            assert!(found.abs_diff(wanted) <= 2, "{found} of {wanted}");
        }
        let mean = samples
            .iter()
            .map(|s| s.point.coords)
            .sum::<nalgebra::Vector3<f64>>()
            / 14_000.0;
        assert!(mean.norm() < 2e-3, "{mean}");
    }

    #[test]
    fn quarters_of_a_triangle_get_a_quarter_each() {
        let mesh = Mesh {
            vertices: vec![
                [0.0, 0.0, 0.0].into(),
                [1.0, 0.0, 0.0].into(),
                [0.0, 1.0, 0.0].into(),
            ],
            triangles: vec![[0, 1, 2]],
        };
        let samples = sample(&mesh, 4000);
        for corner in 0..3 {
            let near = samples.iter().filter(|s| s.weights[corner] > 0.5).count();
            assert!(near.abs_diff(1000) < 20, "{near}");
        }
    }

    #[test]
    fn no_area_gives_no_samples() {
        let mut flat = shapes::cube(0.0);
        assert!(sample(&flat, 10).is_empty());
        flat.triangles.clear();
        assert!(sample(&flat, 10).is_empty());
        assert!(sample(&shapes::cube(1.0), 0).is_empty());
    }
}

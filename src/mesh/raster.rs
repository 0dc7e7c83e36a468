//! A z-buffer: which triangle is in front at each pixel. It is given vertices that someone else has already
//! projected, so it knows no camera.

use super::Mesh;
use crate::image::Grid;

/// What covers a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fragment {
    /// Depth along the optical axis, in metres; infinite where nothing is.
    pub depth: f32,
    /// Index of the nearest triangle; `u32::MAX` where nothing is.
    pub triangle: u32,
}

impl Fragment {
    /// A pixel that nothing covers.
    pub const EMPTY: Self = Self {
        depth: f32::INFINITY,
        triangle: u32::MAX,
    };

    /// Whether a triangle covers the pixel.
    pub fn is_covered(&self) -> bool {
        self.triangle != u32::MAX
    }
}

/// Draws `triangles` into a z-buffer of `width` x `height` pixels. `projected` holds for each vertex its
/// pixel coordinates and its depth (metres along the optical axis); a triangle with a vertex that is not
/// finite or not in front of the camera is left out. Both faces are drawn; depth is interpolated
/// perspectively; on equal depth the lower triangle index wins, so the result does not depend on threads.
pub fn rasterize(
    projected: &[[f32; 3]],
    triangles: &[[u32; 3]],
    width: usize,
    height: usize,
) -> Grid<Fragment> {
    let mut buffer = Grid::filled(width, height, Fragment::EMPTY);
    for (index, triangle) in triangles.iter().enumerate() {
        let corners = triangle.map(|v| projected[v as usize]);
        // A sum is finite only if all its parts are.
        let sum: f32 = corners.as_flattened().iter().sum();
        if sum.is_finite() && corners.iter().all(|c| c[2] > 0.0) {
            draw(&mut buffer, corners, index as u32);
        }
    }
    buffer
}

fn draw(buffer: &mut Grid<Fragment>, [a, b, c]: [[f32; 3]; 3], triangle: u32) {
    let (x0, x1) = pixel_range(a[0], b[0], c[0], buffer.width());
    let (y0, y1) = pixel_range(a[1], b[1], c[1], buffer.height());
    // Many triangles are smaller than a pixel and lie between the centres of pixels.
    if x0 >= x1 || y0 >= y1 {
        return;
    }
    let area = edge(a, b, c[0], c[1]);
    if area == 0.0 {
        return;
    }
    let side = area.signum();
    let inverse_depths = [a[2].recip(), b[2].recip(), c[2].recip()];
    for y in y0..y1 {
        let py = y as f32;
        for (x, fragment) in (x0..x1).zip(&mut buffer.row_mut(y)[x0..x1]) {
            let px = x as f32;
            let weights = [edge(b, c, px, py), edge(c, a, px, py), edge(a, b, px, py)];
            if weights.iter().any(|w| w * side < 0.0) {
                continue;
            }
            let depth = (weights[0] + weights[1] + weights[2])
                / (weights[0] * inverse_depths[0]
                    + weights[1] * inverse_depths[1]
                    + weights[2] * inverse_depths[2]);
            if depth < fragment.depth {
                *fragment = Fragment { depth, triangle };
            }
        }
    }
}

/// Whole pixels from the smallest to the largest of three coordinates, cut to the picture.
fn pixel_range(a: f32, b: f32, c: f32, size: usize) -> (usize, usize) {
    let high = a.max(b).max(c);
    if high < 0.0 {
        return (0, 0);
    }
    // Casts cut towards zero and saturate; `ceil` and `floor` are calls on processors without SSE 4.1.
    let low = a.min(b).min(c).max(0.0);
    let first = low as usize;
    let first = first + usize::from((first as f32) < low);
    (first.min(size), (high as usize).saturating_add(1).min(size))
}

/// Twice the signed area of the triangle a, b, (x, y). In this form swapping a and b changes the sign and
/// nothing else, so two triangles that share an edge leave no pixel between them.
fn edge(a: [f32; 3], b: [f32; 3], x: f32, y: f32) -> f32 {
    (a[0] - x) * (b[1] - y) - (a[1] - y) * (b[0] - x)
}

/// Convenience for whole meshes: projects with `project` and draws.
pub fn rasterize_mesh(
    mesh: &Mesh,
    project: impl Fn(nalgebra::Point3<f32>) -> [f32; 3],
    width: usize,
    height: usize,
) -> Grid<Fragment> {
    let projected: Vec<_> = mesh.vertices.iter().map(|&v| project(v)).collect();
    rasterize(&projected, &mesh.triangles, width, height)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_nearer_triangle_wins_and_depth_is_perspective() {
        // One triangle slants from 1 m to 3 m; another lies behind it at 5 m.
        let projected = [
            [0.0, 0.0, 1.0],
            [10.0, 0.0, 3.0],
            [0.0, 10.0, 1.0],
            [0.0, 0.0, 5.0],
            [10.0, 0.0, 5.0],
            [0.0, 10.0, 5.0],
        ];
        let buffer = rasterize(&projected, &[[3, 4, 5], [0, 1, 2]], 12, 12);
        let middle = buffer[(5, 0)];
        assert_eq!(middle.triangle, 1);
        // 1/z is linear in the picture: the middle of 1 m and 3 m is 1.5 m.
        assert!((middle.depth - 1.5).abs() < 1e-5, "{}", middle.depth);
        assert!(!buffer[(11, 11)].is_covered());
    }

    proptest! {
        #[test]
        fn an_edge_is_the_same_seen_from_both_of_its_triangles(
            a in prop::array::uniform3(0.0..3000.0f32),
            b in prop::array::uniform3(0.0..3000.0f32),
            x in 0..3000u16, y in 0..3000u16,
        ) {
            let (x, y) = (f32::from(x), f32::from(y));
            prop_assert_eq!(edge(a, b, x, y), -edge(b, a, x, y));
        }
    }

    #[test]
    fn a_triangle_behind_the_camera_or_not_finite_is_left_out() {
        let behind = [[0.0, 0.0, -1.0], [9.0, 0.0, 1.0], [0.0, 9.0, 1.0]];
        let broken = [[0.0, 0.0, f32::NAN], [9.0, 0.0, 1.0], [0.0, 9.0, 1.0]];
        for projected in [behind, broken] {
            let buffer = rasterize(&projected, &[[0, 1, 2]], 10, 10);
            assert!(buffer.pixels().iter().all(|f| !f.is_covered()));
        }
    }
}

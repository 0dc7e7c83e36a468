//! A z-buffer: which triangle is in front at each pixel. The caller has already projected the vertices, so this
//! file knows no camera.

use super::Mesh;
use crate::array::three;
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
    rasterize_if(projected, triangles, (width, height), |_| true)
}

/// [`rasterize`] for a closed surface that the camera is outside of: what faces away from it is never in front, and
/// is not drawn.
pub fn rasterize_closed(
    projected: &[[f32; 3]],
    triangles: &[[u32; 3]],
    width: usize,
    height: usize,
) -> Grid<Fragment> {
    // Counter-clockwise in space is clockwise in a picture whose y points down.
    let faces_camera = |[a, b, c]: [[f32; 3]; 3]| edge(a, b, c[0], c[1]) < 0.0;
    rasterize_if(projected, triangles, (width, height), faces_camera)
}

fn rasterize_if(
    projected: &[[f32; 3]],
    triangles: &[[u32; 3]],
    (width, height): (usize, usize),
    is_drawn: impl Fn([[f32; 3]; 3]) -> bool,
) -> Grid<Fragment> {
    let mut buffer = Grid::filled(width, height, Fragment::EMPTY);
    for (index, triangle) in triangles.iter().enumerate() {
        let corners = three(|i| projected[triangle[i] as usize]);
        // A sum is finite only if all its parts are.
        let sum: f32 = corners.as_flattened().iter().sum();
        if sum.is_finite() && corners.iter().all(|c| c[2] > 0.0) && is_drawn(corners) {
            draw(&mut buffer, corners, index as u32);
        }
    }
    buffer
}

/// Pixels from which on a row is first narrowed to the part of it that the triangle can cover.
const WIDE: usize = 16;

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
        let py = y as i32 as f32;
        let (x0, x1) = if x1 - x0 > WIDE {
            row_span([a, b, c], side, py, (x0, x1))
        } else {
            (x0, x1)
        };
        let mut px = x0 as i32 as f32;
        for fragment in &mut buffer.row_mut(y)[x0..x1] {
            let (u, v) = (side * edge(b, c, px, py), side * edge(c, a, px, py));
            let w = side * edge(a, b, px, py);
            // One branch instead of three, which cannot be predicted.
            if least(least(u, v), w) >= 0.0 {
                let depth = (u + v + w)
                    / (u * inverse_depths[0] + v * inverse_depths[1] + w * inverse_depths[2]);
                if depth < fragment.depth {
                    *fragment = Fragment { depth, triangle };
                }
            }
            px += 1.0;
        }
    }
}

/// The part of a row between the lines along a triangle's sides, and a little more: rounding must not leave out
/// what the sides themselves let in.
fn row_span(
    [a, b, c]: [[f32; 3]; 3],
    side: f32,
    y: f32,
    (x0, x1): (usize, usize),
) -> (usize, usize) {
    let (mut low, mut high) = (x0 as f32, x1 as f32);
    for (p, q) in [(b, c), (c, a), (a, b)] {
        let rise = side * (p[1] - q[1]);
        let along = (y - p[1]) * ((q[0] - p[0]) / (q[1] - p[1]));
        let margin = 2.0 + 1e-5 * (p[0].abs() + along.abs());
        if rise > 0.0 {
            low = low.max(p[0] + along - margin);
        } else if rise < 0.0 {
            high = high.min(p[0] + along + margin);
        }
    }
    let end = (high.max(0.0) as usize + 1).min(x1);
    ((low as usize).min(end), end)
}

/// The smaller of two numbers: one instruction, unlike the standard library's, which knows what is not a number.
#[inline]
fn least(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// The larger of two numbers.
#[inline]
fn most(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Whole pixels from the smallest to the largest of three finite coordinates, cut to the picture.
fn pixel_range(a: f32, b: f32, c: f32, size: usize) -> (usize, usize) {
    // Casts cut towards zero, and those to 32 bits are cheap; `ceil` and `floor` are calls on processors without
    // SSE 4.1.
    let end = size as i32 as f32;
    let high = least(most(most(a, b), c), end);
    if high < 0.0 {
        return (0, 0);
    }
    let low = least(most(least(least(a, b), c), 0.0), end);
    let first = low as i32;
    let first = first + i32::from((first as f32) < low);
    (first as usize, size.min(high as i32 as usize + 1))
}

/// Twice the signed area of the triangle a, b, (x, y). In this form swapping a and b changes the sign and
/// nothing else, so two triangles that share an edge leave no pixel between them.
#[inline]
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

    proptest! {
        #[test]
        fn a_wide_triangle_covers_what_its_sides_let_in(
            corners in prop::array::uniform3((-200.0..300.0f32, -200.0..300.0f32, 0.5..2.0f32)),
            flat in 0.0..1.0f32,
        ) {
            // Some are nearly horizontal.
            let corners = corners.map(|(x, y, z)| [x, if flat < 0.3 { 30.0 + y * 1e-3 } else { y }, z]);
            let [a, b, c] = corners;
            let buffer = rasterize(&corners, &[[0, 1, 2]], 100, 60);
            let area = edge(a, b, c[0], c[1]);
            for y in 0..60 {
                for x in 0..100 {
                    let (px, py) = (x as f32, y as f32);
                    let sides = [edge(b, c, px, py), edge(c, a, px, py), edge(a, b, px, py)];
                    let inside = area != 0.0 && sides.iter().all(|s| s * area.signum() >= 0.0);
                    prop_assert_eq!(buffer[(x, y)].is_covered(), inside, "{} {}", x, y);
                }
            }
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

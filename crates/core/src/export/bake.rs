//! Makes the texture of a simplified surface from that of the full surface: each triangle gets its own rectangle of the
//! atlas, and each texel the colour of the nearest point of the full surface.

use crate::array::three;
use crate::image::{RgbImage, pack};
use crate::mesh::{Bvh, Mesh};
use crate::reconstruct::Texture;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Texels around a triangle, so that a viewer's interpolation meets no other triangle's colours.
const GUTTER: usize = 2;
/// Texels of a triangle's side, at most.
const LONGEST: f64 = 2048.0;
/// A texel's length where no camera saw anything, in metres.
const LONGEST_TEXEL: f64 = 0.01;

/// The texture of `mesh` from that of `old`, with texels `coarser` times as long. Its colours of vertices are empty.
pub(super) fn bake(old: &Mesh, texture: &Texture, mesh: &Mesh, coarser: f64) -> Texture {
    let painter = Painter {
        bvh: Bvh::new(old),
        old,
        texture,
    };
    let texel = texture.texel_size(old).unwrap_or(LONGEST_TEXEL).max(1e-6) * coarser;
    let patches: Vec<Patch> = (0..mesh.triangles.len())
        .map(|t| Patch::new(three(|i| mesh.corners(t)[i].cast()), texel))
        .collect();
    let painted: Vec<(Vec<[u8; 3]>, bool)> = patches
        .par_iter()
        .map(|patch| painter.paint(patch))
        .collect();
    let sizes: Vec<[usize; 2]> = patches.iter().map(|p| p.size).collect();
    let area: usize = sizes.iter().map(|[w, h]| w * h).sum();
    let widest = sizes.iter().map(|size| size[0]).max().unwrap_or(1);
    let width = ((area as f64).sqrt() as usize)
        .max(widest)
        .next_multiple_of(4);
    // No rectangle is wider than the strip.
    let (places, height) = pack(&sizes, width).unwrap_or_default();
    let height = height.max(1).next_multiple_of(4);
    let mut atlas = RgbImage::filled(width, height, [128; 3]);
    for ((place, [w, _]), (colors, _)) in places.iter().zip(&sizes).zip(&painted) {
        for (y, row) in colors.chunks_exact(*w).enumerate() {
            atlas.row_mut(place[1] + y)[place[0]..place[0] + w].copy_from_slice(row);
        }
    }
    let uv = |(patch, place): (&Patch, &[usize; 2])| {
        patch.texels.map(|[x, y]| {
            // A texel's centre is half a texel from its corner.
            let u = (place[0] as f64 + x + 0.5) / width as f64;
            let v = (place[1] as f64 + y + 0.5) / height as f64;
            [u as f32, v as f32]
        })
    };
    Texture {
        corner_uv: patches.iter().zip(&places).map(uv).collect(),
        seen: painted.iter().map(|(_, seen)| *seen).collect(),
        vertex_colors: Vec::new(),
        atlas,
    }
}

/// A triangle and its rectangle of texels.
struct Patch {
    corners: [Point3<f64>; 3],
    size: [usize; 2],
    /// Where the corners lie in the rectangle, in texels from the centre of the first.
    texels: [[f64; 2]; 3],
    /// The corner and the unit vectors of the triangle's plane that texels are counted along, and a texel's length.
    frame: (Point3<f64>, Vector3<f64>, Vector3<f64>, [f64; 2]),
}

impl Patch {
    /// The longest side lies along the rectangle's width.
    fn new(corners: [Point3<f64>; 3], texel: f64) -> Self {
        let side = |i: usize| (corners[(i + 1) % 3] - corners[i]).norm();
        let first = (0..3).fold(0, |best, i| if side(i) > side(best) { i } else { best });
        let [a, b, c] = three(|i| corners[(first + i) % 3]);
        let texel = texel.max(side(first) / LONGEST);
        let along = (b - a).try_normalize(0.0).unwrap_or_else(Vector3::x);
        let up = (c - a) - along * along.dot(&(c - a));
        let (height, up) = (
            up.norm(),
            up.try_normalize(1e-12).unwrap_or_else(Vector3::y),
        );
        let gutter = GUTTER as f64;
        let at = |p: Point3<f64>| {
            let from = p - a;
            [
                gutter + along.dot(&from) / texel,
                gutter + up.dot(&from) / texel,
            ]
        };
        let length = |metres: f64| (metres / texel).ceil() as usize + 1 + 2 * GUTTER;
        Self {
            size: [length(side(first)), length(height)],
            texels: corners.map(at),
            frame: (a, along, up, [texel, gutter]),
            corners,
        }
    }

    /// The point of the triangle's plane at a texel; beyond the triangle the nearest one in it.
    fn point(&self, x: usize, y: usize) -> Point3<f64> {
        let (origin, along, up, [texel, gutter]) = self.frame;
        let (x, y) = (x as f64 - gutter, y as f64 - gutter);
        let point = origin + along * (x * texel) + up * (y * texel);
        crate::mesh::closest_on_triangle(point, self.corners)
    }
}

/// The old surface and its colours.
struct Painter<'a> {
    bvh: Bvh,
    old: &'a Mesh,
    texture: &'a Texture,
}

impl Painter<'_> {
    /// The texels of a rectangle, row by row, and whether a camera saw the triangle's middle.
    fn paint(&self, patch: &Patch) -> (Vec<[u8; 3]>, bool) {
        let [width, height] = patch.size;
        let texels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let colors = texels.map(|(x, y)| self.color(patch.point(x, y))).collect();
        let sum = patch
            .corners
            .iter()
            .fold(Vector3::zeros(), |sum, p| sum + p.coords);
        let middle = self.bvh.closest_point((sum / 3.0).into());
        let seen = middle.is_some_and(|nearest| self.texture.seen[nearest.triangle]);
        (colors, seen)
    }

    /// The colour of the point of the old surface that is nearest to `p`.
    fn color(&self, p: Point3<f64>) -> [u8; 3] {
        let Some(nearest) = self.bvh.closest_point(p) else {
            return [128; 3];
        };
        let corners = self.old.corners(nearest.triangle).map(|p| p.cast());
        let weights = barycentric(nearest.point, corners);
        let uv = self.texture.corner_uv[nearest.triangle];
        let place: [f64; 2] = [0, 1].map(|i| {
            let weighted = uv.iter().zip(weights).map(|(uv, w)| f64::from(uv[i]) * w);
            weighted.sum()
        });
        sample(&self.texture.atlas, place)
    }
}

/// The weights of a triangle's corners at a point of it.
fn barycentric(p: Point3<f64>, [a, b, c]: [Point3<f64>; 3]) -> [f64; 3] {
    let normal = (b - a).cross(&(c - a));
    let twice = normal.norm_squared().max(f64::MIN_POSITIVE);
    let weight = |q: Point3<f64>, r: Point3<f64>| (q - p).cross(&(r - p)).dot(&normal) / twice;
    [weight(b, c), weight(c, a), weight(a, b)].map(|w| w.clamp(0.0, 1.0))
}

/// The atlas at a place, interpolated between texels.
fn sample(atlas: &RgbImage, [u, v]: [f64; 2]) -> [u8; 3] {
    let whole = |c: f64, length: usize| {
        let at = (c * length as f64 - 0.5).clamp(0.0, (length - 1) as f64);
        (at as usize, (at as usize + 1).min(length - 1), at.fract())
    };
    let (left, right, x) = whole(u, atlas.width());
    let (top, bottom, y) = whole(v, atlas.height());
    let row = |y: usize, channel: usize| {
        let at = |x: usize| f64::from(atlas.row(y)[x][channel]);
        at(left) * (1.0 - x) + at(right) * x
    };
    three(|channel| (row(top, channel) * (1.0 - y) + row(bottom, channel) * y).round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_between_texels_is_a_mean() {
        let atlas = RgbImage::from_fn(2, 1, |x, _| [x as u8 * 100; 3]);
        assert_eq!(sample(&atlas, [0.5, 0.5]), [50; 3]);
        assert_eq!(sample(&atlas, [0.0, 0.0]), [0; 3]);
        assert_eq!(sample(&atlas, [1.0, 1.0]), [100; 3]);
    }

    #[test]
    fn a_triangle_without_area_gets_texels_too() {
        let point = Point3::new(1.0, 2.0, 3.0);
        let patch = Patch::new([point; 3], 1e-3);
        assert_eq!(patch.size, [1 + 2 * GUTTER; 2]);
        assert!(patch.point(0, 0).coords.iter().all(|c| c.is_finite()));
    }
}

//! Makes the texture of a simplified surface from that of the full surface: `unwrap` cuts it into charts, and each
//! texel gets the colour of the nearest point of the full surface.

use super::unwrap::{Chart, NOBODY, charts};
use crate::array::{three, two};
use crate::image::{CellShape, PackingOrder, RgbImage, pack_shapes};
use crate::mesh::{Bvh, Mesh, bounding_box, closest_on_triangle};
use crate::reconstruct::Texture;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Texels along the surface's diagonal, at most.
const LONGEST: f64 = 4096.0;
/// A texel's length where no camera saw anything, in metres.
const LONGEST_TEXEL: f64 = 0.01;
/// Cells of an atlas' side for packing, about; more cells lie denser and take longer.
const CELLS: f64 = 500.0;

/// The texture of `mesh` from that of `old`, with texels `coarser` times as long. Its colours of vertices are empty.
pub(super) fn bake(old: &Mesh, texture: &Texture, mesh: &Mesh, coarser: f64) -> Texture {
    let painter = Painter {
        bvh: Bvh::new(old),
        old,
        texture,
    };
    let diagonal = bounding_box(&mesh.vertices).map_or(0.0, |[low, high]| (high - low).norm());
    let texel = texture.texel_size(old).unwrap_or(LONGEST_TEXEL).max(1e-6) * coarser;
    let charts = charts(mesh, texel.max(f64::from(diagonal) / LONGEST));
    let painted: Vec<Vec<[u8; 3]>> = charts
        .par_iter()
        .map(|chart| painter.paint(mesh, chart))
        .collect();
    let layout = Layout::new(&charts);
    let triangles = (0..mesh.triangles.len()).into_par_iter();
    Texture {
        corner_uv: layout.corner_uv(mesh, &charts),
        seen: triangles.map(|t| painter.is_seen(mesh, t)).collect(),
        vertex_colors: Vec::new(),
        atlas: layout.atlas(&charts, &painted),
    }
}

/// Where charts lie in an atlas.
struct Layout {
    /// Their top left texels.
    places: Vec<[usize; 2]>,
    /// Width and height of the atlas.
    size: [usize; 2],
}

impl Layout {
    /// Packs the charts by the cells that their texels are in.
    fn new(charts: &[Chart]) -> Self {
        let owned = |chart: &Chart| {
            chart
                .owners
                .pixels()
                .iter()
                .filter(|o| **o != NOBODY)
                .count()
        };
        let texels: usize = charts.iter().map(owned).sum();
        let cell = ((texels as f64).sqrt() / CELLS).ceil().max(1.0) as usize;
        let shapes: Vec<[CellShape; 1]> = charts.iter().map(|c| [shape(c, cell)]).collect();
        let widest = shapes.iter().map(|[shape]| shape.width()).max();
        let cells: usize = shapes.iter().map(|[shape]| shape.area()).sum();
        let width = ((1.1 * cells as f64).sqrt() as usize).max(widest.unwrap_or(1));
        let ways = PackingOrder::ALL.into_iter();
        let found = ways.filter_map(|order| pack_shapes(&shapes, order, width, usize::MAX));
        // No shape is wider than the strip.
        let (places, rows) = found.min_by_key(|(_, rows)| *rows).unwrap_or_default();
        let place = places.iter().map(|placed| placed.place.map(|at| at * cell));
        Self {
            places: place.collect(),
            size: [width, rows].map(|side| (side * cell).max(1).next_multiple_of(4)),
        }
    }

    /// The texels of the charts, each with its own colour.
    fn atlas(&self, charts: &[Chart], painted: &[Vec<[u8; 3]>]) -> RgbImage {
        let [width, height] = self.size;
        let mut atlas = RgbImage::filled(width, height, [128; 3]);
        for ((chart, place), colors) in charts.iter().zip(&self.places).zip(painted) {
            let texels = chart.owners.pixels().iter().zip(colors).enumerate();
            for (i, (_, color)) in texels.filter(|(_, (owner, _))| **owner != NOBODY) {
                let (x, y) = (i % chart.owners.width(), i / chart.owners.width());
                atlas.row_mut(place[1] + y)[place[0] + x] = *color;
            }
        }
        atlas
    }

    /// Where the corners of each triangle lie in the atlas, as shares of its width and height.
    fn corner_uv(&self, mesh: &Mesh, charts: &[Chart]) -> Vec<[[f32; 2]; 3]> {
        let mut corner_uv = vec![[[0.0; 2]; 3]; mesh.triangles.len()];
        let size = self.size.map(|side| side as f64);
        for (chart, place) in charts.iter().zip(&self.places) {
            let place = place.map(|at| at as f64);
            // A texel's centre is half a texel from its corner.
            let uv = |corner: [f64; 2]| two(|i| ((place[i] + corner[i] + 0.5) / size[i]) as f32);
            for &triangle in &chart.triangles {
                corner_uv[triangle as usize] = chart.corners(mesh, triangle).map(uv);
            }
        }
        corner_uv
    }
}

/// The cells that a chart's texels are in.
fn shape(chart: &Chart, cell: usize) -> CellShape {
    let owners = &chart.owners;
    let mut rows = vec![Vec::new(); owners.height().div_ceil(cell)];
    for y in 0..owners.height() {
        let row = owners.row(y).chunks(cell).enumerate();
        let owned = row.filter(|(_, cell)| cell.iter().any(|o| *o != NOBODY));
        rows[y / cell].extend(owned.map(|(x, _)| x..x + 1));
    }
    CellShape::new(rows)
}

/// The old surface and its colours.
struct Painter<'a> {
    bvh: Bvh,
    old: &'a Mesh,
    texture: &'a Texture,
}

impl Painter<'_> {
    /// The texels of a chart, row by row.
    fn paint(&self, mesh: &Mesh, chart: &Chart) -> Vec<[u8; 3]> {
        let width = chart.owners.width();
        let texels = chart.owners.pixels().iter().enumerate();
        let color = |(i, &owner): (usize, &u32)| match owner {
            NOBODY => [128; 3],
            triangle => {
                let texel = Point3::new((i % width) as f64, (i / width) as f64, 0.0);
                let corners = chart.corners(mesh, triangle);
                self.color(point(texel, corners, mesh.corners(triangle as usize)))
            }
        };
        texels.map(color).collect()
    }

    /// Whether a camera saw the middle of a triangle.
    fn is_seen(&self, mesh: &Mesh, triangle: usize) -> bool {
        let corners = mesh.corners(triangle);
        let sum = corners
            .iter()
            .map(|p| p.coords.cast::<f64>())
            .sum::<Vector3<f64>>();
        let middle = self.bvh.closest_point((sum / 3.0).into());
        middle.is_some_and(|nearest| self.texture.seen[nearest.triangle])
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

/// The point of a triangle at a texel of its plane; beyond the triangle, at the nearest place that is on it.
fn point(texel: Point3<f64>, plane: [[f64; 2]; 3], corners: [Point3<f32>; 3]) -> Point3<f64> {
    let plane = plane.map(|[x, y]| Point3::new(x, y, 0.0));
    let weights = barycentric(closest_on_triangle(texel, plane), plane);
    let weighted = three(|i| corners[i].coords.cast::<f64>() * weights[i]);
    let sum = weights.iter().sum::<f64>();
    match sum > 0.0 {
        true => ((weighted[0] + weighted[1] + weighted[2]) / sum).into(),
        false => corners[0].cast(),
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
}

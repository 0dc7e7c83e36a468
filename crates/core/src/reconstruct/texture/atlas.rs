//! Fills the atlas: paints each chart by itself, extends its edge into the gutter, and copies it into its place.

use super::blend::{Blend, Share};
use super::charts::{Chart, Layout, Plane};
use super::exposure::Gain;
use super::{Surface, to_bytes, unseen};
use crate::array::{three, two};
use crate::image::{Grid, RgbImage};
use nalgebra::Vector3;
use rayon::prelude::*;
use std::cmp::Reverse;

/// What texels are painted from.
pub(super) struct Paint<'a> {
    pub surface: &'a Surface<'a>,
    pub gains: &'a [Gain],
    pub blend: &'a Blend,
    /// Colours where no camera sees.
    pub vertex_colors: &'a [Vector3<f32>],
}

/// One view's part in a triangle's colour.
struct Source {
    view: usize,
    /// Its weight at each corner.
    weights: [f32; 3],
    /// The correction at each corner, times the weight.
    offsets: [Vector3<f32>; 3],
    /// The corners in the view's picture; `None` for the view whose chart it is.
    pixels: Option<[[f32; 2]; 3]>,
}

/// A triangle's corners in a tile, ready to be filled.
struct Corners([[f32; 2]; 3]);

impl Paint<'_> {
    /// Paints all charts of a layout. Between them lies the mean colour, which compresses well.
    pub(super) fn compose(&self, layout: &Layout) -> RgbImage {
        let count = self.vertex_colors.len().max(1) as f32;
        let mean = to_bytes(self.vertex_colors.iter().sum::<Vector3<f32>>() / count);
        let tiles = self.tiles(layout, mean);
        let [width, height] = layout.size;
        let mut pixels = vec![[0; 3]; width * height];
        let bands = pixels.par_chunks_mut(width * BAND).enumerate();
        bands.for_each(|(band, pixels)| {
            pixels.fill(mean);
            let mut distance = vec![EMPTY; pixels.len()];
            let mut band = Band {
                pixels,
                distance: &mut distance,
                first: band * BAND,
                width,
            };
            for (chart, tile) in layout.charts.iter().zip(&tiles) {
                band.take(tile, chart.place);
            }
        });
        RgbImage::from_pixels(width, height, pixels)
    }

    /// The charts' pictures; the largest are begun first, so that no thread is left alone with one.
    fn tiles(&self, layout: &Layout, background: [u8; 3]) -> Vec<Tile> {
        let charts = &layout.charts;
        let mut order: Vec<usize> = (0..charts.len()).collect();
        order.sort_by_key(|&i| Reverse(charts[i].size[0] * charts[i].size[1]));
        let paint = |&i: &usize| (i, self.tile(layout, &charts[i], background));
        let mut tiles: Vec<_> = order.par_iter().with_max_len(1).map(paint).collect();
        tiles.sort_by_key(|(i, _)| *i);
        tiles.into_iter().map(|(_, tile)| tile).collect()
    }

    fn tile(&self, layout: &Layout, chart: &Chart, background: [u8; 3]) -> Tile {
        let mut tile = Tile::new(chart.size, background);
        let mut sources = Vec::new();
        for &triangle in &chart.triangles {
            let vertices = self.surface.mesh.triangles[triangle as usize];
            let corners = Corners(three(|i| layout.in_chart(self.surface, chart, vertices[i])));
            match chart.plane {
                Plane::View(view) => {
                    self.gather(vertices, view, &mut sources);
                    self.fill_seen(&mut tile, (layout, chart), &corners, &sources);
                }
                Plane::Nowhere => tile.fill(&corners, |_, _| unseen::NEUTRAL),
                Plane::Axis(_) => {
                    let colors = three(|i| self.vertex_colors[vertices[i] as usize]);
                    tile.fill(&corners, |_, shares| interpolate(&colors, shares));
                }
            }
        }
        tile.extend(layout.gutter);
        tile
    }

    /// Fills a triangle that is seen.
    fn fill_seen(
        &self,
        tile: &mut Tile,
        (layout, chart): (&Layout, &Chart),
        corners: &Corners,
        sources: &[Source],
    ) {
        let scale = layout.scale;
        match sources {
            // Nearly all triangles: one view, whose pixels are the texels, and whose weights are 1.
            [only] if only.pixels.is_none() && scale == 1.0 => {
                let image = &*self.surface.views[only.view].image;
                let gain = self.gains[only.view];
                let [right, bottom] = [image.width() - 1, image.height() - 1];
                tile.fill(corners, |texel, shares| {
                    // The middle of a triangle that holds no texel may lie between pixels.
                    let [x, y] = layout.pixel(chart, texel).map(|p| (p + 0.5) as usize);
                    let pixel = image.row(y.min(bottom))[x.min(right)];
                    let color = Vector3::from(three(|c| f32::from(pixel[c])));
                    color.component_mul(&gain) + interpolate(&only.offsets, shares)
                });
            }
            _ => tile.fill(corners, |texel, shares| {
                self.mix(sources, layout.pixel(chart, texel), shares, scale)
            }),
        }
    }

    /// The views that a triangle is mixed from; at each corner their weights add up to 1.
    fn gather(&self, vertices: [u32; 3], own: usize, sources: &mut Vec<Source>) {
        sources.clear();
        for (corner, v) in vertices.into_iter().enumerate() {
            let mut is_short = false;
            for share in self.blend.of(v as usize) {
                let view = usize::from(share.label);
                match self.find_or_add(vertices, view, own, sources) {
                    Some(index) => sources[index].add(corner, share),
                    None => is_short = true,
                }
            }
            let total: f32 = sources.iter().map(|s| s.weights[corner]).sum();
            if total <= 0.0 {
                // None of the views there sees the whole triangle: its own chart's view paints it.
                if let Some(index) = self.find_or_add(vertices, own, own, sources) {
                    sources[index].weights[corner] = 1.0;
                }
            } else if is_short {
                sources.iter_mut().for_each(|s| s.divide(corner, total));
            }
        }
    }

    /// The place of a view among the sources of a triangle; `None` where it does not see the whole triangle.
    fn find_or_add(
        &self,
        vertices: [u32; 3],
        view: usize,
        own: usize,
        sources: &mut Vec<Source>,
    ) -> Option<usize> {
        let known = sources.iter().position(|s| s.view == view);
        known.or_else(|| {
            sources.push(self.source(vertices, view, own)?);
            Some(sources.len() - 1)
        })
    }

    /// A view with no weight yet; `None` where it does not see the whole triangle.
    fn source(&self, vertices: [u32; 3], view: usize, own: usize) -> Option<Source> {
        use super::visibility::Visibility;
        let hidden = |v: u32| self.surface.sights[view][v as usize] == Visibility::Hidden;
        if view != own && vertices.into_iter().any(hidden) {
            return None;
        }
        let projected = &self.surface.views[view].projected;
        let pixel = |v: u32| [projected[v as usize][0], projected[v as usize][1]];
        Some(Source {
            view,
            weights: [0.0; 3],
            offsets: [Vector3::zeros(); 3],
            pixels: (view != own).then(|| three(|i| pixel(vertices[i]))),
        })
    }

    /// The colour of a place in a triangle, given by its shares of the corners; `own` is its pixel in the
    /// picture of the chart's view.
    fn mix(&self, sources: &[Source], own: [f32; 2], shares: [f32; 3], scale: f32) -> Vector3<f32> {
        let (mut sum, mut weights) = (Vector3::zeros(), 0.0);
        for source in sources {
            let weight = dot(source.weights, shares);
            if weight <= 0.0 {
                continue;
            }
            let [x, y] = match &source.pixels {
                None => own,
                Some(p) => [0, 1].map(|i| dot([p[0][i], p[1][i], p[2][i]], shares)),
            };
            let color = self.sample(source.view, x, y, scale);
            sum += color.component_mul(&self.gains[source.view]) * weight;
            sum += interpolate(&source.offsets, shares);
            weights += weight;
        }
        if weights > 0.0 { sum / weights } else { sum }
    }

    /// A view's colour at a pixel; where texels are larger than pixels, the mean over the texel.
    fn sample(&self, view: usize, x: f32, y: f32, scale: f32) -> Vector3<f32> {
        let view = &self.surface.views[view];
        if scale >= 1.0 {
            return view.color(x, y);
        }
        let taps = (1.0 / scale).ceil().min(16.0) as usize;
        let mut sum = Vector3::zeros();
        for i in 0..taps * taps {
            let step = |k: usize| ((k as f32 + 0.5) / taps as f32 - 0.5) / scale;
            sum += view.color(x + step(i % taps), y + step(i / taps));
        }
        sum / (taps * taps) as f32
    }
}

impl Source {
    fn add(&mut self, corner: usize, share: &Share) {
        self.weights[corner] = share.weight;
        self.offsets[corner] = share.known_offset() * share.weight;
    }

    /// Divides what it adds at a corner by the sum of all weights there.
    fn divide(&mut self, corner: usize, total: f32) {
        self.weights[corner] /= total;
        self.offsets[corner] /= total;
    }
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn interpolate(corners: &[Vector3<f32>; 3], shares: [f32; 3]) -> Vector3<f32> {
    corners[0] * shares[0] + corners[1] * shares[1] + corners[2] * shares[2]
}

/// Rows of the atlas that are put together at once.
const BAND: usize = 64;

/// Rows of the atlas, and how far each of their texels is from what was painted of the chart that it shows.
struct Band<'a> {
    pixels: &'a mut [[u8; 3]],
    distance: &'a mut [u8],
    /// Its first row in the atlas.
    first: usize,
    /// The atlas' width.
    width: usize,
}

impl Band<'_> {
    /// Takes what a tile, given with its top left texel's place, shows in these rows. The rectangles of two tiles may
    /// overlap, and a tile's rectangle may reach beyond the atlas. In a gutter that two charts share, the nearer one
    /// counts; what was painted is never covered.
    fn take(&mut self, tile: &Tile, [left, top]: [isize; 2]) {
        let rows = (self.pixels.len() / self.width) as isize;
        let first = self.first as isize;
        let end = (top + tile.colors.height() as isize).min(first + rows);
        let beyond = left.min(0).unsigned_abs();
        let start = (left.max(0) as usize).min(self.width);
        for y in top.max(first)..end {
            let row = (y - first) as usize * self.width;
            let texels = row + start..row + self.width;
            let shown = self.pixels[texels.clone()].iter_mut();
            let shown = shown.zip(&mut self.distance[texels]);
            let y = (y - top) as usize;
            let painted = tile.colors.row(y).iter().zip(tile.distance.row(y));
            for ((texel, nearest), (color, &distance)) in shown.zip(painted.skip(beyond)) {
                if distance < *nearest {
                    (*texel, *nearest) = (*color, distance);
                }
            }
        }
    }
}

/// A texel that nothing has painted yet.
const EMPTY: u8 = u8::MAX;

/// One chart's pixels.
struct Tile {
    colors: RgbImage,
    /// How far each texel is from what was painted: 0 is painted, [`EMPTY`] is not.
    distance: Grid<u8>,
}

impl Tile {
    fn new([width, height]: [usize; 2], background: [u8; 3]) -> Self {
        Self {
            colors: RgbImage::filled(width, height, background),
            distance: Grid::filled(width, height, EMPTY),
        }
    }

    /// Paints the texels whose centres lie in a triangle; one that holds none paints the texel of its middle,
    /// so that no chart stays empty. `color` is given the texel and its shares of the three corners.
    fn fill(&mut self, corners: &Corners, color: impl Fn([f32; 2], [f32; 3]) -> Vector3<f32>) {
        let [a, b, c] = corners.0;
        let area = edge(a, b, c);
        let [width, height] = [self.colors.width(), self.colors.height()];
        let (x0, x1) = span(a[0], b[0], c[0], width);
        let (y0, y1) = span(a[1], b[1], c[1], height);
        let mut painted = false;
        if area.abs() > 1e-6 {
            let inverse = area.recip();
            for y in y0..y1 {
                let colors = &mut self.colors.row_mut(y)[x0..x1];
                let distances = &mut self.distance.row_mut(y)[x0..x1];
                for ((x, texel), distance) in (x0..x1).zip(colors).zip(distances) {
                    let p = [x as f32, y as f32];
                    let [s, t, u] = [edge(b, c, p), edge(c, a, p), edge(a, b, p)];
                    let shares = [s * inverse, t * inverse, u * inverse];
                    if shares.iter().all(|&s| s >= -1e-4) {
                        *texel = to_bytes(color(p, shares));
                        *distance = 0;
                        painted = true;
                    }
                }
            }
        }
        if !painted {
            let middle = two(|i| (a[i] + b[i] + c[i]) / 3.0);
            let x = ((middle[0] + 0.5) as usize).min(width - 1);
            let y = ((middle[1] + 0.5) as usize).min(height - 1);
            if self.distance[(x, y)] == EMPTY {
                self.colors[(x, y)] = to_bytes(color(middle, [1.0 / 3.0; 3]));
                self.distance[(x, y)] = 0;
            }
        }
    }

    /// Extends the painted texels by `reach` texels, along rows, then along columns.
    fn extend(&mut self, reach: usize) {
        let reach = reach.min(usize::from(EMPTY) - 1) as u8;
        let [width, height] = [self.colors.width(), self.colors.height()];
        for y in 0..height {
            for x in 1..width {
                self.spread((x - 1, y), (x, y), reach);
            }
            for x in (1..width).rev() {
                self.spread((x, y), (x - 1, y), reach);
            }
        }
        for y in 1..height {
            for x in 0..width {
                self.spread((x, y - 1), (x, y), reach);
            }
        }
        for y in (1..height).rev() {
            for x in 0..width {
                self.spread((x, y), (x, y - 1), reach);
            }
        }
    }

    #[inline]
    fn spread(&mut self, from: (usize, usize), to: (usize, usize), reach: u8) {
        let distance = self.distance[from].saturating_add(1);
        if distance <= reach && distance < self.distance[to] {
            self.colors[to] = self.colors[from];
            self.distance[to] = distance;
        }
    }
}

/// Whole texels between three coordinates, first and one past last, cut to `size`.
fn span(a: f32, b: f32, c: f32, size: usize) -> (usize, usize) {
    // Casts cut towards zero; `ceil` and `floor` are calls on processors without SSE 4.1.
    let low = a.min(b).min(c).max(0.0);
    let first = low as usize + usize::from((low as usize as f32) < low);
    let end = (a.max(b).max(c).max(-1.0) + 1.0) as usize;
    (first.min(end).min(size), end.min(size))
}

/// Twice the signed area of a triangle.
fn edge(a: [f32; 2], b: [f32; 2], c: [f32; 2]) -> f32 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_a_shared_gutter_each_chart_has_the_half_on_its_side() {
        let tile = |color: [u8; 3]| {
            let mut tile = Tile::new([5, 1], [0; 3]);
            tile.colors[(2, 0)] = color;
            tile.distance[(2, 0)] = 0;
            tile.extend(2);
            tile
        };
        let (red, green) = ([255, 0, 0], [0, 255, 0]);
        // They are painted at columns 0 and 3.
        let mut tiles = [(tile(red), [-2, 0]), (tile(green), [1, 0])];
        for _ in 0..2 {
            let (mut pixels, mut distance) = ([[9; 3]; 7], [EMPTY; 7]);
            let mut band = Band {
                pixels: &mut pixels,
                distance: &mut distance,
                first: 0,
                width: 7,
            };
            for (tile, place) in &tiles {
                band.take(tile, *place);
            }
            assert_eq!(pixels, [red, red, green, green, green, green, [9; 3]]);
            tiles.reverse();
        }
    }
}

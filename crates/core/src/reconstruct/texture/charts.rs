//! The atlas' layout. Each connected region of one camera is a chart whose texture coordinates are its projection
//! into that camera's picture, so nothing needs unwrapping. What no camera sees shares one neutral place, or is
//! projected along an axis, coarsely. Charts are packed by their outlines, turned by a quarter where that is better, so
//! that small ones lie in the bays of others.

use super::labels::{UNSEEN, regions};
use super::outline::Outline;
use super::specks::Specks;
use super::{Parameters, Surface, Unseen};
use crate::array::two;
use crate::image::{CellShape, PackingOrder, pack_shapes};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// The plane that a chart is projected onto.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Plane {
    /// A view's picture.
    View(usize),
    /// The plane across an axis, 0 to 2 for x to z.
    Axis(usize),
    /// No plane: all is at one place.
    Nowhere,
}

/// A region that is contiguous on the surface and in the atlas.
pub(super) struct Chart {
    pub plane: Plane,
    pub triangles: Vec<u32>,
    /// Its least coordinates, in whole texels.
    low: [f32; 2],
    /// Width and height in texels, gutters included, as it lies in the atlas.
    pub size: [usize; 2],
    /// Whether it lies in the atlas turned by a quarter, so that the plane's x runs down, and its y to the left.
    pub is_turned: bool,
    /// Its top left texel in the atlas, which may lie beyond it by a part of a gutter. Charts whose rectangles overlap
    /// have no painted texel in common.
    pub place: [isize; 2],
}

impl Chart {
    /// Turns it by a quarter.
    pub(super) fn turn(&mut self) {
        self.is_turned = true;
        self.size.reverse();
    }
}

/// All charts with their places.
pub(super) struct Layout {
    pub charts: Vec<Chart>,
    /// What is too small for a chart.
    specks: Specks,
    /// Texels a pixel of the pictures.
    pub scale: f32,
    /// Texels between two charts, and by which each is extended where there is room.
    pub gutter: usize,
    /// Width and height of the atlas.
    pub size: [usize; 2],
    /// Metres a texel in the charts that no camera sees.
    axis_texel: f32,
}

/// Longest side of a chart that no camera sees, in texels.
const LONGEST_AXIS_CHART: f32 = 512.0;
/// Attempts to fit the atlas into its limit, each at 0.85 of the last one's scale.
const ATTEMPTS: i32 = 40;
/// Cells of an atlas' side for packing, about; more cells lie denser and take longer.
const CELLS: f64 = 700.0;
/// Widths of the atlas that are tried, in the side of a square that all cells of the charts would fill.
const WIDTHS: [f64; 5] = [1.0, 1.04, 1.08, 1.13, 1.2];
/// The second of the two forms in which a chart is packed.
const TURNED: usize = 1;

impl Layout {
    /// Cuts the surface into charts and packs them: at the pictures' resolution if that fits, else smaller. Empty where
    /// nothing fits.
    pub(super) fn new(
        surface: &Surface,
        labels: &[u16],
        specks: Specks,
        parameters: &Parameters,
    ) -> Self {
        let largest = parameters.largest_side;
        let mut layout = Self {
            charts: charts(surface, labels, &specks, parameters.unseen),
            specks,
            scale: 1.0,
            gutter: parameters.gutter_px,
            size: [1, 1],
            axis_texel: axis_texel(surface),
        };
        for attempt in 0..ATTEMPTS {
            layout.scale = 0.85_f32.powi(attempt);
            if attempt == ATTEMPTS / 2 {
                // There are so many charts that their gutters do not fit.
                layout.gutter = layout.gutter.min(1);
            }
            layout.measure(surface);
            if layout.place(surface, largest) {
                return layout;
            }
        }
        layout.charts.clear();
        layout
    }

    /// Whether it has no chart.
    pub(super) fn is_empty(&self) -> bool {
        self.charts.is_empty()
    }

    /// Texels around each chart that no other chart has: two charts share the gutter between them.
    fn own_gutter(&self) -> usize {
        self.gutter.div_ceil(2)
    }

    fn measure(&mut self, surface: &Surface) {
        for i in 0..self.charts.len() {
            let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
            for &triangle in &self.charts[i].triangles {
                for v in surface.mesh.triangles[triangle as usize] {
                    let p = self.project(surface, self.charts[i].plane, v);
                    for axis in 0..2 {
                        low[axis] = low[axis].min(p[axis]);
                        high[axis] = high[axis].max(p[axis]);
                    }
                }
            }
            let chart = &mut self.charts[i];
            chart.is_turned = false;
            chart.low = low.map(f32::floor);
            // Of a surface that reaches to infinity: more than fits anywhere.
            let side = |axis: usize| (high[axis].ceil() - chart.low[axis]).min(1e9) as usize;
            chart.size = [0, 1].map(|axis| side(axis) + 1 + 2 * self.gutter);
        }
    }

    /// Packs the charts into the smallest atlas of a few widths and orders; false if none fits.
    fn place(&mut self, surface: &Surface, largest: usize) -> bool {
        let texels: f64 = self
            .charts
            .iter()
            .map(|c| c.size[0] as f64 * c.size[1] as f64)
            .sum();
        let side = largest as f64;
        if self
            .charts
            .iter()
            .any(|c| c.size[0].max(c.size[1]) > largest)
            || texels > 16.0 * side * side
        {
            return false;
        }
        let cell = ((texels.sqrt() / CELLS) as usize).clamp(2, 32).min(largest);
        let charts = self.charts.par_iter();
        let shapes: Vec<[CellShape; 2]> = charts
            .map(|chart| self.outlines(surface, chart, cell))
            .collect();
        let narrowest = |[upright, turned]: &[CellShape; 2]| upright.width().min(turned.width());
        let widest = shapes.iter().map(narrowest).max().unwrap_or(1);
        let cells: usize = shapes.iter().map(|[upright, _]| upright.area()).sum();
        let ways = WIDTHS.map(|factor| PackingOrder::ALL.map(|order| (factor, order)));
        let packed = |&(factor, order): &(f64, PackingOrder)| {
            let width = (((cells as f64).sqrt() * factor) as usize)
                .max(widest)
                .max(1);
            let width = width.min(largest / cell).max(1);
            let (places, height) = pack_shapes(&shapes, order, width, largest / cell)?;
            Some((width * height, [width, height.max(1)], places))
        };
        let found: Vec<_> = ways.as_flattened().par_iter().map(packed).collect();
        let Some((_, size, places)) = found.into_iter().flatten().min_by_key(|found| found.0)
        else {
            return false;
        };
        self.size = size.map(|side| side * cell);
        let shared = (self.gutter - self.own_gutter()) as isize;
        for (chart, placed) in self.charts.iter_mut().zip(places) {
            if placed.form == TURNED {
                chart.turn();
            }
            chart.place = placed.place.map(|side| (side * cell) as isize - shared);
        }
        true
    }

    /// The cells that a chart, which is not turned yet, needs with its own gutter alone: as it is, and turned.
    fn outlines(&self, surface: &Surface, chart: &Chart, cell: usize) -> [CellShape; 2] {
        let own = self.own_gutter();
        let shared = self.gutter - own;
        let [width, height] = chart.size.map(|side| side - 2 * shared);
        let mut upright = Outline::new([width, height], cell, own);
        let mut turned = Outline::new([height, width], cell, own);
        for &triangle in &chart.triangles {
            let corners = surface.mesh.triangles[triangle as usize].map(|v| {
                let p = self.in_chart(surface, chart, v);
                two(|i| p[i] - shared as f32)
            });
            upright.add(corners);
            turned.add(corners.map(|p| turn(p, height)));
        }
        [upright.into_shape(), turned.into_shape()]
    }

    /// A vertex in a plane, in texels from the plane's origin.
    fn project(&self, surface: &Surface, plane: Plane, vertex: u32) -> [f32; 2] {
        let vertex = vertex as usize;
        let p = match plane {
            Plane::View(view) => {
                let [x, y, _] = surface.views[view].projected[vertex];
                [x * self.scale, y * self.scale]
            }
            Plane::Axis(axis) => {
                let p = surface.mesh.vertices[vertex];
                two(|i| p[(axis + 1 + i) % 3] / self.axis_texel)
            }
            Plane::Nowhere => [0.0; 2],
        };
        two(|i| if p[i].is_finite() { p[i] } else { 0.0 })
    }

    /// A vertex in a chart, in texels from the chart's top left texel's centre.
    pub(super) fn in_chart(&self, surface: &Surface, chart: &Chart, vertex: u32) -> [f32; 2] {
        let p = self.project(surface, chart.plane, vertex);
        let upright = two(|i| p[i] - chart.low[i] + self.gutter as f32);
        match chart.is_turned {
            true => turn(upright, chart.size[0]),
            false => upright,
        }
    }

    /// The pixel of a view's picture that a chart's texel shows.
    #[inline]
    pub(super) fn pixel(&self, chart: &Chart, texel: [f32; 2]) -> [f32; 2] {
        let upright = match chart.is_turned {
            true => turn_back(texel, chart.size[0]),
            false => texel,
        };
        two(|i| (upright[i] + chart.low[i] - self.gutter as f32) / self.scale)
    }

    /// For each triangle the places of its corners in the atlas, 0 to 1.
    pub(super) fn corner_uv(&self, surface: &Surface) -> Vec<[[f32; 2]; 3]> {
        let mut uv = vec![[[0.5; 2]; 3]; surface.mesh.triangles.len()];
        for chart in &self.charts {
            for &triangle in &chart.triangles {
                let corners = surface.mesh.triangles[triangle as usize];
                uv[triangle as usize] = corners.map(|v| {
                    let p = self.in_chart(surface, chart, v);
                    two(|i| (p[i] + chart.place[i] as f32 + 0.5) / self.size[i] as f32)
                });
            }
        }
        for (triangles, (lender, corner)) in &self.specks {
            let place = uv[*lender as usize][*corner];
            for &triangle in triangles {
                uv[triangle as usize] = [place; 3];
            }
        }
        uv
    }
}

/// A place of a rectangle of some height in texels, after the rectangle was turned by a quarter, clockwise.
fn turn([x, y]: [f32; 2], height: usize) -> [f32; 2] {
    [(height - 1) as f32 - y, x]
}

/// The reverse of [`turn`].
fn turn_back([x, y]: [f32; 2], height: usize) -> [f32; 2] {
    [y, (height - 1) as f32 - x]
}

/// Connected regions of one label but for specks. Unseen regions are one chart, or are split by the axis they face.
fn charts(surface: &Surface, labels: &[u16], specks: &Specks, unseen: Unseen) -> Vec<Chart> {
    let views = surface.views.len() as u16;
    let faced = |(triangle, &label): (usize, &u16)| match label {
        UNSEEN if unseen == Unseen::Continued => views + facing_axis(surface, triangle),
        label => label,
    };
    let faced: Vec<u16> = labels.iter().enumerate().map(faced).collect();
    let plane = |triangles: &[u32]| match faced[triangles[0] as usize] {
        UNSEEN => Plane::Nowhere,
        label => match label.checked_sub(views) {
            Some(axis) => Plane::Axis(usize::from(axis) / 2),
            None => Plane::View(label.into()),
        },
    };
    let mut is_speck = vec![false; labels.len()];
    for &triangle in specks.iter().flat_map(|(triangles, _)| triangles) {
        is_speck[triangle as usize] = true;
    }
    let mut regions = regions(&faced, &surface.across);
    regions.retain(|region| !is_speck[region[0] as usize]);
    let regions = regions.into_iter();
    let regions = regions.map(|triangles| (plane(&triangles), triangles));
    let (nowhere, mut charts): (Vec<_>, Vec<_>) =
        regions.partition(|(plane, _)| *plane == Plane::Nowhere);
    let nowhere: Vec<u32> = nowhere
        .into_iter()
        .flat_map(|(_, triangles)| triangles)
        .collect();
    if !nowhere.is_empty() {
        charts.push((Plane::Nowhere, nowhere));
    }
    let chart = |(plane, triangles)| Chart {
        plane,
        triangles,
        low: [0.0; 2],
        size: [0; 2],
        is_turned: false,
        place: [0; 2],
    };
    charts.into_iter().map(chart).collect()
}

/// The axis that a triangle's smoothed normal is closest to, twice, plus 1 if it points backwards.
fn facing_axis(surface: &Surface, triangle: usize) -> u16 {
    let corners = surface.mesh.triangles[triangle];
    let normal: Vector3<f32> = corners.iter().map(|&v| surface.normals[v as usize]).sum();
    let axis = normal.iamax();
    2 * axis as u16 + u16::from(normal[axis] < 0.0)
}

/// Metres per texel of unseen charts: a mean edge, such that no chart is longer than [`LONGEST_AXIS_CHART`].
fn axis_texel(surface: &Surface) -> f32 {
    let vertices = &surface.mesh.vertices;
    let triangles = surface.mesh.triangles.iter();
    let edge = |t: &[u32; 3]| (vertices[t[1] as usize] - vertices[t[0] as usize]).norm();
    let sum: f32 = triangles.map(edge).filter(|e| e.is_finite()).sum();
    let mean = sum / surface.mesh.triangles.len().max(1) as f32;
    let extent = |p: &Point3<f32>| p.coords.amax();
    let finite = vertices.iter().map(extent).filter(|e| e.is_finite());
    let reach = 2.0 * finite.fold(0.0, f32::max);
    mean.max(reach / LONGEST_AXIS_CHART).clamp(1e-6, 1e6)
}

//! The atlas' layout. Each connected region of one camera is a chart whose texture coordinates are its projection
//! into that camera's picture, so nothing needs unwrapping. What no camera sees is projected along an axis,
//! coarsely.

use super::labels::{UNSEEN, regions};
use super::{Parameters, Surface};
use crate::array::two;
use crate::image::pack;
use nalgebra::{Point3, Vector3};

/// The plane that a chart is projected onto.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Plane {
    /// A view's picture.
    View(usize),
    /// The plane across an axis, 0 to 2 for x to z.
    Axis(usize),
}

/// A region that is contiguous on the surface and in the atlas.
pub(super) struct Chart {
    pub plane: Plane,
    pub triangles: Vec<u32>,
    /// Its least coordinates, in whole texels.
    low: [f32; 2],
    /// Width and height in texels, gutters included.
    pub size: [usize; 2],
    /// Its top left texel in the atlas.
    pub place: [usize; 2],
}

/// All charts with their places.
pub(super) struct Layout {
    pub charts: Vec<Chart>,
    /// Texels a pixel of the pictures.
    pub scale: f32,
    /// Texels around each chart.
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

impl Layout {
    /// Cuts the surface into charts and packs them: at the pictures' resolution if that fits, else smaller.
    pub(super) fn new(surface: &Surface, labels: &[u16], parameters: &Parameters) -> Self {
        let largest = parameters.largest_side;
        let mut layout = Self {
            charts: charts(surface, labels),
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
            if layout.place(largest) {
                return layout;
            }
        }
        layout.charts.clear();
        layout
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
            chart.low = low.map(f32::floor);
            // Of a surface that reaches to infinity: more than fits anywhere.
            let side = |axis: usize| (high[axis].ceil() - chart.low[axis]).min(1e9) as usize;
            chart.size = [0, 1].map(|axis| side(axis) + 1 + 2 * self.gutter);
        }
    }

    /// Packs the charts into the smallest of a few shapes; false if none fits.
    fn place(&mut self, largest: usize) -> bool {
        let sizes: Vec<_> = self.charts.iter().map(|c| c.size).collect();
        let widest = sizes.iter().map(|s| s[0]).max().unwrap_or(1);
        let area: f64 = sizes.iter().map(|s| s[0] as f64 * s[1] as f64).sum();
        let shapes: &[f64] = if sizes.len() < 1000 {
            &[1.0, 1.1, 1.25, 1.4, 1.6, 2.0]
        } else {
            &[1.1]
        };
        let mut best: Option<(usize, [usize; 2], Vec<[usize; 2]>)> = None;
        for shape in shapes {
            let width = ((area.sqrt() * shape) as usize).max(widest).min(largest);
            let Some((places, height)) = pack(&sizes, width.max(1)) else {
                continue;
            };
            let cost = width * height;
            if height <= largest && best.as_ref().is_none_or(|b| cost < b.0) {
                best = Some((cost, [width.max(1), height.max(1)], places));
            }
        }
        let Some((_, size, places)) = best else {
            return false;
        };
        self.size = size;
        for (chart, place) in self.charts.iter_mut().zip(places) {
            chart.place = place;
        }
        true
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
        };
        two(|i| if p[i].is_finite() { p[i] } else { 0.0 })
    }

    /// A vertex in a chart, in texels from the chart's top left texel's centre.
    pub(super) fn in_chart(&self, surface: &Surface, chart: &Chart, vertex: u32) -> [f32; 2] {
        let p = self.project(surface, chart.plane, vertex);
        two(|i| p[i] - chart.low[i] + self.gutter as f32)
    }

    /// The pixel of a view's picture that a chart's texel shows.
    pub(super) fn pixel(&self, chart: &Chart, texel: [f32; 2]) -> [f32; 2] {
        two(|i| (texel[i] + chart.low[i] - self.gutter as f32) / self.scale)
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
        uv
    }
}

/// Connected regions of one label; unseen regions are split by the axis that they face.
fn charts(surface: &Surface, labels: &[u16]) -> Vec<Chart> {
    let views = surface.views.len() as u16;
    let faced = |(triangle, &label): (usize, &u16)| match label {
        UNSEEN => views + facing_axis(surface, triangle),
        label => label,
    };
    let labels: Vec<u16> = labels.iter().enumerate().map(faced).collect();
    let chart = |triangles: Vec<u32>| {
        let label = labels[triangles[0] as usize];
        let plane = match label.checked_sub(views) {
            Some(axis) => Plane::Axis(usize::from(axis) / 2),
            None => Plane::View(label.into()),
        };
        Chart {
            plane,
            triangles,
            low: [0.0; 2],
            size: [0; 2],
            place: [0; 2],
        }
    };
    regions(&labels, &surface.across)
        .into_iter()
        .map(chart)
        .collect()
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

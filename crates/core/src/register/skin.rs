//! Compares the colours of two captures: for each point of the hull that cameras see, how its colour differs from the
//! colours around it. This difference does not depend on light that falls off, or that comes from another side because
//! the object was turned; painted patterns and stains stay in it.

use super::CaptureSilhouettes;
use super::body::Body;
use crate::image::{Mask, RgbImage, srgb};
use crate::mesh::rasterize;
use crate::reconstruct::ColorView;
use nalgebra::{Isometry3, Point3, Vector3};
use rayon::prelude::*;

/// Radius of the surroundings that a colour is compared with, as a share of the body's radius.
const SURROUNDINGS: f64 = 0.16;
/// Points that stand for all surroundings.
const ANCHORS: usize = 3000;
/// Cosine between normal and view below which a camera's colour does not count.
const FACING: f64 = 0.35;
/// Light below this share of white is noise.
const DARKEST: f64 = 0.004;
/// Edge of a cell of the grid that colours are looked up in, in cells of the mesh.
const GRID_CELLS: f64 = 1.6;
/// Pixels of the z-buffer that decides what is hidden, at most.
const OCCLUSION_PIXELS: f64 = 3e5;
/// Height above the table, as a share of the radius, below which its light and shadow spoil colours.
const ABOVE_TABLE: f64 = 0.05;

/// A point of the surface with its colour's contrast.
#[derive(Clone, Copy, Debug)]
struct Point {
    at: Point3<f64>,
    normal: Vector3<f64>,
    contrast: Vector3<f64>,
    weight: f64,
}

/// The weight and the linear colour that a camera gives a vertex; `None` where it does not see it.
type Sample = Option<(f64, Vector3<f64>)>;

/// A capture's colours on its hull.
#[derive(Clone, Debug)]
pub(super) struct Skin {
    points: Vec<Point>,
    /// Standard deviation of the logarithm of brightness after its surroundings are taken out.
    pub(super) contrast: f64,
    corner: Point3<f64>,
    cell: f64,
    size: [usize; 3],
    cells: Vec<Cell>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Cell {
    weight: f32,
    contrast: [f32; 3],
    normal: [f32; 3],
    trust: f32,
}

/// What colours say of a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Agreement {
    /// Correlation of the contrasts, -1 to 1.
    pub(super) correlation: f64,
    /// Points that both captures show.
    pub(super) points: usize,
}

/// Fewer common points tell nothing.
const LEAST_POINTS: usize = 100;

impl Skin {
    /// The colours of a capture on its hull.
    pub(super) fn new(capture: &CaptureSilhouettes, body: &Body) -> Self {
        let views = capture.scene.colors.par_iter().zip(capture.silhouettes);
        let samples: Vec<Vec<Sample>> = views
            .map(|(view, silhouette)| seen(view, silhouette.unknown.as_ref(), body))
            .collect();
        let mut points = Vec::new();
        let mut disagreement = Vec::new();
        for (v, p) in body.mesh.vertices.iter().enumerate() {
            let at = p.cast::<f64>();
            if at.z < body.floor + ABOVE_TABLE * body.radius {
                continue;
            }
            let of_vertex = || samples.iter().filter_map(|s| s[v]);
            let weight: f64 = of_vertex().map(|(w, _)| w).sum();
            if weight < 0.05 {
                continue;
            }
            let mean = of_vertex().map(|(w, c)| c * w).sum::<Vector3<f64>>() / weight;
            let spread = of_vertex().map(|(w, c)| w * (brightness(c) - brightness(mean)).powi(2));
            disagreement.push(spread.sum::<f64>() / weight);
            let log = mean.map(|c| c.max(DARKEST).ln());
            let contrast = Vector3::new(log.mean(), 1.5 * (log.x - log.y), 1.5 * (log.z - log.y));
            points.push(Point {
                at,
                normal: body.normals[v].cast(),
                contrast,
                weight: 1.0,
            });
        }
        subtract_surroundings(&mut points, SURROUNDINGS * body.radius);
        // Where views disagree the hull is not the surface, as over a hollow: little weight.
        let mut squares: Vec<f64> = points.iter().map(|p| p.contrast.x.powi(2)).collect();
        let usual = crate::statistics::lower_median(&mut squares).unwrap_or(0.0);
        let allowed = (0.25 * usual).max(1e-4);
        for (point, spread) in points.iter_mut().zip(disagreement) {
            point.weight = (1.0 + spread / allowed).powi(-2);
        }
        Self::on_grid(points, GRID_CELLS * body.cell_size)
    }

    fn on_grid(points: Vec<Point>, cell: f64) -> Self {
        let weight: f64 = points.iter().map(|p| p.weight).sum();
        let square: f64 = points.iter().map(|p| p.weight * p.contrast.x.powi(2)).sum();
        let corners = points.iter().map(|p| p.at);
        let low = corners.clone().reduce(|a, b| a.inf(&b)).unwrap_or_default();
        let high = corners.reduce(|a, b| a.sup(&b)).unwrap_or_default();
        let corner = low - Vector3::repeat(cell);
        let size: [usize; 3] = (high - low).map(|s| (s / cell).ceil() as usize + 4).into();
        let mut skin = Self {
            contrast: (square / weight.max(1e-12)).sqrt(),
            corner,
            cell,
            size,
            cells: vec![Cell::default(); size.iter().product()],
            points: Vec::new(),
        };
        for p in &points {
            for (index, share) in skin.around(p.at).into_iter().flatten() {
                let cell = &mut skin.cells[index];
                cell.weight += share as f32;
                cell.trust += (share * p.weight) as f32;
                for i in 0..3 {
                    cell.contrast[i] += (share * p.contrast[i]) as f32;
                    cell.normal[i] += (share * p.normal[i]) as f32;
                }
            }
        }
        skin.points = points;
        skin
    }

    /// The eight cells around a point with their shares; none outside the grid.
    fn around(&self, p: Point3<f64>) -> Option<[(usize, f64); 8]> {
        let at = (p - self.corner) / self.cell;
        let inside = |i: usize| at[i] >= 0.0 && at[i] < (self.size[i] - 1) as f64;
        if !(0..3).all(inside) {
            return None;
        }
        let first = at.map(|c| c as usize);
        let f = Vector3::new(at.x.fract(), at.y.fract(), at.z.fract());
        let place = |i: usize| {
            let bit = [i & 1, i >> 1 & 1, i >> 2];
            let share = |axis: usize| {
                if bit[axis] == 1 {
                    f[axis]
                } else {
                    1.0 - f[axis]
                }
            };
            let index = first.x
                + bit[0]
                + (first.y + bit[1]) * self.size[0]
                + (first.z + bit[2]) * self.size[0] * self.size[1];
            (index, share(0) * share(1) * share(2))
        };
        Some(std::array::from_fn(place))
    }

    /// Contrast, trust and normal at a point, where the surface is near it.
    fn at(&self, p: Point3<f64>) -> Option<(Vector3<f64>, f64, Vector3<f64>)> {
        let (mut weight, mut trust) = (0.0, 0.0);
        let (mut contrast, mut normal) = (Vector3::zeros(), Vector3::zeros());
        for (index, share) in self.around(p)? {
            let cell = &self.cells[index];
            weight += share * f64::from(cell.weight);
            trust += share * f64::from(cell.trust);
            contrast += Vector3::from(cell.contrast.map(f64::from)) * share;
            normal += Vector3::from(cell.normal.map(f64::from)) * share;
        }
        (weight > 0.05).then(|| (contrast / weight, trust / weight, normal / weight))
    }
}

/// How two captures' colours correlate over the surface that both show, where the first's points lie at `pose` in the
/// second's rig. About `count` points are compared.
pub(super) fn agreement(a: &Skin, b: &Skin, pose: &Isometry3<f64>, count: usize) -> Agreement {
    let step = a.points.len().div_ceil(count.max(1)).max(1);
    let mut pairs = Vec::with_capacity(count);
    for p in a.points.iter().step_by(step) {
        let Some((contrast, trust, normal)) = b.at(pose * p.at) else {
            continue;
        };
        if normal.dot(&(pose.rotation * p.normal)) > 0.7 {
            pairs.push((p.contrast, contrast, p.weight * trust));
        }
    }
    let none = Agreement {
        correlation: 0.0,
        points: pairs.len(),
    };
    if pairs.len() < LEAST_POINTS {
        return none;
    }
    let weight: f64 = pairs.iter().map(|p| p.2).sum();
    let mean_a = pairs.iter().map(|p| p.0 * p.2).sum::<Vector3<f64>>() / weight;
    let mean_b = pairs.iter().map(|p| p.1 * p.2).sum::<Vector3<f64>>() / weight;
    let (mut ab, mut aa, mut bb) = (0.0, 1e-12, 1e-12);
    for (a, b, w) in pairs {
        let (a, b) = (a - mean_a, b - mean_b);
        ab += w * a.dot(&b);
        aa += w * a.norm_squared();
        bb += w * b.norm_squared();
    }
    Agreement {
        correlation: ab / f64::sqrt(aa * bb),
        ..none
    }
}

fn brightness(color: Vector3<f64>) -> f64 {
    color.mean().max(DARKEST).ln()
}

/// For each vertex the weight and the linear colour that a camera gives it; `None` where it does not see it, or where
/// its picture is `unknown`: a prop that stands still there would have the same colours at every turn of the object.
fn seen(view: &ColorView, unknown: Option<&Mask>, body: &Body) -> Vec<Sample> {
    let (camera, image) = (&view.camera, &view.image);
    let vertices = &body.mesh.vertices;
    let projected: Vec<[f32; 3]> = vertices
        .iter()
        .map(|&p| camera.project_for_raster(p))
        .collect();
    let (width, height) = (image.width() as f64, image.height() as f64);
    let shrink = (OCCLUSION_PIXELS / (width * height)).sqrt().min(1.0) as f32;
    let small: Vec<[f32; 3]> = projected
        .iter()
        .map(|p| [p[0] * shrink, p[1] * shrink, p[2]])
        .collect();
    let size = [width, height].map(|s| (s * f64::from(shrink)).ceil() as usize + 1);
    let nearest = rasterize(&small, &body.mesh.triangles, size[0], size[1]);
    let eye = camera.center();
    let tolerance = (2.0 * body.cell_size) as f32;
    let of_vertex = |v: usize| {
        let p = vertices[v].cast::<f64>();
        let facing = body.normals[v].cast::<f64>().dot(&(eye - p).normalize());
        let [x, y, z] = projected[v];
        let inside = (2.0..image.width() as f32 - 3.0).contains(&x)
            && (2.0..image.height() as f32 - 3.0).contains(&y);
        let at = (x.round() as isize, y.round() as isize);
        let level = unknown.and_then(|unknown| unknown.get(at.0, at.1));
        let is_unknown = level.is_some_and(|&level| level >= 128);
        if facing <= FACING || !inside || is_unknown {
            return None;
        }
        let [sx, sy, _] = small[v];
        let front = nearest.get(sx.round() as isize, sy.round() as isize)?;
        let slope = tolerance / facing as f32;
        if front.is_covered() && front.depth < z - slope {
            return None;
        }
        Some((facing.powi(4), mean_color(image, x, y)))
    };
    (0..vertices.len()).map(of_vertex).collect()
}

/// The mean of 3 x 3 pixels around a place within the picture, linear.
fn mean_color(image: &RgbImage, x: f32, y: f32) -> Vector3<f64> {
    let linear = srgb::linear_from_srgb();
    let (column, row) = (x.round() as usize, y.round() as usize);
    let mut sum = Vector3::zeros();
    for y in row - 1..=row + 1 {
        for pixel in &image.row(y)[column - 1..=column + 1] {
            sum += Vector3::from(pixel.map(|c| f64::from(linear[usize::from(c)])));
        }
    }
    sum / 9.0
}

/// Takes the weighted mean of the contrasts around each point off its own.
fn subtract_surroundings(points: &mut [Point], radius: f64) {
    let step = points.len().div_ceil(ANCHORS).max(1);
    let anchors: Vec<(Point3<f64>, Vector3<f64>)> = points
        .iter()
        .step_by(step)
        .map(|p| (p.at, p.contrast))
        .collect();
    let scale = (0.6 * radius).powi(-2);
    points.par_iter_mut().for_each(|point| {
        let (mut sum, mut weight) = (Vector3::zeros(), 1e-9);
        for (at, contrast) in &anchors {
            let squared = (at - point.at).norm_squared();
            if squared < radius * radius {
                let w = (-squared * scale).exp();
                sum += contrast * w;
                weight += w;
            }
        }
        point.contrast -= sum / weight;
    });
}

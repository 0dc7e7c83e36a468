//! Prepares one capture's silhouettes for comparing poses: their outlines, viewing rays through contour points, the
//! surface of the hull, and the hull's signed distance on a grid.

use super::outline::Outline;
use super::{CaptureSilhouettes, Error};
use crate::mesh::{Mesh, bounding_box, vertex_normals};
use crate::reconstruct::hull::{self, Cone, Hull};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Cells along the diagonal of the object of the hull that poses are looked for with.
const RESOLUTION: f64 = 120.0;
/// Cells of the field along the hull's longest side.
const FIELD_CELLS: f64 = 80.0;
/// Points of the hull's surface that a pose is tried with.
const SURFACE_POINTS: usize = 250;
/// How far around the hull the field is known, as a share of the hull's radius.
pub(super) const REACH: f64 = 0.08;

/// Shadows at the foot of an object take a little of it away from outlines: beside its table so many metres …
const DOUBT: f64 = 0.7e-3;
/// … and ever less up to so many metres above it.
const DOUBT_HEIGHT: f64 = 4e-3;

/// A viewing ray through a contour point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    /// The camera's centre, in the rig's frame.
    pub(super) eye: Point3<f64>,
    /// Unit direction in the rig's frame.
    pub(super) direction: Vector3<f64>,
    /// Which outline it belongs to.
    pub(super) view: usize,
    /// Which chain of the outline.
    pub(super) chain: usize,
    /// Pixels of contour that it stands for.
    pub(super) length_px: f64,
}

/// A capture's object.
#[derive(Clone, Debug)]
pub(super) struct Body {
    pub(super) outlines: Vec<Outline>,
    /// For each outline the number of its camera in the capture.
    pub(super) cameras: Vec<usize>,
    /// Height of the table, below which there is nothing.
    pub(super) floor: f64,
    /// The plain hull, without stray pieces.
    pub(super) mesh: Mesh,
    pub(super) normals: Vec<Vector3<f32>>,
    pub(super) field: Field,
    /// Points of the hull's surface.
    pub(super) surface: Vec<Point3<f64>>,
    /// The hull's centre of mass.
    pub(super) center: Point3<f64>,
    /// The largest distance of a surface point from that.
    pub(super) radius: f64,
    /// Size of a pixel at the centre, in metres.
    pub(super) pixel: f64,
    /// Edge of a cell of the mesh.
    pub(super) cell_size: f64,
    /// Rays through all contour points, in the order of views and chains.
    pub(super) rays: Vec<Ray>,
}

impl Body {
    /// Prepares a capture.
    pub(super) fn new(capture: &CaptureSilhouettes) -> Result<Self, Error> {
        let views = capture.scene.colors.par_iter().zip(capture.silhouettes);
        let outlines: Vec<Option<Outline>> = views
            .map(|(view, s)| Outline::new(&view.camera, s))
            .collect();
        let cameras = (0..outlines.len())
            .filter(|&i| outlines[i].is_some())
            .collect();
        let outlines: Vec<Outline> = outlines.into_iter().flatten().collect();
        let cones = capture.scene.colors.iter().zip(capture.silhouettes);
        let cones = cones
            .map(|(view, s)| Cone::with_unknown(&view.camera, &s.level, s.unknown.as_ref()))
            .collect();
        let parameters = hull::Parameters {
            resolution: RESOLUTION,
            ..hull::Parameters::default()
        };
        let hull = Hull::new(cones, capture.scene.volume, parameters.least_views);
        let lattice = hull::lattice(&hull, &parameters)?;
        let mesh = hull::extract(&hull, &lattice, &parameters)?.surface.mesh;
        let normals = vertex_normals(&mesh);
        let center = center_of_mass(&mesh);
        let vertices = || mesh.vertices.iter().map(|v| v.cast::<f64>());
        let radius = vertices().map(|v| (v - center).norm()).fold(0.0, f64::max);
        let count = mesh.vertices.len();
        let every = |i: usize| mesh.vertices[i * count / SURFACE_POINTS].cast();
        let mut body = Self {
            floor: capture.scene.volume.min.z,
            surface: (0..SURFACE_POINTS.min(count)).map(every).collect(),
            pixel: hull.pixel_footprint(center),
            field: Field::default(),
            cell_size: lattice.cell_size,
            rays: rays(&outlines),
            outlines,
            cameras,
            normals,
            center,
            radius,
            mesh,
        };
        body.field = Field::of(&body);
        Ok(body)
    }

    /// The same capture, if all lengths of its calibration were `scale` times as large.
    pub(super) fn scaled(&self, scale: f64) -> Self {
        let vertices = self.mesh.vertices.iter().map(|v| v * scale as f32);
        let ray = |ray: &Ray| Ray {
            eye: ray.eye * scale,
            ..*ray
        };
        Self {
            outlines: self.outlines.iter().map(|o| o.scaled(scale)).collect(),
            cameras: self.cameras.clone(),
            floor: self.floor * scale,
            mesh: Mesh {
                vertices: vertices.collect(),
                triangles: self.mesh.triangles.clone(),
            },
            normals: self.normals.clone(),
            field: self.field.scaled(scale),
            surface: self.surface.iter().map(|p| p * scale).collect(),
            center: self.center * scale,
            radius: self.radius * scale,
            pixel: self.pixel * scale,
            cell_size: self.cell_size * scale,
            rays: self.rays.iter().map(ray).collect(),
        }
    }

    /// How far in metres a point lies within all cones and above the table, as far as it matters: the least value of
    /// all, or one below `enough`.
    pub(super) fn value(&self, p: Point3<f64>, enough: f64) -> f64 {
        let mut value = p.z - self.floor;
        for outline in &self.outlines {
            if value < enough {
                break;
            }
            let below = outline.sum_below(value, outline.in_camera(p), 0.0);
            value = below.unwrap_or(value);
        }
        value
    }

    /// Every so many of the rays.
    pub(super) fn chosen_rays(&self, stride: usize) -> impl Iterator<Item = &Ray> {
        self.rays.iter().step_by(stride)
    }
}

/// By how many metres outlines may be too narrow at a height above the table.
#[inline]
pub(super) fn doubt(height: f64) -> f64 {
    DOUBT * (1.0 - height / DOUBT_HEIGHT).clamp(0.0, 1.0)
}

fn rays(outlines: &[Outline]) -> Vec<Ray> {
    let of_outline = |(view, outline): (usize, &Outline)| {
        let eye = outline.eye;
        let points = outline.points.clone().into_iter();
        points.map(move |p| Ray {
            eye,
            direction: p.direction,
            view,
            chain: p.chain,
            length_px: p.length_px,
        })
    };
    outlines.iter().enumerate().flat_map(of_outline).collect()
}

fn center_of_mass(mesh: &Mesh) -> Point3<f64> {
    let (mut sum, mut volume) = (Vector3::zeros(), 0.0);
    let origin = mesh
        .vertices
        .first()
        .map_or(Point3::origin(), |v| v.cast::<f64>());
    for t in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corners(t).map(|p| p.cast::<f64>() - origin);
        let six = a.dot(&b.cross(&c));
        sum += (a + b + c) * (six / 4.0);
        volume += six;
    }
    origin + sum / volume.max(1e-18)
}

/// How far points lie within a hull, on a regular grid around it.
#[derive(Clone, Debug, Default)]
pub(super) struct Field {
    corner: Point3<f64>,
    cell: f64,
    size: [usize; 3],
    values: Vec<f32>,
}

impl Field {
    fn of(body: &Body) -> Self {
        let Some([low, high]) = bounding_box(&body.mesh.vertices) else {
            return Self::default();
        };
        let (low, high) = (low.cast::<f64>(), high.cast::<f64>());
        let cell = (high - low).max() / FIELD_CELLS;
        let margin = Vector3::repeat(REACH * body.radius + 2.0 * cell);
        let corner = low - margin;
        let size = (high - low + 2.0 * margin).map(|s| (s / cell).ceil() as usize + 1);
        let enough = -2.0 * REACH * body.radius;
        let slab = size.x * size.y;
        let mut values = vec![0.0; slab * size.z];
        values
            .par_chunks_mut(slab)
            .enumerate()
            .for_each(|(z, slab)| {
                for (i, value) in slab.iter_mut().enumerate() {
                    let at = Vector3::new(i % size.x, i / size.x, z).map(|c| c as f64 * cell);
                    *value = body.value(corner + at, enough) as f32;
                }
            });
        Self {
            corner,
            cell,
            size: size.into(),
            values,
        }
    }

    fn scaled(&self, scale: f64) -> Self {
        Self {
            corner: self.corner * scale,
            cell: self.cell * scale,
            size: self.size,
            values: self.values.iter().map(|v| v * scale as f32).collect(),
        }
    }

    /// Value and gradient at a point; beyond the grid those of its border.
    #[inline]
    pub(super) fn at(&self, p: Point3<f64>) -> (f64, Vector3<f64>) {
        let at = (p - self.corner) / self.cell;
        let mut first = [0; 3];
        let mut f = [0.0; 3];
        for axis in 0..3 {
            let inside = at[axis].clamp(0.0, (self.size[axis] - 1) as f64);
            first[axis] = (inside as usize).min(self.size[axis] - 2);
            f[axis] = inside - first[axis] as f64;
        }
        let stride = [1, self.size[0], self.size[0] * self.size[1]];
        let base = first[0] + first[1] * stride[1] + first[2] * stride[2];
        let value = |i: usize| {
            let offset = (i & 1) * stride[0] + (i >> 1 & 1) * stride[1] + (i >> 2) * stride[2];
            f64::from(self.values[base + offset])
        };
        let c: [f64; 8] = std::array::from_fn(value);
        let mix = |a: f64, b: f64, f: f64| a + (b - a) * f;
        let x: [f64; 4] = std::array::from_fn(|i| mix(c[2 * i], c[2 * i + 1], f[0]));
        let dx: [f64; 4] = std::array::from_fn(|i| c[2 * i + 1] - c[2 * i]);
        let y = [mix(x[0], x[1], f[1]), mix(x[2], x[3], f[1])];
        let along_x = mix(mix(dx[0], dx[1], f[1]), mix(dx[2], dx[3], f[1]), f[2]);
        let along_y = mix(x[1] - x[0], x[3] - x[2], f[2]);
        let gradient = Vector3::new(along_x, along_y, y[1] - y[0]) / self.cell;
        (mix(y[0], y[1], f[2]), gradient)
    }
}

//! Light on the object and on the table: a key and a fill light of some size, a sky, and what table and object
//! reflect. It is computed once for each scene, a value for each vertex, because lights do not move.

use super::rig::Bounds;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use scand_core::image::Grid;
use scand_core::mesh::{Bvh, Mesh, rasterize, vertex_normals};

/// Linear reflectance of the backdrop and the table's cloth.
pub(super) const BACKDROP: [f32; 3] = [0.045, 0.062, 0.300];
/// Light on an open horizontal surface that comes from the sky.
const SKY: f64 = 0.45;
/// The same from the key light; the three parts are 1 in all.
const KEY: f64 = 0.38;
/// The same from the fill light.
const FILL: f64 = 0.17;
/// Light that a surface of the object throws at another, as a part of what falls on it in the open.
const BOUNCE: f64 = 0.30;
/// Metres that rays start off the surface.
const OFF_SURFACE: f64 = 3e-4;
/// Edge of a cell of the shadow on the table, in metres.
const SHADOW_CELL: f64 = 0.003;
/// How far the shadow reaches beyond the object, in metres.
const SHADOW_REACH: f64 = 0.12;
/// The golden angle in radians, π (3 - √5): points that each lie this angle on from the one before cover a circle
/// evenly.
const GOLDEN_ANGLE: f64 = 2.399963229728653;

/// A direction light comes from, and how much: a horizontal surface gets weight · z.
#[derive(Clone, Copy)]
struct Source {
    direction: Vector3<f64>,
    weight: f64,
}

/// Light as it falls on the object and around it. White in the open is 1.
#[derive(Debug)]
pub(super) struct Light {
    /// For each vertex the light of the lamps and the sky, and of other parts of the object.
    pub white: Vec<f32>,
    /// For each vertex the light that the table and the backdrop throw back at it, before their colour.
    pub spill: Vec<f32>,
    /// Unit normals of the vertices.
    pub normals: Vec<Vector3<f32>>,
    shadow: Grid<f32>,
    shadow_corner: [f64; 2],
}

impl Light {
    /// Bakes the light on `mesh`; `rays` a vertex in all directions, and a third of that for the lamps.
    pub(super) fn bake(mesh: &Mesh, rays: usize) -> Self {
        let sky = sphere(rays);
        let weight = 4.0 * SKY / rays as f64;
        let mut sources: Vec<Source> = sky
            .iter()
            .filter(|d| d.z > 0.0)
            .map(|&direction| Source { direction, weight })
            .collect();
        sources.extend(lamp(Vector3::new(0.55, -0.42, 1.0), 0.16, KEY, rays / 5));
        sources.extend(lamp(Vector3::new(-0.60, 0.50, 0.9), 0.25, FILL, rays / 8));
        let below: Vec<_> = sky.into_iter().filter(|d| d.z <= 0.0).collect();

        let bvh = Bvh::new(mesh);
        let normals = vertex_normals(mesh);
        let lit: Vec<[f32; 2]> = mesh
            .vertices
            .par_iter()
            .zip(&normals)
            .map(|(v, n)| irradiance(&bvh, v.cast(), n.cast(), &sources, &below, rays))
            .collect();
        let (shadow, shadow_corner) = table_shadow(mesh, &sources);
        Self {
            white: lit.iter().map(|l| l[0]).collect(),
            spill: lit.iter().map(|l| l[1]).collect(),
            normals,
            shadow,
            shadow_corner,
        }
    }

    /// The part of the open's light that reaches the table at (x, y).
    pub(super) fn on_table(&self, x: f64, y: f64) -> f32 {
        let u = (x - self.shadow_corner[0]) / SHADOW_CELL;
        let v = (y - self.shadow_corner[1]) / SHADOW_CELL;
        let (i, j) = (u.floor(), v.floor());
        let (fu, fv) = ((u - i) as f32, (v - j) as f32);
        let at = |di: isize, dj: isize| {
            let value = self.shadow.get(i as isize + di, j as isize + dj);
            value.copied().unwrap_or(1.0)
        };
        (at(0, 0) * (1.0 - fu) + at(1, 0) * fu) * (1.0 - fv)
            + (at(0, 1) * (1.0 - fu) + at(1, 1) * fu) * fv
    }
}

/// Evenly spread directions (a Fibonacci lattice).
fn sphere(count: usize) -> Vec<Vector3<f64>> {
    (0..count)
        .map(|k| {
            let z = 1.0 - (2.0 * k as f64 + 1.0) / count as f64;
            let (sin, cos) = (GOLDEN_ANGLE * k as f64).sin_cos();
            let r = (1.0 - z * z).sqrt();
            Vector3::new(r * cos, r * sin, z)
        })
        .collect()
}

/// Samples of a lamp of some angular radius that gives a horizontal surface `light` in all.
fn lamp(towards: Vector3<f64>, radius: f64, light: f64, count: usize) -> Vec<Source> {
    let count = count.max(3);
    let axis = towards.normalize();
    let u = axis.cross(&Vector3::z()).normalize();
    let v = axis.cross(&u);
    (0..count)
        .map(|k| {
            let r = radius * ((k as f64 + 0.5) / count as f64).sqrt();
            let (sin, cos) = (GOLDEN_ANGLE * k as f64).sin_cos();
            let direction = (axis + (u * cos + v * sin) * r).normalize();
            let weight = light / (count as f64 * direction.z);
            Source { direction, weight }
        })
        .collect()
}

/// White light and light from below at a point of the surface.
fn irradiance(
    bvh: &Bvh,
    p: Point3<f64>,
    n: Vector3<f64>,
    sources: &[Source],
    below: &[Vector3<f64>],
    rays: usize,
) -> [f32; 2] {
    let origin = p + n * OFF_SURFACE;
    let (mut white, mut spill) = (0.0, 0.0);
    for source in sources {
        let cosine = n.dot(&source.direction);
        if cosine > 0.0 {
            let part = match bvh.is_occluded(origin, source.direction, 1.0) {
                true => BOUNCE,
                false => 1.0,
            };
            white += source.weight * cosine * part;
        }
    }
    for direction in below {
        let cosine = n.dot(direction);
        if cosine > 0.0 {
            let light = 4.0 * cosine / rays as f64;
            match bvh.is_occluded(origin, *direction, 1.0) {
                true => white += light * BOUNCE,
                false => spill += light,
            }
        }
    }
    [white as f32, spill as f32]
}

/// The part of the open's light that reaches each cell of the table, and the middle of the first cell:
/// every source throws the object's outline onto the plane.
fn table_shadow(mesh: &Mesh, sources: &[Source]) -> (Grid<f32>, [f64; 2]) {
    let bounds = Bounds::of(mesh);
    let corner = [bounds.min.x - SHADOW_REACH, bounds.min.y - SHADOW_REACH];
    let cells = |a: usize| {
        let size = bounds.max[a] - bounds.min[a] + 2.0 * SHADOW_REACH;
        ((size / SHADOW_CELL).clamp(1.0, 1000.0)) as usize
    };
    let (width, height) = (cells(0), cells(1));
    let open: f64 = sources.iter().map(|s| s.weight * s.direction.z).sum();
    let shadows: Vec<Grid<bool>> = sources
        .par_iter()
        .map(|source| {
            let thrown = |v: &Point3<f32>| {
                let p: Point3<f64> = v.cast();
                let q = p - source.direction * (p.z / source.direction.z);
                let cell = |a: usize| ((q[a] - corner[a]) / SHADOW_CELL) as f32;
                [cell(0), cell(1), 1.0]
            };
            let projected: Vec<_> = mesh.vertices.iter().map(thrown).collect();
            rasterize(&projected, &mesh.triangles, width, height).map(|f| f.is_covered())
        })
        .collect();
    let shadow = Grid::from_fn(width, height, |x, y| {
        let light: f64 = sources
            .iter()
            .zip(&shadows)
            .map(|(source, shadow)| {
                let part = if shadow[(x, y)] { BOUNCE } else { 1.0 };
                source.weight * source.direction.z * part
            })
            .sum();
        (light / open) as f32
    });
    (shadow, corner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Shape;
    use std::f64::consts::PI;

    /// To the last bit: the simulator's pictures follow from it.
    #[test]
    fn the_golden_angle_is_exact() {
        assert_eq!(GOLDEN_ANGLE, PI * (3.0 - 5.0_f64.sqrt()));
    }

    #[test]
    fn light_is_1_in_the_open_less_in_a_cup_and_least_where_the_object_stands() {
        let mesh = Shape::Cup.mesh(0.004);
        let light = Light::bake(&mesh, 64);
        let rim = (0..mesh.vertices.len())
            .max_by(|&a, &b| mesh.vertices[a].z.total_cmp(&mesh.vertices[b].z))
            .unwrap();
        let floor = (0..mesh.vertices.len())
            .filter(|&v| (mesh.vertices[v].z - 0.006).abs() < 1e-4)
            .min_by(|&a, &b| {
                mesh.vertices[a]
                    .x
                    .abs()
                    .total_cmp(&mesh.vertices[b].x.abs())
            })
            .unwrap();
        assert!((light.white[rim] - 1.0).abs() < 0.1, "{}", light.white[rim]);
        assert!(light.white[floor] < 0.7 * light.white[rim]);
        assert_eq!(light.on_table(0.5, 0.5), 1.0);
        let near = light.on_table(-0.035, 0.02);
        assert!((0.2..0.8).contains(&near), "{near}");
        assert!(
            light.on_table(-0.10, 0.08) > near,
            "the shadow fades away from the object"
        );
    }
}

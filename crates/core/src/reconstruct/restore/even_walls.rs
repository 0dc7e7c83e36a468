//! Evens walls. Outlines show the outside of a vessel to a fraction of the depth camera's pixel, but a steep wall's
//! inside is known to half of one only, as its readings begin and end with pixels. So what varies in a wall's thickness
//! over a few pixels is mostly the depth camera, and the inside goes to where the thickness is even, no farther than it
//! may be off. Nothing else of the surface moves.

use crate::mesh::{Bvh, vertex_normals};
use crate::reconstruct::{Model, Provenance};
use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;

// Lengths in pixels of the depth camera, at the walls.

/// The thickest wall whose sides follow each other.
const THICKEST_PX: f64 = 8.0;
/// Standard deviation of the weights around a place, and how many of them count.
const SPREAD_PX: f64 = 10.0;
const REACH: f64 = 2.2;
/// Vertices within this are taken together where thickness is averaged.
const SAMPLE_PX: f64 = 1.75;
/// So many times as far from a place are samples that tell its thickness.
const AROUND: f64 = 2.0;
/// The scatter of thickness: what is farther off than this counts less.
const SCATTER_PX: f64 = 0.35;
/// How far the inside of a steep wall may be off.
const FARTHEST_PX: f64 = 0.5;

/// Sines of the angle between normal and view up to which depth itself shows where a place is, and from which on it is
/// as uncertain across as a steep wall: 30 and 53 degrees.
const FACING: f64 = 0.5;
const STEEP: f64 = 0.8;
/// Cosine of the angle within which the two sides of a wall are opposite.
const OPPOSITE: f64 = 0.8;
/// Share of its thickness by which a wall may become thinner.
const THINNER: f64 = 0.5;
/// What is left of the expected error where a wall could become even.
const LEFT: f32 = 0.75;
/// Samples that tell how a wall goes on.
const LEAST_SAMPLES: usize = 12;
/// Rounds of weighing by scatter.
const ROUNDS: usize = 3;

/// A place on the inside of a wall.
#[derive(Clone, Copy)]
struct Wall {
    at: Point3<f64>,
    normal: Vector3<f64>,
    thickness: f64,
}

/// What became of walls.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct EvenWalls {
    /// Vertices on the inside of walls whose outside is faired.
    pub vertices: usize,
    /// How far they moved, in metres, root mean square.
    pub moved_rms: f64,
}

/// How a place on the inside moves.
struct Move {
    /// Along its normal, in metres.
    way: f32,
    /// Whether the wall is even then.
    is_even: bool,
}

/// How the depth camera on whose carving a place lies sees it.
#[derive(Clone, Copy)]
pub(super) struct Sight {
    /// How long a pixel is there, in metres.
    pub(super) pixel: f64,
    /// Cosine of the angle between the normal and the way to the camera.
    pub(super) facing: f64,
}

impl Sight {
    /// Share of what a wall's unevenness asks for that a place moves by: what faces the camera stays.
    fn share(&self) -> f64 {
        let sine = (1.0 - self.facing * self.facing).max(0.0).sqrt();
        ((sine - FACING) / (STEEP - FACING)).clamp(0.0, 1.0)
    }
}

/// Moves the inside of walls to where they are even, and lowers what is expected of their errors. `sight_of` tells how
/// a vertex is seen, `None` where no depth camera carved, and `is_faired` whether the outside is, at a point of it.
/// `None` where there is no wall.
pub(super) fn even_walls(
    model: &mut Model,
    sight_of: impl Fn(usize, &Model) -> Option<Sight>,
    is_faired: impl Fn(Point3<f64>) -> bool + Sync,
) -> Option<EvenWalls> {
    let (inside, sights): (Vec<usize>, Vec<Sight>) = (0..model.mesh.vertices.len())
        .filter(|&v| is_inside(model.provenance[v]))
        .filter_map(|v| Some((v, sight_of(v, model)?)))
        .unzip();
    let pixel = sights.iter().map(|s| s.pixel).sum::<f64>() / sights.len() as f64;
    // Without a length, cubes have none either.
    if inside.is_empty() || pixel <= 0.0 {
        return None;
    }
    let outside = Outside::new(model, is_faired);
    let walls: Vec<Option<Wall>> = inside
        .par_iter()
        .map(|&v| outside.wall(model, v, THICKEST_PX * pixel))
        .collect();
    let trend = Trend::new(&walls, pixel);
    let move_of = |((&v, sight), wall): ((&usize, &Sight), &Option<Wall>)| {
        let (wall, share) = (wall.as_ref()?, sight.share());
        if share == 0.0 {
            return None;
        }
        let most = f64::from(model.expected_error[v]).min(FARTHEST_PX * pixel);
        let way = trend.thickness(wall)? - wall.thickness;
        Some(Move {
            way: (share * way.clamp(-most.min(THINNER * wall.thickness), most)) as f32,
            is_even: way.abs() < most && share == 1.0,
        })
    };
    let moves: Vec<Option<Move>> = inside
        .par_iter()
        .zip(&sights)
        .zip(&walls)
        .map(move_of)
        .collect();
    let (mut vertices, mut squares) = (0, 0.0);
    for (&v, found) in inside.iter().zip(&moves) {
        let Some(found) = found else { continue };
        vertices += 1;
        squares += f64::from(found.way).powi(2);
        model.mesh.vertices[v] += model.normals[v] * found.way;
        if found.is_even {
            model.expected_error[v] *= LEFT;
        }
    }
    if vertices == 0 {
        return None;
    }
    model.normals = vertex_normals(&model.mesh);
    Some(EvenWalls {
        vertices,
        moved_rms: (squares / vertices as f64).sqrt(),
    })
}

fn is_inside(from: Provenance) -> bool {
    use Provenance::{Bridged, Carved, Restored, Unseen};
    matches!(from, Carved | Restored | Bridged | Unseen)
}

/// What outlines show.
struct Outside<F> {
    triangles: Bvh,
    normals: Vec<Vector3<f64>>,
    is_faired: F,
}

impl<F: Fn(Point3<f64>) -> bool> Outside<F> {
    fn new(model: &Model, is_faired: F) -> Self {
        let mesh = model.part(Provenance::Hull);
        let normal = |t: usize| {
            let [a, b, c] = mesh.corners(t).map(|p| p.cast::<f64>());
            (b - a).cross(&(c - a)).normalize()
        };
        Self {
            triangles: Bvh::new(&mesh),
            normals: (0..mesh.triangles.len()).map(normal).collect(),
            is_faired,
        }
    }

    /// The wall behind a vertex, if it is no thicker than `thickest` metres and its other side is faired.
    fn wall(&self, model: &Model, v: usize, thickest: f64) -> Option<Wall> {
        let at: Point3<f64> = model.mesh.vertices[v].cast();
        let normal: Vector3<f64> = model.normals[v].cast();
        let hit = self.triangles.raycast(at, -normal, thickest)?;
        let is_wall = self.normals[hit.triangle].dot(&normal) < -OPPOSITE
            && (self.is_faired)(at - normal * hit.t);
        is_wall.then_some(Wall {
            at,
            normal,
            thickness: hit.t,
        })
    }
}

/// Thickness and how it changes, at the samples of all walls.
struct Trend {
    /// Metres within which samples tell the thickness of a place.
    reach: f64,
    samples: Places,
    slopes: Vec<Option<Slope>>,
}

/// A thickness at a sample, and its gradient.
struct Slope {
    thickness: f64,
    gradient: Vector3<f64>,
}

impl Trend {
    fn new(walls: &[Option<Wall>], pixel: f64) -> Self {
        let samples = samples(walls, SAMPLE_PX * pixel);
        let wide = Places::new(samples.clone(), REACH * SPREAD_PX * pixel);
        let numbers = (0..samples.len()).into_par_iter();
        let slopes = numbers.map(|i| slope(&wide, i, pixel)).collect();
        let reach = AROUND * SAMPLE_PX * pixel;
        Self {
            reach,
            samples: Places::new(samples, reach),
            slopes,
        }
    }

    /// The even thickness at a place: what the samples around it say of it.
    fn thickness(&self, wall: &Wall) -> Option<f64> {
        let reach = self.reach;
        let (mut sum, mut weights) = (0.0, 0.0);
        for i in self.samples.near(wall, reach) {
            let Some(slope) = &self.slopes[i] else {
                continue;
            };
            let way = wall.at - self.samples.walls[i].at;
            let weight = (1.0 - way.norm() / reach).powi(2);
            sum += weight * (slope.thickness + slope.gradient.dot(&way));
            weights += weight;
        }
        (weights > 0.0).then(|| sum / weights)
    }
}

/// The means of walls within cubes of an edge of `size` metres.
fn samples(walls: &[Option<Wall>], size: f64) -> Vec<Wall> {
    let mut cubes: BTreeMap<[i64; 3], (Wall, f64)> = BTreeMap::new();
    for wall in walls.iter().flatten() {
        let (sum, count) = cubes.entry(cube(&wall.at, size)).or_insert((
            Wall {
                at: Point3::origin(),
                normal: Vector3::zeros(),
                thickness: 0.0,
            },
            0.0,
        ));
        sum.at += wall.at.coords;
        sum.normal += wall.normal;
        sum.thickness += wall.thickness;
        *count += 1.0;
    }
    let mean = |(sum, count): (Wall, f64)| {
        Some(Wall {
            at: sum.at / count,
            normal: sum.normal.try_normalize(0.5)?,
            thickness: sum.thickness / count,
        })
    };
    cubes.into_values().filter_map(mean).collect()
}

/// How thickness goes on around a sample, fitted linearly along the wall; `None` where too few samples are around it.
fn slope(samples: &Places, i: usize, pixel: f64) -> Option<Slope> {
    let here = &samples.walls[i];
    let (spread, scatter) = (SPREAD_PX * pixel, SCATTER_PX * pixel);
    let first = here
        .normal
        .cross(&Vector3::ith(here.normal.iamin(), 1.0))
        .normalize();
    let second = here.normal.cross(&first);
    let around: Vec<(Vector3<f64>, f64, f64)> = samples
        .near(here, REACH * spread)
        .map(|j| {
            let wall = &samples.walls[j];
            let way = wall.at - here.at;
            let row = Vector3::new(1.0, way.dot(&first) / spread, way.dot(&second) / spread);
            let along = wall.normal.dot(&here.normal).max(0.0);
            let weight = (-0.5 * way.norm_squared() / (spread * spread)).exp() * along * along;
            (row, wall.thickness, weight)
        })
        .collect();
    if around.len() < LEAST_SAMPLES {
        return None;
    }
    let mut line = Vector3::new(here.thickness, 0.0, 0.0);
    for round in 0..ROUNDS {
        let (mut matrix, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for (row, thickness, weight) in &around {
            let off = if round > 0 {
                (thickness - row.dot(&line)) / scatter
            } else {
                0.0
            };
            let weight = weight / (1.0 + off * off);
            matrix += row * row.transpose() * weight;
            right += row * (thickness * weight);
        }
        line = matrix.cholesky()?.solve(&right);
    }
    line.iter().all(|x| x.is_finite()).then(|| Slope {
        thickness: line.x,
        gradient: (first * line.y + second * line.z) / spread,
    })
}

/// Walls that are found by where they are.
struct Places {
    walls: Vec<Wall>,
    size: f64,
    cubes: BTreeMap<[i64; 3], Vec<usize>>,
}

impl Places {
    /// To be asked for what is within `size` metres of a place.
    fn new(walls: Vec<Wall>, size: f64) -> Self {
        let mut cubes: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
        for (i, wall) in walls.iter().enumerate() {
            cubes.entry(cube(&wall.at, size)).or_default().push(i);
        }
        Self { walls, size, cubes }
    }

    /// The walls within `reach` metres of one that face where it does.
    fn near(&self, wall: &Wall, reach: f64) -> impl Iterator<Item = usize> {
        let low = cube(&(wall.at - Vector3::repeat(reach)), self.size);
        let high = cube(&(wall.at + Vector3::repeat(reach)), self.size);
        let cubes = (low[0]..=high[0]).flat_map(move |x| {
            (low[1]..=high[1]).flat_map(move |y| (low[2]..=high[2]).map(move |z| [x, y, z]))
        });
        let numbers = cubes.filter_map(|c| self.cubes.get(&c)).flatten().copied();
        numbers.filter(move |&i| {
            let other = &self.walls[i];
            (other.at - wall.at).norm() < reach && other.normal.dot(&wall.normal) > 0.0
        })
    }
}

fn cube(p: &Point3<f64>, size: f64) -> [i64; 3] {
    [p.x, p.y, p.z].map(|x| (x / size).floor() as i64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;
    use std::f64::consts::TAU;

    /// Around and along of the tube's vertices.
    const COUNT: [usize; 2] = [160, 50];
    const PIXEL: f64 = 1e-3;

    fn steep() -> Sight {
        Sight {
            pixel: PIXEL,
            facing: 0.2,
        }
    }

    /// A tube whose outside has a radius of 30 mm, and a wall as `thickness` tells in metres, by angle and height.
    fn tube(inside: Provenance, thickness: impl Fn(f64, f64) -> f64) -> Model {
        let (mut mesh, mut normals) = (Mesh::default(), Vec::new());
        for side in [1.0, -1.0] {
            let first = mesh.vertices.len();
            for i in 0..COUNT[0] * COUNT[1] {
                let angle = TAU * (i % COUNT[0]) as f64 / COUNT[0] as f64;
                let height = 1e-3 * (i / COUNT[0]) as f64;
                let wall = if side > 0.0 {
                    0.0
                } else {
                    thickness(angle, height)
                };
                let out = Vector3::new(angle.cos(), angle.sin(), 0.0);
                let p = Point3::from(out * (0.03 - wall) + Vector3::z() * height);
                mesh.vertices.push(p.cast());
                normals.push((out * side).cast());
            }
            for i in 0..COUNT[0] * (COUNT[1] - 1) {
                let next = i - i % COUNT[0] + (i + 1) % COUNT[0];
                let corners = [i, next, next + COUNT[0], i + COUNT[0]].map(|v| (first + v) as u32);
                let [a, b, c, d] = corners;
                let around = if side > 0.0 {
                    [[a, b, c], [a, c, d]]
                } else {
                    [[c, b, a], [d, c, a]]
                };
                mesh.triangles.extend(around);
            }
        }
        let half = normals.len() / 2;
        Model {
            expected_error: vec![4e-4; 2 * half],
            provenance: [vec![Provenance::Hull; half], vec![inside; half]].concat(),
            mesh,
            normals,
            ..Model::default()
        }
    }

    /// Thickness inside the tube, in metres, row by row.
    fn thickness(model: &Model) -> Vec<f64> {
        let inside = &model.mesh.vertices[COUNT[0] * COUNT[1]..];
        inside
            .iter()
            .map(|p| 0.03 - f64::from(p.x.hypot(p.y)))
            .collect()
    }

    fn evened(mut model: Model, is_faired: bool) -> Model {
        even_walls(&mut model, |_, _| Some(steep()), |_| is_faired);
        model
    }

    fn rms(values: impl Iterator<Item = f64> + Clone) -> f64 {
        (values.clone().map(|v| v * v).sum::<f64>() / values.count() as f64).sqrt()
    }

    /// Twelve waves around, of 14 mm each, as the depth camera's pixels make them at a rim.
    fn wavy(angle: f64, _height: f64) -> f64 {
        3e-3 + 2.5e-4 * (12.0 * angle).sin()
    }

    #[test]
    fn waves_of_a_wall_go_and_its_thickness_stays() {
        let off = |model: &Model| rms(thickness(model).into_iter().map(|t| t - 3e-3));
        let before = tube(Provenance::Restored, wavy);
        let after = evened(before.clone(), true);
        assert!(
            off(&after) < 0.35 * off(&before),
            "{} of {}",
            off(&after),
            off(&before)
        );
        let mean = thickness(&after).iter().sum::<f64>() / thickness(&after).len() as f64;
        assert!((mean - 3e-3).abs() < 5e-6, "{mean}");
    }

    #[test]
    fn a_wall_that_grows_thicker_downwards_still_does() {
        let taper = |_: f64, height: f64| 5e-3 - 0.05 * height;
        let before = tube(Provenance::Restored, taper);
        let after = evened(before.clone(), true);
        let pairs = thickness(&before).into_iter().zip(thickness(&after));
        let worst = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 2e-5, "{worst}");
    }

    #[test]
    fn nothing_moves_farther_than_it_may_be_off() {
        let step = |angle: f64, _: f64| if angle < 0.3 { 5e-3 } else { 3e-3 };
        for (error, most) in [(1e-4, 1e-4), (9e-3, FARTHEST_PX * PIXEL)] {
            let mut before = tube(Provenance::Restored, step);
            before.expected_error.fill(error);
            let after = evened(before.clone(), true);
            let pairs = before.mesh.vertices.iter().zip(&after.mesh.vertices);
            let farthest = pairs
                .map(|(a, b)| f64::from((a - b).norm()))
                .fold(0.0, f64::max);
            assert!((farthest / most - 1.0).abs() < 0.01, "{farthest} of {most}");
        }
    }

    #[test]
    fn less_error_is_expected_where_a_wall_could_become_even() {
        let waves = evened(tube(Provenance::Restored, wavy), true);
        let inside = COUNT[0] * COUNT[1]..;
        assert!(
            waves.expected_error[inside.clone()]
                .iter()
                .all(|&e| e == LEFT * 4e-4)
        );
        let mut doubted = tube(Provenance::Restored, wavy);
        doubted.expected_error.fill(1e-5);
        let kept = evened(doubted, true).expected_error;
        assert!(kept[inside].iter().filter(|&&e| e == 1e-5).count() > COUNT[0] * COUNT[1] / 2);
    }

    #[test]
    fn a_thin_wall_is_not_turned_inside_out() {
        let thin = |angle: f64, _: f64| if angle < 0.1 { 2e-3 } else { 2e-4 };
        let mut before = tube(Provenance::Restored, thin);
        before.expected_error.fill(9e-3);
        assert!(
            thickness(&evened(before, true))
                .into_iter()
                .all(|t| t > 9e-5)
        );
    }

    #[test]
    fn the_outside_and_what_is_beside_a_plain_hull_stay() {
        let before = tube(Provenance::Restored, wavy);
        assert_eq!(evened(before.clone(), false).mesh, before.mesh);
        let outside = ..COUNT[0] * COUNT[1];
        let after = evened(before.clone(), true);
        assert_eq!(after.mesh.vertices[outside], before.mesh.vertices[outside]);
        let solid = tube(Provenance::Hull, wavy);
        assert_eq!(evened(solid.clone(), true).mesh, solid.mesh);
    }

    #[test]
    fn what_faces_the_depth_camera_stays() {
        let before = tube(Provenance::Restored, wavy);
        let mut after = before.clone();
        let faces = |_: usize, _: &Model| {
            Some(Sight {
                facing: 0.9,
                ..steep()
            })
        };
        assert_eq!(even_walls(&mut after, faces, |_| true), None);
        assert_eq!(after.mesh, before.mesh);
    }

    #[test]
    fn a_wall_that_is_too_thick_to_measure_stays() {
        let before = tube(Provenance::Restored, |a, h| 7e-3 + wavy(a, h));
        assert_eq!(evened(before.clone(), true).mesh, before.mesh);
    }

    #[test]
    fn nothing_comes_of_nothing() {
        let mut empty = Model::default();
        assert_eq!(even_walls(&mut empty, |_, _| Some(steep()), |_| true), None);
    }
}

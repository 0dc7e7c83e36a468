//! The flat parts of the convex hull of certain edges, and how much of the contours agrees with the outline of each.
//! Which of them count as sides of the object is not decided here.

use super::contour::Contour;
use super::corners::{distance, outline, pictures};
use crate::mesh::{Bvh, Mesh, sorted_sides};
use nalgebra::{Matrix3, Point2, Point3, SymmetricEigen, Vector3};
use std::collections::{BTreeMap, BTreeSet};

/// A side is flat where its corners lie within so many pixels of one plane.
const FLAT_PX: f64 = 1.25;
/// The contours agree with an outline that is within so many pixels of them.
const AGREES_PX: f64 = 0.75;
/// Length of contour that has to agree with a side, and edge of a square as large as the smallest side, in pixels.
pub(super) const LEAST_PX: f64 = 16.0;
/// Beyond a side's border the surface turns by more than this, but for a share of the border: strips of something round
/// are no sides.
pub(super) const SHARP_COSINE: f64 = 0.906;
const BLUNT: f64 = 0.15;
/// A neighbour with less than this share of the area is a bevel that noise makes: what lies beyond it tells how the
/// surface turns.
pub(super) const NARROW: f64 = 0.1;
/// Parts whose planes have normals within this angle (3 degrees) are one side if the corners of both lie within so many
/// pixels of one plane: a plane through three corners that are off by a fraction of a pixel misses the fourth by
/// several. Neighbouring strips of something round turn by more.
const SAME_COSINE: f64 = 0.9986;
const MERGED_PX: f64 = 1.5;
/// Facets of one side have normals within this angle of the plane's, but for narrow ones, which have only noise.
const ALIKE_COSINE: f64 = 0.97;

/// A plane: the points p with `normal` · p = `height`, which is metres from the rig's origin.
#[derive(Clone, Copy)]
pub(super) struct Plane {
    pub(super) normal: Vector3<f64>,
    pub(super) height: f64,
}

impl Plane {
    pub(super) fn outside(&self, p: Point3<f64>) -> f64 {
        self.normal.dot(&p.coords) - self.height
    }
}

/// The flat parts of a convex hull.
pub(super) struct Flat<'a> {
    pub(super) mesh: &'a Mesh,
    /// The part of each facet.
    pub(super) of_facet: Vec<Option<u32>>,
    pub(super) planes: Vec<Plane>,
    pub(super) areas: Vec<f64>,
    /// Whether each facet lies on the table, once that was asked.
    pub(super) is_foot: Vec<bool>,
    /// The two facets at each edge.
    at_edge: BTreeMap<(u32, u32), Vec<u32>>,
}

impl<'a> Flat<'a> {
    pub(super) fn of(mesh: &'a Mesh, pixel: f64) -> Self {
        let mut at_edge: BTreeMap<(u32, u32), Vec<u32>> = BTreeMap::new();
        for side in sorted_sides(&mesh.triangles, mesh.vertices.len()) {
            at_edge
                .entry((side.low, side.high))
                .or_default()
                .push(side.triangle);
        }
        let mut flat = Self {
            mesh,
            of_facet: vec![None; mesh.triangles.len()],
            is_foot: vec![false; mesh.triangles.len()],
            planes: Vec::new(),
            areas: Vec::new(),
            at_edge,
        };
        let mut largest: Vec<(usize, f64)> = (0..mesh.triangles.len())
            .map(|t| (t, 0.5 * flat.cross(t).norm()))
            .collect();
        largest.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        let least = LEAST_PX * pixel;
        for (seed, area) in largest {
            // What is smaller than this can be the middle of no side.
            if flat.of_facet[seed].is_none() && area > 0.01 * least * least {
                flat.grow(seed, pixel);
            }
        }
        flat.merge(pixel);
        flat
    }

    /// Makes parts that lie in one plane one part, the largest first. A part that became another's has no area left.
    fn merge(&mut self, pixel: f64) {
        for part in 0..self.planes.len() {
            for other in part + 1..self.planes.len() {
                let [a, b] = [part, other].map(|i| self.planes[i].normal);
                if self.areas[part] == 0.0 || self.areas[other] == 0.0 || a.dot(&b) < SAME_COSINE {
                    continue;
                }
                let of_either = |t: &usize| {
                    let number = self.of_facet[*t].map(|number| number as usize);
                    number == Some(part) || number == Some(other)
                };
                let members: Vec<usize> = (0..self.of_facet.len()).filter(of_either).collect();
                let Some(plane) = self.fitted(&members) else {
                    continue;
                };
                let fits = |&t: &usize| {
                    let mut corners = self.corners(t).into_iter();
                    corners.all(|p| plane.outside(p).abs() < MERGED_PX * pixel)
                };
                if members.iter().all(fits) {
                    members
                        .iter()
                        .for_each(|&t| self.of_facet[t] = Some(part as u32));
                    self.planes[part] = plane;
                    self.areas[part] += std::mem::take(&mut self.areas[other]);
                }
            }
        }
    }

    /// Whether the surface turns at a part's border, and does not go on as something round. Beyond bevels, it turns as
    /// much as to that part around them towards which it turns least.
    pub(super) fn has_sharp_border(&self, part: u32) -> bool {
        let (mut sharp, mut blunt) = (0.0, 0.0);
        for (&(a, b), facets) in &self.at_edge {
            let is_of = |t: &&u32| self.of_facet[**t as usize] == Some(part);
            let (Some(_), Some(&other)) =
                (facets.iter().find(is_of), facets.iter().find(|t| !is_of(t)))
            else {
                continue;
            };
            let Some(cosine) = self.turn_beyond(part, other) else {
                continue;
            };
            let [a, b] = [a, b].map(|v| self.mesh.vertices[v as usize].cast::<f64>());
            let length = (a - b).norm();
            if cosine > SHARP_COSINE {
                blunt += length;
            } else {
                sharp += length;
            }
        }
        sharp > 0.0 && blunt <= BLUNT * (sharp + blunt)
    }

    /// The cosine of the angle by which the surface turns from a part to the part of a facet beside it. Where that is
    /// narrow, the parts around it count, and of them the one towards which the surface turns least; `None` if all that
    /// can be reached over narrow ones is narrow.
    fn turn_beyond(&self, part: u32, facet: u32) -> Option<f64> {
        let normal = self.planes[part as usize].normal;
        let is_narrow =
            |other: u32| self.areas[other as usize] < NARROW * self.areas[part as usize];
        let mut seen = BTreeSet::from([facet]);
        let mut next = vec![facet];
        let mut cosine: Option<f64> = None;
        while let Some(t) = next.pop() {
            match self.of_facet[t as usize] {
                Some(other) if other == part => {}
                Some(other) if !is_narrow(other) => {
                    let turned = normal.dot(&self.planes[other as usize].normal);
                    cosine = Some(cosine.map_or(turned, |largest| largest.max(turned)));
                }
                _ => {
                    let beside = self.beside_facet(t as usize);
                    next.extend(beside.filter(|&other| seen.insert(other)));
                }
            }
        }
        cosine
    }

    /// The facets at the edges of a facet, itself among them.
    pub(super) fn beside_facet(&self, t: usize) -> impl Iterator<Item = u32> {
        let corners = self.mesh.triangles[t];
        [(0, 1), (1, 2), (2, 0)]
            .into_iter()
            .map(move |(i, j)| (corners[i], corners[j]))
            .flat_map(|(a, b)| &self.at_edge[&(a.min(b), a.max(b))])
            .copied()
    }

    fn corners(&self, t: usize) -> [Point3<f64>; 3] {
        self.mesh.corners(t).map(|c| c.cast())
    }

    pub(super) fn cross(&self, t: usize) -> Vector3<f64> {
        let [a, b, c] = self.corners(t);
        (b - a).cross(&(c - a))
    }

    /// Makes the facets around a facet that lie in its plane a part.
    fn grow(&mut self, seed: usize, pixel: f64) {
        let number = self.planes.len() as u32;
        let Some(normal) = self.cross(seed).try_normalize(0.0) else {
            return;
        };
        let height = normal.dot(&self.corners(seed)[0].coords);
        let mut plane = Plane { normal, height };
        let mut members = vec![seed];
        self.of_facet[seed] = Some(number);
        let mut next = 0;
        while let Some(&t) = members.get(next) {
            next += 1;
            let corners = self.mesh.triangles[t];
            for i in 0..3 {
                let (a, b) = (corners[i], corners[(i + 1) % 3]);
                for &other in &self.at_edge[&(a.min(b), a.max(b))] {
                    let other = other as usize;
                    if self.of_facet[other].is_none() && self.lies_in(other, &plane, pixel) {
                        self.of_facet[other] = Some(number);
                        members.push(other);
                    }
                }
            }
            if next.is_power_of_two() {
                plane = self.fitted(&members).unwrap_or(plane);
            }
        }
        self.areas
            .push(members.iter().map(|&t| 0.5 * self.cross(t).norm()).sum());
        self.planes.push(self.fitted(&members).unwrap_or(plane));
    }

    fn lies_in(&self, t: usize, plane: &Plane, pixel: f64) -> bool {
        let corners = self.corners(t);
        let cross = self.cross(t);
        let longest = (0..3).map(|i| (corners[i] - corners[(i + 1) % 3]).norm());
        let is_narrow = cross.norm() < pixel * longest.fold(0.0, f64::max);
        let is_alike = cross.dot(&plane.normal) > ALIKE_COSINE * cross.norm();
        let near = |p: &Point3<f64>| plane.outside(*p).abs() < FLAT_PX * pixel;
        (is_narrow || is_alike) && corners.iter().all(near)
    }

    /// The plane that fits the corners of some facets best.
    fn fitted(&self, members: &[usize]) -> Option<Plane> {
        let mut corners: Vec<u32> = members
            .iter()
            .flat_map(|&t| self.mesh.triangles[t])
            .collect();
        corners.sort_unstable();
        corners.dedup();
        let points: Vec<Point3<f64>> = corners
            .iter()
            .map(|&v| self.mesh.vertices[v as usize].cast())
            .collect();
        fitted(&points, members.iter().map(|&t| self.cross(t)).sum())
    }

    /// The part on the table is no side that a contour could show.
    pub(super) fn leave_out_the_foot(&mut self, floor: f64, near: f64) {
        for t in 0..self.of_facet.len() {
            let is_low = self.corners(t).iter().all(|p| p.z < floor + near);
            if is_low && self.cross(t).z < 0.0 {
                self.of_facet[t] = None;
                self.is_foot[t] = true;
            }
        }
    }

    /// For each part the length of contour beside it that agrees with its outline, and that does not, in pixels. What
    /// lies below `low` is not asked: shadows and the table blur the contours of a foot.
    pub(super) fn tally(&self, contour: &Contour, low: f64) -> Vec<[f64; 2]> {
        let mut tally = vec![[0.0; 2]; self.planes.len()];
        let Some(outline) = self.outline(contour) else {
            return tally;
        };
        let lens = &contour.camera.intrinsics;
        for (pixel, length) in &contour.points {
            let Some(ray) = lens.unproject(*pixel) else {
                continue;
            };
            let p = Point2::new(ray.x * lens.focal_px.x, ray.y * lens.focal_px.y);
            let nearest = (0..outline.len())
                .map(|i| {
                    let (a, b) = (outline[i], outline[(i + 1) % outline.len()]);
                    (distance(p, a.1, b.1), a.0, b.0)
                })
                .min_by(|a, b| a.0.total_cmp(&b.0));
            let Some((distance, a, b)) = nearest else {
                continue;
            };
            let is_low = |v: u32| f64::from(self.mesh.vertices[v as usize].z) < low;
            if is_low(a) && is_low(b) {
                continue;
            }
            let column = usize::from(distance > AGREES_PX);
            for side in self.beside(a, b) {
                tally[side as usize][column] += length;
            }
        }
        tally
    }

    /// The parts at the edge between two corners, each once; where there is no edge, those at either corner.
    fn beside(&self, a: u32, b: u32) -> Vec<u32> {
        let mut sides: Vec<u32> = match self.at_edge.get(&(a.min(b), a.max(b))) {
            Some(facets) => facets
                .iter()
                .filter_map(|&t| self.of_facet[t as usize])
                .collect(),
            None => (0..self.of_facet.len())
                .filter(|&t| self.mesh.triangles[t].iter().any(|v| [a, b].contains(v)))
                .filter_map(|t| self.of_facet[t])
                .collect(),
        };
        sides.sort_unstable();
        sides.dedup();
        sides
    }

    /// The outline in a picture: corners with their places.
    fn outline(&self, contour: &Contour) -> Option<Vec<(u32, Point2<f64>)>> {
        let corners: Vec<Point3<f64>> = self.mesh.vertices.iter().map(|p| p.cast()).collect();
        let pictures = pictures(&corners, contour)?;
        let outline = outline((0..).zip(pictures).collect());
        (outline.len() > 2).then_some(outline)
    }

    /// Fits the planes to all points of edges that lie on them.
    pub(super) fn fit_to(&mut self, points: &[Point3<f64>], pixel: f64) {
        let facets = Bvh::new(self.mesh);
        let mut on = vec![Vec::new(); self.planes.len()];
        for p in points {
            let corners = facets
                .closest_point(*p)
                .map(|c| self.mesh.triangles[c.triangle]);
            // A point of an edge belongs to the sides on both sides of it.
            let Some(corners) = corners else { continue };
            for (part, plane) in self.planes.iter().enumerate() {
                let is_beside = || {
                    let of = |t: usize| self.of_facet[t] == Some(part as u32);
                    (0..self.of_facet.len()).any(|t| {
                        of(t) && self.mesh.triangles[t].iter().any(|v| corners.contains(v))
                    })
                };
                if plane.outside(*p).abs() < FLAT_PX * pixel && is_beside() {
                    on[part].push(*p);
                }
            }
        }
        for (plane, on) in self.planes.iter_mut().zip(on) {
            if on.len() > 3 {
                *plane = fitted(&on, plane.normal).unwrap_or(*plane);
            }
        }
    }
}

/// The plane that fits points best, seen from where `outwards` points to.
fn fitted(points: &[Point3<f64>], outwards: Vector3<f64>) -> Option<Plane> {
    let mean = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64;
    let ways = points.iter().map(|p| p.coords - mean);
    let fit = SymmetricEigen::new(ways.map(|w| w * w.transpose()).sum::<Matrix3<f64>>());
    let normal = fit.eigenvectors.column(fit.eigenvalues.imin()).into_owned();
    let normal = normal.try_normalize(1e-9)? * normal.dot(&outwards).signum();
    Some(Plane {
        normal,
        height: normal.dot(&mean),
    })
}

/// For each side itself and the sides that it meets at an edge, or over facets that belong to none.
pub(super) fn meeting(mesh: &Mesh, of_facet: &[Option<u32>], sides: usize) -> Vec<Vec<u32>> {
    let mut at_corner: Vec<Vec<u32>> = vec![Vec::new(); mesh.vertices.len()];
    for (t, side) in of_facet.iter().enumerate() {
        for v in mesh.triangles[t] {
            at_corner[v as usize].extend(side);
        }
    }
    let mut meeting: Vec<Vec<u32>> = (0..sides as u32).map(|s| vec![s]).collect();
    for mut around in at_corner {
        around.sort_unstable();
        around.dedup();
        for &a in &around {
            meeting[a as usize].extend(&around);
        }
    }
    for list in &mut meeting {
        list.sort_unstable();
        list.dedup();
    }
    meeting
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::convex_hull;
    use std::f64::consts::TAU;

    const PIXEL: f64 = 1e-3;

    /// Levels of a solid: at each height, in pixels, the corners of a regular polygon of a radius in pixels.
    fn solid(corners: usize, levels: &[[f64; 2]]) -> Vec<Point3<f32>> {
        let at = |&[height, radius]: &[f64; 2]| {
            (0..corners).map(move |i| {
                let angle = TAU * i as f64 / corners as f64;
                let p = Point3::new(radius * angle.cos(), radius * angle.sin(), height);
                (p * PIXEL).cast()
            })
        };
        levels.iter().flat_map(at).collect()
    }

    /// The largest part that faces up by more than this.
    fn top(flat: &Flat, least_z: f64) -> u32 {
        let parts = (0..flat.planes.len()).filter(|&i| flat.planes[i].normal.z > least_z);
        let largest = parts.max_by(|&a, &b| flat.areas[a].total_cmp(&flat.areas[b]));
        largest.unwrap() as u32
    }

    #[test]
    fn a_side_with_a_corner_that_is_off_is_one_side() {
        let mut points = solid(4, &[[0.0, 40.0], [60.0, 40.0]]);
        // The facets above and below this corner's diagonal differ by two degrees.
        points[4].z += (1.5 * PIXEL) as f32;
        let mesh = convex_hull(&points).unwrap();
        let flat = Flat::of(&mesh, PIXEL);
        let area = flat.areas[top(&flat, 0.9) as usize];
        assert!((area / (3200.0 * PIXEL * PIXEL) - 1.0).abs() < 0.01);
        assert_eq!(flat.areas.iter().filter(|&&area| area > 0.0).count(), 6);
        let whole: f64 = (0..mesh.triangles.len())
            .map(|t| 0.5 * flat.cross(t).norm())
            .sum();
        assert!((flat.areas.iter().sum::<f64>() / whole - 1.0).abs() < 1e-9);
    }

    #[test]
    fn strips_of_something_round_stay_apart() {
        let points = solid(48, &[[0.0, 150.0], [60.0, 150.0]]);
        let mesh = convex_hull(&points).unwrap();
        let flat = Flat::of(&mesh, PIXEL);
        assert_eq!(flat.areas.iter().filter(|&&area| area > 0.0).count(), 50);
        let strip = (0..flat.planes.len()).find(|&i| flat.planes[i].normal.z.abs() < 0.1);
        assert!(!flat.has_sharp_border(strip.unwrap() as u32));
    }

    #[test]
    fn beyond_bevels_the_surface_turns_as_much_as_to_what_lies_there() {
        let is_sharp = |levels: &[[f64; 2]]| {
            let mesh = convex_hull(&solid(6, levels)).unwrap();
            let flat = Flat::of(&mesh, PIXEL);
            flat.has_sharp_border(top(&flat, 0.99))
        };
        // Narrow bevels of 45 degrees all around: beyond them are walls, or a roof that leans by 20 degrees.
        assert!(is_sharp(&[[0.0, 82.0], [80.0, 82.0], [82.0, 80.0]]));
        assert!(!is_sharp(&[
            [0.0, 120.0],
            [80.0, 120.0],
            [94.2, 81.0],
            [94.5, 80.0]
        ]));
    }
}

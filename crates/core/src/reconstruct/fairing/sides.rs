//! Flat sides between certain edges: those of the edges' convex hull that the contours agree with. Between views the
//! hull of silhouettes stands up to centimetres in front of such a side, and the surface of least bending some
//! millimetres. How the rest of the surface goes on from there is not decided here.

use super::contour::Contour;
use crate::mesh::{Bvh, Mesh, convex_hull, sorted_sides};
use nalgebra::{Matrix3, Point2, Point3, SymmetricEigen, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A side is flat where its corners lie within so many pixels of one plane.
const FLAT_PX: f64 = 1.25;
/// The contours agree with an outline that is within so many pixels of them.
const AGREES_PX: f64 = 0.75;
/// At the table, contours may be off by so many pixels.
const BLURRED_PX: f64 = 1.5;
/// Share of the length of contour beside a side that may disagree.
const DISAGREEING: f64 = 0.05;
/// A corner without which no outline would retreat by so many pixels is left out.
const NEEDED_PX: f64 = 0.6;
/// Length of contour that has to agree with a side, and edge of a square as large as the smallest side, in pixels.
const LEAST_PX: f64 = 16.0;
/// Beyond a side's border the surface turns by more than this, but for a share of the border: strips of something round
/// are no sides.
const SHARP_COSINE: f64 = 0.906;
const BLUNT: f64 = 0.15;
/// A neighbour with less than this share of the area is a bevel that noise makes, and says nothing of the border.
const NARROW: f64 = 0.1;
/// Facets of one side have normals within this angle of the plane's, but for narrow ones, which have only noise.
const ALIKE_COSINE: f64 = 0.97;

/// A plane: the points p with `normal` · p = `height`, which is metres from the rig's origin.
#[derive(Clone, Copy)]
struct Plane {
    normal: Vector3<f64>,
    height: f64,
}

impl Plane {
    fn outside(&self, p: Point3<f64>) -> f64 {
        self.normal.dot(&p.coords) - self.height
    }
}

/// The flat sides that were found.
pub(super) struct Sides {
    planes: Vec<Plane>,
    /// For each side itself and those that meet it at an edge, ascending.
    meeting: Vec<Vec<u32>>,
    /// The side of each facet of the convex hull.
    of_facet: Vec<Option<u32>>,
    facets: Bvh,
    floor: f64,
    pixel: f64,
}

impl Sides {
    /// The sides between edges that go through `points`; `None` where there is none. `pixel` is the size of a pixel
    /// in metres, `floor` the height of the table.
    pub(super) fn find(
        points: &[Point3<f64>],
        contours: &[Contour],
        pixel: f64,
        floor: f64,
    ) -> Option<Self> {
        let mut corners = needed(points, contours);
        let mesh = convex_hull(&corners)?;
        corners.extend(Flat::of(&mesh, pixel).on_the_table(contours, floor));
        let mesh = convex_hull(&corners)?;
        let mut found = Flat::of(&mesh, pixel);
        found.fit_to(points, pixel);
        found.leave_out_the_foot(floor, 2.0 * pixel);
        let tallies: Vec<Vec<[f64; 2]>> = contours
            .par_iter()
            .map(|contour| found.tally(contour, floor + 2.0 * pixel))
            .collect();
        let least = LEAST_PX * pixel;
        let is_confirmed = |side: usize| {
            let [agreeing, disagreeing] = tallies.iter().fold([0.0; 2], |sum, t| {
                [sum[0] + t[side][0], sum[1] + t[side][1]]
            });
            found.areas[side] > least * least
                && agreeing > LEAST_PX
                && found.has_sharp_border(side as u32)
                && disagreeing < DISAGREEING * (agreeing + disagreeing)
        };
        let confirmed: Vec<bool> = (0..found.planes.len()).map(is_confirmed).collect();
        if !confirmed.contains(&true) {
            return None;
        }
        let of_facet: Vec<Option<u32>> = found
            .of_facet
            .iter()
            .map(|side| side.filter(|&s| confirmed[s as usize]))
            .collect();
        Some(Self {
            meeting: meeting(&mesh, &of_facet, found.planes.len()),
            planes: found.planes,
            of_facet,
            facets: Bvh::new(&mesh),
            floor,
            pixel,
        })
    }

    /// The point of a flat side that is nearest to `p`, with the side; `None` where the nearest is on none. A point on
    /// the table stays on it.
    pub(super) fn nearest(&self, p: Point3<f64>) -> Option<(u32, Point3<f64>)> {
        let on_table = p.z == self.floor;
        // At the table the nearest facet would be the one below.
        let from = if on_table {
            p + Vector3::z() * (8.0 * self.pixel)
        } else {
            p
        };
        let found = self.facets.closest_point(from)?;
        let side = self.of_facet[found.triangle]?;
        let plane = &self.planes[side as usize];
        if on_table {
            let flat = Vector3::new(plane.normal.x, plane.normal.y, 0.0);
            let squared = flat.norm_squared();
            return (squared > 0.1).then(|| (side, p - flat * (plane.outside(p) / squared)));
        }
        let on_plane = found.point - plane.normal * plane.outside(found.point);
        Some((side, on_plane))
    }

    /// How far within all of some sides, and those that they meet, a point is, in metres, with the outward unit normal
    /// of the nearest.
    pub(super) fn inside(&self, sides: [u32; 3], p: Point3<f64>) -> (f64, Vector3<f64>) {
        let mut least = (f64::INFINITY, Vector3::z());
        for side in sides {
            for &other in &self.meeting[side as usize] {
                let plane = &self.planes[other as usize];
                let inside = -plane.outside(p);
                if inside < least.0 {
                    least = (inside, plane.normal);
                }
            }
        }
        least
    }
}

/// Those of the points that the outlines of their convex hull need: without them one would retreat by more than a
/// fraction of a pixel. Points that only seem to be on an edge lie in front of a side where no outline shows them.
fn needed(points: &[Point3<f64>], contours: &[Contour]) -> Vec<Point3<f32>> {
    let pictures: Vec<Vec<Point2<f64>>> = contours
        .iter()
        .filter_map(|contour| pictures(points, contour))
        .collect();
    let mut left: Vec<u32> = (0..points.len() as u32).collect();
    let outline_of = |picture: &Vec<Point2<f64>>, left: &[u32]| {
        outline(left.iter().map(|&v| (v, picture[v as usize])).collect())
    };
    let mut outlines: Vec<Vec<(u32, Point2<f64>)>> = pictures
        .par_iter()
        .map(|picture| outline_of(picture, &left))
        .collect();
    loop {
        // How far some outline would retreat without each point.
        let mut retreats: BTreeMap<u32, f64> = BTreeMap::new();
        for outline in &outlines {
            for (i, &(v, p)) in outline.iter().enumerate() {
                let before = outline[(i + outline.len() - 1) % outline.len()].1;
                let after = outline[(i + 1) % outline.len()].1;
                let retreat = retreats.entry(v).or_insert(0.0);
                *retreat = retreat.max(distance(p, before, after));
            }
        }
        left = retreats.keys().copied().collect();
        let least = retreats.iter().min_by(|a, b| a.1.total_cmp(b.1));
        match least {
            Some((&v, &retreat)) if retreat < NEEDED_PX => left.retain(|&other| other != v),
            _ => break,
        }
        outlines
            .par_iter_mut()
            .zip(&pictures)
            .for_each(|(outline, picture)| *outline = outline_of(picture, &left));
    }
    left.iter().map(|&v| points[v as usize].cast()).collect()
}

/// Where a camera without distortion would see points, in pixels from its axis; `None` where one is behind it.
fn pictures(points: &[Point3<f64>], contour: &Contour) -> Option<Vec<Point2<f64>>> {
    let focal = contour.camera.intrinsics.focal_px;
    let picture = |p: &Point3<f64>| {
        let q = contour.camera.camera_from_rig(*p);
        (q.z > 0.0).then(|| Point2::new(q.x / q.z * focal.x, q.y / q.z * focal.y))
    };
    points.iter().map(picture).collect()
}

/// The convex polygon around points, counter-clockwise.
fn outline(mut points: Vec<(u32, Point2<f64>)>) -> Vec<(u32, Point2<f64>)> {
    points.sort_by(|a, b| a.1.x.total_cmp(&b.1.x).then(a.1.y.total_cmp(&b.1.y)));
    let mut outline = chain(points.iter());
    outline.pop();
    outline.extend(chain(points.iter().rev()));
    outline.pop();
    outline
}

/// The flat parts of a convex hull.
struct Flat<'a> {
    mesh: &'a Mesh,
    /// The part of each facet.
    of_facet: Vec<Option<u32>>,
    planes: Vec<Plane>,
    areas: Vec<f64>,
    /// The two facets at each edge.
    at_edge: BTreeMap<(u32, u32), Vec<u32>>,
}

impl<'a> Flat<'a> {
    fn of(mesh: &'a Mesh, pixel: f64) -> Self {
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
        flat
    }

    /// Whether the surface turns at a part's border, and does not go on as something round.
    fn has_sharp_border(&self, part: u32) -> bool {
        let (mut sharp, mut blunt) = (0.0, 0.0);
        let normal = self.planes[part as usize].normal;
        for (&(a, b), facets) in &self.at_edge {
            let parts: Vec<Option<u32>> =
                facets.iter().map(|&t| self.of_facet[t as usize]).collect();
            let other = match parts[..] {
                [Some(a), Some(b)] if a == part && b != part => b,
                [Some(a), Some(b)] if b == part && a != part => a,
                _ => continue,
            };
            if self.areas[other as usize] < NARROW * self.areas[part as usize] {
                continue;
            }
            let [a, b] = [a, b].map(|v| self.mesh.vertices[v as usize].cast::<f64>());
            let length = (a - b).norm();
            if normal.dot(&self.planes[other as usize].normal) > SHARP_COSINE {
                blunt += length;
            } else {
                sharp += length;
            }
        }
        blunt <= BLUNT * (sharp + blunt)
    }

    fn corners(&self, t: usize) -> [Point3<f64>; 3] {
        self.mesh.corners(t).map(|c| c.cast())
    }

    fn cross(&self, t: usize) -> Vector3<f64> {
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

    /// Where two sides that meet reach the table, as far as the contours allow it. The lowest part of an edge is often
    /// not certain, for shadows and the table blur the contours there.
    fn on_the_table(&self, contours: &[Contour], floor: f64) -> Vec<Point3<f32>> {
        let allowed = |p: Point3<f64>| {
            let offsets = || contours.iter().map(|c| c.offset(p));
            offsets().flatten().all(|o| o.inside_px > -BLURRED_PX)
                && offsets().flatten().next().is_some()
                && !contours.iter().any(|c| c.is_far_outside(p))
        };
        let largest = self.areas.iter().copied().fold(0.0, f64::max);
        let mut found = Vec::new();
        for (a, sides) in meeting(self.mesh, &self.of_facet, self.planes.len())
            .iter()
            .enumerate()
        {
            for &b in sides.iter().filter(|&&b| b as usize > a) {
                let b = b as usize;
                let (first, second) = (&self.planes[a], &self.planes[b]);
                let is_large = self.areas[a].min(self.areas[b]) > NARROW * largest;
                if !is_large || first.normal.dot(&second.normal) > SHARP_COSINE {
                    continue;
                }
                let rows = Matrix3::from_rows(&[
                    first.normal.transpose(),
                    second.normal.transpose(),
                    Vector3::z().transpose(),
                ]);
                let heights = Vector3::new(first.height, second.height, floor);
                // Two sides that hardly lean to the table meet it nowhere in particular.
                if rows.determinant().abs() > 0.1
                    && let Some(p) = rows.lu().solve(&heights)
                    && allowed(p.into())
                {
                    found.push(Point3::from(p).cast());
                }
            }
        }
        found
    }

    /// The part on the table is no side that a contour could show.
    fn leave_out_the_foot(&mut self, floor: f64, near: f64) {
        for t in 0..self.of_facet.len() {
            let is_low = self.corners(t).iter().all(|p| p.z < floor + near);
            if is_low && self.cross(t).z < 0.0 {
                self.of_facet[t] = None;
            }
        }
    }

    /// For each part the length of contour beside it that agrees with its outline, and that does not, in pixels. What
    /// lies below `low` is not asked: shadows and the table blur the contours of a foot.
    fn tally(&self, contour: &Contour, low: f64) -> Vec<[f64; 2]> {
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
    fn fit_to(&mut self, points: &[Point3<f64>], pixel: f64) {
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

/// One half of a convex polygon, from points that are sorted (Andrew's monotone chain).
fn chain<'a>(points: impl Iterator<Item = &'a (u32, Point2<f64>)>) -> Vec<(u32, Point2<f64>)> {
    let mut chain: Vec<(u32, Point2<f64>)> = Vec::new();
    for point in points {
        while let [.., a, b] = chain[..]
            && (b.1 - a.1).perp(&(point.1 - b.1)) <= 0.0
        {
            chain.pop();
        }
        chain.push(*point);
    }
    chain
}

fn distance(p: Point2<f64>, a: Point2<f64>, b: Point2<f64>) -> f64 {
    let along = b - a;
    let t = (p - a).dot(&along) / along.norm_squared().max(1e-12);
    (p - (a + along * t.clamp(0.0, 1.0))).norm()
}

/// For each side itself and the sides that it meets at an edge, or over facets that belong to none.
fn meeting(mesh: &Mesh, of_facet: &[Option<u32>], sides: usize) -> Vec<Vec<u32>> {
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

//! The hull as a solid: the intersection of the cones and the volume.

use super::cone::{Cone, SURELY};
use crate::calibration::Volume;
use crate::frame::CameraId;
use crate::reconstruct::surface::{Constraint, Side, Solid, UndecidedConstraints};
use crate::statistics::upper_median;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// The volume's floor. Cameras are numbered from 0, the volume's other sides from `WALLS`.
pub const FLOOR: Constraint = Constraint::MAX;
const WALLS: Constraint = Constraint::MAX - 6;

/// The bit for the volume and for whether enough cameras see a point.
const BOUNDS: UndecidedConstraints = 1;

/// A plane that bounds the object, as the table that it stood on in another capture: nothing is beyond it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// A point of it.
    pub point: Point3<f64>,
    /// Unit normal, towards the object.
    pub normal: Vector3<f64>,
}

impl Plane {
    /// How far a point is from it, positive on the object's side.
    fn distance(&self, p: Point3<f64>) -> f64 {
        (p - self.point).dot(&self.normal)
    }
}

/// What bounds a hull besides its cones.
#[derive(Clone, Debug)]
pub struct Bounds {
    volume: Volume,
    planes: Vec<Plane>,
}

impl Bounds {
    /// How far a point is above the nearest table, in metres, with that table's downward unit normal: the volume's
    /// lower face, or a plane.
    pub fn nearest_table(&self, p: Point3<f64>) -> (f64, Vector3<f64>) {
        let mut nearest = (p.z - self.volume.min.z, -Vector3::z());
        for plane in &self.planes {
            let distance = plane.distance(p);
            if distance < nearest.0 {
                nearest = (distance, -plane.normal);
            }
        }
        nearest
    }

    /// How far a point is above each table, in metres: the volume's lower face, then the planes.
    pub fn heights(&self, p: Point3<f64>) -> impl Iterator<Item = f64> + '_ {
        let planes = self.planes.iter().map(move |plane| plane.distance(p));
        std::iter::once(p.z - self.volume.min.z).chain(planes)
    }

    /// The tables of captures that were fused into the scene.
    pub(in crate::reconstruct) fn planes(&self) -> &[Plane] {
        &self.planes
    }

    /// The outward unit normal of a face or plane.
    fn normal(&self, face: usize) -> Vector3<f64> {
        match face.checked_sub(6).and_then(|i| self.planes.get(i)) {
            Some(plane) => -plane.normal,
            None => {
                let side = if face.is_multiple_of(2) { -1.0 } else { 1.0 };
                Vector3::ith(face / 2 % 3, side)
            }
        }
    }

    /// Distance to the nearest face of the volume, or to a plane, positive within, and its number: planes come after
    /// the six faces.
    fn nearest_face(&self, p: Point3<f64>) -> (f64, usize) {
        let (below, above) = (p - self.volume.min, self.volume.max - p);
        let distances = [below.x, above.x, below.y, above.y, below.z, above.z];
        let face = (0..6)
            .min_by(|&a, &b| distances[a].total_cmp(&distances[b]))
            .unwrap_or(0);
        let mut nearest = (distances[face], face);
        for (number, plane) in self.planes.iter().enumerate() {
            let distance = plane.distance(p);
            if distance < nearest.0 {
                nearest = (distance, 6 + number);
            }
        }
        nearest
    }
}

/// The visual hull.
pub struct Hull<'a> {
    cones: Vec<Cone<'a>>,
    bounds: Bounds,
    least_views: usize,
    /// Turns metres beyond the volume's faces into the units of a silhouette.
    values_per_metre: f64,
}

impl<'a> Hull<'a> {
    /// The intersection of cones within a volume. A point needs to be in the picture of `least_views`
    /// cameras (of all, where there are fewer).
    pub fn new(cones: Vec<Cone<'a>>, volume: Volume, least_views: usize) -> Self {
        let least_views = least_views.min(cones.len());
        let values_per_metre = 300.0 * f64::from(SURELY) / (volume.max - volume.min).norm();
        Self {
            cones,
            bounds: Bounds {
                volume,
                planes: Vec::new(),
            },
            least_views,
            values_per_metre,
        }
    }

    /// Bounded by planes as well.
    #[must_use]
    pub fn within(mut self, planes: &[Plane]) -> Self {
        self.bounds.planes = planes.to_vec();
        self
    }

    /// What bounds it besides its cones.
    pub fn bounds(&self) -> &Bounds {
        &self.bounds
    }

    /// The box that bounds it.
    pub fn volume(&self) -> Volume {
        self.bounds.volume
    }

    /// Its cones.
    pub fn cones(&self) -> &[Cone<'a>] {
        &self.cones
    }

    /// Size of a pixel at a point, the median over the cameras, in metres.
    pub fn pixel_footprint(&self, p: Point3<f64>) -> f64 {
        let mut sizes: Vec<f64> = self
            .cones
            .iter()
            .map(|c| c.camera().pixel_footprint(p))
            .collect();
        upper_median(&mut sizes).unwrap_or(0.0)
    }

    /// How far the hull reaches from a point within it along a unit vector, in metres: to a third of it at worst, for
    /// each step doubles the way, and at least `least`.
    pub fn reach(&self, p: Point3<f64>, along: Vector3<f64>, least: f64) -> f64 {
        let most = (self.bounds.volume.max - self.bounds.volume.min).norm();
        let mut way = least.max(1e-6);
        while way < most && self.value(p + along * way, UndecidedConstraints::MAX) > 0.0 {
            way *= 2.0;
        }
        (0.75 * way).max(least)
    }

    /// How far the hull reaches from a point within it along a unit vector, in metres: as [`Self::reach`], but where
    /// the hull ends is then found by halving, to a thirtieth of the way.
    pub fn thickness(&self, p: Point3<f64>, along: Vector3<f64>, least: f64) -> f64 {
        const HALVINGS: usize = 4;
        let beyond = self.reach(p, along, least) / 0.75;
        let (mut within, mut outside) = (0.5 * beyond, beyond);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (within + outside);
            if self.value(p + along * middle, UndecidedConstraints::MAX) > 0.0 {
                within = middle;
            } else {
                outside = middle;
            }
        }
        0.5 * (within + outside)
    }

    /// How much of space (cubic metres) no camera objects to, but is no part of the hull because so few cameras see it
    /// past what they ignore; `None` where no camera ignores anything.
    pub fn unproved_volume(&self) -> Option<f64> {
        const SIDE: u32 = 64;
        if self.cones.iter().all(|cone| cone.unknown().is_none()) {
            return None;
        }
        let cell = (self.bounds.volume.max - self.bounds.volume.min) / f64::from(SIDE);
        let unproved = |i: u32| {
            let at = Vector3::new(i % SIDE, i / SIDE % SIDE, i / (SIDE * SIDE));
            let p = self.bounds.volume.min + at.map(|i| f64::from(i) + 0.5).component_mul(&cell);
            let objects = |cone: &Cone| cone.value(p).is_some_and(|v| v < 0.0);
            let framing = self.cones.iter().filter(|cone| cone.frames(p));
            !self.is_seen_enough(p)
                && framing.count() >= self.least_views
                && !self.cones.iter().any(objects)
        };
        let count = (0..SIDE * SIDE * SIDE)
            .into_par_iter()
            .filter(|i| unproved(*i));
        Some(count.count() as f64 * cell.product())
    }

    /// A camera for which all of the volume is outside its silhouette.
    pub(super) fn blind_camera(&self) -> Option<&CameraId> {
        let cell = (self.bounds.volume.max - self.bounds.volume.min) / 32.0;
        let half = 0.5 * cell.max();
        let centers = (0..32 * 32 * 32).map(|i: u32| {
            let at = Vector3::new(i % 32, i / 32 % 32, i / 1024).map(|i| f64::from(i) + 0.5);
            self.bounds.volume.min + at.component_mul(&cell)
        });
        let blind = |cone: &&Cone| {
            centers
                .clone()
                .all(|c| cone.side(c, half).side == Side::Outside)
        };
        self.cones.iter().find(blind).map(|cone| &cone.camera().id)
    }

    /// The camera whose silhouette has the longest outline for its size.
    pub(super) fn most_ragged_camera(&self) -> Option<&CameraId> {
        let ragged = self.cones.iter().map(|c| (c.raggedness(), c));
        ragged
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, cone)| &cone.camera().id)
    }

    /// The camera whose pixels are largest at a point, and their size there in metres.
    pub(super) fn coarsest_camera(&self, p: Point3<f64>) -> (String, f64) {
        let sizes = self.cones.iter().map(|cone| {
            let camera = cone.camera();
            (camera.id.to_string(), camera.pixel_footprint(p))
        });
        let coarser = |a: (String, f64), b: (String, f64)| if b.1 > a.1 { b } else { a };
        sizes.reduce(coarser).unwrap_or_default()
    }

    fn bit(camera: usize) -> UndecidedConstraints {
        1 << ((camera + 1) % 64)
    }

    /// The cameras that may matter.
    fn asked(&self, undecided: UndecidedConstraints) -> impl Iterator<Item = (usize, &Cone<'a>)> {
        self.cones
            .iter()
            .enumerate()
            .filter(move |(i, _)| undecided & Self::bit(*i) != 0)
    }

    /// The value of the volume's bounds alone, and the face.
    fn bounds_value(&self, p: Point3<f64>) -> (f32, usize) {
        let (distance, face) = self.bounds.nearest_face(p);
        (
            (distance * self.values_per_metre).clamp(-f64::from(SURELY), f64::from(SURELY)) as f32,
            face,
        )
    }

    /// Whether enough cameras have all of a cube in their pictures.
    fn all_is_seen(&self, center: Point3<f64>, half: f64) -> bool {
        let sees = |cone: &&Cone| cone.side(center, half).seen;
        let seeing = self.cones.iter().filter(sees).take(self.least_views);
        seeing.count() == self.least_views
    }

    /// Whether too few cameras can see any part of a cube within their silhouettes for it to hold a part of the hull.
    fn is_unconfirmed(&self, center: Point3<f64>, half: f64) -> bool {
        let may_confirm = |cone: &&Cone| cone.side(center, half).may_confirm;
        let left = self.cones.iter().filter(may_confirm).take(self.least_views);
        left.count() < self.least_views
    }

    fn is_seen_enough(&self, p: Point3<f64>) -> bool {
        let sees = |cone: &&Cone| {
            let projected = cone.camera().project(p);
            projected.is_some_and(|(pixel, _)| cone.sees(pixel))
        };
        self.cones
            .iter()
            .filter(sees)
            .take(self.least_views)
            .count()
            >= self.least_views
    }
}

impl Solid for Hull<'_> {
    fn side(&self, center: Point3<f64>, half: f64, undecided: UndecidedConstraints) -> Side {
        let mut left = 0;
        let mut seen = 0;
        for (i, cone) in self.asked(undecided) {
            let known = cone.side(center, half);
            seen += usize::from(known.seen);
            match known.side {
                Side::Outside => return Side::Outside,
                Side::Inside => {}
                Side::Across(_) => left |= Self::bit(i),
            }
        }
        if undecided & BOUNDS != 0 {
            let reach = |p: Point3<f64>, q: Point3<f64>| (p - q).min();
            let beyond =
                reach(center, self.bounds.volume.min).min(reach(self.bounds.volume.max, center));
            // A cube reaches farther towards a slanted plane than towards a face.
            let planes = self.bounds.planes.iter().map(|plane| {
                let reach = half * plane.normal.abs().sum();
                plane.distance(center) + half - reach
            });
            let surely = planes.fold(beyond, f64::min);
            let planes = self.bounds.planes.iter().map(|plane| {
                let reach = half * plane.normal.abs().sum();
                plane.distance(center) + reach - half
            });
            let possibly = planes.fold(beyond, f64::min);
            if possibly < -half {
                return Side::Outside;
            }
            // Cameras that were decided before were not asked, so the count may be too low.
            if surely <= half || seen < self.least_views && !self.all_is_seen(center, half) {
                if self.is_unconfirmed(center, half) {
                    return Side::Outside;
                }
                left |= BOUNDS;
            }
        }
        if left == 0 {
            Side::Inside
        } else {
            Side::Across(left)
        }
    }

    fn value(&self, p: Point3<f64>, undecided: UndecidedConstraints) -> f32 {
        let mut value = SURELY;
        if undecided & BOUNDS != 0 {
            value = self.bounds_value(p).0;
            if value > -SURELY && !self.is_seen_enough(p) {
                return -SURELY;
            }
        }
        for (_, cone) in self.asked(undecided) {
            if value <= -SURELY {
                break;
            }
            value = cone.value(p).map_or(value, |v| v.min(value));
        }
        value
    }

    fn normal(
        &self,
        p: Point3<f64>,
        undecided: UndecidedConstraints,
    ) -> (Vector3<f32>, Constraint) {
        let (mut lowest, face) = self.bounds_value(p);
        let mut nearest = None;
        if undecided & BOUNDS == 0 {
            lowest = f32::INFINITY;
        }
        for (i, cone) in self.asked(undecided) {
            if let Some(value) = cone.value(p).filter(|v| *v < lowest) {
                lowest = value;
                nearest = Some(i);
            }
        }
        if let Some(i) = nearest
            && let Some(normal) = self.cones[i].normal(p)
        {
            return (normal.cast(), i as Constraint);
        }
        let constraint = match face {
            0 | 1 | 2 | 3 | 5 => WALLS + face as Constraint,
            _ => FLOOR,
        };
        (self.bounds.normal(face).cast(), constraint)
    }
}

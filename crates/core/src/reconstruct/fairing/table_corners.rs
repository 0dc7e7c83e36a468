//! The corners that flat sides have at the height of the table. The lowest part of an edge is often not certain, for
//! shadows and the table blur the contours there; where its sides go on to is known from the rest of them.

use super::contour::Contour;
use super::flat::{Flat, NARROW, Plane, SHARP_COSINE, meeting};
use crate::calibration::Volume;
use nalgebra::{Matrix3, Point3, Vector2, Vector3};

/// At the table, contours may be off by so many pixels.
const BLURRED_PX: f64 = 1.5;
/// Planes that are off by a fraction of a pixel may meet outside the contours. The corner is drawn in by up to so many
/// pixels, in steps, until the contours allow it, unless another corner is within so many pixels.
const DRAWN_IN_PX: f64 = 3.0;
const STEP_PX: f64 = 0.25;
const ANOTHER_PX: f64 = 6.0;
/// What faces down more than this, 26 degrees from straight down, is what the object stands on.
const DOWN: f64 = -0.9;
/// Two sides that hardly lean to the table meet it nowhere in particular: least determinant of the three unit normals.
const LEAST_DETERMINANT: f64 = 0.1;

/// Where the corners of an object may be.
pub(super) struct Allowed<'a> {
    pub(super) contours: &'a [Contour<'a>],
    /// The box around the object's hull, from the table up.
    pub(super) object: &'a Volume,
    /// Size of a pixel in metres.
    pub(super) pixel: f64,
}

impl Flat<'_> {
    /// The corners of large sides at the height of the table, as far as the contours allow them.
    pub(super) fn corners_on_the_table(&self, allowed: &Allowed) -> Vec<Point3<f32>> {
        let meetings = self.meetings(allowed.object.min.z);
        let places = meetings.iter().map(|of| of.place);
        let mut corners: Vec<Point3<f64>> = places.filter(|p| allowed.bears(*p)).collect();
        let apart = ANOTHER_PX * allowed.pixel;
        for drawn_in in meetings.iter().filter_map(|of| of.drawn_in(allowed)) {
            if corners
                .iter()
                .all(|other| (other - drawn_in).norm() > apart)
            {
                corners.push(drawn_in);
            }
        }
        corners.iter().map(|corner| corner.cast()).collect()
    }

    /// Where large sides meet at the height of the table, if they share a vertex or the borders of both are sharp:
    /// planes of strips of something round meet in front of it.
    fn meetings(&self, floor: f64) -> Vec<Meeting> {
        let largest = self.areas.iter().copied().fold(0.0, f64::max);
        let is_large = |part: &usize| {
            self.areas[*part] > NARROW * largest && self.planes[*part].normal.z > DOWN
        };
        let sides: Vec<usize> = (0..self.planes.len()).filter(is_large).collect();
        let sharp: Vec<bool> = sides
            .iter()
            .map(|&side| self.has_sharp_border(side as u32))
            .collect();
        let beside = meeting(self.mesh, &self.of_facet, self.planes.len());
        let mut meetings = Vec::new();
        for i in 0..sides.len() {
            for j in i + 1..sides.len() {
                let may_meet =
                    beside[sides[i]].contains(&(sides[j] as u32)) || sharp[i] && sharp[j];
                let [first, second] = [i, j].map(|side| &self.planes[sides[side]]);
                if may_meet && first.normal.dot(&second.normal) <= SHARP_COSINE {
                    meetings.extend(Meeting::of(first, second, floor));
                }
            }
        }
        meetings
    }
}

/// Where two sides meet at the height of the table.
struct Meeting {
    place: Point3<f64>,
    /// Unit vector along the table to within both.
    inwards: Vector2<f64>,
}

impl Meeting {
    fn of(first: &Plane, second: &Plane, floor: f64) -> Option<Self> {
        let rows = Matrix3::from_rows(&[
            first.normal.transpose(),
            second.normal.transpose(),
            Vector3::z().transpose(),
        ]);
        if rows.determinant().abs() <= LEAST_DETERMINANT {
            return None;
        }
        let heights = Vector3::new(first.height, second.height, floor);
        Some(Self {
            place: rows.lu().solve(&heights)?.into(),
            inwards: -(first.normal + second.normal).xy().try_normalize(1e-9)?,
        })
    }

    /// The place as far inwards as it has to be to be allowed.
    fn drawn_in(&self, allowed: &Allowed) -> Option<Point3<f64>> {
        let steps = (DRAWN_IN_PX / STEP_PX) as usize;
        let way = |step: usize| self.inwards * (step as f64 * STEP_PX * allowed.pixel);
        (0..=steps)
            .map(|step| self.place + way(step).push(0.0))
            .find(|p| allowed.bears(*p))
    }
}

impl Allowed<'_> {
    /// Whether a point at the height of the table may be a corner of the object.
    fn bears(&self, p: Point3<f64>) -> bool {
        let margin = BLURRED_PX * self.pixel;
        let (low, high) = (self.object.min, self.object.max);
        let is_near = |axis: usize| (low[axis] - margin..=high[axis] + margin).contains(&p[axis]);
        let mut seen = self
            .contours
            .iter()
            .filter_map(|c| c.inside_px(p))
            .peekable();
        is_near(0) && is_near(1) && seen.peek().is_some() && seen.all(|inside| inside > -BLURRED_PX)
    }
}

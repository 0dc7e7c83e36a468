//! Flat sides between certain edges: those of the edges' convex hull that the contours agree with. Between views the
//! hull of silhouettes stands up to centimetres in front of such a side, and the surface of least bending some
//! millimetres. How the rest of the surface goes on from there is not decided here.

use super::contour::Contour;
use super::corners::needed;
use super::flat::{Flat, LEAST_PX, Plane, meeting};
use super::table_corners::Allowed;
use crate::calibration::Volume;
use crate::mesh::{Bvh, convex_hull};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Share of the length of contour beside a side that may disagree.
const DISAGREEING: f64 = 0.05;

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
    /// in metres, `object` the box around the hull, from the table up.
    pub(super) fn find(
        points: &[Point3<f64>],
        contours: &[Contour],
        pixel: f64,
        object: &Volume,
    ) -> Option<Self> {
        let floor = object.min.z;
        let mut corners = needed(points, contours);
        let mesh = convex_hull(&corners)?;
        let mut first = Flat::of(&mesh, pixel);
        first.fit_to(points, pixel);
        let allowed = Allowed {
            contours,
            object,
            pixel,
        };
        corners.extend(first.corners_on_the_table(&allowed));
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
        found.give_bevels_to_sides(&confirmed);
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

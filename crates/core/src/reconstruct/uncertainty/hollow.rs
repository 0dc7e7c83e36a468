//! Where a hollow may hide: silhouettes show none, and a part of the hull that faces up and that no depth camera read
//! may be the lid over one. Nothing here carves.

use super::readings::{Readings, beneath};
use super::touch::ViewingEdge;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Height of a unit normal from which on a part of the surface faces up. Objects on a table open upwards.
const UP: f32 = 0.5;

/// Whether a place of the hull (metres, with its unit outward normal) may be the lid over a hollow.
pub fn may_be_lid(p: Point3<f64>, normal: Vector3<f32>, readings: &[Readings]) -> bool {
    normal.z > UP && beneath(p, normal, readings).is_none()
}

/// The way along a viewing edge to the nearest end at which the object has an edge, for there it is. Zero where it has
/// none: the object is round there, and touches the viewing edge on its way.
pub(super) fn way_to_object(edge: &ViewingEdge) -> f64 {
    let certain = edge.ends.iter().filter(|end| end.is_certain);
    let nearest = certain.map(|end| end.distance).reduce(f64::min);
    nearest.unwrap_or(0.0)
}

/// What bounds the hull at a place.
#[derive(Clone, Copy)]
pub(super) enum Bound {
    /// An outline: the object is this many metres away at most.
    Outline(f64),
    /// The volume, so that no outline tells: the hull reaches this many metres beneath.
    Volume(f64),
}

/// What is known of a place of the hull.
#[derive(Clone, Copy)]
pub(super) struct Place {
    /// Where it is.
    pub point: Point3<f64>,
    /// What is expected of the outside there, in metres.
    pub of_outside: f64,
    /// Whether it may be the lid over a hollow.
    pub may_be_lid: bool,
    /// Whether no outline is anywhere near it.
    pub is_guess: bool,
    /// How far beneath it a depth camera read the surface, in metres; 0 where none did.
    pub beneath: f64,
    /// What bounds the hull there.
    pub bound: Bound,
}

/// What is expected at each of `places`: on a lid half of how far the object is at most, where only the volume bounds
/// the hull half of how far it reaches, and where the surface was read beneath half of that way.
pub(super) fn with_hollows(places: &[Place]) -> Vec<f64> {
    let known = |place: &Place| match place.bound {
        Bound::Outline(way) => Some((place.point, way)),
        Bound::Volume(_) => None,
    };
    let known: Vec<(Point3<f64>, f64)> = places.iter().filter_map(known).collect();
    let of_nearest = |p: Point3<f64>| {
        let ways = known.iter().map(|(q, way)| (q - p).norm() + way);
        ways.fold(f64::INFINITY, f64::min)
    };
    let expected = |place: &Place| {
        let hidden = match place.bound {
            Bound::Outline(way) if place.may_be_lid => way,
            Bound::Volume(reach) if place.may_be_lid => of_nearest(place.point).min(reach),
            Bound::Volume(reach) if place.is_guess => reach,
            _ => 0.0,
        };
        place.of_outside.hypot(0.5 * hidden.hypot(place.beneath))
    };
    places.par_iter().map(expected).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(x: f64, may_be_lid: bool, bound: Bound) -> Place {
        Place {
            point: Point3::new(x, 0.0, 0.0),
            of_outside: 0.0,
            may_be_lid,
            is_guess: false,
            beneath: 0.0,
            bound,
        }
    }

    fn hold(places: &[Place], expected: &[f64]) {
        let found = with_hollows(places);
        assert_eq!(found.len(), expected.len());
        for (found, expected) in found.into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
    }

    #[test]
    fn a_lid_states_half_the_way_to_the_object_and_asks_others_where_no_outline_tells() {
        let places = [
            place(0.0, false, Bound::Outline(0.03)),
            place(0.01, true, Bound::Outline(0.02)),
            place(0.05, true, Bound::Volume(0.1)),
            place(0.05, false, Bound::Volume(0.1)),
        ];
        hold(&places, &[0.0, 0.01, 0.03, 0.0]);
        // Where no outline tells at all, it is somewhere within the hull.
        hold(&places[2..3], &[0.05]);
    }

    #[test]
    fn what_only_the_volume_bounds_is_known_least() {
        let mut guess = place(0.0, false, Bound::Volume(0.08));
        guess.is_guess = true;
        hold(&[guess], &[0.04]);
    }

    #[test]
    fn half_the_way_to_a_surface_that_was_read_beneath_is_expected() {
        let mut through = place(0.0, false, Bound::Outline(0.02));
        (through.of_outside, through.beneath) = (0.3e-3, 0.03);
        hold(&[through], &[0.3e-3_f64.hypot(0.015)]);
    }
}

//! Finds an outline that lost a piece, as to glare: rays of several other views miss what all outlines leave to the
//! object, and would not if that one had no say. Where something broke off the object, several outlines say so, and
//! none of them alone. Close to a table outlines err all around, because of shadows, so nothing there counts.

use super::ContourStretch;
use super::body::{Body, Ray};
use super::spots::{AgainstBoth, Spot};
use super::touch::{Target, Touch, touch_without};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A ray counts that misses by so many pixels …
const MISS_PX: f64 = 1.25;
/// … of which one outline alone explains so many.
const EXPLAINED_PX: f64 = 1.0;
/// It counts so many metres above both captures' tables and more.
const ABOVE_TABLE: f64 = 4e-3;
/// Rays lie at one piece whose places, as the outline's camera sees them, are nearer than so many metres.
const REACH: f64 = 0.013;

/// A place at which one outline alone denies what other views show.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct LostPiece {
    /// What other views show there, without the view that shows most, so that one wrong outline among those says
    /// nothing. Its stretch is as that view has it, but the camera is that of the outline.
    pub(super) at: Spot,
    /// Whether the outline is the second capture's.
    pub(super) is_second: bool,
}

/// An outline of one of the two captures: whether it is the second's, and its number there.
type OutlineKey = (bool, usize);

/// A ray that one outline makes miss.
#[derive(Clone, Copy, Debug)]
struct Witness {
    /// Capture and outline to which the ray belongs.
    view: OutlineKey,
    outline: OutlineKey,
    /// The ray's place, seen from the outline's camera, in metres at the object.
    seen_at: Vector3<f64>,
    length_px: f64,
    explained_px: f64,
}

/// The heaviest piece that an outline of either capture seems to have lost.
pub(super) fn piece(both: &[AgainstBoth; 2]) -> Option<LostPiece> {
    let [a, b] = both;
    let mut witnesses: BTreeMap<OutlineKey, Vec<Witness>> = BTreeMap::new();
    for witness in [witnesses_of(a, false), witnesses_of(b, true)].concat() {
        witnesses.entry(witness.outline).or_default().push(witness);
    }
    let of_outline = |(&(is_second, outline), witnesses): (&OutlineKey, &Vec<Witness>)| {
        let body = if is_second { b.own } else { a.own };
        let around = witnesses.iter().map(|middle| around(witnesses, middle));
        let (weight, length_px, sum) = around.max_by(|x, y| x.0.total_cmp(&y.0))?;
        let stretch = ContourStretch {
            camera: body.cameras[outline],
            length_px,
            miss_px: sum / length_px,
        };
        Some(LostPiece {
            at: Spot { weight, stretch },
            is_second,
        })
    };
    let pieces = witnesses.iter().filter_map(of_outline);
    pieces.max_by(|x, y| x.at.weight.total_cmp(&y.at.weight))
}

/// What views say of an outline's piece around one place: the sum without the view that says most, and that view's
/// length in pixels and length by depth.
fn around(witnesses: &[Witness], middle: &Witness) -> (f64, f64, f64) {
    let mut views: BTreeMap<OutlineKey, (f64, f64)> = BTreeMap::new();
    let is_near = |w: &&Witness| (w.seen_at - middle.seen_at).norm() <= REACH;
    for witness in witnesses.iter().filter(is_near) {
        let view = views.entry(witness.view).or_default();
        view.0 += witness.length_px;
        view.1 += witness.length_px * witness.explained_px;
    }
    let all: f64 = views.values().map(|view| view.1).sum();
    let most = views.values().max_by(|x, y| x.1.total_cmp(&y.1));
    let (length_px, most) = most.copied().unwrap_or_default();
    (all - most, length_px, most)
}

/// All that the rays of one capture say of any outline.
fn witnesses_of(against: &AgainstBoth, is_second: bool) -> Vec<Witness> {
    let own = against.own;
    let rays = own.rays.par_iter().zip(&against.touches);
    let missing = rays.filter(|(_, touch)| -touch.inside > MISS_PX * own.pixel);
    let found = missing.flat_map_iter(|(ray, touch)| {
        let outlines = (0..2).flat_map(|t| {
            let count = against.targets[t].body.outlines.len();
            (0..count).map(move |outline| (t, outline))
        });
        outlines.filter_map(move |which| witness(against, is_second, ray, touch, which))
    });
    found.collect()
}

/// What a ray that misses says of an outline of one of the two targets.
fn witness(
    against: &AgainstBoth,
    is_second: bool,
    ray: &Ray,
    touch: &Touch,
    (target, outline): (usize, usize),
) -> Option<Witness> {
    let own = against.own;
    let without = touch_without(own, ray, &against.targets, (target, outline));
    let explained_px = (without.inside.min(0.0) - touch.inside) / own.pixel;
    if explained_px < EXPLAINED_PX {
        return None;
    }
    let place = ray.eye + ray.direction * without.along;
    let is_clear = |t: &Target| (t.body_from_ray * place).z - t.body.floor > ABOVE_TABLE;
    if !against.targets.iter().all(is_clear) {
        return None;
    }
    let of = &against.targets[target];
    Some(Witness {
        view: (is_second, ray.view),
        outline: (is_second != (target == 0), outline),
        seen_at: seen_at(of.body, outline, of.body_from_ray * place),
        length_px: ray.length_px,
        explained_px,
    })
}

/// A point of a body's rig as the camera of one of its outlines sees it, in metres at the object's distance.
fn seen_at(body: &Body, outline: usize, place: Point3<f64>) -> Vector3<f64> {
    let outline = &body.outlines[outline];
    let away = outline.in_camera(body.center).z;
    let seen = outline.in_camera(place);
    seen * (away / seen.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn witness(view: usize, x: f64) -> Witness {
        Witness {
            view: (false, view),
            outline: (true, 0),
            seen_at: Vector3::new(x, 0.0, 0.4),
            length_px: 2.0,
            explained_px: 1.5,
        }
    }

    #[test]
    fn one_view_says_nothing_of_an_outline_and_two_at_one_place_do() {
        let of_one = [witness(3, 0.0), witness(3, 0.002)];
        assert_eq!(around(&of_one, &of_one[0]), (0.0, 4.0, 6.0));
        let of_two = [of_one[0], of_one[1], witness(4, 0.004)];
        assert_eq!(around(&of_two, &of_two[0]), (3.0, 4.0, 6.0));
        let apart = [of_one[0], of_one[1], witness(4, 0.03)];
        assert_eq!(around(&apart, &apart[0]), (0.0, 4.0, 6.0));
    }
}

//! Finds where the object changed between two captures, such as by a chip in an edge: a spot at which contours of
//! several views of one capture miss what that capture's other outlines and the other capture leave to the object, by
//! more than they miss what their own capture leaves. One wrong outline, such as one that fills a handle's hole, makes
//! a stretch of contour that misses, too, but no other view misses at its place.

use super::ContourStretch;
use super::body::Body;
use super::noise::{Run, chains, runs};
use super::touch::{Target, Touch, touch};
use nalgebra::{Isometry3, Point3, Vector3};
use rayon::prelude::*;

/// A ray counts that misses by so many pixels more than it does in its own capture.
const MORE_PX: f64 = 1.0;
/// Stretches lie at one spot whose middles are nearer to each other than this many pixels.
const REACH_PX: f64 = 20.0;

/// What contours of one capture say against another one, beyond what they say against their own.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Changes {
    /// The heaviest stretch of one view.
    pub(super) stretch: Option<ContourStretch>,
    /// The heaviest spot; `None` where no two views miss at one place.
    pub(super) spot: Option<Spot>,
}

/// A spot of the object's surface where contours of several views miss.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Spot {
    /// The sum of length by depth, in square pixels, of the stretches there, without those of the view that says most,
    /// so that one wrong outline says nothing.
    pub(super) weight: f64,
    /// The stretch there that weighs most.
    pub(super) stretch: ContourStretch,
}

/// A stretch of one view's contour that misses.
#[derive(Clone, Debug)]
struct Miss {
    /// Its middle, in the frame of its capture's rig.
    middle: Point3<f64>,
    stretch: ContourStretch,
}

/// By how many pixels each ray of a body misses what the other outlines of its capture leave; negative where it does
/// not.
pub(super) fn own_misses(own: &Body) -> Vec<f64> {
    misses(own, &touches(own, &[itself(own)]))
}

/// All rays of a capture against another one and the other outlines of their own.
pub(super) struct AgainstBoth<'a> {
    pub(super) own: &'a Body,
    /// The other capture and the own one, in this order.
    pub(super) targets: [Target<'a>; 2],
    /// The best place of each ray.
    pub(super) touches: Vec<Touch>,
}

impl<'a> AgainstBoth<'a> {
    pub(super) fn new(own: &'a Body, other: &'a Body, other_from_own: Isometry3<f64>) -> Self {
        let target = Target {
            body: other,
            body_from_ray: other_from_own,
            is_self: false,
        };
        let targets = [target, itself(own)];
        Self {
            own,
            targets,
            touches: touches(own, &targets),
        }
    }

    /// Where the contours say most for a change of the object. `alone` is [`own_misses`] of `own`.
    pub(super) fn changes(&self, alone: &[f64]) -> Changes {
        let (own, touches) = (self.own, &self.touches);
        let more = misses(own, touches).into_iter().zip(alone);
        let more: Vec<f64> = more.map(|(miss, alone)| miss - alone.max(0.0)).collect();
        let place = |i: usize| own.rays[i].eye + own.rays[i].direction * touches[i].along;
        let found = stretches(own, &more, &place);
        let heavier = |a: &ContourStretch, b: &ContourStretch| a.weight().total_cmp(&b.weight());
        Changes {
            spot: heaviest(&found, REACH_PX * own.pixel),
            stretch: found.into_iter().map(|miss| miss.stretch).max_by(heavier),
        }
    }
}

fn itself(own: &Body) -> Target<'_> {
    Target {
        body: own,
        body_from_ray: Isometry3::identity(),
        is_self: true,
    }
}

fn touches(own: &Body, targets: &[Target]) -> Vec<Touch> {
    let rays = own.rays.par_iter();
    rays.map(|ray| touch(own, ray, targets, None)).collect()
}

fn misses(own: &Body, touches: &[Touch]) -> Vec<f64> {
    touches.iter().map(|t| -t.inside / own.pixel).collect()
}

/// The stretches whose rays miss by more than [`MORE_PX`].
fn stretches(own: &Body, misses: &[f64], place: &dyn Fn(usize) -> Point3<f64>) -> Vec<Miss> {
    let of_chain = |chain: std::ops::Range<usize>| {
        let first = &own.rays[chain.start];
        let is_closed = own.outlines[first.view].is_closed[first.chain];
        let count = chain.len();
        let found = runs(&misses[chain.clone()], is_closed, MORE_PX).into_iter();
        let middle = move |run: &Run| {
            let rays = (0..run.length).map(|i| chain.start + (run.first + i) % count);
            let sum: Vector3<f64> = rays.map(|i| place(i).coords).sum();
            Point3::from(sum / run.length as f64)
        };
        found.map(move |run| Miss {
            middle: middle(&run),
            stretch: ContourStretch {
                camera: own.cameras[first.view],
                length_px: run.length as f64 * first.length_px,
                miss_px: run.sum / run.length as f64,
            },
        })
    };
    chains(own).into_iter().flat_map(of_chain).collect()
}

/// The heaviest spot around one of the stretches.
fn heaviest(stretches: &[Miss], reach: f64) -> Option<Spot> {
    let around = |center: &Miss| {
        let near = |s: &&Miss| (s.middle - center.middle).norm() <= reach;
        let near: Vec<&ContourStretch> =
            stretches.iter().filter(near).map(|s| &s.stretch).collect();
        let mut views: Vec<(usize, f64)> = Vec::new();
        for stretch in &near {
            match views.iter_mut().find(|view| view.0 == stretch.camera) {
                Some(view) => view.1 += stretch.weight(),
                None => views.push((stretch.camera, stretch.weight())),
            }
        }
        let most = views.iter().map(|view| view.1).fold(0.0, f64::max);
        let most_of_all =
            |a: &&&ContourStretch, b: &&&ContourStretch| a.weight().total_cmp(&b.weight());
        let stretch = near.iter().max_by(most_of_all)?;
        (views.len() > 1).then(|| Spot {
            weight: views.iter().map(|view| view.1).sum::<f64>() - most,
            stretch: (*stretch).clone(),
        })
    };
    let spots = stretches.iter().filter_map(around);
    spots.max_by(|a, b| a.weight.total_cmp(&b.weight))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn miss(camera: usize, x: f64, length_px: f64) -> Miss {
        Miss {
            middle: Point3::new(x, 0.0, 0.0),
            stretch: ContourStretch {
                camera,
                length_px,
                miss_px: 2.0,
            },
        }
    }

    #[test]
    fn one_view_says_nothing_however_long_its_stretch_and_others_far_away_add_nothing() {
        assert_eq!(heaviest(&[], 1.0), None);
        let one_view = [miss(3, 0.0, 200.0), miss(3, 0.5, 25.0)];
        assert_eq!(heaviest(&one_view, 1.0), None);
        let apart = [miss(3, 0.0, 200.0), miss(4, 2.0, 25.0)];
        assert_eq!(heaviest(&apart, 1.0), None);
    }

    #[test]
    fn views_that_miss_at_one_place_add_up_to_a_spot() {
        let at_one_place = [miss(3, 0.0, 15.0), miss(4, 0.5, 12.0), miss(5, 0.8, 10.0)];
        let with_one_apart = [&at_one_place[..], &[miss(6, 9.0, 45.0)]].concat();
        let spot = heaviest(&with_one_apart, 1.0).unwrap();
        assert_eq!(spot.weight, 44.0);
        assert_eq!(spot.stretch, at_one_place[0].stretch);
    }
}

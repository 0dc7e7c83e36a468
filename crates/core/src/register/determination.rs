//! Tests how firmly the silhouettes determine a pose: the pose is moved in the direction in which they resist least,
//! and the disagreement that this causes is compared with their noise. If they do not resist at all, the outside of the
//! object is symmetric in that direction.

use super::align::{Aligned, Rays, align, lever};
use super::body::Body;
use super::motion::{Twist, displacement, moved};
use nalgebra::{Isometry3, Point3, UnitVector3, Vector3};
use rayon::prelude::*;

/// Degrees by which a pose is made to slip.
const SLIPS_DEG: [f64; 3] = [5.0, 10.0, 30.0];
/// Degrees of slip from which on without an objection a direction counts as free.
pub(super) const UNDETERMINED_DEG: f64 = 10.0;
/// Degrees of slip from which on without an objection a direction is held loosely.
const LOOSE_DEG: f64 = 5.0;
/// Poses along a free turn that are put back on the silhouettes.
const ANCHORS: usize = 12;
/// So many of them may be off for the noise of silhouettes.
const FEW_ANCHORS: usize = 2;

/// How firmly the silhouettes determine a pose.
#[derive(Clone, Debug)]
pub(super) struct Determination {
    /// The most degrees of slip in the softest direction that the silhouettes do not object to on either side …
    free_deg: f64,
    /// … or on one: a pose need not lie in the middle of what they bear.
    pub(super) slack_deg: f64,
    /// The softest direction, with turns multiplied by the lever.
    pub(super) softest: Twist,
}

impl Determination {
    /// Makes a pose slip. Up to `limit` metres of disagreement are no objection.
    pub(super) fn of(a: &Body, b: &Body, aligned: &Aligned, limit: f64) -> Self {
        let softest = aligned.softest()[0].0;
        let (mut free_deg, mut slack_deg, mut is_free) = (0.0, 0.0, true);
        for degrees in SLIPS_DEG {
            let slipped = [1.0, -1.0].map(|sign| {
                let radians = sign * degrees.to_radians();
                let pose = moved_along(a, b, &aligned.pose, &softest, radians);
                align(a, b, pose, Rays::SOME, Some(&softest)).disagreement
            });
            if slipped[0].min(slipped[1]) >= limit {
                break;
            }
            slack_deg = degrees;
            is_free &= slipped[0].max(slipped[1]) < limit;
            if is_free {
                free_deg = degrees;
            }
        }
        Self {
            free_deg,
            slack_deg,
            softest,
        }
    }

    /// Whether a turn is free, and nothing else is.
    pub(super) fn is_free(&self) -> bool {
        self.free_deg >= UNDETERMINED_DEG
    }

    /// Whether the silhouettes hold a turn, but not to the few degrees that a pose must be known to.
    pub(super) fn is_loose(&self) -> bool {
        self.slack_deg >= LOOSE_DEG
    }

    /// Poses a degree apart, up to `side` degrees from one in the softest direction, where the silhouettes do not
    /// object by more than `limit` metres after the other directions are put back on them.
    pub(super) fn near(
        &self,
        a: &Body,
        b: &Body,
        aligned: &Aligned,
        side: i32,
        limit: f64,
    ) -> Vec<Isometry3<f64>> {
        let at = |degrees: i32| {
            let radians = f64::from(degrees).to_radians();
            let slipped = moved_along(a, b, &aligned.pose, &self.softest, radians);
            align(a, b, slipped, Rays::SOME, Some(&self.softest))
        };
        (-side..=side)
            .into_par_iter()
            .map(at)
            .filter(|slipped| slipped.disagreement < limit)
            .map(|slipped| slipped.pose)
            .collect()
    }
}

/// A pose moved along a direction until it has turned by `radians`.
fn moved_along(
    a: &Body,
    b: &Body,
    pose: &Isometry3<f64>,
    direction: &Twist,
    radians: f64,
) -> Isometry3<f64> {
    moved(pose, b.center, &twist(a, b, direction, radians))
}

fn twist(a: &Body, b: &Body, direction: &Twist, radians: f64) -> Twist {
    let lever = lever(a, b);
    let turn = direction.fixed_rows::<3>(3).norm().max(0.3);
    let mut twist = direction * (radians * lever / turn);
    for i in 3..6 {
        twist[i] /= lever;
    }
    twist
}

/// The axis of a direction, in the second body's rig.
pub(super) fn axis(direction: &Twist) -> Option<UnitVector3<f64>> {
    let turn: Vector3<f64> = direction.fixed_rows::<3>(3).into_owned();
    UnitVector3::try_new(turn, 1e-3)
}

/// Poses all the way round a free turn.
#[derive(Clone, Debug)]
pub(super) struct Turns {
    anchors: Vec<(Aligned, Twist)>,
}

impl Turns {
    /// Turns a pose in steps, each put back on the silhouettes.
    pub(super) fn of(a: &Body, b: &Body, aligned: &Aligned, direction: &Twist) -> Self {
        let half = ANCHORS / 2;
        let step = std::f64::consts::TAU / ANCHORS as f64;
        let way = |(sign, count): (f64, usize)| {
            let mut found: Vec<(Aligned, Twist)> = Vec::new();
            let (mut pose, mut along) = (aligned.pose, *direction);
            for _ in 0..count {
                let turned = moved_along(a, b, &pose, &along, sign * step);
                let next = align(a, b, turned, Rays::SOME, Some(&along));
                let softest = next.softest()[0].0;
                along = if softest.dot(&along) < 0.0 {
                    -softest
                } else {
                    softest
                };
                pose = next.pose;
                found.push((next, along));
            }
            found
        };
        let mut ways = [(1.0, half), (-1.0, half - 1)]
            .par_iter()
            .map(|&w| way(w))
            .collect::<Vec<_>>();
        let back = ways.pop().unwrap_or_default();
        let mut anchors = vec![(aligned.clone(), *direction)];
        anchors.extend(ways.pop().unwrap_or_default());
        anchors.extend(back.into_iter().rev());
        Self { anchors }
    }

    /// Poses about `degrees` apart, where the silhouettes do not object by more than `limit` metres.
    pub(super) fn bearable(
        &self,
        a: &Body,
        b: &Body,
        degrees: f64,
        limit: f64,
    ) -> Vec<Isometry3<f64>> {
        let each = 360.0 / ANCHORS as f64;
        let count = (each / degrees).round().max(1.0) as usize;
        let of_anchor = |(aligned, along): &(Aligned, Twist)| {
            let at = |i: usize| ((i as f64 + 0.5) / count as f64 - 0.5) * each;
            let (pose, along) = (aligned.pose, *along);
            let turned = move |i: usize| moved_along(a, b, &pose, &along, at(i).to_radians());
            (0..count).map(turned).collect::<Vec<_>>()
        };
        let anchors = self.anchors.iter();
        let bearable = anchors.filter(|(aligned, _)| aligned.disagreement < limit);
        bearable.flat_map(of_anchor).collect()
    }

    /// Whether the silhouettes bear the turn all the way round, but for a place or two where they err.
    pub(super) fn is_whole(&self, limit: f64) -> bool {
        let borne = self.anchors.iter().filter(|(a, _)| a.disagreement < limit);
        borne.count() + FEW_ANCHORS >= ANCHORS
    }

    /// Whether a pose is one of these turns, to within `apart` metres.
    pub(super) fn contain(
        &self,
        a: &Body,
        b: &Body,
        pose: &Isometry3<f64>,
        apart: f64,
        points: &[Point3<f64>],
    ) -> bool {
        let poses = self.bearable(a, b, 2.0, f64::INFINITY);
        poses.iter().any(|p| displacement(p, pose, points) < apart)
    }
}

/// The pose at which `rating` is highest within a few degrees of slip along a direction.
pub(super) fn polished(
    a: &Body,
    b: &Body,
    pose: &Isometry3<f64>,
    direction: &Twist,
    rating: &(dyn Fn(&Isometry3<f64>) -> f64 + Sync),
) -> Isometry3<f64> {
    const SPANS_DEG: [f64; 3] = [3.0, 0.75, 0.25];
    const SIDE: i32 = 4;
    let mut pose = *pose;
    for span in SPANS_DEG {
        let step = span.to_radians() / f64::from(SIDE);
        let at = |i: i32| moved_along(a, b, &pose, direction, f64::from(i) * step);
        let rated: Vec<f64> = (-SIDE..=SIDE)
            .into_par_iter()
            .map(|i| rating(&at(i)))
            .collect();
        let best = (0..rated.len()).max_by(|&i, &j| rated[i].total_cmp(&rated[j]).then(j.cmp(&i)));
        let best = best.unwrap_or(SIDE as usize);
        let mut place = best as f64 - f64::from(SIDE);
        if best > 0 && best + 1 < rated.len() {
            let (l, m, r) = (rated[best - 1], rated[best], rated[best + 1]);
            let bend = l - 2.0 * m + r;
            if bend < 0.0 {
                place += 0.5 * (l - r) / bend;
            }
        }
        pose = moved_along(a, b, &pose, direction, place * step);
    }
    pose
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slip_of_five_degrees_is_loose_and_one_of_ten_is_free() {
        let of = |free_deg: f64, slack_deg: f64| {
            let determination = Determination {
                free_deg,
                slack_deg,
                softest: Twist::zeros(),
            };
            (determination.is_loose(), determination.is_free())
        };
        assert_eq!(of(0.0, 0.0), (false, false));
        assert_eq!(of(5.0, 5.0), (true, false));
        assert_eq!(of(10.0, 10.0), (true, true));
        // To one side.
        assert_eq!(of(0.0, 10.0), (true, false));
    }
}

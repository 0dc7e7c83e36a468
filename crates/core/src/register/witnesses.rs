//! Decides by colours and depth where several poses agree with the silhouettes, and tests whether colours or depth
//! contradict a pose.

use super::align::{Aligned, Rays, align};
use super::alike::{alike, picked};
use super::body::Body;
use super::decide::{CapturePair, Decision};
use super::depth::{Contradiction, contradiction};
use super::determination::{Determination, Turns, axis, polished};
use super::motion::{Twist, displacement, moved};
use super::skin::agreement;
use super::{ColorAgreement, DepthWitness, PoseEvidence, Refusal, limits};
use nalgebra::{Isometry3, UnitVector3, Vector3};
use rayon::prelude::*;
use std::ops::Range;

/// Points that colours are compared at while turns are compared, and for a final word.
const FEW_POINTS: usize = 1500;
const MANY_POINTS: usize = 6000;
/// Degrees between turns that are compared.
const TURN_DEG: f64 = 1.5;
/// Degrees by which a given pose is turned about each axis, to learn what depth says beside it.
const NEAR_DEG: [f64; 4] = [-6.0, -3.0, 3.0, 6.0];

/// Degrees between the turns of a given pose, where silhouettes leave its turn open, at which colours are compared.
const AROUND_DEG: f64 = 15.0;

/// Poses that agree with the silhouettes, among which colours or depth decide.
struct Candidates {
    poses: Vec<Isometry3<f64>>,
    /// Where each free turn lies among the poses, all the way round; empty where no turn is free.
    turns: Vec<Range<usize>>,
    /// Whether silhouettes bear each of these turns all the way round.
    are_whole: bool,
    /// Whether the pose on which silhouettes agree best is among them.
    have_best: bool,
}

impl Candidates {
    /// The poses of each free turn, or each pose where no turn is free.
    fn families(&self) -> Vec<Range<usize>> {
        if self.turns.is_empty() {
            (0..self.poses.len()).map(|i| i..i + 1).collect()
        } else {
            self.turns.clone()
        }
    }

    /// Only those of some families. The first family has the best pose.
    fn only(&self, families: &[Range<usize>]) -> Self {
        let mut end = 0;
        let moved = families.iter().map(|family| {
            let begin = end;
            end += family.len();
            begin..end
        });
        let turns: Vec<Range<usize>> = moved.collect();
        Self {
            poses: picked(&self.poses, families),
            turns: if self.turns.is_empty() {
                Vec::new()
            } else {
                turns
            },
            are_whole: self.are_whole,
            have_best: self.have_best && families.first().is_some_and(|f| f.start == 0),
        }
    }
}

/// How far depth contradicts each of the candidates, and the least and most that are known.
struct Contradictions {
    shares: Vec<f64>,
    least: f64,
    most: f64,
}

impl Contradictions {
    fn new(shares: Vec<f64>) -> Self {
        let known = || shares.iter().copied().filter(|s| s.is_finite());
        let (least, most) = (
            known().fold(f64::INFINITY, f64::min),
            known().fold(0.0, f64::max),
        );
        Self {
            shares,
            least,
            most,
        }
    }

    /// Whether depth tells something of most of the candidates.
    fn are_known(&self) -> bool {
        let known = self.shares.iter().filter(|s| s.is_finite()).count();
        2 * known > self.shares.len()
    }

    /// Whether depth contradicts some of the candidates by more than others.
    fn differ(&self) -> bool {
        self.least.is_finite() && self.most > limits::depth(self.least)
    }
}

impl CapturePair<'_> {
    /// Several poses agree with the silhouettes: colours or depth decide between them, or nothing does.
    pub(super) fn by_witnesses(
        &self,
        mut decision: Decision,
        best: &Aligned,
        determination: &Determination,
        rivals: &[Aligned],
    ) -> Decision {
        decision.rivals = rivals.iter().map(|r| self.rival(r, best)).collect();
        let is_free = determination.is_free();
        decision.free_axis = is_free.then(|| axis(&determination.softest)).flatten();
        let candidates = self.candidates(best, determination, rivals);
        let (a, apart) = (&self.a.body, limits::APART * self.a.body.radius);
        let is_other =
            |x: &Isometry3<f64>, y: &Isometry3<f64>| displacement(x, y, &a.surface) > apart;
        let rated = self.rated(&candidates.poses);
        let chosen = self.best_of(&candidates.poses, &rated, &is_other);
        let Some((top, colours)) = chosen else {
            decision.verdict = Err(Refusal::Undecided);
            return decision;
        };
        decision.colours = Some(colours);
        let shares = self.contradicting_shares(&candidates.poses);
        if limits::do_colours_decide(&colours) {
            let least = Contradictions::new(shares).least;
            return self.by_colours(decision, candidates.poses[top], is_free, least);
        }
        let families = candidates.families();
        let silent = if colours.contrast < limits::PLAIN {
            Some(families)
        } else {
            alike(&families, &rated).filter(|_| limits::are_compared(&colours))
        };
        let Some(silent) = silent else {
            return self.by_depth_alone(decision, &candidates, Contradictions::new(shares), false);
        };
        let depth = Contradictions::new(picked(&shares, &silent));
        let borne = candidates.only(&silent);
        if !borne.have_best {
            let verdict = Ok(PoseEvidence::Nothing);
            decision = self.settled_at(decision, candidates.poses[top], verdict);
        }
        self.by_depth_alone(decision, &borne, depth, true)
    }

    /// Colours do not decide between some poses: depth does, or nothing. `are_silent` says whether colours tell none of
    /// them from another, be it that the surface is plain.
    fn by_depth_alone(
        &self,
        mut decision: Decision,
        candidates: &Candidates,
        depth: Contradictions,
        are_silent: bool,
    ) -> Decision {
        let knows_nothing = are_silent && !candidates.turns.is_empty();
        let limit = limits::depth(depth.least);
        let mut turns = candidates.turns.iter();
        let is_indifferent =
            |turn: &Range<usize>| is_indifferent(&depth.shares[turn.clone()], limit);
        if depth.differ() && !(knows_nothing && turns.all(is_indifferent)) {
            let turns = if knows_nothing {
                &candidates.turns[..]
            } else {
                &[]
            };
            return self.by_depth(decision, turns, &candidates.poses, &depth);
        }
        let at_pose = self.depth_at(&decision.pose);
        decision.depth = at_pose.filter(|_| depth.are_known());
        decision.verdict = if at_pose.is_some_and(is_too_much) {
            Err(Refusal::DepthContradicts)
        } else if !are_silent || !candidates.are_whole {
            Err(Refusal::Undecided)
        } else {
            // Whichever of these poses is right, neither silhouettes nor depth nor colours can tell it from another.
            decision.verdict.and(Ok(PoseEvidence::Nothing))
        };
        decision
    }

    /// The best pose and its rivals, each turned all the way round where a turn is free.
    fn candidates(
        &self,
        best: &Aligned,
        determination: &Determination,
        rivals: &[Aligned],
    ) -> Candidates {
        let (a, b) = (&self.a.body, &self.b.body);
        if !determination.is_free() {
            let rivals = rivals.iter().map(|r| r.pose);
            return Candidates {
                poses: std::iter::once(best.pose).chain(rivals).collect(),
                turns: Vec::new(),
                are_whole: true,
                have_best: true,
            };
        }
        let mut free = vec![Turns::of(a, b, best, &determination.softest)];
        for rival in rivals {
            let is_turn = |t: &Turns| t.contain(a, b, &rival.pose, 0.06 * a.radius, &a.surface);
            if free.len() < limits::MOST_TURNS && !free.iter().any(is_turn) {
                free.push(Turns::of(a, b, rival, &rival.softest()[0].0));
            }
        }
        let (mut poses, mut turns) = (Vec::new(), Vec::new());
        for turn in &free {
            let begin = poses.len();
            poses.extend(turn.bearable(a, b, TURN_DEG, self.object));
            turns.push(begin..poses.len());
        }
        Candidates {
            poses,
            turns,
            are_whole: free.iter().all(|turn| turn.is_whole(self.object)),
            have_best: true,
        }
    }

    /// The pose at which colours agree best, and how well they agree there and at the next one that is apart from it;
    /// `None` of no pose.
    pub(super) fn best_by_colours(
        &self,
        poses: &[Isometry3<f64>],
        apart: &dyn Fn(&Isometry3<f64>, &Isometry3<f64>) -> bool,
    ) -> Option<(usize, ColorAgreement)> {
        self.best_of(poses, &self.rated(poses), apart)
    }

    /// The correlation of colours at each pose.
    fn rated(&self, poses: &[Isometry3<f64>]) -> Vec<f64> {
        poses
            .par_iter()
            .map(|p| agreement(&self.a.skin, &self.b.skin, p, FEW_POINTS).correlation)
            .collect()
    }

    /// The share of depth readings that contradict each pose; NaN where the captures have too few in common.
    fn contradicting_shares(&self, poses: &[Isometry3<f64>]) -> Vec<f64> {
        let share = |found: Option<Contradiction>| found.map_or(f64::NAN, |found| found.share);
        poses
            .par_iter()
            .map(|p| share(contradiction(&self.a.depths, &self.b.depths, p)))
            .collect()
    }

    /// The best rated of some poses, and how well colours agree there and at the next one that is apart from it.
    fn best_of(
        &self,
        poses: &[Isometry3<f64>],
        rated: &[f64],
        apart: &dyn Fn(&Isometry3<f64>, &Isometry3<f64>) -> bool,
    ) -> Option<(usize, ColorAgreement)> {
        let (top, next) = best_and_next(poses, rated, apart)?;
        let colours = ColorAgreement {
            best: rated[top],
            next,
            contrast: self.contrast(),
            points: agreement(&self.a.skin, &self.b.skin, &poses[top], FEW_POINTS).points,
        };
        Some((top, colours))
    }

    /// The pose that colours chose, refined by silhouettes and colours.
    pub(super) fn by_colours(
        &self,
        decision: Decision,
        mut pose: Isometry3<f64>,
        is_free: bool,
        least: f64,
    ) -> Decision {
        let (a, b) = (&self.a.body, &self.b.body);
        for _ in 0..2 {
            let softest = is_free.then(|| as_it_is(a, b, pose, Rays::SOME).softest()[0].0);
            if let Some(softest) = &softest {
                let rating = |p: &Isometry3<f64>| {
                    agreement(&self.a.skin, &self.b.skin, p, MANY_POINTS).correlation
                };
                pose = polished(a, b, &pose, softest, &rating);
            }
            pose = align(a, b, pose, Rays::MANY, softest.as_ref()).pose;
        }
        let aligned = as_it_is(a, b, pose, Rays::MANY);
        let mut settled = self.state(&aligned, Ok(PoseEvidence::Colours));
        settled.free_axis = decision.free_axis;
        settled.rivals = decision.rivals;
        settled.colours = decision.colours;
        settled.depth = self.depth_at(&aligned.pose).map(|d| DepthWitness {
            least: least.min(d.contradicting),
            ..d
        });
        if self.is_contradicted(&settled) {
            settled.verdict = Err(Refusal::DepthContradicts);
        }
        settled
    }

    /// The turn with the least contradiction of depths, where all good ones lie close together. Where they are a wide
    /// part of one of the free `turns` of a plain surface, the one in their middle, and no turn is claimed.
    fn by_depth(
        &self,
        mut decision: Decision,
        turns: &[Range<usize>],
        poses: &[Isometry3<f64>],
        depth: &Contradictions,
    ) -> Decision {
        let a = &self.a.body;
        let (shares, least) = (&depth.shares, depth.least);
        let limit = limits::depth(least);
        let good = |i: &usize| shares[*i] <= 0.5 * (least + limit);
        let good: Vec<usize> = (0..poses.len()).filter(good).collect();
        let Some(&top) = good
            .iter()
            .min_by(|&&i, &&j| shares[i].total_cmp(&shares[j]))
        else {
            decision.verdict = Err(Refusal::Undecided);
            return decision;
        };
        let is_good = |i: usize| good.binary_search(&i).is_ok();
        let is_borne = least < limits::DEPTH_CONTRADICTS;
        let middle = middle_of_wide(turns, is_good).filter(|_| is_borne);
        let top = middle.unwrap_or(top);
        let near = limits::DEPTH_SPREAD * a.radius;
        let is_near = |i: usize| displacement(&poses[i], &poses[top], &a.surface) < near;
        let sigma_deg = half_width_deg(&good, poses);
        let is_one = may_be_right(shares, &good).all(is_near)
            && sigma_deg <= limits::DEPTH_SIGMA_DEG
            && least < limits::DEPTH_CONTRADICTS;
        let is_free = decision.free_axis.is_some();
        let verdict = if middle.is_some() {
            Ok(PoseEvidence::Nothing)
        } else if is_one {
            Ok(PoseEvidence::Depth)
        } else {
            Err(Refusal::Undecided)
        };
        let mut settled = self.settled_at(decision, poses[top], verdict);
        settled.depth = Some(DepthWitness {
            contradicting: shares[top],
            least,
        });
        // A turn that depth holds is known to the degrees that it finds equally good, and no closer than they are
        // tried.
        let step_deg = if is_free { TURN_DEG } else { 0.0 };
        settled.uncertainty.0 = settled.uncertainty.0.max(sigma_deg).max(step_deg);
        settled
    }

    /// What is known of another pose than that of a decision, put on the silhouettes without a turn where that is free.
    fn settled_at(
        &self,
        decision: Decision,
        pose: Isometry3<f64>,
        verdict: Result<PoseEvidence, Refusal>,
    ) -> Decision {
        let (a, b) = (&self.a.body, &self.b.body);
        let is_free = decision.free_axis.is_some();
        let fixed = is_free.then(|| as_it_is(a, b, pose, Rays::SOME).softest()[0].0);
        let aligned = align(a, b, pose, Rays::MANY, fixed.as_ref());
        Decision {
            free_axis: decision.free_axis,
            rivals: decision.rivals,
            colours: decision.colours,
            ..self.state(&aligned, verdict)
        }
    }

    pub(super) fn colours_at(&self, pose: &Isometry3<f64>, next: f64) -> ColorAgreement {
        let found = agreement(&self.a.skin, &self.b.skin, pose, MANY_POINTS);
        ColorAgreement {
            best: found.correlation,
            next,
            contrast: self.contrast(),
            points: found.points,
        }
    }

    /// What colours say of a pose, with the most that they say of one that is turned about an axis in the second's rig.
    pub(super) fn colours_around(
        &self,
        pose: &Isometry3<f64>,
        axis: &UnitVector3<f64>,
    ) -> ColorAgreement {
        let turned = |i: i32| {
            let turn = axis.into_inner() * (f64::from(i) * AROUND_DEG).to_radians();
            let twist = Twist::new(0.0, 0.0, 0.0, turn.x, turn.y, turn.z);
            let pose = moved(pose, self.b.body.center, &twist);
            agreement(&self.a.skin, &self.b.skin, &pose, FEW_POINTS).correlation
        };
        let count = (360.0 / AROUND_DEG).round() as i32;
        let others = (1..count).into_par_iter().map(turned);
        self.colours_at(pose, others.reduce(|| 0.0, f64::max))
    }

    /// The contrast of the plainer capture.
    fn contrast(&self) -> f64 {
        self.a.skin.contrast.min(self.b.skin.contrast)
    }

    /// What depth says of a pose, with the least that it says of poses near it.
    pub(super) fn depth_near(&self, pose: &Isometry3<f64>) -> Option<DepthWitness> {
        let center = self.b.body.center;
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
        let turns = axes
            .iter()
            .flat_map(|axis| NEAR_DEG.map(|degrees| axis * degrees));
        let shares = turns.filter_map(|turn| {
            let turn = turn.map(f64::to_radians);
            let twist = Twist::new(0.0, 0.0, 0.0, turn.x, turn.y, turn.z);
            self.depth_at(&moved(pose, center, &twist))
        });
        let least = shares
            .map(|d| d.contradicting)
            .fold(f64::INFINITY, f64::min);
        self.depth_at(pose).map(|d| DepthWitness {
            least: least.min(d.contradicting),
            ..d
        })
    }

    pub(super) fn depth_at(&self, pose: &Isometry3<f64>) -> Option<DepthWitness> {
        contradiction(&self.a.depths, &self.b.depths, pose).map(|c| DepthWitness {
            contradicting: c.share,
            least: c.share,
        })
    }

    pub(super) fn is_contradicted(&self, decision: &Decision) -> bool {
        decision.depth.is_some_and(is_too_much)
    }
}

/// Whether so many readings contradict a pose that it is not accepted.
fn is_too_much(depth: DepthWitness) -> bool {
    depth.contradicting > limits::DEPTH_CONTRADICTS
        || depth.contradicting > limits::depth(depth.least)
}

/// The poses that depth does not speak against: those that it finds good, and those at which the captures have too few
/// readings in common to tell.
fn may_be_right<'a>(shares: &'a [f64], good: &'a [usize]) -> impl Iterator<Item = usize> + 'a {
    let unknown = (0..shares.len()).filter(move |&i| shares[i].is_nan());
    good.iter().copied().chain(unknown)
}

/// Half the largest turn between two of the good poses, in degrees.
fn half_width_deg(good: &[usize], poses: &[Isometry3<f64>]) -> f64 {
    let turns = good.iter().flat_map(|&i| {
        let of = move |&j: &usize| poses[i].rotation.angle_to(&poses[j].rotation);
        good.iter().map(of)
    });
    0.5 * turns.fold(0.0, f64::max).to_degrees()
}

/// A pose measured against the silhouettes, and not moved.
fn as_it_is(a: &Body, b: &Body, pose: Isometry3<f64>, rays: Rays) -> Aligned {
    align(a, b, pose, Rays { rounds: 0, ..rays }, None)
}

/// Whether depth tells none of the turns about an axis from the others, of which the shares of contradicting readings
/// go all the way round: it objects to few of them, to none much, and nowhere to many in a row.
fn is_indifferent(shares: &[f64], limit: f64) -> bool {
    let count = shares.len();
    let objects = |i: usize| shares[i % count] > limit;
    let objections = (0..count).filter(|&i| objects(i)).count();
    let (mut run, mut longest) = (0, 0);
    for i in 0..2 * count {
        run = if objects(i) { run + 1 } else { 0 };
        longest = longest.max(run);
    }
    let most = shares.iter().copied().fold(0.0, f64::max);
    count > 0
        && most < limits::DEPTH_CONTRADICTS
        && (objections as f64) < limits::DEPTH_OBJECTS_TO * count as f64
        && longest as f64 * TURN_DEG <= limits::DEPTH_OBJECTS_IN_A_ROW_DEG
}

/// The middle of the turns that are good, if they are an unbroken wide part of one free turn.
fn middle_of_wide(turns: &[Range<usize>], is_good: impl Fn(usize) -> bool) -> Option<usize> {
    let good_in = |turn: &&Range<usize>| (*turn).clone().any(&is_good);
    let mut with_good = turns.iter().filter(good_in);
    let (turn, None) = (with_good.next()?, with_good.next()) else {
        return None;
    };
    let count = turn.len();
    let (mut run, mut longest, mut end) = (0, 0, 0);
    for i in 0..2 * count {
        run = if is_good(turn.start + i % count) {
            run + 1
        } else {
            0
        };
        if run > longest {
            (longest, end) = (run, i);
        }
    }
    let all = turn.clone().filter(|&i| is_good(i)).count();
    let is_wide = longest as f64 * TURN_DEG >= limits::DEPTH_WIDE_DEG;
    // What is good elsewhere too is no one part.
    let is_one = all <= longest + count / 20;
    (is_wide && is_one).then(|| turn.start + (end - longest.min(count) / 2) % count)
}

/// The best rated pose, and the best rating among those that are apart from it.
fn best_and_next(
    poses: &[Isometry3<f64>],
    rated: &[f64],
    apart: impl Fn(&Isometry3<f64>, &Isometry3<f64>) -> bool,
) -> Option<(usize, f64)> {
    let numbers = 0..poses.len();
    let top = numbers.max_by(|&i, &j| rated[i].total_cmp(&rated[j]).then(j.cmp(&i)))?;
    let others = (0..poses.len()).filter(|&i| apart(&poses[i], &poses[top]));
    let next = others.map(|i| rated[i]).fold(0.0, f64::max);
    Some((top, next))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Shares all the way round, `high` within `width` degrees of each of `places`.
    fn around(high: f64, places: &[f64], width: f64) -> Vec<f64> {
        let count = (360.0 / TURN_DEG) as usize;
        let near = |i: usize| {
            let away = |place: &f64| {
                let off = (i as f64 * TURN_DEG - place).abs();
                off.min(360.0 - off)
            };
            places.iter().any(|place| away(place) <= 0.5 * width)
        };
        (0..count)
            .map(|i| if near(i) { high } else { 0.002 })
            .collect()
    }

    #[test]
    fn depth_is_indifferent_where_it_objects_to_few_turns_and_little() {
        let limit = limits::depth(0.0);
        assert!(is_indifferent(&around(0.0, &[], 0.0), limit));
        // Noise, here and there.
        assert!(is_indifferent(
            &around(0.015, &[0.0, 90.0, 200.0], 20.0),
            limit
        ));
        // A thing in the hollow: all turns but those near the right one contradict.
        assert!(!is_indifferent(&around(0.02, &[180.0], 320.0), limit));
        // The same that fits after half a turn.
        assert!(!is_indifferent(&around(0.02, &[90.0, 270.0], 80.0), limit));
        // A small one that some turns contradict by much.
        assert!(!is_indifferent(&around(0.08, &[180.0], 20.0), limit));
        assert!(!is_indifferent(&[], limit));
    }

    #[test]
    fn a_wide_part_of_one_turn_has_a_middle() {
        let near = |middle: usize, width: usize| {
            move |i: usize| {
                let off = i.abs_diff(middle);
                off.min(240 - off) <= width / 2
            }
        };
        let whole = 0..240;
        let one = std::slice::from_ref(&whole);
        // 120 degrees, across the begin.
        let middle = middle_of_wide(one, near(10, 80)).unwrap();
        assert!(middle.abs_diff(10) <= 1, "{middle}");
        assert_eq!(middle_of_wide(one, near(10, 20)), None);
        let opposite = |i: usize| near(10, 70)(i) || near(130, 70)(i);
        assert_eq!(middle_of_wide(one, opposite), None);
        // Another free turn has good ones as well.
        let both = |i: usize| near(10, 80)(i % 240);
        assert_eq!(middle_of_wide(&[0..240, 240..480], both), None);
        assert_eq!(middle_of_wide(&[], |_| true), None);
    }

    #[test]
    fn good_turns_are_as_wide_as_the_two_that_are_farthest_apart() {
        let turn = |degrees: f64| Isometry3::rotation(Vector3::new(0.0, 0.0, degrees.to_radians()));
        let poses = [0.0, 1.5, 3.0, 4.5, 90.0].map(turn);
        assert!(half_width_deg(&[1], &poses) < 1e-6);
        assert!((half_width_deg(&[0, 1, 2], &poses) - 1.5).abs() < 1e-6);
        assert!(half_width_deg(&[0, 1, 2, 3], &poses) > limits::DEPTH_SIGMA_DEG);
        assert!((half_width_deg(&[0, 4], &poses) - 45.0).abs() < 1e-6);
    }

    #[test]
    fn a_pose_that_depth_cannot_compare_may_be_the_right_one() {
        let shares = [f64::NAN, 0.001, 0.05];
        assert!(may_be_right(&shares, &[1]).eq([1, 0]));
        assert!(may_be_right(&shares[1..], &[0]).eq([0]));
    }

    #[test]
    fn of_no_pose_none_is_the_best() {
        assert_eq!(best_and_next(&[], &[], |_, _| true), None);
    }
}

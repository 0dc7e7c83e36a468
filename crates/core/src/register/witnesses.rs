//! Decides by colours and depth where several poses agree with the silhouettes, and tests whether colours or depth
//! contradict a pose.

use super::align::{Aligned, Rays, align};
use super::body::Body;
use super::decide::{CapturePair, Decision};
use super::depth::{Contradiction, contradiction};
use super::determination::{Determination, Turns, axis, polished};
use super::motion::displacement;
use super::skin::agreement;
use super::{ColorAgreement, DepthWitness, PoseEvidence, Refusal, limits};
use nalgebra::Isometry3;
use rayon::prelude::*;
use std::ops::Range;

/// Points that colours are compared at while turns are compared, and for a final word.
const FEW_POINTS: usize = 1500;
const MANY_POINTS: usize = 6000;
/// Degrees between turns that are compared.
const TURN_DEG: f64 = 1.5;

/// Poses that agree with the silhouettes, among which colours or depth decide.
struct Candidates {
    poses: Vec<Isometry3<f64>>,
    /// Where each free turn lies among the poses, all the way round; empty where no turn is free.
    turns: Vec<Range<usize>>,
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
        let poses = &candidates.poses;
        let (top, colours) = self.best_by_colours(poses);
        decision.colours = Some(colours);
        let contradiction = |p| contradiction(&self.a.depths, &self.b.depths, p);
        let share = |found: Option<Contradiction>| found.map_or(f64::NAN, |found| found.share);
        let shares = poses.par_iter().map(|p| share(contradiction(p))).collect();
        let depth = Contradictions::new(shares);
        let margin = colours.best - colours.next;
        if colours.best > limits::CORRELATION && margin > limits::CORRELATION_MARGIN {
            return self.by_colours(decision, poses[top], is_free, depth.least);
        }
        let is_plain = self.a.skin.contrast.min(self.b.skin.contrast) < limits::PLAIN;
        let knows_nothing = is_plain && is_free;
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
            return self.by_depth(decision, turns, poses, &depth.shares, depth.least);
        }
        decision.depth = self.depth_at(&decision.pose);
        decision.verdict = if self.is_contradicted(&decision) {
            Err(Refusal::DepthContradicts)
        } else if !is_plain {
            Err(Refusal::Undecided)
        } else {
            // Whichever of these poses is right, silhouettes and depth cannot tell its form from another's.
            Ok(PoseEvidence::Nothing)
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
        Candidates { poses, turns }
    }

    /// The pose at which colours agree best, and how well they agree there and at the next one that is not the same.
    fn best_by_colours(&self, poses: &[Isometry3<f64>]) -> (usize, ColorAgreement) {
        let a = &self.a.body;
        let apart = limits::APART * a.radius;
        let rated: Vec<f64> = poses
            .par_iter()
            .map(|p| agreement(&self.a.skin, &self.b.skin, p, FEW_POINTS).correlation)
            .collect();
        let is_other = |x: &_, y: &_| displacement(x, y, &a.surface) > apart;
        let (top, next) = best_and_next(poses, &rated, is_other);
        let colours = ColorAgreement {
            best: rated[top],
            next,
            contrast: self.a.skin.contrast.min(self.b.skin.contrast),
        };
        (top, colours)
    }

    /// The pose that colours chose, refined by silhouettes and colours.
    fn by_colours(
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
        shares: &[f64],
        least: f64,
    ) -> Decision {
        let (a, b) = (&self.a.body, &self.b.body);
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
        let spread = good
            .iter()
            .map(|&i| displacement(&poses[i], &poses[top], &a.surface));
        let is_one = spread.fold(0.0, f64::max) < near && least < limits::DEPTH_CONTRADICTS;
        let fixed = decision
            .free_axis
            .is_some()
            .then(|| as_it_is(a, b, poses[top], Rays::SOME).softest()[0].0);
        let aligned = align(a, b, poses[top], Rays::MANY, fixed.as_ref());
        let verdict = if middle.is_some() {
            Ok(PoseEvidence::Nothing)
        } else if is_one {
            Ok(PoseEvidence::Depth)
        } else {
            Err(Refusal::Undecided)
        };
        let mut settled = self.state(&aligned, verdict);
        settled.free_axis = decision.free_axis;
        settled.rivals = decision.rivals;
        settled.colours = decision.colours;
        settled.depth = Some(DepthWitness {
            contradicting: shares[top],
            least,
        });
        // A turn that depth holds is known to degrees, not to tenths.
        settled.uncertainty.0 = settled.uncertainty.0.max(2.0);
        settled
    }

    pub(super) fn colours_at(&self, pose: &Isometry3<f64>, next: f64) -> ColorAgreement {
        ColorAgreement {
            best: agreement(&self.a.skin, &self.b.skin, pose, MANY_POINTS).correlation,
            next,
            contrast: self.a.skin.contrast.min(self.b.skin.contrast),
        }
    }

    pub(super) fn depth_at(&self, pose: &Isometry3<f64>) -> Option<DepthWitness> {
        contradiction(&self.a.depths, &self.b.depths, pose).map(|c| DepthWitness {
            contradicting: c.share,
            least: c.share,
        })
    }

    pub(super) fn is_contradicted(&self, decision: &Decision) -> bool {
        decision.depth.is_some_and(|d| {
            d.contradicting > limits::DEPTH_CONTRADICTS || d.contradicting > limits::depth(d.least)
        })
    }
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
) -> (usize, f64) {
    let top = (0..poses.len())
        .max_by(|&i, &j| rated[i].total_cmp(&rated[j]).then(j.cmp(&i)))
        .unwrap_or(0);
    let others = (0..poses.len()).filter(|&i| apart(&poses[i], &poses[top]));
    let next = others.map(|i| rated[i]).fold(0.0, f64::max);
    (top, next)
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
}

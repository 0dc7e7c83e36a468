//! Decides by colours and depth where several poses agree with the silhouettes, and tests whether colours or depth
//! contradict a pose.

use super::align::{Aligned, Rays, align};
use super::decide::{Decision, Two};
use super::depth::{Contradiction, contradiction};
use super::hold::{Hold, Turns, axis, polished};
use super::motion::displacement;
use super::skin::agreement;
use super::{Colours, DepthWitness, HeldBy, Refusal, limits};
use nalgebra::Isometry3;
use rayon::prelude::*;
use std::ops::Range;

/// Points that colours are compared at while turns are compared, and for a final word.
const FEW_POINTS: usize = 1500;
const MANY_POINTS: usize = 6000;
/// Degrees between turns that are compared.
const TURN_DEG: f64 = 1.5;

impl Two<'_> {
    /// Several poses agree with the silhouettes: colours or depth decide between them, or nothing does.
    pub(super) fn by_witnesses(
        &self,
        mut decision: Decision,
        best: &Aligned,
        hold: &Hold,
        rivals: &[&Aligned],
    ) -> Decision {
        let (a, b) = (&self.a.body, &self.b.body);
        let apart = limits::APART * a.radius;
        decision.rivals = rivals.iter().map(|r| self.rival(r, best)).collect();
        decision.free_axis = hold.is_free().then(|| axis(&hold.softest)).flatten();
        let mut poses: Vec<Isometry3<f64>> = Vec::new();
        // Where each free turn begins among the poses, all the way round.
        let mut begins: Vec<usize> = Vec::new();
        if hold.is_free() {
            let mut turns = vec![Turns::of(a, b, best, &hold.softest)];
            for rival in rivals {
                let is_turn = |t: &Turns| t.contain(a, b, &rival.pose, 0.06 * a.radius, &a.surface);
                if turns.len() < limits::MOST_TURNS && !turns.iter().any(is_turn) {
                    turns.push(Turns::of(a, b, rival, &rival.softest()[0].0));
                }
            }
            for turn in &turns {
                begins.push(poses.len());
                poses.extend(turn.bearable(a, b, TURN_DEG, self.object));
            }
        } else {
            poses.push(best.pose);
            poses.extend(rivals.iter().map(|r| r.pose));
        }
        let colour =
            |p: &Isometry3<f64>| agreement(&self.a.skin, &self.b.skin, p, FEW_POINTS).correlation;
        let rated: Vec<f64> = poses.par_iter().map(colour).collect();
        let (top, next) = best_and_next(&poses, &rated, |x, y| {
            displacement(x, y, &a.surface) > apart
        });
        let deep: Vec<Option<Contradiction>> = poses
            .par_iter()
            .map(|p| contradiction(&self.a.depths, &self.b.depths, p))
            .collect();
        let shares: Vec<f64> = deep
            .iter()
            .map(|d| d.map_or(f64::NAN, |d| d.share))
            .collect();
        let known = || shares.iter().copied().filter(|s| s.is_finite());
        let (least, most) = (
            known().fold(f64::INFINITY, f64::min),
            known().fold(0.0, f64::max),
        );
        decision.colours = Some(Colours {
            best: rated[top],
            next,
            contrast: self.a.skin.contrast.min(self.b.skin.contrast),
        });
        let depth_differs = least.is_finite() && most > limits::depth(least);
        let by_colours =
            rated[top] > limits::CORRELATION && rated[top] - next > limits::CORRELATION_MARGIN;
        if by_colours {
            let mut pose = poses[top];
            for _ in 0..2 {
                if hold.is_free() {
                    let softest = align(
                        a,
                        b,
                        pose,
                        Rays {
                            rounds: 0,
                            ..Rays::SOME
                        },
                        None,
                    )
                    .softest()[0]
                        .0;
                    let rating = |p: &Isometry3<f64>| {
                        agreement(&self.a.skin, &self.b.skin, p, MANY_POINTS).correlation
                    };
                    pose = polished(a, b, &pose, &softest, &rating);
                    pose = align(a, b, pose, Rays::MANY, Some(&softest)).pose;
                } else {
                    pose = align(a, b, pose, Rays::MANY, None).pose;
                }
            }
            let aligned = align(
                a,
                b,
                pose,
                Rays {
                    rounds: 0,
                    ..Rays::MANY
                },
                None,
            );
            let mut settled = self.state(&aligned, Ok(HeldBy::Colours));
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
            return settled;
        }
        let is_plain = self.a.skin.contrast.min(self.b.skin.contrast) < limits::PLAIN;
        let ends = begins.iter().skip(1).copied().chain([poses.len()]);
        let turns: Vec<Range<usize>> = begins.iter().zip(ends).map(|(&b, e)| b..e).collect();
        let limit = limits::depth(least);
        let is_indifferent = |turns: &Range<usize>| is_indifferent(&shares[turns.clone()], limit);
        let knows_nothing = is_plain && hold.is_free();
        if depth_differs && !(knows_nothing && turns.iter().all(is_indifferent)) {
            let turns = if knows_nothing { &turns[..] } else { &[] };
            return self.by_depth(decision, turns, &poses, &shares, least);
        }
        decision.depth = self.depth_at(&decision.pose);
        decision.verdict = if self.is_contradicted(&decision) {
            Err(Refusal::DepthContradicts)
        } else if !is_plain {
            Err(Refusal::Undecided)
        } else {
            // Whichever of these poses is right, silhouettes and depth cannot tell its form from another's.
            Ok(HeldBy::Nothing)
        };
        decision
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
        let fixed = decision.free_axis.is_some().then(|| {
            align(
                a,
                b,
                poses[top],
                Rays {
                    rounds: 0,
                    ..Rays::SOME
                },
                None,
            )
            .softest()[0]
                .0
        });
        let aligned = align(a, b, poses[top], Rays::MANY, fixed.as_ref());
        let verdict = if middle.is_some() {
            Ok(HeldBy::Nothing)
        } else if is_one {
            Ok(HeldBy::Depth)
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

    pub(super) fn colours_at(&self, pose: &Isometry3<f64>, next: f64) -> Colours {
        Colours {
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

//! What colours and depth say where the silhouettes bear several poses, and whether they contradict a pose.

use super::align::{Aligned, Rays, align};
use super::decide::{Decision, Two};
use super::depth::{Contradiction, contradiction};
use super::hold::{Hold, Turns, axis, polished};
use super::motion::displacement;
use super::skin::agreement;
use super::{Colours, DepthWitness, HeldBy, Refusal, limits};
use nalgebra::Isometry3;
use rayon::prelude::*;

/// Points that colours are compared at while turns are compared, and for a final word.
const FEW_POINTS: usize = 1500;
const MANY_POINTS: usize = 6000;
/// Degrees between turns that are compared.
const TURN_DEG: f64 = 1.5;

impl Two<'_> {
    /// Several poses bear the silhouettes: colours and depth decide, or nothing does.
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
        if hold.is_free() {
            let mut turns = vec![Turns::of(a, b, best, &hold.softest)];
            for rival in rivals {
                let is_turn = |t: &Turns| t.contain(a, b, &rival.pose, 0.06 * a.radius, &a.surface);
                if turns.len() < limits::MOST_TURNS && !turns.iter().any(is_turn) {
                    turns.push(Turns::of(a, b, rival, &rival.softest()[0].0));
                }
            }
            let bearable = |t: &Turns| t.bearable(a, b, TURN_DEG, self.object);
            poses.extend(turns.iter().flat_map(bearable));
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
        if depth_differs {
            return self.by_depth(decision, hold, &poses, &shares, least);
        }
        decision.depth = self.depth_at(&decision.pose);
        let is_plain = self.a.skin.contrast.min(self.b.skin.contrast) < limits::PLAIN;
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

    /// The turn with the least contradiction of depths, where all good ones lie close together.
    fn by_depth(
        &self,
        mut decision: Decision,
        hold: &Hold,
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
        let near = limits::DEPTH_SPREAD * a.radius;
        let spread = good
            .iter()
            .map(|&i| displacement(&poses[i], &poses[top], &a.surface));
        let is_one = spread.fold(0.0, f64::max) < near && least < limits::DEPTH_CONTRADICTS;
        let fixed = hold.is_free().then(|| {
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
        let verdict = if is_one {
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

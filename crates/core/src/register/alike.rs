//! Finds colours that are the same at every turn, such as those of a pot with painted rings: they agree, but tell no
//! turn from another.

use super::limits;
use crate::statistics::upper_median;
use std::ops::Range;

/// Of `families` of poses those that colours bear, if colours agree at all of their poses and no better at one than at
/// another but for their noise; else `None`. `rated` has the correlation of colours at each pose. A family is ruled out
/// where each of its poses correlates by so much less than the best one that colours decide against it.
pub(super) fn alike(families: &[Range<usize>], rated: &[f64]) -> Option<Vec<Range<usize>>> {
    let best = rated.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let is_borne = |family: &&Range<usize>| {
        let rated = &rated[(*family).clone()];
        rated.iter().any(|&r| !limits::is_outdone(r, best))
    };
    let borne: Vec<Range<usize>> = families.iter().filter(is_borne).cloned().collect();
    let rated = picked(rated, &borne);
    let least = rated.iter().copied().fold(best, f64::min);
    let are_alike = limits::are_colours_alike(best, least) && !stands_out(best, &rated);
    (!borne.is_empty() && are_alike).then_some(borne)
}

/// Whether the best correlation stands out of the noise of all, as where a small mark meets itself.
fn stands_out(best: f64, rated: &[f64]) -> bool {
    let median = upper_median(&mut rated.to_vec()).unwrap_or(best);
    let mut deviations: Vec<f64> = rated.iter().map(|r| (r - median).abs()).collect();
    let noise = 1.4826 * upper_median(&mut deviations).unwrap_or(0.0);
    limits::is_peak(best - median, noise)
}

/// What belongs to the poses of some families, in their order.
pub(super) fn picked<T: Copy>(all: &[T], families: &[Range<usize>]) -> Vec<T> {
    let of_family = |family: &Range<usize>| all[family.clone()].iter().copied();
    families.iter().flat_map(of_family).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Correlations all the way round: `base`, which noise changes by up to 0.01, and `peak` at one turn.
    fn around(base: f64, peak: f64) -> Vec<f64> {
        let noise = |i: usize| 0.01 * (0.7 * i as f64).sin();
        let at = |i: usize| base + noise(i) + if i == 100 { peak } else { 0.0 };
        (0..240).map(at).collect()
    }

    #[test]
    fn rings_are_alike_at_every_turn_and_a_mark_between_them_is_not() {
        let whole = 0..240;
        let whole = std::slice::from_ref(&whole);
        for base in [0.97, 0.93, 0.85] {
            let found = alike(whole, &around(base, 0.0));
            assert_eq!(found.as_deref(), Some(whole), "{base}");
        }
        // Marks that are too small to decide, and more than noise.
        assert_eq!(alike(whole, &around(0.95, 0.03)), None);
        assert_eq!(alike(whole, &around(0.83, 0.08)), None);
        assert_eq!(alike(whole, &around(0.84, 0.035)), None);
        // Colours that hardly agree may hide one.
        assert_eq!(alike(whole, &around(0.5, 0.0)), None);
        assert_eq!(alike(whole, &around(0.0, 0.0)), None);
    }

    #[test]
    fn a_pattern_that_comes_again_is_not_alike_between() {
        let turned = |i: u32| 0.5 + 0.4 * (f64::from(i) * std::f64::consts::TAU / 120.0).cos();
        let rated: Vec<f64> = (0..240).map(turned).collect();
        let whole = 0..240;
        assert_eq!(alike(std::slice::from_ref(&whole), &rated), None);
    }

    #[test]
    fn rings_may_rule_out_that_the_body_is_upside_down() {
        let (upright, turned) = (0..240, 240..480);
        let families = [upright.clone(), turned.clone()];
        let with = |other: f64| [around(0.93, 0.0), around(other, 0.0)].concat();
        assert_eq!(alike(&families, &with(0.2)), Some(vec![upright]));
        // Rings that are the same from both ends rule out nothing.
        assert_eq!(alike(&families, &with(0.93)), Some(families.to_vec()));
        // Where they agree less the other way, but not by enough, nothing is known.
        assert_eq!(alike(&families, &with(0.85)), None);
        let reversed = [around(0.2, 0.0), around(0.93, 0.0)].concat();
        assert_eq!(alike(&families, &reversed), Some(vec![turned.clone()]));
        assert_eq!(picked(&reversed, &[turned]), around(0.93, 0.0));
    }

    #[test]
    fn of_two_handles_colours_tell_one_from_the_other_or_not() {
        let each = [0..1, 1..2, 2..3];
        assert_eq!(alike(&each, &[0.91, 0.9, 0.3]), Some(vec![0..1, 1..2]));
        assert_eq!(alike(&each[..2], &[0.91, 0.84]), None);
        assert_eq!(alike(&[], &[]), None);
    }
}

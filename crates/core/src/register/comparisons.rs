//! The comparisons of captures with each other: each pair is compared once, and only so many are.

use super::PoseEvidence;
use super::decide::Decision;
use super::limits;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Compares two captures, given by their numbers; `None` where one of them cannot be compared.
pub(super) type Compare<'a> = &'a (dyn Fn(usize, usize) -> Option<Decision> + Sync);

/// What is known of pairs of captures.
pub(super) struct Comparisons<'a> {
    compare: Compare<'a>,
    /// By the numbers of the two captures, in the order in which they were asked for.
    known: BTreeMap<(usize, usize), Decision>,
    /// How many more there may be.
    left: usize,
}

impl<'a> Comparisons<'a> {
    /// None yet, of so many captures.
    pub(super) fn new(compare: Compare<'a>, captures: usize) -> Self {
        Self {
            compare,
            known: BTreeMap::new(),
            left: limits::comparisons(captures),
        }
    }

    /// Compares those of the pairs that were not compared yet, in whichever order; the first of them, if there are too
    /// many.
    pub(super) fn make(&mut self, pairs: &[(usize, usize)]) {
        for &(first, second) in pairs {
            let back = self.known.get(&(second, first)).map(Decision::reversed);
            if let Some(back) = back {
                self.known.entry((first, second)).or_insert(back);
            }
        }
        let is_new = |pair: &&(usize, usize)| !self.known.contains_key(*pair);
        let new: Vec<(usize, usize)> = pairs.iter().filter(is_new).copied().collect();
        let new = &new[..new.len().min(self.left)];
        self.left -= new.len();
        let compare = self.compare;
        let found: Vec<_> = new
            .par_iter()
            .map(|&(first, second)| Some(((first, second), compare(first, second)?)))
            .collect();
        self.known.extend(found.into_iter().flatten());
    }

    /// What was found of a pair, if the evidence holds the second one's pose against the first.
    pub(super) fn held(&self, first: usize, second: usize) -> Option<&Decision> {
        let found = self.known.get(&(first, second))?;
        let is_held = found
            .verdict
            .is_ok_and(|held| held != PoseEvidence::Nothing);
        is_held.then_some(found)
    }

    /// What was found of a pair, if no evidence holds the turn, and the form does not depend on it.
    pub(super) fn unheld(&self, first: usize, second: usize) -> Option<&Decision> {
        let found = self.known.get(&(first, second))?;
        (found.verdict == Ok(PoseEvidence::Nothing)).then_some(found)
    }

    /// Why a capture has no pose against another one, with that one's number: the first of `wanted` that it was
    /// compared with, or else the first of all.
    pub(super) fn refusal(&self, of: usize, wanted: &[usize]) -> Option<(usize, Decision)> {
        let against = |other: usize| {
            let forth = self.known.get(&(other, of)).cloned();
            let found = forth.or_else(|| self.known.get(&(of, other)).map(Decision::reversed))?;
            found.verdict.is_err().then_some((other, found))
        };
        let all = self.known.keys().filter_map(|&(first, second)| {
            let other = if second == of { first } else { second };
            (first == of || second == of).then_some(other)
        });
        wanted.iter().copied().chain(all).find_map(against)
    }
}

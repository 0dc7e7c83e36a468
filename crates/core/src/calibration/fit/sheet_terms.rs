//! Decides which terms of the board's shape are part of the fit: those that predict held-out placements better, and on
//! which both halves of the placements agree. Also decides how the uncertainty of the other terms is stated.

use super::adjust::{Bundle, Loss};
use super::holdout::{Prediction, held_out};
use super::outliers::mild_loss;
use super::result::{FittedShape, HeldOut, ShapeTerm, TermStatus};
use super::sheet::{Mask, TERMS};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

/// Part by which a term has to predict placements better.
const PAYS: f64 = 0.02;
/// Share by which the fit's own residuals must grow without a term before placements are held out to test it.
const MAY_PAY: f64 = 0.005;
/// Standard deviations by which two halves of the placements may differ.
const AGREE: f64 = 3.0;
/// Fewest placements of a half.
const FEWEST_IN_HALF: usize = 3;
/// Fewest placements from which a term can be checked.
pub(super) const FEWEST_TO_CHECK: usize = 2 * FEWEST_IN_HALF;

/// How often placements are held out, and how few views a camera may be left with.
#[derive(Clone, Copy)]
pub(super) struct CrossValidation {
    pub count: usize,
    pub min_views: usize,
}

/// A bundle with the terms that were kept, and how well it predicts.
pub(super) struct TermSelection {
    pub bundle: Bundle,
    pub shape: FittedShape,
    pub held_out: Option<HeldOut>,
    /// Covariance of all columns before the shape's, with the doubt that its terms leave.
    pub covariance: DMatrix<f64>,
}

/// Settles the shape of a bundle that is adjusted with all terms free. If the pattern maps onto itself by a quarter
/// turn, the direction of its rows is unknown, and no term is kept that depends on it. `None` if the equations cannot
/// be solved.
pub(super) fn settled(mut bundle: Bundle, folds: CrossValidation) -> Option<TermSelection> {
    bundle.sheet.variance = bundle.variance();
    let whole = bundle.covariance(Loss::SQUARED)? * bundle.variance();
    let joint = Estimate::of(&bundle, &whole);
    let mut tried = TermCandidate {
        bundle: &bundle,
        folds,
        done: Vec::new(),
    };
    let (wanted, mut untested) = tried.wanted(&joint);
    let (knowable, shown) = (bundle.sheet.knowable(), joint.gaining(PAYS, [true; TERMS]));
    for i in (0..TERMS).filter(|&i| !knowable[i]) {
        untested[i] = shown[i];
    }
    let halves = Halves::of(&bundle);
    let terms: [ShapeTerm; TERMS] = std::array::from_fn(|i| {
        let halves = halves.as_ref().filter(|_| wanted[i]).map(|h| h.of_term(i));
        ShapeTerm {
            value: 0.0,
            deviation: 0.0,
            fate: match (wanted[i], untested[i]) {
                (true, _) if halves.is_some_and(agree) => TermStatus::Kept,
                (false, false) => TermStatus::NotNeeded,
                _ => TermStatus::NotHeld,
            },
            halves,
        }
    });
    let kept = terms.map(|term| term.fate == TermStatus::Kept);
    let (mut settled, prediction) = tried.take(kept);
    settled.sheet.free = kept;
    let covariance = told(&whole, &joint, kept, bundle.shape_column());
    let values = settled.sheet.terms();
    let fitted: [ShapeTerm; TERMS] = std::array::from_fn(|i| ShapeTerm {
        value: if kept[i] { values[i] } else { 0.0 },
        deviation: match kept[i] {
            true => joint.covariance[(i, i)].max(0.0).sqrt(),
            false => joint.possible(i),
        },
        ..terms[i]
    });
    Some(TermSelection {
        bundle: settled,
        shape: told_shape(fitted, knowable),
        held_out: prediction.map(|p| p.held_out),
        covariance,
    })
}

/// The terms as a report has them: of a board whose directions are unknown, both bends are their mean.
fn told_shape([first, second, stretch]: [ShapeTerm; TERMS], knowable: Mask) -> FittedShape {
    if knowable[1] {
        return FittedShape {
            bend: [first, second],
            stretch,
            bends_differ: None,
        };
    }
    let either = ShapeTerm {
        deviation: first.deviation.hypot(second.deviation),
        ..first
    };
    FittedShape {
        bend: [either; 2],
        stretch,
        bends_differ: Some(second.fate),
    }
}

/// What all placements say of the shape.
#[derive(Clone, Copy)]
struct Estimate {
    terms: Vector3<f64>,
    covariance: Matrix3<f64>,
    /// Coordinates that were seen.
    coordinates: f64,
}

impl Estimate {
    fn of(bundle: &Bundle, covariance: &DMatrix<f64>) -> Self {
        let first = bundle.shape_column();
        let corners: usize = bundle.views.iter().map(|v| v.points.len()).sum();
        Self {
            terms: bundle.sheet.terms().into(),
            covariance: covariance.fixed_view::<3, 3>(first, first).into_owned(),
            coordinates: 2.0 * corners as f64,
        }
    }

    /// The part by which residuals grow, in first order, if this term alone becomes 0.
    fn gain(&self, term: usize) -> f64 {
        let squared = self.terms[term].powi(2) / self.covariance[(term, term)].max(1e-300);
        1.0 - (1.0 + squared / self.coordinates).sqrt().recip()
    }

    /// The other terms once this one is 0.
    fn without(&self, term: usize) -> Self {
        let column = self.covariance.column(term).into_owned();
        let variance = self.covariance[(term, term)].max(1e-300);
        Self {
            terms: self.terms - column * (self.terms[term] / variance),
            covariance: self.covariance - column * column.transpose() / variance,
            ..*self
        }
    }

    /// How large a term may be that is taken for 0.
    fn possible(&self, term: usize) -> f64 {
        let variance = self.covariance[(term, term)].max(0.0);
        (variance + self.terms[term].powi(2)).sqrt()
    }

    /// The terms, of those that may be kept, without which residuals grow by `least` or more. The smallest of the
    /// others is dropped first, because it may express the same shape as a term that is kept.
    fn gaining(&self, least: f64, may_be_kept: Mask) -> Mask {
        let (mut rest, mut mask) = (*self, may_be_kept);
        for term in (0..TERMS).filter(|&i| !may_be_kept[i]) {
            rest = rest.without(term);
        }
        loop {
            let left = (0..TERMS).filter(|&i| mask[i]);
            let weakest = left.min_by(|&a, &b| rest.gain(a).total_cmp(&rest.gain(b)));
            match weakest.filter(|&i| rest.gain(i) < least) {
                Some(term) => {
                    mask[term] = false;
                    rest = rest.without(term);
                }
                None => return mask,
            }
        }
    }
}

/// Bundles that were adjusted with some of the terms, and how well they predict.
struct TermCandidate<'a> {
    bundle: &'a Bundle,
    folds: CrossValidation,
    done: Vec<(Mask, Bundle, Option<Prediction>)>,
}

impl TermCandidate<'_> {
    /// The terms that predict placements better, and those for which this cannot be tested although the residuals
    /// shrink.
    fn wanted(&mut self, joint: &Estimate) -> (Mask, Mask) {
        let knowable = self.bundle.sheet.knowable();
        if self.folds.count < 2 {
            return (joint.gaining(PAYS, knowable), [false; TERMS]);
        }
        let mut mask = joint.gaining(MAY_PAY, knowable);
        while mask.contains(&true) {
            let Some(with) = self.predicted(mask) else {
                return ([false; TERMS], joint.gaining(PAYS, knowable));
            };
            let without = |term: usize| {
                let mut less = mask;
                less[term] = false;
                less
            };
            let terms: Vec<usize> = (0..TERMS).filter(|&i| mask[i]).collect();
            let mut gains = Vec::new();
            for term in terms {
                let others = self.predicted(without(term)).unwrap_or(with);
                gains.push((1.0 - with / others.max(1e-12), term));
            }
            match gains.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)) {
                Some((gain, term)) if gain < PAYS => mask = without(term),
                _ => break,
            }
        }
        (mask, [false; TERMS])
    }

    /// How well placements are predicted with these terms; `None` where too little is left to tell.
    fn predicted(&mut self, mask: Mask) -> Option<f64> {
        if let Some((_, _, prediction)) = self.done.iter().find(|done| done.0 == mask) {
            return prediction.as_ref().map(|p| p.weighted_px);
        }
        let bundle = with_terms(self.bundle, mask);
        let prediction = held_out(&bundle, self.folds.count, self.folds.min_views);
        let weighted_px = prediction.as_ref().map(|p| p.weighted_px);
        self.done.push((mask, bundle, prediction));
        weighted_px
    }

    /// The bundle with these terms, and how well it predicts.
    fn take(mut self, mask: Mask) -> (Bundle, Option<Prediction>) {
        self.predicted(mask);
        let found = self.done.into_iter().find(|done| done.0 == mask);
        found.map_or_else(
            || (with_terms(self.bundle, mask), None),
            |(_, bundle, prediction)| (bundle, prediction),
        )
    }
}

/// The bundle with these terms alone, adjusted.
fn with_terms(bundle: &Bundle, mask: Mask) -> Bundle {
    let mut bundle = bundle.clone();
    if mask == [true; TERMS] {
        return bundle;
    }
    let terms = bundle.sheet.terms();
    let left = std::array::from_fn(|i| if mask[i] { terms[i] } else { 0.0 });
    bundle.sheet.set_terms(left);
    bundle.sheet.free = mask;
    bundle.adjust(mild_loss(&bundle), 30);
    bundle
}

/// What each half of the placements says of the shape, the cameras being as all placements say.
struct Halves {
    estimates: [(Vector3<f64>, Vector3<f64>); 2],
}

impl Halves {
    /// `None` where there are too few placements.
    fn of(bundle: &Bundle) -> Option<Self> {
        let used =
            (0..bundle.placements.len()).filter(|&p| bundle.views.iter().any(|v| v.placement == p));
        let all: Vec<_> = used.filter_map(|p| bundle.speaks_of_shape(p)).collect();
        let half = all.len() / 2;
        if half < FEWEST_IN_HALF {
            return None;
        }
        let terms = Vector3::from(bundle.sheet.terms());
        let estimate = |part: &[(Matrix3<f64>, Vector3<f64>)]| {
            half_estimate(part, bundle.variance())
                .map(|(step, deviation)| (terms + step, deviation))
        };
        Some(Self {
            estimates: [estimate(&all[..half])?, estimate(&all[half..])?],
        })
    }

    fn of_term(&self, term: usize) -> [[f64; 2]; 2] {
        let of =
            |(terms, deviations): (Vector3<f64>, Vector3<f64>)| [terms[term], deviations[term]];
        self.estimates.map(of)
    }
}

/// By how much these placements would change the terms, and with which deviations: what their number and noise let
/// expect, or, where that is more, what they differ among themselves.
fn half_estimate(
    placements: &[(Matrix3<f64>, Vector3<f64>)],
    variance: f64,
) -> Option<(Vector3<f64>, Vector3<f64>)> {
    let information: Matrix3<f64> = placements.iter().map(|(a, _)| a).sum();
    let gradient: Vector3<f64> = placements.iter().map(|(_, g)| g).sum();
    let inverse = information.try_inverse()?;
    let step = -inverse * gradient;
    let scores = placements.iter().map(|(a, g)| g + a * step);
    let scatter: Matrix3<f64> = scores.map(|u| u * u.transpose()).sum();
    let count = placements.len() as f64;
    let differing = inverse * scatter * inverse * (count / (count - 1.0));
    let deviation = |i: usize| {
        f64::max(inverse[(i, i)] * variance, differing[(i, i)])
            .max(0.0)
            .sqrt()
    };
    Some((step, Vector3::from_fn(|i, _| deviation(i))))
}

/// Whether two halves' estimates differ by no more than their deviations let expect.
fn agree([[first, a], [last, b]]: [[f64; 2]; 2]) -> bool {
    (first - last).abs() <= AGREE * a.hypot(b)
}

/// Covariance of cameras and back with the dropped terms fixed at 0, plus the error if those terms are not 0.
fn told(whole: &DMatrix<f64>, joint: &Estimate, kept: Mask, columns: usize) -> DMatrix<f64> {
    let out: Vec<usize> = (0..TERMS).filter(|&i| !kept[i]).collect();
    let block = whole.view((0, 0), (columns, columns)).into_owned();
    let coupling = DMatrix::from_fn(columns, out.len(), |i, k| whole[(i, columns + out[k])]);
    let terms = DMatrix::from_fn(out.len(), out.len(), |i, k| {
        joint.covariance[(out[i], out[k])]
    });
    let Some(inverse) = terms.try_inverse() else {
        return block;
    };
    // How the columns follow the terms, once these are fixed.
    let follow = &coupling * inverse;
    let possible = out.iter().map(|&i| joint.possible(i).powi(2)).collect();
    let doubt = DMatrix::from_diagonal(&DVector::from_vec(possible));
    block - &follow * coupling.transpose() + &follow * doubt * follow.transpose()
}

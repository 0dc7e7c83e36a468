//! Measures how well a fit predicts views that it was not given, by leaving out placements in turn.

use super::adjust::{Bundle, Observation};
use super::outliers::{mild_loss, placed};
use super::result::{Figures, HeldOut};
use rayon::prelude::*;

/// How well placements are predicted that a fit did not see.
pub(super) struct Prediction {
    pub held_out: HeldOut,
    /// Root mean square of their residuals, each weighted as its view is.
    pub weighted_px: f64,
}

/// Fits `folds` times without every `folds`-th placement and looks at the placements left out: only the board's pose
/// is fitted to them. `None` where too little would be left to fit from.
pub(super) fn held_out(bundle: &Bundle, folds: usize, min_views: usize) -> Option<Prediction> {
    let used: Vec<usize> = (0..bundle.placements.len())
        .filter(|&p| bundle.placements[p].free && bundle.views.iter().any(|v| v.placement == p))
        .collect();
    let folds = folds.min(used.len());
    if folds < 2 {
        return None;
    }
    let fold = |fold: usize| {
        let out: Vec<usize> = used.iter().copied().skip(fold).step_by(folds).collect();
        of_fold(bundle, &out, min_views)
    };
    let done: Vec<_> = (0..folds).into_par_iter().map(fold).collect();
    let done: Vec<Fold> = done.into_iter().flatten().collect();
    let predicted = Figures::of(done.iter().flat_map(|fold| &fold.predicted).copied());
    let fitted = Figures::of(done.iter().flat_map(|fold| &fold.fitted).copied());
    let sum = |of: fn(&Fold) -> f64| done.iter().map(of).sum::<f64>();
    (predicted.corners > 0).then(|| Prediction {
        held_out: HeldOut {
            figures: predicted,
            ratio: predicted.rms_px / fitted.rms_px.max(1e-12),
            folds: done.len(),
        },
        weighted_px: (sum(|f| f.squares) / sum(|f| f.weights).max(1e-12)).sqrt(),
    })
}

/// Residuals, in pixels, of the placements that one fit did not see.
#[derive(Default)]
struct Fold {
    predicted: Vec<f64>,
    /// Those that the same corners have in the whole fit.
    fitted: Vec<f64>,
    /// Sums over the predicted ones, weighted as their views are: of squares, and of weights.
    squares: f64,
    weights: f64,
}

/// A fit without the placements of `out`, and what it says of them.
fn of_fold(bundle: &Bundle, out: &[usize], min_views: usize) -> Option<Fold> {
    let mut rest = bundle.clone();
    rest.retain_views(|_, view| !out.contains(&view.placement));
    let views = |c: usize| rest.views.iter().filter(|v| v.camera == c).count();
    let enough = |c: usize| {
        let seen = bundle.views.iter().any(|v| v.camera == c);
        !seen || views(c) >= min_views || bundle.cameras[c].free.iter().all(|free| !free)
    };
    if !(0..bundle.cameras.len()).all(enough) || !is_connected(&rest) {
        return None;
    }
    rest.adjust(mild_loss(&rest), 15);
    let mut fold = Fold::default();
    for &placement in out {
        let views: Vec<_> = bundle
            .views
            .iter()
            .filter(|v| v.placement == placement)
            .cloned()
            .collect();
        let of = |b: &Bundle, v: &Observation| {
            b.residuals(v)
                .into_iter()
                .flatten()
                .map(|r| r.norm())
                .collect::<Vec<_>>()
        };
        fold.fitted.extend(views.iter().flat_map(|v| of(bundle, v)));
        let alone = placed(&rest, placement, views);
        for view in &alone.views {
            let lengths = of(&alone, view);
            fold.squares += view.weight * lengths.iter().map(|l| l * l).sum::<f64>();
            fold.weights += view.weight * lengths.len() as f64;
            fold.predicted.extend(lengths);
        }
    }
    Some(fold)
}

/// Whether all cameras that see anything are joined through placements.
pub(super) fn is_connected(bundle: &Bundle) -> bool {
    let seen: Vec<usize> = (0..bundle.cameras.len())
        .filter(|&c| bundle.views.iter().any(|v| v.camera == c))
        .collect();
    let Some(&first) = seen.first() else {
        return false;
    };
    let mut cameras = vec![first];
    let mut placements: Vec<usize> = Vec::new();
    loop {
        let before = (cameras.len(), placements.len());
        for view in &bundle.views {
            let (c, p) = (
                cameras.contains(&view.camera),
                placements.contains(&view.placement),
            );
            if c && !p {
                placements.push(view.placement);
            } else if p && !c {
                cameras.push(view.camera);
            }
        }
        if before == (cameras.len(), placements.len()) {
            return cameras.len() == seen.len();
        }
    }
}

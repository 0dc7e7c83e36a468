//! Measures how well a fit predicts views that it was not given, by leaving out placements in turn.

use super::adjust::{Bundle, Observation};
use super::outliers::{mild_loss, placed};
use super::result::{Figures, HeldOut};
use rayon::prelude::*;

/// Fits `folds` times without every `folds`-th placement and looks at the placements left out: only the board's pose
/// is fitted to them. `None` where too little would be left to fit from.
pub(super) fn held_out(bundle: &Bundle, folds: usize, min_views: usize) -> Option<HeldOut> {
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
    let done: Vec<(Vec<f64>, Vec<f64>)> = done.into_iter().flatten().collect();
    let predicted = Figures::of(done.iter().flat_map(|(held, _)| held).copied());
    let fitted = Figures::of(done.iter().flat_map(|(_, fitted)| fitted).copied());
    (predicted.corners > 0).then(|| HeldOut {
        figures: predicted,
        ratio: predicted.rms_px / fitted.rms_px.max(1e-12),
        folds: done.len(),
    })
}

/// Residuals of the placements that are held out, and those that they have in the whole fit.
fn of_fold(bundle: &Bundle, out: &[usize], min_views: usize) -> Option<(Vec<f64>, Vec<f64>)> {
    let mut rest = bundle.clone();
    rest.retain_views(|_, view| !out.contains(&view.placement));
    let views = |c: usize| rest.views.iter().filter(|v| v.camera == c).count();
    let enough = |c: usize| {
        let seen = bundle.views.iter().any(|v| v.camera == c);
        !seen || views(c) >= min_views || bundle.cameras[c].free.iter().all(|free| !free)
    };
    if !(0..bundle.cameras.len()).all(enough) || !hangs_together(&rest) {
        return None;
    }
    rest.adjust(mild_loss(&rest), 15);
    let (mut predicted, mut fitted) = (Vec::new(), Vec::new());
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
        fitted.extend(views.iter().flat_map(|v| of(bundle, v)));
        let alone = placed(&rest, placement, views);
        predicted.extend(alone.views.iter().flat_map(|v| of(&alone, v)));
    }
    Some((predicted, fitted))
}

/// Whether all cameras that see anything are joined through placements.
pub(super) fn hangs_together(bundle: &Bundle) -> bool {
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

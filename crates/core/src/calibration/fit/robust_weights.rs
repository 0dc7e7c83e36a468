//! Weights each view by its residuals: a view whose corners are three times as exact counts nine times as much, and its
//! stated uncertainty follows from its own residuals.

use super::adjust::{Bundle, Observation};
use super::outliers::mild_loss;

/// Times that weights and residuals are made to agree.
const ROUNDS: usize = 3;
/// Weight, in coordinates, of the camera's pooled variance in the estimate of a view's variance.
const OF_CAMERA: f64 = 40.0;
/// Smallest and largest deviation of a view over that of all.
const RANGE: [f64; 2] = [0.1, 10.0];

/// Squares of residuals, and the degrees of freedom that they have.
#[derive(Clone, Copy, Default)]
struct Spread {
    squares: f64,
    freedom: f64,
}

impl Bundle {
    /// Adjusts with every view weighted by what its residuals turn out to be.
    pub(super) fn adjust_weighted(&mut self) {
        self.adjust(mild_loss(self), 30);
        for _ in 0..ROUNDS {
            self.weigh();
            self.adjust(mild_loss(self), 30);
        }
    }

    fn weigh(&mut self) {
        let spreads: Vec<Spread> = self.views.iter().map(|view| self.spread(view)).collect();
        let mut of_cameras = vec![Spread::default(); self.cameras.len()];
        let mut of_all = Spread::default();
        for (view, spread) in self.views.iter().zip(&spreads) {
            for sum in [&mut of_cameras[view.camera], &mut of_all] {
                sum.squares += spread.squares;
                sum.freedom += spread.freedom;
            }
        }
        let variance = |s: &Spread| s.squares / s.freedom.max(1.0);
        let mean = variance(&of_all).max(1e-12);
        let [least, most] = RANGE.map(|part| mean * part * part);
        for (view, own) in self.views.iter_mut().zip(&spreads) {
            let squares = own.squares + OF_CAMERA * variance(&of_cameras[view.camera]);
            let found = squares / (own.freedom.max(0.0) + OF_CAMERA);
            view.weight = mean / found.clamp(least, most);
        }
    }

    /// A view's residuals; the parameters of its camera and of its placement are fitted to it as far as it counts among
    /// their views.
    fn spread(&self, view: &Observation) -> Spread {
        let counts = |v: &Observation| v.weight * v.points.len() as f64;
        let part = |belongs: &dyn Fn(&Observation) -> bool| {
            let all = self.views.iter().filter(|v| belongs(v));
            counts(view) / all.map(counts).sum::<f64>()
        };
        let state = &self.cameras[view.camera];
        let lens = state.free.iter().filter(|free| **free).count();
        let pose = |is_free: bool| if is_free { 6.0 } else { 0.0 };
        let of_camera = lens as f64 + pose(state.pose_free);
        let of_placement = pose(self.placements[view.placement].free);
        let fitted = of_camera * part(&|v| v.camera == view.camera)
            + of_placement * part(&|v| v.placement == view.placement);
        let residuals = self.residuals(view);
        Spread {
            squares: residuals.iter().flatten().map(|r| r.norm_squared()).sum(),
            freedom: 2.0 * residuals.len() as f64 - fitted,
        }
    }

    /// Variance of a coordinate's residual in a view that counts once, as the fit leaves it.
    pub(super) fn variance(&self) -> f64 {
        let coordinates = 2 * self.views.iter().map(|v| v.points.len()).sum::<usize>();
        let squares = self.views.iter().map(|view| {
            let residuals = self.residuals(view).into_iter().flatten();
            view.weight * residuals.map(|r| r.norm_squared()).sum::<f64>()
        });
        let freedom = coordinates.saturating_sub(self.free_parameters()).max(1);
        squares.sum::<f64>() / freedom as f64
    }
}

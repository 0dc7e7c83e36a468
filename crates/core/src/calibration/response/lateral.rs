//! Decides how much of a lateral scale s(z) = s₀ + s₁·z the boards support: a term is kept only if held-out boards are
//! predicted better with it; otherwise the scale is a constant, or 1.

use super::jackknife::{BoardEquations, NormalEquations};

/// What of the lateral scale is fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Lateral {
    /// Nothing: it is 1.
    One,
    /// A constant.
    Constant,
    /// A line in the distance.
    Line,
}

/// By how much the squared errors of boards that were held out must fall, in units of their noise: one standard
/// deviation, for a prediction of what was not seen owes nothing to chance but its noise.
const PAYS: f64 = 1.0;

impl Lateral {
    /// Whether the constant and the change a metre are free.
    pub(super) fn is_free(self) -> [bool; 2] {
        match self {
            Self::One => [false, false],
            Self::Constant => [true, false],
            Self::Line => [true, true],
        }
    }

    /// What was fitted to come to these values.
    pub(super) fn of([constant, change]: [f64; 2]) -> Self {
        // Values that were held are what they were held at but for rounding.
        match ((constant - 1.0).abs() > 1e-12, change.abs() > 1e-12) {
            (_, true) => Self::Line,
            (true, false) => Self::Constant,
            (false, false) => Self::One,
        }
    }
}

/// The models from the one that is borne out to the simplest. `normals` are about the values of the line, and `prior`
/// says what of them is held.
pub(super) fn in_order_of_merit(
    normals: &BoardEquations,
    prior: impl Fn(Lateral) -> NormalEquations,
) -> Vec<Lateral> {
    let cost = |lateral: Lateral| held_out(normals, &prior(lateral));
    let [one, constant, line] = [Lateral::One, Lateral::Constant, Lateral::Line].map(cost);
    if line < constant.min(one) - PAYS {
        vec![Lateral::Line, Lateral::Constant, Lateral::One]
    } else if constant < one - PAYS {
        vec![Lateral::Constant, Lateral::One]
    } else {
        vec![Lateral::One]
    }
}

/// The sum of squared errors of boards, each predicted from the others.
fn held_out(normals: &BoardEquations, prior: &NormalEquations) -> f64 {
    let boards = normals.of_boards.iter();
    let all = boards.fold(*prior, |all, own| (all.0 + own.0, all.1 + own.1));
    let of_board = |(own, squares): (&NormalEquations, &f64)| {
        let Some(solved) = (all.0 - own.0).cholesky() else {
            return f64::INFINITY;
        };
        let step = -solved.solve(&(all.1 - own.1));
        squares + 2.0 * own.1.dot(&step) + step.dot(&(own.0 * step))
    };
    normals
        .of_boards
        .iter()
        .zip(&normals.squares)
        .map(of_board)
        .sum()
}

//! Estimates how far a response may be off: each board in turn is left out, and the differences between the fitted
//! responses give the error (the jackknife; Efron and Stein, "The jackknife estimate of variance", 1981). All pixels of
//! a board share the error of its pose, so many pixels do not make the error smaller.

use nalgebra::{Matrix4, Vector4};

/// Normal equations about the values that were found: matrix and gradient.
pub(super) type NormalEquations = (Matrix4<f64>, Vector4<f64>);

/// What was fitted from.
pub(super) struct BoardEquations {
    /// All that was known.
    pub all: NormalEquations,
    /// Each board's part of it.
    pub of_boards: Vec<NormalEquations>,
    /// The sum of each board's weighted squared errors.
    pub squares: Vec<f64>,
}

/// Standard deviation of the slope, in metres a unit; `None` from fewer than two boards.
pub(super) fn slope_deviation(normals: &BoardEquations) -> Option<f64> {
    let of_boards = normals.of_boards.iter();
    let steps: Vec<f64> = of_boards
        .filter_map(|own| Some(step_without(normals, own)?[0]))
        .collect();
    let count = steps.len() as f64;
    let mean = steps.iter().sum::<f64>() / count;
    let squares: f64 = steps.iter().map(|step| (step - mean).powi(2)).sum();
    (steps.len() >= 2).then(|| ((count - 1.0) / count * squares).sqrt())
}

/// Standard deviation of the depth that the line gives to these readings, the larger one, in metres; infinite from
/// fewer than two boards, with which nothing can be compared.
pub(super) fn deviation(normals: &BoardEquations, readings: [f64; 2]) -> f64 {
    let without = normals
        .of_boards
        .iter()
        .map(|own| step_without(normals, own));
    let steps: Vec<Vector4<f64>> = without.flatten().collect();
    let count = steps.len() as f64;
    if steps.len() < 2 {
        return f64::INFINITY;
    }
    let of_reading = |reading: f64| {
        let moved = |step: &Vector4<f64>| step[0] * reading + step[1];
        let mean = steps.iter().map(moved).sum::<f64>() / count;
        let squares: f64 = steps.iter().map(|s| (moved(s) - mean).powi(2)).sum();
        ((count - 1.0) / count * squares).sqrt()
    };
    readings.map(of_reading).into_iter().fold(0.0, f64::max)
}

/// By how much the values change where a board is left out; `None` where nothing would be left.
fn step_without(normals: &BoardEquations, own: &NormalEquations) -> Option<Vector4<f64>> {
    let (matrix, gradient) = (normals.all.0 - own.0, normals.all.1 - own.1);
    Some(-matrix.cholesky()?.solve(&gradient))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Boards that each say where one reading lies, off by so much.
    fn boards(errors: &[f64]) -> BoardEquations {
        let board = |(k, error): (usize, &f64)| {
            let by = Vector4::new(k as f64 / errors.len() as f64, 1.0, 0.0, 0.0);
            (by * by.transpose() * 1e6, by * (*error * 1e6))
        };
        let of_boards: Vec<NormalEquations> = errors.iter().enumerate().map(board).collect();
        let expected = (Matrix4::from_diagonal_element(1e-3), Vector4::zeros());
        let all = of_boards
            .iter()
            .fold(expected, |all, own| (all.0 + own.0, all.1 + own.1));
        // About the values that solve them.
        let found = all.0.cholesky().unwrap().solve(&all.1);
        let about = |normal: &NormalEquations| (normal.0, normal.1 - normal.0 * found);
        BoardEquations {
            of_boards: of_boards.iter().map(about).collect(),
            all: about(&all),
            squares: vec![0.0; errors.len()],
        }
    }

    #[test]
    fn boards_that_differ_are_doubted_by_as_much_and_those_that_agree_are_not() {
        let alternating: Vec<f64> = (0..20)
            .map(|k| if k % 2 == 0 { 1e-3 } else { -1e-3 })
            .collect();
        // A line through 20 readings that are 1 mm off knows its ends to twice 1 mm over the root of 20.
        let found = deviation(&boards(&alternating), [0.0, 1.0]);
        assert!((0.35e-3..0.6e-3).contains(&found), "{found}");
        assert!(deviation(&boards(&[2e-4; 20]), [0.0, 1.0]) < 1e-9);
    }

    #[test]
    fn of_a_single_board_no_error_is_known() {
        let one = deviation(&boards(&[1e-3]), [0.0, 1.0]);
        assert_eq!(one, f64::INFINITY);
    }
}

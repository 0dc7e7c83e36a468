//! Fits polynomials to measurements by least squares.

use nalgebra::{DMatrix, DVector};

/// A polynomial c₀ + c₁·x + … with how well it fits.
#[derive(Clone, Debug, PartialEq)]
pub struct Polynomial {
    /// Coefficients, the constant first.
    pub coefficients: Vec<f64>,
    /// Coefficient of determination R²: 1 less the part of the variance that is left.
    pub r_squared: f64,
}

impl Polynomial {
    /// Fits a polynomial of a degree; `None` where there are fewer points than coefficients or they do not say enough.
    pub fn fit(x: &[f64], y: &[f64], degree: usize) -> Option<Self> {
        let count = x.len().min(y.len());
        if count <= degree {
            return None;
        }
        // In units of the largest |x|, so that high powers lose no digits.
        let unit = x.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        if unit == 0.0 || !unit.is_finite() {
            return None;
        }
        let powers = DMatrix::from_fn(count, degree + 1, |i, k| (x[i] / unit).powi(k as i32));
        let values = DVector::from_fn(count, |i, _| y[i]);
        let solution = powers.svd(true, true).solve(&values, 1e-10).ok()?;
        let scaled = solution.iter().enumerate();
        let mut polynomial = Self {
            coefficients: scaled.map(|(k, c)| c / unit.powi(k as i32)).collect(),
            r_squared: 0.0,
        };
        let all_finite = polynomial.coefficients.iter().all(|c| c.is_finite());
        polynomial.r_squared = polynomial.determination(&x[..count], &y[..count]);
        all_finite.then_some(polynomial)
    }

    /// Its value.
    pub fn at(&self, x: f64) -> f64 {
        self.coefficients
            .iter()
            .rev()
            .fold(0.0, |sum, c| sum * x + c)
    }

    fn determination(&self, x: &[f64], y: &[f64]) -> f64 {
        let mean = y.iter().sum::<f64>() / y.len() as f64;
        let total: f64 = y.iter().map(|v| (v - mean).powi(2)).sum();
        let left: f64 = x
            .iter()
            .zip(y)
            .map(|(&x, y)| (y - self.at(x)).powi(2))
            .sum();
        if total > 0.0 { 1.0 - left / total } else { 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_polynomial_is_found_again() {
        let x: Vec<f64> = (0..9).map(|k| 0.7 + 0.1 * f64::from(k)).collect();
        let y: Vec<f64> = x.iter().map(|x| 1.0 - 2.0 * x + 0.5 * x.powi(4)).collect();
        let found = Polynomial::fit(&x, &y, 4).unwrap();
        for (c, expected) in found.coefficients.iter().zip([1.0, -2.0, 0.0, 0.0, 0.5]) {
            assert!((c - expected).abs() < 1e-8, "{:?}", found.coefficients);
        }
        assert!((found.r_squared - 1.0).abs() < 1e-12);
        assert!(Polynomial::fit(&x[..4], &y, 4).is_none());
        assert!(Polynomial::fit(&[0.0, 0.0], &[1.0, 2.0], 1).is_none());
    }
}

//! The paper's linearisation (section 3): a straight line from the distance to the measured depth, and a quartic that
//! compensates the measured width of a target, each with its R².

use super::polynomial::Polynomial;
use super::{DepthTable, ResponseError, too_little};
use crate::calibration::DepthResponse;

/// What section 3 of the paper finds in a table.
#[derive(Clone, Debug, PartialEq)]
pub struct PaperFit {
    /// A straight line from the distance to the reading: the paper's DL.
    pub depth: Polynomial,
    /// The fit of the widths, if the table has them.
    pub scale: Option<ScaleFit>,
    /// Smallest and largest distance of the table, in metres; the fit is not valid beyond them.
    pub range: [f64; 2],
    /// Largest difference between a distance and the distance that the line gives for its reading, in metres.
    pub largest_error: f64,
}

/// The paper's compensation of the lateral scale.
#[derive(Clone, Debug, PartialEq)]
pub struct ScaleFit {
    /// Measured width W over distance, a line: the paper's L.
    pub line: Polynomial,
    /// The relative error (L − W) / W at each row: the paper's E.
    pub errors: Vec<f64>,
    /// A quartic through L − W: the paper's P. A corrected width is W + P.
    pub compensation: Polynomial,
}

impl PaperFit {
    /// Fits a table.
    ///
    /// # Errors
    /// If it has fewer than 3 rows, or 5 with widths, or all distances or readings are the same.
    pub fn of(table: &DepthTable) -> Result<Self, ResponseError> {
        let [distance, depth, width] = table.columns();
        let rows = || format!("{} rows", distance.len());
        let line = Polynomial::fit(&distance, &depth, 1).filter(|_| distance.len() >= 3);
        let Some(depth_line) = line else {
            return too_little(rows(), "3 or more at different distances");
        };
        let slope = depth_line.coefficients[1];
        let follows = slope.abs() >= 1e-9 && depth_line.r_squared > 0.5;
        if !follows {
            let found = format!(
                "a depth that does not follow the distance (slope {slope:.3e} a metre, R² {:.3})",
                depth_line.r_squared
            );
            return too_little(found, "readings that change with the distance");
        }
        let scale = match width.iter().any(|w| w.is_nan()) {
            true => None,
            false => Some(ScaleFit::of(&distance, &width)?),
        };
        let bound = |pick: fn(f64, f64) -> f64, start| distance.iter().copied().fold(start, pick);
        let inverted = |reading: f64| (reading - depth_line.coefficients[0]) / slope;
        let errors = distance
            .iter()
            .zip(&depth)
            .map(|(d, &r)| (inverted(r) - d).abs());
        Ok(Self {
            largest_error: errors.fold(0.0, f64::max),
            range: [bound(f64::min, f64::MAX), bound(f64::max, 0.0)],
            depth: depth_line,
            scale,
        })
    }

    /// The width W of the table, corrected as the paper does: W + P.
    ///
    /// # Errors
    /// Outside the fitted range, where a quartic may be anything, or if the table has no widths.
    pub fn corrected_width(&self, distance: f64, width: f64) -> Result<f64, ResponseError> {
        let Some(scale) = &self.scale else {
            return too_little("a table without widths".into(), "a width in each row");
        };
        if !(self.range[0]..=self.range[1]).contains(&distance) {
            return Err(ResponseError::OutsideRange {
                distance,
                range: self.range,
            });
        }
        Ok(width + scale.compensation.at(distance))
    }

    /// The line as a response in metres, from the smallest to the largest distance of the table. The widths are not
    /// used: the lens explains that an object seems smaller from farther away.
    ///
    /// # Errors
    /// If no real sensor would give this line.
    pub fn response(&self) -> Result<DepthResponse, ResponseError> {
        let [at_zero, slope] = [0, 1].map(|k| self.depth.coefficients[k]);
        let response = DepthResponse {
            slope: 1.0 / slope,
            intercept: -at_zero / slope,
            range: Some(self.range),
            uncertainty: self.largest_error,
            ..DepthResponse::default()
        };
        Ok(response.checked()?)
    }
}

impl ScaleFit {
    fn of(distance: &[f64], width: &[f64]) -> Result<Self, ResponseError> {
        let line = Polynomial::fit(distance, width, 1);
        let scale = line.and_then(|line| {
            let differences: Vec<f64> = distance
                .iter()
                .zip(width)
                .map(|(&d, w)| line.at(d) - w)
                .collect();
            let compensation = Polynomial::fit(distance, &differences, 4)?;
            let errors = differences.iter().zip(width).map(|(e, w)| e / w).collect();
            Some(Self {
                line,
                errors,
                compensation,
            })
        });
        let rows = format!("{} rows with widths", distance.len());
        scale.map_or_else(|| too_little(rows, "5 or more at different distances"), Ok)
    }
}

#[cfg(test)]
mod tests {
    use super::super::Measurement;
    use super::*;

    const DISTANCE: [f64; 7] = [0.9, 1.8, 2.7, 3.6, 4.5, 5.4, 6.3];
    const DEPTH: [f64; 7] = [231.0, 208.0, 184.0, 161.0, 136.0, 113.0, 90.0];
    const WIDTH: [f64; 7] = [152.67, 76.8, 54.0, 40.2, 30.5, 22.0, 20.0];
    /// The paper's errors E.
    const PRINTED_ERRORS: [f64; 7] = [
        -0.256383, 0.23119792, 0.3997037, 0.40825871, 0.23409836, -0.1514545, -1.0152,
    ];
    /// Slope of L as the paper prints it, a misprint, and as its errors prove it to be.
    const MISPRINTED_SLOPE: f64 = -21.68;
    const PROVEN_SLOPE: f64 = -21.08;
    const PRINTED_CONSTANT: f64 = 132.5;

    fn papers_table() -> PaperFit {
        let rows = (0..7).map(|k| Measurement {
            distance: DISTANCE[k],
            depth: DEPTH[k],
            width: WIDTH[k],
        });
        PaperFit::of(&DepthTable {
            rows: rows.collect(),
        })
        .unwrap()
    }

    fn assert_near(found: f64, expected: f64) {
        assert!(
            (found - expected).abs() < 1e-6,
            "{found}, expected {expected}"
        );
    }

    #[test]
    fn the_papers_table_1_depth_is_a_line_as_printed() {
        let fit = papers_table();
        assert_near(fit.depth.coefficients[1], -26.230159);
        assert_near(fit.depth.coefficients[0], 254.857143);
        assert_near(fit.depth.r_squared, 0.999911);
        // As printed: -26.23 D + 254.9, R² 0.9999.
        assert!((fit.depth.coefficients[1] + 26.23).abs() < 0.005);
        assert!((fit.depth.coefficients[0] - 254.9).abs() < 0.05);
    }

    #[test]
    fn the_papers_table_2_the_widths_slope_is_a_misprint_of_21_08() {
        let scale = papers_table().scale.unwrap();
        assert_near(scale.line.coefficients[1], -21.075794);
        assert_near(scale.line.coefficients[0], 132.468571);
        assert_near(scale.line.r_squared, 0.767200);
        assert!((scale.line.coefficients[1] - PROVEN_SLOPE).abs() < 0.005);
        assert!((scale.line.coefficients[1] - MISPRINTED_SLOPE).abs() > 0.5);
    }

    #[test]
    fn the_papers_table_3_errors_are_relative_and_prove_the_slope() {
        let error =
            |slope: f64, k: usize| (slope * DISTANCE[k] + PRINTED_CONSTANT - WIDTH[k]) / WIDTH[k];
        let worst = |slope: f64| {
            (0..7)
                .map(|k| (error(slope, k) - PRINTED_ERRORS[k]).abs())
                .fold(0.0, f64::max)
        };
        assert!(worst(PROVEN_SLOPE) < 1e-6, "{}", worst(PROVEN_SLOPE));
        assert!(worst(MISPRINTED_SLOPE) > 0.01);
        // Ours are the same but for the two digits that the paper gives its line.
        let ours = papers_table().scale.unwrap().errors;
        for (k, (e, printed)) in ours.iter().zip(PRINTED_ERRORS).enumerate() {
            assert!(
                (e - printed).abs() < 0.04 / WIDTH[k] + 1e-6,
                "{e} {printed}"
            );
        }
    }

    #[test]
    fn the_papers_table_4_the_quartic_was_made_with_the_misprint() {
        let misprinted = |slope: f64| {
            let left: Vec<f64> = (0..7)
                .map(|k| slope * DISTANCE[k] + PRINTED_CONSTANT - WIDTH[k])
                .collect();
            Polynomial::fit(&DISTANCE, &left, 4).unwrap()
        };
        let p = misprinted(MISPRINTED_SLOPE);
        let recomputed = [-183.678571, 230.584879, -90.453189, 14.717511, -0.878181];
        for (c, expected) in p.coefficients.iter().zip(recomputed) {
            assert_near(*c, expected);
        }
        assert_near(p.r_squared, 0.995611);
        assert_near(misprinted(PROVEN_SLOPE).coefficients[1], 231.184879);
    }

    #[test]
    fn the_papers_table_5_the_corrected_widths_do_not_depend_on_the_slope() {
        let direct = Polynomial::fit(&DISTANCE, &WIDTH, 4).unwrap();
        let scale = papers_table().scale.unwrap();
        let mut squares = 0.0;
        let mut largest = 0.0_f64;
        for (k, &d) in DISTANCE.iter().enumerate() {
            assert_near(scale.line.at(d) - scale.compensation.at(d), direct.at(d));
            let left = direct.at(d) - WIDTH[k];
            squares += left * left;
            largest = largest.max(left.abs());
        }
        assert!(
            ((squares / 7.0_f64).sqrt() - 1.386).abs() < 5e-4,
            "{squares}"
        );
        assert!((largest - 2.548).abs() < 5e-4, "{largest}");
    }

    #[test]
    fn the_papers_table_6_widths_are_perspective_and_the_quartic_ends_at_its_range() {
        // W = c / D alone explains almost all of it.
        let (mut products, mut inverses) = (0.0, 0.0);
        for k in 0..7 {
            products += WIDTH[k] / DISTANCE[k];
            inverses += 1.0 / (DISTANCE[k] * DISTANCE[k]);
        }
        let c = products / inverses;
        assert!((c - 137.961).abs() < 5e-4, "{c}");
        let mean = WIDTH.iter().sum::<f64>() / 7.0;
        let left: f64 = (0..7).map(|k| (WIDTH[k] - c / DISTANCE[k]).powi(2)).sum();
        let total: f64 = WIDTH.iter().map(|w| (w - mean).powi(2)).sum();
        assert!((1.0 - left / total - 0.99782).abs() < 5e-6);
        // The quartic of the widths turns up again within the table: beyond it, it is worth nothing.
        let direct = Polynomial::fit(&DISTANCE, &WIDTH, 4).unwrap();
        let steps = (0..=540).map(|k| 0.9 + 0.01 * f64::from(k));
        let lowest = steps.min_by(|a, b| direct.at(*a).total_cmp(&direct.at(*b)));
        assert!((lowest.unwrap() - 5.92).abs() < 0.011, "{lowest:?}");
        let fit = papers_table();
        assert!(fit.corrected_width(6.3, 20.0).is_ok());
        let message = fit.corrected_width(6.31, 20.0).unwrap_err().to_string();
        assert!(
            message.contains("6.31 m is outside the fitted range of 0.9 to 6.3 m"),
            "{message}"
        );
    }

    #[test]
    fn a_table_becomes_a_response_within_its_range() {
        let response = papers_table().response().unwrap();
        assert_eq!(response.range, Some([0.9, 6.3]));
        assert!((response.depth(161).unwrap() - 3.6).abs() < 0.03);
        assert_eq!(response.depth(250), None, "nearer than the table");
        assert_eq!(response.depth(50), None, "farther than the table");
    }

    #[test]
    fn tables_that_say_too_little_are_refused() {
        let table = |rows: &[(f64, f64, f64)]| DepthTable {
            rows: rows
                .iter()
                .map(|&(distance, depth, width)| Measurement {
                    distance,
                    depth,
                    width,
                })
                .collect(),
        };
        let nan = f64::NAN;
        for (rows, named) in [
            (vec![(1.0, 1.0, nan), (2.0, 2.0, nan)], "2 rows"),
            (
                vec![(1.0, 5.0, nan), (2.0, 5.0, nan), (3.0, 5.0, nan)],
                "does not follow",
            ),
            (
                vec![(1.0, 1.0, 3.0), (2.0, 2.0, 2.0), (3.0, 3.0, 1.0)],
                "3 rows with widths",
            ),
        ] {
            let message = PaperFit::of(&table(&rows)).unwrap_err().to_string();
            assert!(message.contains(named), "{message}");
        }
    }
}

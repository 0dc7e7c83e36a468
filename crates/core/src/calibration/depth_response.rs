//! Turns a depth camera's raw reading into a point in metres (the paper's section 2.B, "linearization" of depth and of
//! scale, in metric terms).

use super::{Error, Intrinsics};
use nalgebra::{Point2, Point3};

/// A reading r > 0 at pixel (u, v) is the point z = slope·r + intercept, X = x_n·z·s(z), Y = y_n·z·s(z),
/// where (x_n, y_n) is the undistorted normalised pixel and s(z) = s₀ + s₁·z + ….
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthResponse {
    /// Metres a raw unit.
    pub slope: f64,
    /// Metres at reading 0.
    pub intercept: f64,
    /// Polynomial s(z) that compensates the lateral scale.
    pub scale: [f64; 5],
    /// Where the fit holds, in metres; readings outside count as none.
    pub range: Option<[f64; 2]>,
    /// Metres of bias that the calibration may have left.
    pub uncertainty: f64,
}

/// Metres at which a response without a range is checked.
const USUAL_RANGE: [f64; 2] = [0.5, 2.0];

impl Default for DepthResponse {
    /// Readings in millimetres with nothing to correct.
    fn default() -> Self {
        Self {
            slope: 0.001,
            intercept: 0.0,
            scale: [1.0, 0.0, 0.0, 0.0, 0.0],
            range: None,
            uncertainty: 0.0,
        }
    }
}

impl DepthResponse {
    /// The largest uncertainty in metres that a response may state. It stands for one that is not known.
    pub const MOST_UNCERTAINTY: f64 = 10.0;

    /// Whether it is known how far off its depth is.
    pub fn has_known_uncertainty(&self) -> bool {
        self.uncertainty < Self::MOST_UNCERTAINTY
    }

    /// Checks the numbers.
    ///
    /// # Errors
    /// If a number is not finite, the slope not that of a sensor, the lateral scale not positive, the range not
    /// ascending, the uncertainty negative.
    pub fn checked(self) -> Result<Self, Error> {
        let bad = |what, found: String, expected| {
            Err(Error::BadValue {
                what,
                found,
                expected,
            })
        };
        // The readings have 16 bits: beyond these no reading, or every one, is a place in a room.
        if !(1e-6..=0.1).contains(&self.slope.abs()) {
            return bad(
                "depth response slope",
                self.slope.to_string(),
                "1e-6 to 0.1 m a unit, or less than 0 by as much (0.001 for millimetres)",
            );
        }
        if !(self.intercept.is_finite() && self.intercept.abs() <= 1e3) {
            return bad(
                "depth response intercept",
                self.intercept.to_string(),
                "within 1000 m",
            );
        }
        if !self.scale.iter().all(|s| s.is_finite() && s.abs() <= 1e3) {
            return bad(
                "depth response scale",
                format!("{:?}", self.scale),
                "finite coefficients",
            );
        }
        if let Some([min, max]) = self.range
            && !(min.is_finite() && max.is_finite() && 0.0 <= min && min < max)
        {
            return bad(
                "depth response range",
                format!("{min} to {max} m"),
                "0 <= min < max",
            );
        }
        let [near, far] = self.range.unwrap_or(USUAL_RANGE);
        let distances = (0..=8).map(|k| near + f64::from(k) / 8.0 * (far - near));
        if let Some(z) = distances.into_iter().find(|&z| self.scale_at(z) <= 0.0) {
            return bad(
                "depth response scale",
                format!(
                    "{:?}, which is {:.3} at {z:.2} m",
                    self.scale,
                    self.scale_at(z)
                ),
                "a positive scale over the range",
            );
        }
        if !(0.0..=Self::MOST_UNCERTAINTY).contains(&self.uncertainty) {
            return bad(
                "depth response uncertainty",
                self.uncertainty.to_string(),
                "0 to 10 m",
            );
        }
        Ok(self)
    }

    /// Depth in metres of a raw reading; `None` for no reading (0) or one outside the range.
    #[inline]
    pub fn depth(&self, reading: u16) -> Option<f64> {
        if reading == 0 {
            return None;
        }
        let z = self.slope * f64::from(reading) + self.intercept;
        let inside = self.range.is_none_or(|[min, max]| (min..=max).contains(&z));
        (z > 0.0 && inside).then_some(z)
    }

    /// Lateral scale s(z).
    #[inline]
    pub fn scale_at(&self, z: f64) -> f64 {
        self.scale.iter().rev().fold(0.0, |sum, s| sum * z + s)
    }

    /// The point, in the depth camera's frame, at `depth` metres seen by `pixel`; `None` where the lens
    /// model cannot be inverted.
    pub fn point(&self, lens: &Intrinsics, pixel: Point2<f64>, depth: f64) -> Option<Point3<f64>> {
        let n = lens.unproject(pixel)?;
        let lateral = depth * self.scale_at(depth);
        Some(Point3::new(n.x * lateral, n.y * lateral, depth))
    }

    /// The pixel at which the depth camera sees a point of its frame: the inverse of [`Self::point`].
    #[inline]
    pub fn project(&self, lens: &Intrinsics, p: Point3<f64>) -> Option<Point2<f64>> {
        let scale = self.scale_at(p.z);
        (scale > 1e-6)
            .then(|| lens.project(p.x / scale, p.y / scale, p.z))
            .flatten()
    }
}

#[cfg(test)]
mod tests {
    use super::super::Distortion;
    use super::*;
    use nalgebra::Vector2;

    #[test]
    fn readings_become_points_and_points_pixels() {
        let response = DepthResponse {
            slope: 0.00104,
            intercept: -0.018,
            scale: [1.012, -0.009, 0.0, 0.0, 0.0],
            range: Some([0.5, 2.0]),
            uncertainty: 0.001,
        };
        let lens = Intrinsics::new(
            640,
            480,
            Vector2::new(575.8, 575.8),
            Vector2::new(319.5, 239.5),
            Distortion::default(),
        )
        .unwrap();
        assert_eq!(response.depth(0), None);
        assert_eq!(response.depth(100), None, "below the range");
        let z = response.depth(1000).unwrap();
        assert!((z - 1.022).abs() < 1e-12);
        let pixel = Point2::new(100.0, 50.0);
        let p = response.point(&lens, pixel, z).unwrap();
        let expected_x = (100.0 - 319.5) / 575.8 * z * (1.012 - 0.009 * z);
        assert!((p.x - expected_x).abs() < 1e-12);
        assert!((response.project(&lens, p).unwrap() - pixel).norm() < 1e-9);
    }

    #[test]
    fn bad_numbers_are_refused() {
        let good = DepthResponse::default();
        assert!(good.checked().is_ok());
        for slope in [0.0, 1.0, -1.0, f64::NAN] {
            let words = DepthResponse { slope, ..good }
                .checked()
                .unwrap_err()
                .to_string();
            assert!(
                words.contains("slope") && words.contains("0.001 for millimetres"),
                "{words}"
            );
        }
        for scale in [[-1.0, 0.0], [1.0, -0.8]] {
            let scale = [scale[0], scale[1], 0.0, 0.0, 0.0];
            let words = DepthResponse { scale, ..good }
                .checked()
                .unwrap_err()
                .to_string();
            assert!(words.contains("positive scale"), "{words}");
        }
        assert!(
            DepthResponse {
                range: Some([2.0, 1.0]),
                ..good
            }
            .checked()
            .is_err()
        );
        assert!(
            DepthResponse {
                uncertainty: -1.0,
                ..good
            }
            .checked()
            .is_err()
        );
    }
}

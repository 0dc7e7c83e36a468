//! A lens: projects a direction to a pixel and back (Brown–Conrady and the rational model, as in the ROS
//! `plumb_bob` and `rational_polynomial` conventions). `fit::lens` has the same formula with its derivatives.

use super::Error;
use nalgebra::{Matrix2, Point2, Vector2};

/// Lens distortion. One formula serves all models: the rational one, with zeros where a model has no term.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Distortion {
    /// k1 … k6: radial, numerator k1 k2 k3, denominator k4 k5 k6.
    pub radial: [f64; 6],
    /// p1, p2: tangential.
    pub tangential: [f64; 2],
}

impl Distortion {
    /// From a model's name and its coefficients D, as a recording has them: `plumb_bob` k1 k2 p1 p2 k3,
    /// `rational_polynomial` k1 k2 p1 p2 k3 k4 k5 k6; a shorter D is padded with zeros.
    ///
    /// # Errors
    /// If the model is unknown, D too long or not finite.
    pub fn from_model(model: &str, d: &[f64]) -> Result<Self, Error> {
        let longest = match model {
            "plumb_bob" => 5,
            "rational_polynomial" => 8,
            "" => 0,
            other => {
                let name = other.chars().take(40).collect();
                return Err(Error::UnknownDistortionModel(name));
            }
        };
        if d.len() > longest || d.iter().any(|v| !v.is_finite() || v.abs() > 1e6) {
            return Err(Error::BadValue {
                what: "distortion D",
                found: format!("{:?} ({} values)", &d[..d.len().min(16)], d.len()),
                expected: "finite, at most 5 values for plumb_bob, 8 for rational_polynomial, 0 for none",
            });
        }
        let at = |i: usize| d.get(i).copied().unwrap_or(0.0);
        Ok(Self {
            radial: [at(0), at(1), at(4), at(5), at(6), at(7)],
            tangential: [at(2), at(3)],
        })
    }

    /// Name and coefficients D of the plainest model that holds the lens: what [`Self::from_model`] reads.
    pub fn to_model(&self) -> (&'static str, Vec<f64>) {
        let [k1, k2, k3, k4, k5, k6] = self.radial;
        let [p1, p2] = self.tangential;
        if self.is_none() {
            ("", vec![])
        } else if [k4, k5, k6] == [0.0; 3] {
            ("plumb_bob", vec![k1, k2, p1, p2, k3])
        } else {
            ("rational_polynomial", vec![k1, k2, p1, p2, k3, k4, k5, k6])
        }
    }

    /// Whether the lens is a pinhole.
    pub fn is_none(&self) -> bool {
        self.radial == [0.0; 6] && self.tangential == [0.0; 2]
    }

    /// Distorts a normalised point (x/z, y/z).
    #[inline]
    pub fn distort(&self, p: Vector2<f64>) -> Vector2<f64> {
        let [k1, k2, k3, k4, k5, k6] = self.radial;
        let [p1, p2] = self.tangential;
        let (x, y) = (p.x, p.y);
        let r2 = x * x + y * y;
        let numerator = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let denominator = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
        let radial = numerator / denominator;
        Vector2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        )
    }

    /// Inverts [`Distortion::distort`] by Newton's method; `None` where the model cannot be inverted.
    pub fn undistort(&self, distorted: Vector2<f64>) -> Option<Vector2<f64>> {
        if self.is_none() {
            return Some(distorted);
        }
        let mut p = distorted;
        for _ in 0..30 {
            let error = self.distort(p) - distorted;
            if error.norm_squared() < 1e-24 {
                return Some(p);
            }
            let step = self.jacobian(p).try_inverse()? * error;
            p -= step;
            if !p.iter().all(|v| v.is_finite()) {
                return None;
            }
        }
        (self.distort(p) - distorted).norm().lt(&1e-9).then_some(p)
    }

    /// Derivative of [`Distortion::distort`] by central differences, exact to 1e-9 for real lenses.
    fn jacobian(&self, p: Vector2<f64>) -> Matrix2<f64> {
        const H: f64 = 1e-6;
        let dx = (self.distort(p + Vector2::new(H, 0.0)) - self.distort(p - Vector2::new(H, 0.0)))
            / (2.0 * H);
        let dy = (self.distort(p + Vector2::new(0.0, H)) - self.distort(p - Vector2::new(0.0, H)))
            / (2.0 * H);
        Matrix2::from_columns(&[dx, dy])
    }
}

/// How many times nearer to the principal point, or farther from it, a distortion may move what the middle half of a
/// picture shows: a fisheye lens of 180 degrees moves it less than two times.
const LARGEST_STRETCH: f64 = 4.0;
/// Distance from the principal point up to which a lens is checked, over the focal length.
const FARTHEST_CHECKED: f64 = 0.35;

/// A camera's lens and sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intrinsics {
    /// Width of its pictures in pixels.
    pub width: usize,
    /// Height of its pictures in pixels.
    pub height: usize,
    /// Focal lengths fx, fy in pixels.
    pub focal_px: Vector2<f64>,
    /// Principal point cx, cy in pixels.
    pub center_px: Vector2<f64>,
    /// Its lens' distortion.
    pub distortion: Distortion,
    /// Square of the largest normalised radius at which the distortion is still one to one: beyond it a
    /// polynomial model folds far points back into the picture.
    largest_radius_squared: f64,
}

impl Intrinsics {
    /// Largest picture that is read, in pixels a side.
    pub const LARGEST_SIDE: usize = 16_384;

    /// Checks and makes intrinsics.
    ///
    /// # Errors
    /// If the size is 0 or over [`Self::LARGEST_SIDE`], or a number cannot be a camera's.
    pub fn new(
        width: usize,
        height: usize,
        focal_px: Vector2<f64>,
        center_px: Vector2<f64>,
        distortion: Distortion,
    ) -> Result<Self, Error> {
        let size = 1..=Self::LARGEST_SIDE;
        if !size.contains(&width) || !size.contains(&height) {
            return Err(Error::BadValue {
                what: "picture size",
                found: format!("{width}x{height}"),
                expected: "1 to 16384 pixels a side",
            });
        }
        if !focal_px.iter().all(|f| (1.0..=1e6).contains(f)) {
            return Err(Error::BadValue {
                what: "focal length",
                found: format!("{}, {} px", focal_px.x, focal_px.y),
                expected: "1 to 1000000 px",
            });
        }
        if !center_px.iter().all(|c| c.is_finite() && c.abs() <= 1e6) {
            return Err(Error::BadValue {
                what: "principal point",
                found: format!("{}, {} px", center_px.x, center_px.y),
                expected: "finite, within 1000000 px",
            });
        }
        let largest_radius_squared = largest_one_to_one_radius(&distortion).powi(2);
        Ok(Self {
            width,
            height,
            focal_px,
            center_px,
            distortion,
            largest_radius_squared,
        })
    }

    /// Checks that the lens shows something in the middle of its picture: that each pixel of the middle half has a
    /// direction, of which it is the picture, and that the distortion leaves distances from the principal point within
    /// a factor of four. Farther out, and farther than 20 degrees from the axis, even good models fold.
    ///
    /// # Errors
    /// If it does not.
    pub fn checked(self) -> Result<Self, Error> {
        let size = Vector2::new(self.width as f64, self.height as f64);
        let eighths = (2..=6).flat_map(|x| (2..=6).map(move |y| Vector2::new(x, y)));
        for eighth in eighths {
            let pixel = eighth.map(f64::from).component_mul(&size) / 8.0;
            let from_center = (pixel - self.center_px).component_div(&self.focal_px);
            let distorted = from_center.cap_magnitude(FARTHEST_CHECKED);
            if !self.is_one_to_one_at(distorted) {
                let pixel = distorted.component_mul(&self.focal_px) + self.center_px;
                return Err(Error::BadValue {
                    what: "distortion D",
                    found: format!(
                        "{:?} of a focal length of {:.1} px, with which pixel ({:.0}, {:.0}) of {} x {} has no direction or one \
                        far off",
                        self.distortion.to_model().1,
                        self.focal_px.x,
                        pixel.x,
                        pixel.y,
                        self.width,
                        self.height
                    ),
                    expected: "a lens that is one to one over the middle half of the picture",
                });
            }
        }
        Ok(self)
    }

    /// At a place of the picture, given as the distorted normalised direction.
    fn is_one_to_one_at(&self, distorted: Vector2<f64>) -> bool {
        let Some(direction) = self.distortion.undistort(distorted) else {
            return false;
        };
        let stretch = distorted.norm().max(1e-6) / direction.norm().max(1e-6);
        direction.norm_squared() <= self.largest_radius_squared
            && (LARGEST_STRETCH.recip()..=LARGEST_STRETCH).contains(&stretch)
    }

    /// Angle to the optical axis, in radians, beyond which nothing is in the picture: a little more than its corners'.
    pub fn largest_angle_in_picture(&self) -> f64 {
        const MARGIN: f64 = 1.1;
        const DIRECTIONS: u32 = 64;
        let (right, bottom) = (self.width as f64 - 0.5, self.height as f64 - 0.5);
        let corners = [[-0.5, -0.5], [right, -0.5], [-0.5, bottom], [right, bottom]];
        let radius = |corner: [f64; 2]| self.unproject(Point2::from(corner)).map(|n| n.norm());
        let mut farthest = corners.into_iter().map(radius);
        let farthest = farthest.try_fold(0.0, |most: f64, radius| Some(most.max(radius?)));
        // The lens model is one to one up to its fold: what is beyond a circle stays beyond the circle's image.
        let is_around = |radius: f64| {
            (0..DIRECTIONS).all(|i| {
                let turn = std::f64::consts::TAU * f64::from(i) / f64::from(DIRECTIONS);
                let pixel = self.project(radius * turn.cos(), radius * turn.sin(), 1.0);
                pixel.is_some_and(|pixel| !self.contains(pixel))
            })
        };
        let around = farthest.map(|radius| MARGIN * radius);
        let fold = self.largest_radius_squared.sqrt();
        around.filter(|r| is_around(*r)).unwrap_or(fold).atan()
    }

    /// Pixel of a point in the camera's frame; `None` behind the camera or where the lens model folds over.
    /// The pixel may lie outside the picture.
    #[inline]
    pub fn project(&self, x: f64, y: f64, z: f64) -> Option<Point2<f64>> {
        if z <= 1e-9 {
            return None;
        }
        let normalized = Vector2::new(x / z, y / z);
        if normalized.norm_squared() > self.largest_radius_squared {
            return None;
        }
        let distorted = self.distortion.distort(normalized);
        Some(Point2::from(
            distorted.component_mul(&self.focal_px) + self.center_px,
        ))
    }

    /// Normalised direction (x/z, y/z) of a pixel; `None` where the lens model cannot be inverted.
    pub fn unproject(&self, pixel: Point2<f64>) -> Option<Vector2<f64>> {
        let distorted = (pixel.coords - self.center_px).component_div(&self.focal_px);
        self.distortion.undistort(distorted)
    }

    /// Whether a pixel lies within the picture (pixel centres at whole numbers).
    pub fn contains(&self, pixel: Point2<f64>) -> bool {
        pixel.x >= -0.5
            && pixel.y >= -0.5
            && pixel.x < self.width as f64 - 0.5
            && pixel.y < self.height as f64 - 0.5
    }
}

/// The radius up to which the radial distortion grows, searched in steps of 0.5 %, up to 10 (84°).
fn largest_one_to_one_radius(distortion: &Distortion) -> f64 {
    let radius = |r: f64| {
        let radial = Distortion {
            tangential: [0.0; 2],
            ..*distortion
        };
        radial.distort(Vector2::new(r, 0.0)).x
    };
    let mut r = 0.01;
    while r < 10.0 {
        let next = r * 1.005;
        if radius(next) <= radius(r) {
            return r;
        }
        r = next;
    }
    if distortion.is_none() {
        f64::INFINITY
    } else {
        r
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn lens(distortion: Distortion) -> Intrinsics {
        Intrinsics::new(
            640,
            480,
            Vector2::new(600.0, 610.0),
            Vector2::new(320.0, 238.0),
            distortion,
        )
        .unwrap()
    }

    proptest! {
        #[test]
        fn unproject_inverts_project(
            x in -0.5..0.5f64, y in -0.4..0.4f64,
            k1 in -0.2..0.2f64, k2 in -0.1..0.1f64, p1 in -0.002..0.002f64, p2 in -0.002..0.002f64,
            k4 in -0.05..0.05f64,
        ) {
            let d = Distortion { radial: [k1, k2, 0.0, k4, 0.0, 0.0], tangential: [p1, p2] };
            let lens = lens(d);
            let pixel = lens.project(x * 2.0, y * 2.0, 2.0).unwrap();
            let back = lens.unproject(pixel).unwrap();
            prop_assert!((back - Vector2::new(x, y)).norm() < 1e-9);
        }
    }

    #[test]
    fn a_lens_that_folds_over_shows_no_far_points() {
        let folding = Distortion {
            radial: [-0.3, 0.0, 0.0, 0.0, 0.0, 0.0],
            tangential: [0.0; 2],
        };
        // r (1 - 0.3 r²) grows up to r = 1.054.
        assert!(lens(folding).project(1.0, 0.0, 1.0).is_some());
        assert!(lens(folding).project(1.2, 0.0, 1.0).is_none());
    }

    #[test]
    fn nothing_beyond_the_largest_angle_is_in_the_picture() {
        let distorted = |radial: f64| Distortion {
            radial: [radial, 0.0, 0.0, 0.0, 0.0, 0.0],
            tangential: [2e-3, -1e-3],
        };
        for distortion in [Distortion::default(), distorted(-0.25), distorted(0.3)] {
            let lens = lens(distortion);
            let largest = lens.largest_angle_in_picture();
            let corner = lens.unproject(Point2::new(639.5, 479.5)).unwrap().norm();
            assert!(largest < 1.2 * corner.atan(), "{largest} {corner}");
            for turn in (0..360).map(|degrees| f64::from(degrees).to_radians()) {
                for more in (1..200).map(|i| largest + 0.01 * f64::from(i)) {
                    let (r, z) = more.sin_cos();
                    let pixel = lens.project(r * turn.cos(), r * turn.sin(), z);
                    assert!(!pixel.is_some_and(|pixel| lens.contains(pixel)));
                }
            }
        }
        // Where the model folds over within the picture, its fold is the limit.
        let folding = lens(distorted(-1.5));
        let fold = folding.largest_radius_squared.sqrt().atan();
        assert_eq!(folding.largest_angle_in_picture(), fold);
    }

    #[test]
    fn a_lens_that_is_not_one_to_one_over_the_middle_of_its_picture_is_refused() {
        let of_k1 = |k1: f64| {
            let distortion = Distortion {
                radial: [k1, 0.0, 0.0, 0.0, 0.0, 0.0],
                tangential: [0.0; 2],
            };
            lens(distortion).checked()
        };
        for sound in [0.0, 0.3, -0.3, -1.0] {
            assert!(of_k1(sound).is_ok(), "{sound}");
        }
        // The first folds at 0.16 of the focal length, 94 of the 200 pixels to the middle half's corner.
        for bad in [-6.0, -50.0, 1e6] {
            let words = of_k1(bad).unwrap_err().to_string();
            assert!(words.contains("one to one over the middle half"), "{words}");
        }
    }

    #[test]
    fn models_are_padded_and_checked() {
        let short = Distortion::from_model("plumb_bob", &[0.1]).unwrap();
        assert_eq!(short.radial[0], 0.1);
        let full = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0];
        let rational = Distortion::from_model("rational_polynomial", &full).unwrap();
        assert_eq!(rational.radial, [1.0, 2.0, 5.0, 6.0, 7.0, 8.0]);
        assert_eq!(rational.tangential, [3.0, 4.0]);
        assert!(Distortion::from_model("plumb_bob", &full).is_err());
        assert!(Distortion::from_model("plumb_bob", &[f64::NAN]).is_err());
        assert!(Distortion::from_model("fisheye", &[]).is_err());
    }
}

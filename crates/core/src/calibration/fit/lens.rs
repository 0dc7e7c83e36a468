//! A lens as the fit's parameters, with the derivatives of its projection. The model itself is
//! `calibration::Intrinsics`. Nothing is solved here.

use crate::calibration::{Distortion, Error, Intrinsics};
use nalgebra::{Matrix2x3, Point2, SMatrix, Vector2, Vector3};

/// Number of a lens' parameters.
pub(super) const PARAMETERS: usize = 12;

/// Derivative of a pixel by a lens' parameters.
pub(super) type LensJacobian = SMatrix<f64, 2, PARAMETERS>;

/// Which terms of the distortion are fitted.
#[derive(serde::Deserialize, serde::Serialize, Clone, Copy, Debug, PartialEq, Eq, Default)]
#[serde(rename_all = "snake_case")]
pub enum LensModel {
    /// Brown–Conrady: k1, k2, k3 and p1, p2.
    #[default]
    PlumbBob,
    /// The same over a denominator with k4, k5, k6.
    Rational,
}

/// fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6, and the picture's size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// The parameters.
    pub values: [f64; PARAMETERS],
    /// Width and height in pixels.
    pub size: [usize; 2],
}

impl Lens {
    /// The lens that a camera's intrinsics describe.
    pub fn from_intrinsics(lens: &Intrinsics) -> Self {
        let [k1, k2, k3, k4, k5, k6] = lens.distortion.radial;
        let [p1, p2] = lens.distortion.tangential;
        let (f, c) = (lens.focal_px, lens.center_px);
        Self {
            values: [f.x, f.y, c.x, c.y, k1, k2, p1, p2, k3, k4, k5, k6],
            size: [lens.width, lens.height],
        }
    }

    /// A pinhole with square pixels and its principal point in the picture's middle.
    pub fn pinhole(size: [usize; 2], focal_px: f64) -> Self {
        let middle = |side: usize| (side as f64 - 1.0) / 2.0;
        let mut values = [0.0; PARAMETERS];
        values[..4].copy_from_slice(&[focal_px, focal_px, middle(size[0]), middle(size[1])]);
        Self { values, size }
    }

    /// The intrinsics of this lens.
    ///
    /// # Errors
    /// If no camera can have them.
    pub fn intrinsics(&self) -> Result<Intrinsics, Error> {
        let [fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6] = self.values;
        let distortion = Distortion {
            radial: [k1, k2, k3, k4, k5, k6],
            tangential: [p1, p2],
        };
        let (focal, center) = (Vector2::new(fx, fy), Vector2::new(cx, cy));
        Intrinsics::new(self.size[0], self.size[1], focal, center, distortion)
    }

    /// Pixel of a point in the camera's frame, however far outside the picture; `None` behind the camera.
    #[inline]
    pub fn project(&self, p: Vector3<f64>) -> Option<Point2<f64>> {
        (p.z > NEAREST).then(|| {
            let t = Terms::new(&self.values, p.x / p.z, p.y / p.z);
            let [fx, fy, cx, cy, ..] = self.values;
            Point2::new(fx * t.distorted.x + cx, fy * t.distorted.y + cy)
        })
    }

    /// The pixel with its derivatives by the lens' parameters and by the point.
    #[inline]
    pub fn derive(&self, p: Vector3<f64>) -> Option<(Point2<f64>, LensJacobian, Matrix2x3<f64>)> {
        if p.z <= NEAREST {
            return None;
        }
        let [fx, fy, cx, cy, _, _, p1, p2, ..] = self.values;
        let (x, y) = (p.x / p.z, p.y / p.z);
        let t = Terms::new(&self.values, x, y);
        let pixel = Point2::new(fx * t.distorted.x + cx, fy * t.distorted.y + cy);
        let cross = 2.0 * x * y * t.slope + 2.0 * p1 * x + 2.0 * p2 * y;
        let xx = t.radial + 2.0 * x * x * t.slope + 2.0 * p1 * y + 6.0 * p2 * x;
        let yy = t.radial + 2.0 * y * y * t.slope + 6.0 * p1 * y + 2.0 * p2 * x;
        let (ux, uy, vx, vy) = (fx * xx, fx * cross, fy * cross, fy * yy);
        let iz = 1.0 / p.z;
        let by_point = Matrix2x3::new(
            ux * iz,
            uy * iz,
            -(ux * x + uy * y) * iz,
            vx * iz,
            vy * iz,
            -(vx * x + vy * y) * iz,
        );
        let mut by_lens = LensJacobian::zeros();
        by_lens[(0, 0)] = t.distorted.x;
        by_lens[(1, 1)] = t.distorted.y;
        by_lens[(0, 2)] = 1.0;
        by_lens[(1, 3)] = 1.0;
        let (r2, r4, r6) = (t.r2, t.r2 * t.r2, t.r2 * t.r2 * t.r2);
        let over = 1.0 / t.denominator;
        let radials = [(4, r2), (5, r4), (8, r6), (9, r2), (10, r4), (11, r6)];
        for (column, power) in radials {
            let by = if column < 9 { power } else { -t.radial * power } * over;
            by_lens[(0, column)] = fx * x * by;
            by_lens[(1, column)] = fy * y * by;
        }
        by_lens[(0, 6)] = fx * 2.0 * x * y;
        by_lens[(1, 6)] = fy * (r2 + 2.0 * y * y);
        by_lens[(0, 7)] = fx * (r2 + 2.0 * x * x);
        by_lens[(1, 7)] = fy * 2.0 * x * y;
        Some((pixel, by_lens, by_point))
    }

    /// Normalised directions (x/z, y/z) of pixels; where the model cannot be inverted, those of the pinhole.
    pub fn unproject(&self, pixels: impl Iterator<Item = Point2<f64>>) -> Vec<Vector2<f64>> {
        let [fx, fy, cx, cy, ..] = self.values;
        let intrinsics = self.intrinsics().ok();
        let direction = |pixel: Point2<f64>| {
            let exact = intrinsics.as_ref().and_then(|i| i.unproject(pixel));
            exact.unwrap_or_else(|| Vector2::new((pixel.x - cx) / fx, (pixel.y - cy) / fy))
        };
        pixels.map(direction).collect()
    }

    /// Mean focal length in pixels.
    pub fn focal_px(&self) -> f64 {
        (self.values[0] + self.values[1]) / 2.0
    }

    /// Larger side of the picture in pixels.
    pub fn side(&self) -> f64 {
        self.size[0].max(self.size[1]) as f64
    }
}

/// Nearest depth that is projected, in metres.
const NEAREST: f64 = 1e-6;

/// What projection and its derivatives share.
struct Terms {
    r2: f64,
    denominator: f64,
    /// Radial factor and its derivative by r².
    radial: f64,
    slope: f64,
    distorted: Vector2<f64>,
}

impl Terms {
    #[inline]
    fn new(values: &[f64; PARAMETERS], x: f64, y: f64) -> Self {
        let [_, _, _, _, k1, k2, p1, p2, k3, k4, k5, k6] = *values;
        let r2 = x * x + y * y;
        let numerator = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let denominator = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
        let radial = numerator / denominator;
        let rising = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
        let falling = k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6);
        Self {
            r2,
            denominator,
            radial,
            slope: (rising - radial * falling) / denominator,
            distorted: Vector2::new(
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn close(analytic: f64, numeric: f64) -> bool {
        (analytic - numeric).abs() <= 1e-5 * (1.0 + analytic.abs().max(numeric.abs()))
    }

    proptest! {
        #[test]
        fn derivatives_are_those_of_finite_differences(
            x in -0.6..0.6f64, y in -0.5..0.5f64, z in 0.5..3.0f64,
            k in proptest::array::uniform6(-0.1..0.1f64), p1 in -0.01..0.01f64, p2 in -0.01..0.01f64,
            fx in 300.0..3000.0f64, fy in 300.0..3000.0f64,
        ) {
            let values = [fx, fy, 320.0, 240.0, k[0], k[1], p1, p2, k[2], k[3], k[4], k[5]];
            let lens = Lens { values, size: [640, 480] };
            let p = Vector3::new(x * z, y * z, z);
            let (pixel, by_lens, by_point) = lens.derive(p).unwrap();
            prop_assert!((pixel - lens.project(p).unwrap()).norm() < 1e-9);
            for i in 0..PARAMETERS {
                let step = 1e-6 * values[i].abs().max(1.0);
                let moved = |by: f64| {
                    let mut moved = lens;
                    moved.values[i] += by;
                    moved.project(p).unwrap()
                };
                let numeric = (moved(step) - moved(-step)) / (2.0 * step);
                prop_assert!(close(by_lens[(0, i)], numeric.x) && close(by_lens[(1, i)], numeric.y), "{i}");
            }
            for i in 0..3 {
                let mut step = Vector3::zeros();
                step[i] = 1e-6;
                let numeric = (lens.project(p + step).unwrap() - lens.project(p - step).unwrap()) / 2e-6;
                prop_assert!(close(by_point[(0, i)], numeric.x) && close(by_point[(1, i)], numeric.y), "{i}");
            }
        }

        #[test]
        fn it_projects_as_the_intrinsics_do(
            x in -0.4..0.4f64, y in -0.3..0.3f64, k1 in -0.2..0.2f64, k4 in -0.05..0.05f64, p1 in -0.01..0.01f64,
        ) {
            let values = [700.0, 710.0, 320.0, 240.0, k1, 0.01, p1, 0.002, 0.0, k4, 0.0, 0.0];
            let lens = Lens { values, size: [640, 480] };
            let intrinsics = lens.intrinsics().unwrap();
            let one = lens.project(Vector3::new(2.0 * x, 2.0 * y, 2.0)).unwrap();
            let other = intrinsics.project(2.0 * x, 2.0 * y, 2.0).unwrap();
            prop_assert!((one - other).norm() < 1e-9);
            prop_assert!(Lens::from_intrinsics(&intrinsics) == lens);
        }
    }
}

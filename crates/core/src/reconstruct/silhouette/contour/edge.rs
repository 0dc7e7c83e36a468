//! The profile of an object's edge in a blurred picture, fitted to a measured one. Near its outline an object turns
//! away, and its light changes with the square root of the distance to the outline, most at the outline itself. That
//! looks like blur, but it begins sharply: so shading and blur are fitted together. Measuring profiles is not here.

use nalgebra::{Matrix4, Vector4};
use std::f64::consts::TAU;
use std::sync::LazyLock;

/// Blurs that are tried, in pixels: the narrowest, …
const NARROWEST_PX: f64 = 0.3;
/// … how much wider each is than the one before, …
const WIDER: f64 = 1.12;
/// … and the widest, as a share of the profile's reach.
const WIDEST: f64 = 0.5;
/// Places of the edge that are tried, in pixels apart, …
const PLACE_PX: f64 = 0.25;
/// … so far to the inside and to the outside, as shares of the reach: where a profile passes one half, shading lies
/// before the edge.
const PLACES: (f64, f64) = (0.125, 0.25);

/// Standard deviation in pixels of the Gaussian blur that explains a profile best: the object's share of the light from
/// the inside to the outside, `per_px` samples a pixel, with the edge near its middle. `None` if nothing can be fitted.
pub(super) fn blur_px(profile: &[f32], per_px: usize) -> Option<f64> {
    let middle = (profile.len().saturating_sub(1)) as f64 / 2.0;
    let reach = middle / per_px as f64;
    let at: Vec<f64> = (0..profile.len())
        .map(|i| (i as f64 - middle) / per_px as f64)
        .collect();
    let widths = std::iter::successors(Some(NARROWEST_PX), |w| Some(w * WIDER));
    let widths = widths.take_while(|w| *w <= WIDEST * reach);
    let places = ((PLACES.0 + PLACES.1) * reach / PLACE_PX) as usize;
    let tried = widths.flat_map(|sigma| {
        (0..=places).map(move |i| (sigma, i as f64 * PLACE_PX - PLACES.0 * reach))
    });
    let fitted = tried.filter_map(|(sigma, edge)| {
        let misfit = misfit(profile, &at, sigma, edge)?;
        Some((misfit, sigma))
    });
    let best = fitted.min_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(best.1)
}

/// The sum of squares that a blur of an edge leaves, whatever the light outside, the object's at the edge, and its two
/// kinds of shading.
fn misfit(profile: &[f32], at: &[f64], sigma: f64, edge: f64) -> Option<f64> {
    let (mut normal, mut right, mut square) = (Matrix4::zeros(), Vector4::zeros(), 0.0);
    for (value, t) in profile.iter().zip(at) {
        let [step, root, ramp] = BLURRED.at((edge - t) / sigma);
        let row = Vector4::new(1.0, step, sigma.sqrt() * root, sigma * ramp);
        let value = f64::from(*value);
        normal += row * row.transpose();
        right += row * value;
        square += value * value;
    }
    let solved = normal.cholesky()?.solve(&right);
    Some(square - solved.dot(&right))
}

static BLURRED: LazyLock<Blurred> = LazyLock::new(Blurred::new);

/// Values of the table are so many a standard deviation.
const FINE: usize = 32;
/// The table ends so many standard deviations from the edge.
const END: f64 = 6.0;

/// One, the square root and the distance inside of an edge, nothing outside, blurred by one standard deviation.
struct Blurred(Vec<[f64; 3]>);

impl Blurred {
    fn new() -> Self {
        let end = 2 * END as usize * FINE;
        let at = |i: usize| i as f64 / FINE as f64 - END;
        Self((0..=end).map(|i| blurred(at(i))).collect())
    }

    /// At so many standard deviations from the edge, positive inside.
    fn at(&self, distance: f64) -> [f64; 3] {
        if distance <= -END {
            return [0.0; 3];
        }
        if distance >= END {
            return [1.0, distance.sqrt(), distance];
        }
        let i = (distance + END) * FINE as f64;
        let low = (i as usize).min(self.0.len() - 2);
        let [a, b] = [self.0[low], self.0[low + 1]];
        std::array::from_fn(|k| a[k] + (b[k] - a[k]) * (i - low as f64))
    }
}

/// Sums the blur over the inside.
fn blurred(distance: f64) -> [f64; 3] {
    let step = 1.0 / FINE as f64;
    let mut sums = [0.0; 3];
    for i in 0..2 * END as usize * FINE {
        let inside = (i as f64 + 0.5) * step;
        let weight = (-0.5 * (distance - inside).powi(2)).exp() * step / TAU.sqrt();
        for (sum, value) in sums.iter_mut().zip([1.0, inside.sqrt(), inside]) {
            *sum += weight * value;
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A profile of an object whose light is `light` of the distance in pixels to its outline, blurred.
    fn profile(reach: usize, sigma: f64, light: impl Fn(f64) -> f64) -> Vec<f32> {
        let fine = 16;
        let value = |t: f64| {
            let steps = -(6 * fine)..=6 * fine;
            let weigh = |i: i32| (-0.5 * (f64::from(i) / f64::from(fine)).powi(2)).exp();
            let all: f64 = steps.clone().map(weigh).sum();
            let each = steps.map(|i| {
                let depth = sigma * f64::from(i) / f64::from(fine) - t;
                let is_inside = depth > 0.0;
                weigh(i) * if is_inside { light(depth) } else { 0.1 }
            });
            (each.sum::<f64>() / all) as f32
        };
        let at = |i| (i as f64) / 2.0 - reach as f64;
        (0..=4 * reach).map(|i| value(at(i))).collect()
    }

    #[test]
    fn the_blur_of_an_even_object_is_found() {
        for (reach, sigma) in [(4, 0.7), (4, 1.2), (8, 2.0), (24, 4.0), (24, 8.0)] {
            let found = blur_px(&profile(reach, sigma, |_| 0.9), 2).unwrap();
            assert!((found / sigma - 1.0).abs() < 0.1, "{sigma}: {found}");
        }
    }

    #[test]
    fn shading_towards_the_outline_is_no_blur_and_hides_none() {
        // The light of a ball of 100 pixels from before it.
        let ball = |depth: f64| (1.0 - (1.0 - depth / 100.0).powi(2)).max(0.0).sqrt();
        for sigma in [1.0, 4.0, 6.0] {
            let found = blur_px(&profile(24, sigma, ball), 2).unwrap();
            assert!((found / sigma - 1.0).abs() < 0.2, "{sigma}: {found}");
        }
    }

    #[test]
    fn no_profile_has_no_blur() {
        assert_eq!(blur_px(&[], 2), None);
        assert_eq!(blur_px(&[0.5; 3], 2), None);
    }
}

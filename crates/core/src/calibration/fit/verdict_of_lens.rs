//! Tests whether a camera's residuals show that the lens model does not fit its lens: they then point to the centre of
//! the picture, or away from it, by an amount that depends on the distance from the centre.

use super::reason::{Reason, ReasonKind};
use super::result::{Fit, ViewResiduals};
use crate::calibration::CalibrationLevel;
use nalgebra::Vector2;

/// Rings of the picture, each with as many corners.
const RINGS: usize = 8;
/// Fewest corners for which this is tested.
const FEWEST: usize = 200;
/// Part of the residuals' squares, from 0 to 1, that the rings explain with a lens that is beyond its model: at least
/// this part, this many times what they explain of noise, and this many pixels. The views that would show more are
/// those in the corners of the picture, and they have been left out.
const SYSTEMATIC: f64 = 0.02;
const OF_NOISE: f64 = 4.0;
const LEAST_PX: f64 = 0.01;
/// Part of the residual of a good calibration above which such residuals make it doubtful. So do views that were left
/// out, in this number.
const MUCH: f64 = 0.2;
const FEWEST_LEFT_OUT: usize = 2;

/// What to say of a camera whose residuals go with the distance from the middle of its picture; `None` where its lens
/// fits the lens model. A lens that was given, and is another one, does the same.
pub(super) fn beyond_model(fit: &Fit, camera: usize, good_px: f64) -> Option<Reason> {
    let fitted = &fit.cameras[camera];
    let own = fit.residuals.iter().filter(|view| view.camera == camera);
    let part = radial_part(own, fitted.camera.intrinsics.center_px)?;
    let by_px = part.sqrt() * fitted.figures.rms_px;
    // Each ring takes one of the residuals' coordinates, two of each corner.
    let of_noise = RINGS as f64 / (2.0 * fitted.figures.corners.max(1) as f64);
    let is_beyond = part >= SYSTEMATIC && part >= OF_NOISE * of_noise && by_px >= LEAST_PX;
    let is_much = by_px > MUCH * good_px;
    let level = match is_much || fit.left_out_share_of(fitted).left_out >= FEWEST_LEFT_OUT {
        true => CalibrationLevel::Doubtful,
        false => CalibrationLevel::Accepted,
    };
    is_beyond.then(|| {
        let (kind, cause) = match fitted.is_lens_given {
            true => (
                ReasonKind::GivenLens,
                "the lens that was given does not fit: fit it anew",
            ),
            false => (
                ReasonKind::BeyondLensModel,
                "the lens is beyond the lens model, as a fisheye lens is",
            ),
        };
        let words = format!(
            "camera {}: {:.0} % of its squared residuals depend on the distance from the middle of its picture \
             ({by_px:.2} px): {cause}",
            fitted.camera.id,
            100.0 * part
        );
        Reason::new(level, kind, words)
    })
}

/// The part of the residuals' squares that the mean of each ring's components along its radius explains.
fn radial_part<'a>(
    views: impl Iterator<Item = &'a ViewResiduals>,
    center: Vector2<f64>,
) -> Option<f64> {
    let along = |(pixel, residual): &(nalgebra::Point2<f64>, Vector2<f64>)| {
        let from = pixel.coords - center;
        let radius = from.norm();
        let outward = from
            .try_normalize(1e-9)
            .map_or(0.0, |out| out.dot(residual));
        (radius, outward, residual.norm_squared())
    };
    let mut all: Vec<(f64, f64, f64)> = views
        .flat_map(|view| view.corners.iter().map(along))
        .collect();
    if all.len() < FEWEST {
        return None;
    }
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = all.iter().map(|(_, _, squared)| squared).sum();
    let explained = all.chunks(all.len().div_ceil(RINGS)).map(|ring| {
        let sum: f64 = ring.iter().map(|(_, outward, _)| outward).sum();
        sum * sum / ring.len() as f64
    });
    Some(explained.sum::<f64>() / total.max(1e-300))
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::Random;
    use super::*;
    use crate::calibration::Face;
    use nalgebra::Point2;

    /// Residuals over a picture of 640 x 480: noise, and what goes with the radius.
    fn residuals(noise: f64, systematic: f64) -> ViewResiduals {
        let mut random = Random(5);
        let corner = |_| {
            let pixel = Point2::new(random.between(0.0, 640.0), random.between(0.0, 480.0));
            let from = pixel.coords - Vector2::new(320.0, 240.0);
            let wave = systematic * (from.norm() / 40.0).sin();
            let random_part = Vector2::new(random.normal(), random.normal()) * noise;
            (pixel, from.normalize() * wave + random_part)
        };
        ViewResiduals {
            camera: 0,
            placement: 0,
            face: Face::Front,
            corners: (0..1000).map(corner).collect(),
        }
    }

    #[test]
    fn residuals_that_go_with_the_radius_are_told_from_noise() {
        let part = |noise, systematic| {
            let view = residuals(noise, systematic);
            radial_part(std::iter::once(&view), Vector2::new(320.0, 240.0)).unwrap()
        };
        let of_noise = RINGS as f64 / 2000.0;
        assert!(part(0.3, 0.0) < OF_NOISE * of_noise, "{}", part(0.3, 0.0));
        assert!(part(0.3, 1.0) > 0.25, "{}", part(0.3, 1.0));
        let mut few = residuals(0.3, 1.0);
        few.corners.truncate(FEWEST - 1);
        assert_eq!(radial_part(std::iter::once(&few), Vector2::zeros()), None);
    }
}

//! What a cell's colour says by itself: object (positive) or backdrop (negative). The backdrop may stand in
//! a shadow, which takes light in proportion and keeps the colour nearly, and may catch a little light that
//! the object throws back.

use super::Parameters;
use super::cells::Cells;
use super::photometry::Photometry;
use crate::image::{Grid, srgb};

/// Evidence is cut off here: one cell cannot outweigh all its neighbours.
const STRONGEST: f32 = 20.0;

/// What the cells say.
pub(super) struct Evidence {
    /// Positive for object, negative for backdrop.
    pub object: Grid<f32>,
}

/// Weighs all cells.
pub(super) fn of_cells(
    cells: &Cells,
    photometry: &Photometry,
    parameters: &Parameters,
) -> Evidence {
    let weigh = |i: usize| {
        if !cells.in_volume.pixels()[i] {
            return -STRONGEST;
        }
        let plate = photometry.expected(cells.plate.pixels()[i]);
        Light::new(cells.picture.pixels()[i], plate, photometry.noise).evidence(parameters)
    };
    let n = cells.picture.pixels().len();
    let object = (0..n).map(weigh).collect();
    Evidence {
        object: Grid::from_pixels(cells.picture.width(), cells.picture.height(), object),
    }
}

/// A cell in linear light.
struct Light {
    picture: [f32; 3],
    plate: [f32; 3],
    variance: [f32; 3],
}

impl Light {
    fn new(picture: [f32; 3], plate: [f32; 3], noise: [f32; 3]) -> Self {
        Self {
            picture: picture.map(srgb::decode),
            plate: plate.map(srgb::decode),
            variance: std::array::from_fn(|c| {
                // The encoding's slope turns noise of encoded values into noise of light.
                let slope = srgb::decode(plate[c] + 1.0) - srgb::decode((plate[c] - 1.0).max(0.0));
                (noise[c] * slope / 2.0).powi(2) + 1e-9
            }),
        }
    }

    fn evidence(&self, parameters: &Parameters) -> f32 {
        let (share, _) = self.fit(|c| self.variance[c] + (0.01 * self.plate[c]).powi(2));
        let taken = (1.0 - share).clamp(0.0, 1.0);
        let (share, misfit) = self.fit(|c| {
            let tint = (0.01 + parameters.shadow_tint * taken) * self.plate[c];
            self.variance[c] + tint * tint
        });
        let threshold = parameters.significance.powi(2);
        let brightness = if share > 1.0 {
            self.brighter(share, parameters.spill)
        } else {
            darker(share, parameters.darkest_shadow, threshold)
        };
        (misfit + brightness - threshold).clamp(-STRONGEST, STRONGEST)
    }

    /// The multiple of the plate that is nearest to the picture, and the misfit that remains (a sum of
    /// squared standard deviations).
    fn fit(&self, variance: impl Fn(usize) -> f32) -> (f32, f32) {
        let (mut cross, mut square) = (0.0, 1e-12);
        for c in 0..3 {
            let weight = 1.0 / variance(c);
            cross += weight * self.picture[c] * self.plate[c];
            square += weight * self.plate[c] * self.plate[c];
        }
        let share = cross / square;
        let misfit = (0..3)
            .map(|c| (self.picture[c] - share * self.plate[c]).powi(2) / variance(c))
            .sum();
        (share, misfit)
    }

    /// Light beyond what the object may throw back counts against the backdrop.
    fn brighter(&self, share: f32, spill: f32) -> f32 {
        let variance: f32 = (0..3)
            .map(|c| self.variance[c] / (self.plate[c] * self.plate[c] + 1e-6))
            .sum::<f32>()
            / 9.0;
        (share - 1.0).powi(2) / (variance + (spill / 4.0).powi(2))
    }
}

/// A shadow of any depth down to the darkest costs little; below that the cost rises to certainty.
fn darker(share: f32, darkest: f32, threshold: f32) -> f32 {
    if share >= darkest {
        0.9 * threshold * (1.0 - share) / (1.0 - darkest)
    } else {
        threshold * (0.9 + 4.0 * (darkest - share) / darkest)
    }
}

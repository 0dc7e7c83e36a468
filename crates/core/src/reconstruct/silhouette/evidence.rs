//! Computes what a cell's colour alone says: object (positive) or backdrop (negative). The backdrop may lie in a
//! shadow, which removes a share of the light and almost keeps the colour, and may receive a little light that the
//! object reflects.

use super::Parameters;
use super::cells::Cells;
use super::photometry::Photometry;
use crate::array::three;
use crate::image::{Grid, PixelRect, srgb};
use rayon::prelude::*;

/// Evidence is cut off here: one cell cannot outweigh all its neighbours.
pub(super) const STRONGEST: f32 = 20.0;
/// How much a piece leans to the object that may be a shadow, over what would make it one whatever its edges.
pub(super) const LEAN: f32 = 3.0;
/// Shade that soft light casts far around an object, as a share of the light: it says nothing.
const SLIGHT: f32 = 0.2;
/// Light added to both sides of a ratio, so that black over black says nothing.
const DARK: f32 = 0.003;

/// Sum of squared standard deviations (of three channels) below which a cell agrees with the background and is not
/// looked at more closely: 19 in 20 cells that show the backdrop alone.
const AGREES: f32 = 7.8;

/// Rows of cells that are worth a thread.
const ROWS: usize = 32;

/// Weighs all cells: positive for object, negative for backdrop.
pub(super) fn of_cells(
    cells: &Cells,
    photometry: &Photometry,
    parameters: &Parameters,
) -> Grid<f32> {
    let (columns, rows) = (cells.picture.width(), cells.picture.height());
    // A leaning so slight that it outweighs the boundary of a piece with abrupt edges and yields to that of a
    // piece with soft ones, for any size of piece.
    let inside: usize = cells.in_volume.iter().map(|r| r.len()).sum();
    let hint = LEAN * parameters.smoothness / (inside as f32).sqrt().max(1.0);
    let mut object = Grid::filled(columns, rows, -STRONGEST);
    let threshold = parameters.significance.powi(2);
    let weighed = object.pixels_mut().par_chunks_mut(columns.max(1));
    let weighed = weighed.zip(&cells.in_volume).enumerate();
    weighed.with_min_len(ROWS).for_each(|(y, (row, inside))| {
        let pictures = &cells.picture.row(y)[inside.clone()];
        let plates = &cells.plate.row(y)[inside.clone()];
        let row = &mut row[inside.clone()];
        for ((object, &picture), &plate) in row.iter_mut().zip(pictures).zip(plates) {
            let deviation = photometry.deviation(picture, plate);
            *object = if deviation < AGREES {
                deviation - threshold
            } else {
                Light::new(picture, plate, photometry).evidence(parameters, hint)
            };
        }
    });
    object
}

/// The rectangle, in cells, around all that does not clearly show the backdrop, with a few cells of backdrop
/// around it; `None` where everything does.
pub(super) fn suspicious(evidence: &Grid<f32>) -> Option<PixelRect> {
    const MARGIN: usize = 6;
    let (columns, rows) = (evidence.width(), evidence.height());
    evidence
        .extent(PixelRect::whole(columns, rows), |&e| e > -STRONGEST / 2.0)
        .map(|rect| rect.grown(MARGIN, columns, rows))
}

/// How the light of cells compares with the background's.
pub(super) struct Ratios {
    /// Logarithm of the picture's light over the expected, per channel: flat across a shadow's soft edge,
    /// steep at the object's.
    pub log_ratio: Grid<[f32; 3]>,
    /// Variance of that logarithm.
    pub variance: Grid<[f32; 3]>,
}

/// Compares all cells; those that are as expected have no ratio and no noise.
pub(super) fn ratios(cells: &Cells, photometry: &Photometry) -> Ratios {
    let (columns, rows) = (cells.picture.width(), cells.picture.height());
    let mut ratios = Ratios {
        log_ratio: Grid::filled(columns, rows, [0.0; 3]),
        variance: Grid::filled(columns, rows, [0.0; 3]),
    };
    let width = columns.max(1);
    let rows = ratios.log_ratio.pixels_mut().par_chunks_mut(width);
    let rows = rows.zip(ratios.variance.pixels_mut().par_chunks_mut(width));
    rows.enumerate()
        .with_min_len(ROWS)
        .for_each(|(y, (log_ratios, variances))| {
            let cells = cells.picture.row(y).iter().zip(cells.plate.row(y));
            for (x, (&picture, &plate)) in cells.enumerate() {
                if photometry.deviation(picture, plate) >= AGREES {
                    let light = Light::new(picture, plate, photometry);
                    log_ratios[x] = light.log_ratio();
                    variances[x] = light.log_variance();
                }
            }
        });
    ratios
}

/// A cell in linear light.
struct Light {
    picture: [f32; 3],
    expected: [f32; 3],
    variance: [f32; 3],
}

impl Light {
    fn new(picture: [f32; 3], plate: [f32; 3], photometry: &Photometry) -> Self {
        let backdrop = srgb::decode_pixel(plate);
        Self {
            picture: srgb::decode_pixel(picture),
            expected: three(|c| photometry.gain[c] * backdrop[c]),
            variance: three(|c| photometry.variance_of_light(c, plate[c])),
        }
    }

    fn log_ratio(&self) -> [f32; 3] {
        three(|c| ((self.picture[c] + DARK) / (self.expected[c] + DARK)).ln())
    }

    fn log_variance(&self) -> [f32; 3] {
        three(|c| self.variance[c] / (self.expected[c].min(self.picture[c]) + DARK).powi(2))
    }

    fn evidence(&self, parameters: &Parameters, hint: f32) -> f32 {
        let (share, _) = self.fit(0.01);
        let taken = (1.0 - share).clamp(0.0, 1.0);
        let (share, misfit) = self.fit(0.01 + parameters.shadow_tint * taken);
        let threshold = parameters.significance.powi(2);
        let brightness = if share > 1.0 {
            self.brighter(share, parameters, hint)
        } else {
            self.darker(share, parameters, hint)
        };
        (misfit + brightness - threshold).clamp(-STRONGEST, STRONGEST)
    }

    /// The multiple of the background that is nearest to the picture, and the misfit that remains (a sum of
    /// squared standard deviations), where each channel may be off by `tint` of its light.
    fn fit(&self, tint: f32) -> (f32, f32) {
        let variance = |c: usize| self.variance[c] + (tint * self.expected[c]).powi(2);
        let (mut cross, mut square) = (0.0, 1e-12);
        for c in 0..3 {
            let weight = 1.0 / variance(c);
            cross += weight * self.picture[c] * self.expected[c];
            square += weight * self.expected[c] * self.expected[c];
        }
        let share = cross / square;
        let misfit = (0..3)
            .map(|c| (self.picture[c] - share * self.expected[c]).powi(2) / variance(c))
            .sum();
        (share, misfit)
    }

    /// Light that the object throws back says little; far more light than that is the object's own.
    fn brighter(&self, share: f32, parameters: &Parameters, hint: f32) -> f32 {
        let threshold = parameters.significance.powi(2);
        let excess = (share - 1.0).powi(2);
        let noise = self.relative_variance();
        let weak = threshold * excess / (parameters.spill.powi(2) + threshold * noise);
        let sure = (share - 1.0 - 3.0 * parameters.spill).max(0.0).powi(2)
            / (noise + parameters.spill.powi(2) / threshold);
        weak.min(threshold + self.lean(share, hint)) + sure
    }

    /// Darkness may be a shadow or the object; only the deepest is surely the object.
    fn darker(&self, share: f32, parameters: &Parameters, hint: f32) -> f32 {
        let threshold = parameters.significance.powi(2);
        let noise = self.relative_variance();
        let weak = (1.0 - share).powi(2) / (noise + SLIGHT * SLIGHT / threshold);
        let sure = (parameters.darkest_shadow - share).max(0.0).powi(2)
            / (noise + (parameters.darkest_shadow / 6.0).powi(2));
        weak.min(threshold + self.lean(share, hint)) + sure
    }

    /// What a cell leans to that may as well be a shadow: on a coloured backdrop an object of exactly its hue
    /// is rare; on a grey one both are likely, the object the more the darker it is.
    fn lean(&self, share: f32, hint: f32) -> f32 {
        let light = self.expected;
        let (low, high) = (
            light[0].min(light[1]).min(light[2]),
            light[0].max(light[1]).max(light[2]),
        );
        let colour = ((1.0 - low / (high + 1e-6) - 0.3) / 0.4).clamp(0.0, 1.0);
        let dark = ((0.7 - share) / 0.3).clamp(-0.5, 1.0);
        hint * (dark * (1.0 - colour) - 2.0 * colour)
    }

    /// Variance of the share that a fit finds.
    fn relative_variance(&self) -> f32 {
        let information: f32 = (0..3)
            .map(|c| self.expected[c].powi(2) / self.variance[c])
            .sum();
        1.0 / (information + 1e-6)
    }
}

//! What a cell's colour says by itself: object (positive) or backdrop (negative). The backdrop may stand in
//! a shadow, which takes light in proportion and keeps the colour nearly, and may catch a little light that
//! the object throws back.

use super::Parameters;
use super::cells::Cells;
use super::photometry::Photometry;
use crate::image::{Grid, srgb};

/// Evidence is cut off here: one cell cannot outweigh all its neighbours.
pub(super) const STRONGEST: f32 = 20.0;
/// Light added to both sides of a ratio, so that black over black says nothing.
const DARK: f32 = 0.003;

/// What the cells say.
pub(super) struct Evidence {
    /// Positive for object, negative for backdrop.
    pub object: Grid<f32>,
    /// Logarithm of the picture's light over the expected, per channel: flat across a shadow's soft edge,
    /// steep at the object's.
    pub log_ratio: Grid<[f32; 3]>,
    /// Standard deviation of that logarithm.
    pub noise: Grid<[f32; 3]>,
}

/// Weighs all cells.
pub(super) fn of_cells(
    cells: &Cells,
    photometry: &Photometry,
    parameters: &Parameters,
) -> Evidence {
    let (columns, rows) = (cells.picture.width(), cells.picture.height());
    let mut evidence = Evidence {
        object: Grid::filled(columns, rows, -STRONGEST),
        log_ratio: Grid::filled(columns, rows, [0.0; 3]),
        noise: Grid::filled(columns, rows, [0.0; 3]),
    };
    for y in 0..rows {
        for x in cells.in_volume[y].clone() {
            let light = Light::new(cells.picture[(x, y)], cells.plate[(x, y)], photometry);
            evidence.object[(x, y)] = light.evidence(parameters);
            evidence.log_ratio[(x, y)] = light.log_ratio();
            evidence.noise[(x, y)] = light.log_noise();
        }
    }
    evidence
}

/// A cell in linear light.
struct Light {
    picture: [f32; 3],
    expected: [f32; 3],
    variance: [f32; 3],
}

impl Light {
    fn new(picture: [f32; 3], plate: [f32; 3], photometry: &Photometry) -> Self {
        Self {
            picture: picture.map(srgb::decode),
            expected: std::array::from_fn(|c| photometry.gain[c] * srgb::decode(plate[c])),
            variance: std::array::from_fn(|c| photometry.variance_of_light(c, plate[c])),
        }
    }

    fn log_ratio(&self) -> [f32; 3] {
        std::array::from_fn(|c| ((self.picture[c] + DARK) / (self.expected[c] + DARK)).ln())
    }

    fn log_noise(&self) -> [f32; 3] {
        std::array::from_fn(|c| {
            self.variance[c].sqrt() / (self.expected[c].min(self.picture[c]) + DARK)
        })
    }

    fn evidence(&self, parameters: &Parameters) -> f32 {
        let (share, _) = self.fit(0.01);
        let taken = (1.0 - share).clamp(0.0, 1.0);
        let (share, misfit) = self.fit(0.01 + parameters.shadow_tint * taken);
        let threshold = parameters.significance.powi(2);
        let brightness = if share > 1.0 {
            self.brighter(share, parameters.spill)
        } else {
            self.darker(share, parameters.darkest_shadow, threshold)
        };
        (misfit + brightness - threshold).clamp(-STRONGEST, STRONGEST)
    }

    /// The multiple of the plate that is nearest to the picture, and the misfit that remains (a sum of
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

    /// Light beyond what the object may throw back counts against the backdrop.
    fn brighter(&self, share: f32, spill: f32) -> f32 {
        (share - 1.0).powi(2) / (self.relative_variance() + (spill / 4.0).powi(2))
    }

    /// Variance of the share that a fit finds.
    fn relative_variance(&self) -> f32 {
        let information: f32 = (0..3)
            .map(|c| self.expected[c].powi(2) / self.variance[c])
            .sum();
        1.0 / (information + 1e-6)
    }

    /// What darkness says. On a coloured backdrop an object of exactly its hue is rare, and darkness alone is
    /// a shadow; on a grey one a shadow and a grey object look alike, and deeper darkness says more, until at
    /// the darkest shadow it is certain. In between the evidence is weak and the edges decide.
    fn darker(&self, share: f32, darkest: f32, threshold: f32) -> f32 {
        let beyond_noise = (1.0 - share).powi(2) / (self.relative_variance() + 0.02f32.powi(2));
        let (low, high) = self
            .expected
            .iter()
            .fold((f32::MAX, 0.0f32), |(l, h), &v| (l.min(v), h.max(v)));
        let colour = ((1.0 - low / (high + 1e-6) - 0.2) / 0.4).clamp(0.0, 1.0);
        let shadow = 0.12 * threshold * (1.0 + 2.0 * colour);
        if share < darkest {
            let sure = (darkest - share) / darkest;
            return threshold - shadow * (1.0 - sure) + 2.0 * threshold * sure;
        }
        // Up to the depth of shadow that is usual the backdrop is likelier, below it the object.
        let depth = ((1.0 - share) / (1.0 - darkest)).clamp(0.0, 1.0);
        let tilt = shadow * (1.0 - 1.6 * (1.0 - colour) * depth);
        beyond_noise.min(threshold - tilt)
    }
}

//! How picture and background differ where both show the backdrop: the drift of exposure and white balance, and the
//! sensor's noise, both estimated from the pictures themselves.

use super::cells::Cells;
use crate::image::{Mask, RgbImage, srgb};
use crate::statistics::upper_median;

/// What turns the background into the picture of the backdrop.
#[derive(Clone, Debug)]
pub(super) struct Photometry {
    /// Linear light of the picture over that of the background, per channel.
    pub gain: [f32; 3],
    /// Standard deviation of a cell's difference, in sRGB units, per channel.
    pub noise: [f32; 3],
    /// The same of a single pixel.
    pub pixel_noise: [f32; 3],
    /// Reciprocals of `noise`.
    inverse_noise: [f32; 3],
    /// Encoded values to expect of the picture by the background's, per channel.
    expected: [[f32; 256]; 3],
    /// Share of the cells around the volume that differ from the background by more than noise.
    pub mismatch: f32,
}

/// Fewest cells, or pairs of them, around the volume that are trusted on their own.
const FEWEST_REFERENCES: usize = 200;
/// Least noise that is assumed, in sRGB units: the rounding of one picture and the other.
const LEAST_NOISE: f32 = 0.4;

impl Photometry {
    /// Learns from the cells around the volume, or where those are few, from all.
    pub(super) fn estimate(
        (picture, plate): (&RgbImage, &RgbImage),
        hidden: Option<&Mask>,
        cells: &Cells,
    ) -> Self {
        let around = sample(cells, true);
        let reference = if around.len() >= FEWEST_REFERENCES {
            around
        } else {
            sample(cells, false)
        };
        let gain: [f32; 3] = std::array::from_fn(|c| gain_of_channel(cells, &reference, c));
        let linear = srgb::linear_from_srgb();
        let mut this = Self {
            gain,
            expected: gain.map(|gain| linear.map(|l| srgb::encode(gain * l))),
            noise: [LEAST_NOISE; 3],
            inverse_noise: [1.0 / LEAST_NOISE; 3],
            pixel_noise: [LEAST_NOISE; 3],
            mismatch: 0.0,
        };
        this.pixel_noise =
            std::array::from_fn(|c| this.noise_of_pixels((picture, plate), hidden, cells, c));
        let around = pairs(cells, true);
        this.noise = if around.len() >= FEWEST_REFERENCES {
            std::array::from_fn(|c| this.noise_of_cells(cells, &around, c))
        } else {
            // The object may be in most of the pairs. A mean has no more noise than what it is the mean of.
            let all = pairs(cells, false);
            std::array::from_fn(|c| this.noise_of_cells(cells, &all, c).min(this.pixel_noise[c]))
        };
        this.inverse_noise = this.noise.map(f32::recip);
        let differing = reference
            .iter()
            .filter(|&&i| this.differs(cells, i))
            .count();
        this.mismatch = differing as f32 / reference.len().max(1) as f32;
        this
    }

    /// Variance of the linear light of a cell where the background has the encoded value `plate`. A channel that
    /// is overexposed in the background says less.
    #[inline]
    pub(super) fn variance_of_light(&self, c: usize, plate: f32) -> f32 {
        self.variance(c, plate, self.noise[c])
    }

    /// The same of a single pixel.
    #[inline]
    pub(super) fn variance_of_pixel(&self, c: usize, plate: f32) -> f32 {
        self.variance(c, plate, self.pixel_noise[c])
    }

    #[inline]
    fn variance(&self, c: usize, plate: f32, noise: f32) -> f32 {
        let clipped = ((plate - 248.0) / 7.0).clamp(0.0, 1.0) * 0.05;
        let noise = noise * slope(plate) * self.gain[c].max(1.0);
        noise * noise + clipped * clipped + 1e-9
    }

    /// How far the picture is from what the background leads to expect, in encoded units.
    #[inline]
    fn error(&self, picture: f32, plate: f32, c: usize) -> f32 {
        (srgb::decode(picture) - self.gain[c] * srgb::decode(plate)) / slope(plate)
    }

    /// The encoded value to expect of the picture where the background has the encoded value `plate`.
    #[inline]
    pub(super) fn expected(&self, c: usize, plate: f32) -> f32 {
        let low = plate.clamp(0.0, 254.0) as usize;
        let [a, b] = [self.expected[c][low], self.expected[c][low + 1]];
        a + (b - a) * (plate - low as f32)
    }

    /// How far a cell is from what the background leads to expect, as a sum of squared standard deviations: a
    /// quick look that spares most cells a closer one.
    #[inline]
    pub(super) fn deviation(&self, picture: [f32; 3], plate: [f32; 3]) -> f32 {
        let squared = |c: usize| {
            let difference = picture[c] - self.expected(c, plate[c]);
            (difference * self.inverse_noise[c]).powi(2)
        };
        squared(0) + squared(1) + squared(2)
    }

    fn differs(&self, cells: &Cells, i: usize) -> bool {
        let (picture, plate) = (cells.picture.pixels()[i], cells.plate.pixels()[i]);
        (0..3).any(|c| {
            let difference = picture[c] - self.expected(c, plate[c]);
            difference.abs() > 6.0 * self.noise[c] + 0.03 * plate[c]
        })
    }

    /// Noise of the difference of two cells' errors.
    fn noise_of_cells(&self, cells: &Cells, pairs: &[[usize; 2]], c: usize) -> f32 {
        let (picture, plate) = (cells.picture.pixels(), cells.plate.pixels());
        let error = |i: usize| self.error(picture[i][c], plate[i][c], c);
        let differences = pairs.iter().map(|&[a, b]| (error(a) - error(b)).abs());
        deviation_of_pairs(&mut differences.collect::<Vec<_>>())
    }

    /// The same of pixels, two columns apart, which a colour filter array treats alike.
    fn noise_of_pixels(
        &self,
        (picture, plate): (&RgbImage, &RgbImage),
        hidden: Option<&Mask>,
        cells: &Cells,
        c: usize,
    ) -> f32 {
        let r = cells.region;
        let (linear, slopes) = (srgb::linear_from_srgb(), srgb::derivatives());
        let mut differences = Vec::with_capacity(10_000);
        for y in (r.y0..r.y1).step_by((r.height() / 32).max(1)) {
            let is_seen = |x: &usize| {
                let at = |x: usize| hidden.is_none_or(|mask| mask[(r.x0 + x, y)] < 128);
                at(*x) && at(*x + 2)
            };
            let picture = &picture.row(y)[r.x0..r.x1];
            let plate = &plate.row(y)[r.x0..r.x1];
            let error = |x: usize| {
                let (picture, plate) = (usize::from(picture[x][c]), usize::from(plate[x][c]));
                (linear[picture] - self.gain[c] * linear[plate]) / slopes[plate]
            };
            let pairs = (0..r.width().saturating_sub(2)).step_by(9).filter(is_seen);
            differences.extend(pairs.map(|x| (error(x + 2) - error(x)).abs()));
        }
        deviation_of_pairs(&mut differences)
    }
}

/// Linear light over encoded units at an encoded value.
#[inline]
fn slope(encoded: f32) -> f32 {
    srgb::derivatives()[(encoded + 0.5).clamp(0.0, 255.0) as usize]
}

/// Every how many columns and rows of a grid a sample makes about `samples`.
fn stride(cells: usize, samples: usize) -> usize {
    ((cells as f32 / samples as f32).sqrt() as usize).max(1)
}

/// A sample of the cells, by index: those outside the volume, or all.
fn sample(cells: &Cells, outside_only: bool) -> Vec<usize> {
    let (columns, rows) = (cells.picture.width(), cells.picture.height());
    let step = stride(columns * rows, 12_000);
    let mut sample = Vec::with_capacity(columns * rows / (step * step) + columns + rows);
    for y in (0..rows).step_by(step) {
        let inside = &cells.in_volume[y];
        let is_seen = |x: &usize| !cells.is_hidden(y * columns + x);
        let keep = |x: &usize| is_seen(x) && (!outside_only || !inside.contains(x));
        sample.extend(
            (0..columns)
                .step_by(step)
                .filter(keep)
                .map(|x| y * columns + x),
        );
    }
    sample
}

/// A sample of the pairs of cells, by index, that lie 20 pixels apart in a row or a column: near enough for
/// shadows and spill to cancel, and further than the blocks of a JPEG, whose errors neighbours share. Those
/// with both cells outside the volume, or all: in a small picture most pairs touch the object.
fn pairs(cells: &Cells, outside_only: bool) -> Vec<[usize; 2]> {
    let (columns, rows) = (cells.picture.width(), cells.picture.height());
    let lag = (20 / cells.size).max(1);
    let step = stride(columns * rows, 5_000);
    let eligible = |x: usize, y: usize| {
        x < columns
            && y < rows
            && !(outside_only && cells.in_volume[y].contains(&x))
            && !cells.is_hidden(y * columns + x)
    };
    let mut pairs = Vec::with_capacity(2 * (columns.div_ceil(step) * rows.div_ceil(step)));
    for y in (0..rows).step_by(step) {
        for x in (0..columns).step_by(step).filter(|&x| eligible(x, y)) {
            let cell = y * columns + x;
            let partners = [(x + lag, y), (x, y + lag)];
            let partners = partners.into_iter().filter(|&(x, y)| eligible(x, y));
            pairs.extend(partners.map(|(x, y)| [cell, y * columns + x]));
        }
    }
    pairs
}

/// The most frequent ratio of picture to background, then the median of those near it: half of the cells may be
/// object, whose ratios spread.
fn gain_of_channel(cells: &Cells, reference: &[usize], c: usize) -> f32 {
    const BINS: usize = 240;
    const BIN: f32 = 0.01;
    const WINDOW: usize = 7;
    let mut log_ratios: Vec<f32> = reference
        .iter()
        .map(|&i| (cells.picture.pixels()[i][c], cells.plate.pixels()[i][c]))
        .filter(|(picture, plate)| (3.0..250.0).contains(plate) && (1.0..252.0).contains(picture))
        .map(|(picture, plate)| (srgb::decode(picture) / srgb::decode(plate)).ln())
        .collect();
    let mut histogram = [0u32; BINS];
    for r in &log_ratios {
        let bin = (r / BIN + BINS as f32 / 2.0).floor();
        if (0.0..BINS as f32).contains(&bin) {
            histogram[bin as usize] += 1;
        }
    }
    let count = |b: usize| histogram[b..b + WINDOW].iter().sum::<u32>();
    let fullest = (0..BINS - WINDOW)
        .max_by_key(|&b| (count(b), std::cmp::Reverse(b)))
        .unwrap_or(0);
    let mode = (fullest as f32 + (WINDOW as f32 - BINS as f32) / 2.0) * BIN;
    log_ratios.retain(|r| (r - mode).abs() < 0.1);
    let centre = upper_median(&mut log_ratios).unwrap_or(0.0);
    log_ratios.retain(|r| (r - centre).abs() < 0.05);
    let n = log_ratios.len().max(1) as f32;
    (log_ratios.iter().sum::<f32>() / n).exp()
}

/// Standard deviation of one value from absolute differences of two; the median finds which differences are
/// noise, their mean square is not quantised as the median is.
fn deviation_of_pairs(differences: &mut [f32]) -> f32 {
    let rough = 1.4826 * upper_median(differences).unwrap_or(0.0) + 0.5;
    let small = differences.iter().filter(|&&d| d < 3.0 * rough);
    let (sum, n) = small.fold((0.0, 0u32), |(sum, n), d| (sum + d * d, n + 1));
    (sum / (2 * n.max(1)) as f32).sqrt().max(LEAST_NOISE)
}

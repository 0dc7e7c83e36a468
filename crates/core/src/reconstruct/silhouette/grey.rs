//! Finds the object in pictures without colour. What is as bright as the background may be object as well, and what is
//! darker may be shadow or object, so only the outline decides: compared with the background, the backdrop and any
//! shadow on it change softly, and only the object's outline is abrupt.

use super::Parameters;
use super::cells::Cells;
use super::evidence::{LEAN, Ratios};
use super::photometry::Photometry;
use super::segment;
use crate::image::Grid;
use crate::statistics::upper_median;

/// Cells beside the rectangle's border that are backdrop: all around it agrees with the background.
const BORDER: usize = 2;
/// How much cheaper a boundary becomes where the light changes; more than beside colours, which decide there.
const SHARPNESS: i32 = 4;
/// Evidence below which a cell is not surely object by itself.
const UNSURE: f32 = 1.0;

/// Share of the cells that may be coloured in a scene without colours: noise has outliers.
const COLOURED: f32 = 0.02;
/// Standard deviations of noise that a cell may be off grey.
const OFF_GREY: f32 = 3.0;
/// How far the light on a backdrop may be from neutral, as a share of its green value.
const MOST_TINT: f32 = 0.1;
/// Values that tell the backdrop's colour.
const SAMPLES: usize = 5_000;
/// A darker backdrop, or a cell that is nearly clipped in all channels, shows no tint.
const SHOWS_TINT: std::ops::Range<f32> = 32.0..248.0;

/// Whether neither the backdrop nor what surely differs from it has any colour but for noise and the light's tint. Of
/// the picture only that counts: a small coloured object leaves most cells grey.
pub(super) fn is_grey(cells: &Cells, evidence: &Grid<f32>, photometry: &Photometry) -> bool {
    let backdrop: [f32; 3] = std::array::from_fn(|c| median(&cells.plate, c));
    let lit: [f32; 3] = std::array::from_fn(|c| photometry.expected(c, backdrop[c]));
    let [plate_tint, picture_tint] = [tint(backdrop), tint(lit)];
    if plate_tint
        .iter()
        .any(|share| (share - 1.0).abs() > MOST_TINT)
    {
        return false;
    }
    let plate = cells.plate.pixels().iter();
    let picture = cells.picture.pixels().iter().zip(evidence.pixels());
    let differing = picture.filter(|(_, evidence)| **evidence > 0.0);
    are_grey(plate, plate_tint, photometry)
        && are_grey(differing.map(|(v, _)| v), picture_tint, photometry)
}

/// Median of a channel, of about `SAMPLES` values.
fn median(values: &Grid<[f32; 3]>, channel: usize) -> f32 {
    let step = (values.pixels().len() / SAMPLES).max(1);
    let sample = values.pixels().iter().step_by(step);
    let mut values: Vec<f32> = sample.map(|v| v[channel]).collect();
    upper_median(&mut values).unwrap_or(0.0)
}

/// Each channel of something grey over its green one.
fn tint(grey: [f32; 3]) -> [f32; 3] {
    match grey[1] >= SHOWS_TINT.start {
        true => grey.map(|value| value / grey[1]),
        false => [1.0; 3],
    }
}

/// Whether all but a few of the values have a tint and no other colour.
fn are_grey<'a>(
    values: impl Iterator<Item = &'a [f32; 3]>,
    tint: [f32; 3],
    photometry: &Photometry,
) -> bool {
    let is_coloured = |v: &[f32; 3]| {
        let is_clipped = v.iter().all(|&value| value >= SHOWS_TINT.end);
        let is_off = |c: usize| (v[c] - tint[c] * v[1]).abs() > OFF_GREY * photometry.noise[c];
        !is_clipped && (0..3).any(is_off)
    };
    let (coloured, all) = values.fold((0u32, 0u32), |(coloured, all), v| {
        (coloured + u32::from(is_coloured(v)), all + 1)
    });
    coloured as f32 <= COLOURED * all as f32
}

/// Decides all cells by the outline around them.
pub(super) fn decide(
    cells: &Cells,
    evidence: &Grid<f32>,
    ratios: &Ratios,
    parameters: &Parameters,
) -> Grid<bool> {
    let leaning = leaning(cells, evidence, parameters);
    segment::decide(&leaning, ratios, SHARPNESS, parameters)
}

/// Share of the object's cells that only the outline distinguishes from the backdrop.
pub(super) fn told_by_outline(object: &Grid<bool>, evidence: &Grid<f32>) -> f32 {
    let cells = object.pixels().iter().zip(evidence.pixels());
    let (unsure, all) = cells
        .filter(|&(&is_object, _)| is_object)
        .fold((0u32, 0u32), |(unsure, all), (_, &evidence)| {
            (unsure + u32::from(evidence < UNSURE), all + 1)
        });
    unsure as f32 / all.max(1) as f32
}

/// What is not surely object leans to it, so slightly that a piece of any size within a soft boundary is backdrop.
fn leaning(cells: &Cells, evidence: &Grid<f32>, parameters: &Parameters) -> Grid<f32> {
    let (columns, rows) = (evidence.width(), evidence.height());
    let lean = LEAN * parameters.smoothness / ((columns * rows) as f32).sqrt();
    let is_within = |x: usize, y: usize| {
        let margin = x.min(y).min(columns - 1 - x).min(rows - 1 - y);
        margin >= BORDER && cells.in_volume[y].contains(&x)
    };
    Grid::from_fn(columns, rows, |x, y| match is_within(x, y) {
        true => evidence[(x, y)].max(lean),
        false => evidence[(x, y)],
    })
}

#[cfg(test)]
mod tests {
    use super::super::{evidence, region::Region};
    use super::*;
    use crate::image::{PixelRect, RgbImage};
    use nalgebra::Point2;

    const SIZE: (usize, usize) = (120, 90);

    /// A picture of a backdrop with a disc of a radius and a colour, with one level of noise in red and blue.
    fn noisy(seed: usize, backdrop: [u8; 3], radius: f64, disc: [u8; 3]) -> RgbImage {
        RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| {
            let is_disc = (x as f64 - 60.0).hypot(y as f64 - 45.0) < radius;
            let [r, g, b] = if is_disc { disc } else { backdrop };
            let mixed = mixed(seed + x + 131 * y);
            let noisy = |value: u8, of: u64| value - 1 + (of % 3) as u8;
            [noisy(r, mixed), g, noisy(b, mixed / 3)]
        })
    }

    /// A number that looks random (SplitMix64).
    fn mixed(number: usize) -> u64 {
        let mut mixed = (number as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    /// Whether a disc on a backdrop, pictured under light that has another tint than the background's, is grey.
    fn is_disc_grey(backdrop: [[u8; 3]; 2], radius: f64, disc: [u8; 3]) -> bool {
        let plate = noisy(1, backdrop[0], 0.0, disc);
        let picture = noisy(1_000_000, backdrop[1], radius, disc);
        let corners = [(30.0, 15.0), (90.0, 15.0), (90.0, 75.0), (30.0, 75.0)];
        let region = Region {
            rect: PixelRect {
                x0: 30,
                y0: 15,
                x1: 91,
                y1: 76,
            },
            outline: corners.map(|(x, y)| Point2::new(x, y)).to_vec(),
            picture: SIZE,
        };
        let cells = Cells::new((&picture, &plate), None, &region, 1);
        let photometry = Photometry::estimate((&picture, &plate), None, &cells);
        let evidence = evidence::of_cells(&cells, &photometry, &Parameters::default());
        is_grey(&cells, &evidence, &photometry)
    }

    #[test]
    fn noise_is_no_colour() {
        assert!(is_disc_grey([[120; 3]; 2], 20.0, [200; 3]));
        assert!(is_disc_grey([[120; 3]; 2], 20.0, [40; 3]));
    }

    #[test]
    fn the_tint_of_the_light_is_no_colour() {
        let tinted = [[126, 120, 114], [114, 120, 126]];
        assert!(is_disc_grey(tinted, 20.0, [190, 200, 210]));
    }

    #[test]
    fn a_coloured_object_has_colour_however_small() {
        for radius in [3.0, 20.0] {
            assert!(!is_disc_grey([[120; 3]; 2], radius, [200, 60, 60]));
        }
    }

    #[test]
    fn a_coloured_backdrop_has_colour() {
        assert!(!is_disc_grey([[60, 80, 160]; 2], 20.0, [200; 3]));
    }
}

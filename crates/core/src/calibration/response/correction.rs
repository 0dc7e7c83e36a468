//! Tests whether a smooth correction of each pixel would improve depth: one is fitted to all views but one, and must
//! predict that one.

use crate::calibration::Intrinsics;
use nalgebra::{SMatrix, SVector};

/// Terms of a polynomial of degree 3 in the picture's two coordinates.
const TERMS: usize = 10;
/// How much better views must be predicted that the fit did not see.
const PAYS: f64 = 0.9;
/// Side in pixels of the blocks whose means are compared: what is left of the noise there is little.
const BLOCK: f64 = 16.0;
/// What the correction is expected to be, at 1 m, in metres: the more so, the fewer pixels say otherwise.
const EXPECTED: f64 = 0.002;

/// A smooth correction, and what it would do to views that it was not fitted to.
#[derive(serde::Serialize, Clone, Debug, PartialEq)]
pub struct Correction {
    /// Coefficients of 1, u, v, u², uv, v², u³, u²v, uv², v³ with u and v from -1 to 1 over the picture: metres by
    /// which depth is too large at 1 m; it grows with z².
    pub coefficients: [f64; TERMS],
    /// Root mean square of the blocks' errors of views held out, at 1 m, in metres, without it.
    pub held_out: f64,
    /// The same with it.
    pub held_out_corrected: f64,
    /// Whether it pays: views held out are predicted better by a tenth or more.
    pub pays: bool,
}

type NormalEquations = (SMatrix<f64, TERMS, TERMS>, SVector<f64, TERMS>);

impl Correction {
    /// Fits a correction to views: of each, pixels with their error over z².
    pub(super) fn weigh(lens: &Intrinsics, views: &[Vec<([f64; 2], f64)>]) -> Self {
        let views: Vec<Vec<Block>> = views.iter().map(|samples| blocks(lens, samples)).collect();
        let normals: Vec<NormalEquations> = views.iter().map(|view| normal(view)).collect();
        let all = normals
            .iter()
            .fold(empty(), |sum, n| (sum.0 + n.0, sum.1 + n.1));
        let (mut before, mut after, mut count) = (0.0, 0.0, 0.0);
        for (view, own) in views.iter().zip(&normals) {
            let others = (all.0 - own.0, all.1 - own.1);
            let coefficients = solved(&others);
            for block in view {
                before += block.error.powi(2);
                after += (block.error - coefficients.dot(&block.terms)).powi(2);
                count += 1.0;
            }
        }
        let rms = |sum: f64| (sum / f64::max(count, 1.0)).sqrt();
        let (held_out, held_out_corrected) = (rms(before), rms(after));
        Self {
            coefficients: solved(&all).into(),
            held_out,
            held_out_corrected,
            pays: views.len() >= 5 && held_out_corrected < PAYS * held_out,
        }
    }
}

/// The mean of some neighbouring pixels.
struct Block {
    terms: SVector<f64, TERMS>,
    error: f64,
}

fn blocks(lens: &Intrinsics, samples: &[([f64; 2], f64)]) -> Vec<Block> {
    const FEWEST: f64 = 64.0;
    let mut sums: std::collections::BTreeMap<[usize; 2], [f64; 4]> = Default::default();
    for (pixel, error) in samples {
        let sum = sums.entry(pixel.map(|v| (v / BLOCK) as usize)).or_default();
        for (total, value) in sum.iter_mut().zip([pixel[0], pixel[1], *error, 1.0]) {
            *total += value;
        }
    }
    let full = sums.into_values().filter(|sum| sum[3] >= FEWEST);
    full.map(|[x, y, error, count]| Block {
        terms: terms(lens, [x / count, y / count]),
        error: error / count,
    })
    .collect()
}

fn terms(lens: &Intrinsics, pixel: [f64; 2]) -> SVector<f64, TERMS> {
    let u = 2.0 * pixel[0] / lens.width as f64 - 1.0;
    let v = 2.0 * pixel[1] / lens.height as f64 - 1.0;
    SVector::from([
        1.0,
        u,
        v,
        u * u,
        u * v,
        v * v,
        u * u * u,
        u * u * v,
        u * v * v,
        v * v * v,
    ])
}

fn empty() -> NormalEquations {
    (SMatrix::zeros(), SVector::zeros())
}

fn normal(view: &[Block]) -> NormalEquations {
    view.iter().fold(empty(), |(matrix, right), block| {
        let outer = block.terms * block.terms.transpose();
        (matrix + outer, right + block.terms * block.error)
    })
}

fn solved(normal: &NormalEquations) -> SVector<f64, TERMS> {
    // Errors of blocks are some tenths of a millimetre; so much is believed of the coefficients beforehand.
    const NOISE: f64 = 5e-4;
    let ridge = SMatrix::identity() * (NOISE / EXPECTED).powi(2);
    let solution = (normal.0 + ridge).cholesky().map(|c| c.solve(&normal.1));
    solution.unwrap_or_else(SVector::zeros)
}

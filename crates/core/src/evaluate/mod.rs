//! Compares a model with the truth or with another model: distances, figures, and pictures of them. Files are only
//! read here; the results are returned as data.

mod against_truth;
mod appearance;
mod difference;
mod expected;
mod figures;
pub mod load;
mod near;
pub mod picture;
mod rim;
mod sample;
mod statistics;
mod surface;
pub mod table;
#[cfg(test)]
mod tests;
mod wall;

pub use against_truth::{Evaluation, ExpectedBin, ProvenanceFigures, Solid, evaluate};
pub use difference::{
    Difference, DifferenceParameters, Place, ProvenanceChange, ProvenanceChanges, Side, difference,
};
pub use expected::Expected;
pub use figures::{Angles, Bias, FScore, Figures, Part, RimFigures, WallFigures};
pub use sample::{Sample, sample};
pub use statistics::Summary;

use std::path::PathBuf;

/// What can be wrong with what is to be evaluated.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Error {
    /// A file cannot be read.
    #[error("{}: {cause}", path.display())]
    Io {
        path: PathBuf,
        cause: std::io::Error,
    },
    /// A file's name ends in an unknown extension.
    #[error("{}: the file's name ends in {extension}, expected ply or glb", path.display())]
    UnknownFormat { path: PathBuf, extension: String },
    /// A file is not what its ending says.
    #[error("{}: {what}", path.display())]
    Format {
        path: PathBuf,
        /// What is wrong, and where.
        what: String,
    },
    /// A mesh has nothing to measure.
    #[error("the {what} has no surface above {floor_mm} mm of height")]
    NoSurface { what: &'static str, floor_mm: f64 },
    /// A mesh that is to be compared has no area at all.
    #[error("the {what} has no area to compare")]
    NoArea { what: &'static str },
}

/// What is measured, and how closely. Lengths are finite numbers of 0 or more, where no other range is named; the
/// commands check what they let a person set.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// Points on each surface, 1 to 20 000 000. Default 200 000.
    pub samples: usize,
    /// What is at or below this height (of z, in millimetres) is left out, for no camera sees it; any
    /// finite number. Default 1.5.
    pub floor_mm: f64,
    /// Thresholds of the F-scores, in millimetres, each above 0. Default 0.5, 1 and 2.
    pub thresholds_mm: Vec<f64>,
    /// The truth's concave part lies deeper than this inside its convex hull, in millimetres. Default 4.
    pub concave_depth_mm: f64,
    /// Distances along the normal and errors of thickness count as at most this, in millimetres, above 0. Default 30.
    pub cap_mm: f64,
    /// A rim bends outwards with a radius below this, in millimetres, above 0. Default 3.
    pub rim_radius_mm: f64,
    /// What is nearer to a rim than this is near it, in millimetres. Default 3.
    pub rim_width_mm: f64,
    /// Largest thickness of a wall, in millimetres, above 0. Default 10.
    pub wall_mm: f64,
    /// Where the bins of expected errors end, in millimetres, above 0 and ascending. Default 0.1, 0.25, 0.5, 1, 2, 4
    /// and 8.
    pub expected_bins_mm: Vec<f64>,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            samples: 200_000,
            floor_mm: 1.5,
            thresholds_mm: vec![0.5, 1.0, 2.0],
            concave_depth_mm: 4.0,
            cap_mm: 30.0,
            rim_radius_mm: 3.0,
            rim_width_mm: 3.0,
            wall_mm: 10.0,
            expected_bins_mm: vec![0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0],
        }
    }
}

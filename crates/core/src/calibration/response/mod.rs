//! Fits how a depth camera's readings relate to distances: from a table of measurements, as in the paper, or from
//! boards whose planes are known from its colour picture. Pure functions; nothing here reads a recording.

mod against_boards;
mod bias;
mod check;
mod consistent;
mod correction;
mod jackknife;
mod lateral;
mod misfit;
mod paper;
mod plane;
mod plane_view;
mod polynomial;
mod reading_change;
mod samples;
mod solve;
mod table;

pub use against_boards::{BoardsBias, bias_on_boards};
pub use bias::{DistanceBias, ViewBias};
pub use check::{DepthCheck, DepthDeviation, DepthTolerance, TooFewBoards, check_depth};
pub use correction::Correction;
pub use misfit::{Cause, Misfit, SessionPart};
pub use paper::PaperFit;
pub use plane::{PlaneFit, fit_plane};
pub use plane_view::{PlaneParameters, PlaneView, mean_readings};
pub use polynomial::Polynomial;
pub use reading_change::{Deeper, ReadingChange};
pub use table::{DepthTable, Measurement};

use std::path::PathBuf;

/// Why no response can be fitted.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum ResponseError {
    /// A table that cannot be read.
    #[error("depth table {}: {cause}", path.display())]
    Read {
        path: PathBuf,
        cause: std::io::Error,
    },
    /// A table that is not what it should be.
    #[error("depth table {}: line {line}: {message}", path.display())]
    Table {
        path: PathBuf,
        /// Which line, counted from 1.
        line: usize,
        /// What was found and expected.
        message: String,
    },
    /// Too little to fit from.
    #[error("the depth response cannot be fitted: {found}, expected {expected}")]
    TooLittle { found: String, expected: String },
    /// A distance at which the fit says nothing.
    #[error("{distance} m is outside the fitted range of {} to {} m", range[0], range[1])]
    OutsideRange {
        /// What was asked for.
        distance: f64,
        /// Where the fit holds, in metres.
        range: [f64; 2],
    },
    /// A fit that no real sensor would give.
    #[error(transparent)]
    Impossible(#[from] super::Error),
}

fn too_little<T>(found: String, expected: impl Into<String>) -> Result<T, ResponseError> {
    let expected = expected.into();
    Err(ResponseError::TooLittle { found, expected })
}

#[cfg(test)]
mod tests;

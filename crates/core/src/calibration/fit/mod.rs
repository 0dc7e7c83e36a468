//! Fits a rig's calibration to what its cameras saw of a board: lenses, poses and the board's placements, with what
//! is uncertain of them. It computes from pictures and the corners found in them; it reads no file and draws nothing.

mod adjust;
mod appearance;
mod corners;
mod coverage;
mod diagnosis;
mod drift;
mod frame;
mod gradient_refine;
mod grid;
mod holdout;
mod lens;
mod outliers;
mod planar;
mod pose_graph;
mod resize;
mod result;
mod robust_weights;
mod session;
mod single_camera;
mod solve;
mod subpixel;
mod template;
mod template_refine;
mod verdict;
mod volume;

pub use corners::find_corners;
pub use coverage::{Wanted, missing};
pub use diagnosis::{Finding, diagnose};
pub use drift::{CheckError, Checked, Motion, Watch, check};
pub use grid::Rejection;
pub use lens::{Lens, Model};
pub use result::{
    Figures, Fit, FittedCamera, FittedPlacement, HeldOut, LeftOut, LeftOutShare, Uncertainty,
    ViewResiduals,
};
pub use session::{Corner, Session, SessionCamera, View};
pub use solve::fit;
pub use template_refine::{crowded_views, matched_with_print};
pub use verdict::{Judgement, Limits, judge};

use crate::frame::CameraId;
use crate::number;

/// How a calibration is fitted.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// Model of the lenses' distortion. Default `plumb_bob`.
    pub model: Model,
    /// Fewest views from which a lens is fitted.
    /// Default 3, range 1 to 1000.
    #[serde(deserialize_with = "number::count::<_, _, 1, 1000>")]
    pub min_views: usize,
    /// Fewest corners that make a view.
    /// Default 6, range 4 to 10000.
    #[serde(deserialize_with = "number::count::<_, _, 4, 10_000>")]
    pub min_corners: usize,
    /// The placement that lies flat on the table; by default the one that all others lie above.
    pub table_placement: Option<String>,
    /// How many times the usual residual a view may have before it is left out.
    /// Default 3, range 1 to 1000.
    #[serde(deserialize_with = "number::within::<_, _, 1, 1000>")]
    pub outlier_ratio: f64,
    /// How many standard deviations a corner may be off before it is false.
    /// Default 5, range 1 to 1000.
    #[serde(deserialize_with = "number::within::<_, _, 1, 1000>")]
    pub false_corner_deviations: f64,
    /// Parts of the placements that are held out in turn to see how well they are predicted; 0 for no
    /// such test.
    /// Default 5, range 0 to 1000.
    #[serde(deserialize_with = "number::count::<_, _, 0, 1000>")]
    pub folds: usize,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            model: Model::default(),
            min_views: 3,
            min_corners: 6,
            table_placement: None,
            outlier_ratio: 3.0,
            false_corner_deviations: 5.0,
            folds: 5,
        }
    }
}

/// Why no calibration can be fitted.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum Error {
    /// Not enough to see in any camera.
    #[error("no camera has enough views of the board: {details}")]
    NothingToFit {
        /// What each camera has.
        details: String,
    },
    /// The cameras do not form one connected graph of shared board placements.
    #[error("{}", disjoint(.groups, .ambiguous))]
    Disjoint {
        /// The cameras that hang together.
        groups: Vec<Vec<CameraId>>,
        /// Pairs that share placements which do not say how the cameras lie to each other.
        ambiguous: Vec<[CameraId; 2]>,
    },
    /// No such placement.
    #[error("the table's placement {name:?} is none of those that were used: {known}")]
    NoSuchPlacement {
        /// What was asked for.
        name: String,
        /// Those there are.
        known: String,
    },
    /// The equations have no solution.
    #[error("the fit failed: {0}")]
    Unsolvable(String),
}

/// Names the groups, and the views that would join them.
fn disjoint(groups: &[Vec<CameraId>], ambiguous: &[[CameraId; 2]]) -> String {
    let names = |group: &Vec<CameraId>| {
        let names: Vec<&str> = group.iter().map(CameraId::as_str).collect();
        names.join(", ")
    };
    let listed: Vec<String> = groups.iter().map(|g| format!("[{}]", names(g))).collect();
    let mut words = format!(
        "the cameras fall into {} groups that no view of the board joins: {}; place the board three times or more \
         where a camera of each of two groups sees it at once, in different tilts",
        groups.len(),
        listed.join(" and "),
    );
    if !ambiguous.is_empty() {
        let pairs: Vec<String> = ambiguous
            .iter()
            .take(10)
            .map(|[a, b]| format!("{a} and {b}"))
            .collect();
        words += &format!(
            " ({} share placements, but these do not agree on one relative pose: pictures of different moments, \
             exchanged cables or a mirrored picture would do this, and so would a single placement of a board that \
             looks the same turned by 180°)",
            pairs.join("; ")
        );
    }
    words
}

#[cfg(test)]
mod synthetic;
#[cfg(test)]
mod tests;

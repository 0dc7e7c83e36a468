//! Fits a rig's calibration to its cameras' views of a board: lenses, poses and the board's placements, with their
//! uncertainties. It computes from pictures and the corners found in them; it reads no file and draws nothing.

mod adjust;
mod appearance;
mod as_calibrated;
mod board_size;
mod change;
mod corners;
mod coverage;
mod diagnosis;
mod drift;
#[cfg(test)]
mod fisheye_tests;
mod frame;
mod gradient_refine;
mod grid;
mod holdout;
mod lens;
mod outliers;
mod planar;
mod pose_graph;
mod projection;
mod readings;
mod reason;
mod resize;
mod result;
mod robust_weights;
mod scale;
mod session;
mod sheet;
mod sheet_terms;
mod single_camera;
mod solve;
mod subpixel;
mod template;
mod template_refine;
mod verdict;
mod verdict_of_contradictions;
mod verdict_of_joints;
mod verdict_of_lens;
mod verdict_of_shape;
mod volume;

pub use change::ViewChange;
pub use corners::find_corners;
pub use coverage::{CoverageLimits, missing};
pub use diagnosis::{Finding, diagnose, refer_to_findings};
pub use drift::{CheckError, CheckedCamera, DriftLimits, DriftResult, Motion, PairMotion, check};
pub use grid::Rejection;
pub use lens::{Lens, LensModel};
pub use projection::Projection;
pub use reason::{Reason, ReasonKind};
pub use result::{
    Figures, Fit, FittedCamera, FittedPlacement, FittedShape, HeldOut, LeftOut, LeftOutShare,
    ShapeTerm, TermStatus, Uncertainty, ViewResiduals,
};
pub use scale::{
    CameraDistance, Length, MeasuredLengths, RulerReading, ScaleWitnessLimits, Slope,
    WitnessReading, scale_words, witnesses,
};
pub use session::{Corner, Session, SessionCamera, View};
pub use solve::fit;
pub use template_refine::{crowded_views, matched_with_print};
pub use verdict::{DepthError, DepthMisfit, Judgement, Limits, judge};

use crate::frame::CameraId;
use crate::range;

/// How a calibration is fitted.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// Model of the lenses' distortion. Default `plumb_bob`.
    pub model: LensModel,
    /// Fewest views from which a lens is fitted.
    /// Default 3, range 1 to 1000.
    #[serde(deserialize_with = "range::count::<_, _, 1, 1000>")]
    pub min_views: usize,
    /// Fewest corners of a view.
    /// Default 6, range 4 to 10000.
    #[serde(deserialize_with = "range::count::<_, _, 4, 10_000>")]
    pub min_corners: usize,
    /// The placement that lies flat on the table; by default the one that lies below all others.
    pub table_placement: Option<String>,
    /// A view is left out if its residual is more than this many times the usual one.
    /// Default 3, range 1 to 1000.
    #[serde(deserialize_with = "range::within::<_, _, 1, 1000>")]
    pub outlier_ratio: f64,
    /// A corner counts as false if it is off by more than this many standard deviations.
    /// Default 5, range 1 to 1000.
    #[serde(deserialize_with = "range::within::<_, _, 1, 1000>")]
    pub false_corner_deviations: f64,
    /// Number of parts into which the placements are divided; each is held out in turn to test how well it is
    /// predicted. 0 means no such test.
    /// Default 5, range 0 to 1000.
    #[serde(deserialize_with = "range::count::<_, _, 0, 1000>")]
    pub folds: usize,
    /// How far, in millimetres, a board is expected to be bent along its rows and down its columns, as one standard
    /// deviation.
    /// Default 0.5, range 0.000001 to 100.
    #[serde(deserialize_with = "range::at_least_a_millionth::<_, _, 100>")]
    pub bend_expected_mm: f64,
    /// By how many per cent squares are expected to be longer along the rows than their mean, as one standard
    /// deviation.
    /// Default 0.05, range 0.000001 to 10.
    #[serde(deserialize_with = "range::at_least_a_millionth::<_, _, 10>")]
    pub stretch_expected_percent: f64,
}

impl Parameters {
    /// Fewest corners of a view: fewer than four do not say where the board was, whatever is configured.
    pub fn fewest_corners(&self) -> usize {
        self.min_corners.max(4)
    }
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            model: LensModel::default(),
            min_views: 3,
            min_corners: 6,
            table_placement: None,
            outlier_ratio: 3.0,
            false_corner_deviations: 5.0,
            folds: 5,
            bend_expected_mm: 0.5,
            stretch_expected_percent: 0.05,
        }
    }
}

/// Why no calibration can be fitted.
#[derive(Debug, thiserror::Error, PartialEq)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
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
        /// The groups of connected cameras.
        groups: Vec<Vec<CameraId>>,
        /// Pairs that share placements which do not say how the cameras lie to each other.
        ambiguous: Vec<[CameraId; 2]>,
    },
    /// No such placement.
    #[error(
        "placement {name:?} cannot define the rig's frame, because no view of it was used: expected one of {known} \
         (--table-placement)"
    )]
    NoSuchPlacement {
        /// What was asked for.
        name: String,
        known: String,
    },
    /// A placement of which only the back was seen.
    #[error(
        "placement {name:?} cannot define the rig's frame, because no camera saw the board's front there (camera {camera} \
         saw its back): the cameras would lie below the table. Lay the board on the table with its front side up and show \
         it again{}",
        or_another(known)
    )]
    TableUpsideDown {
        /// What was asked for.
        name: String,
        /// A camera that saw its back.
        camera: CameraId,
        known: String,
    },
    /// The equations have no solution.
    #[error("the fit failed: {0}")]
    Unsolvable(String),
}

/// That one of these placements may be named instead.
fn or_another(known: &str) -> String {
    match known {
        "" => String::new(),
        known => {
            format!(", or name a placement whose front was seen ({known}; --table-placement)")
        }
    }
}

/// Names the groups, and the views that would join them.
fn disjoint(groups: &[Vec<CameraId>], ambiguous: &[[CameraId; 2]]) -> String {
    let names = |group: &Vec<CameraId>| {
        let names: Vec<&str> = group.iter().map(CameraId::as_str).collect();
        names.join(", ")
    };
    let listed: Vec<String> = groups.iter().map(|g| format!("[{}]", names(g))).collect();
    let (count, listed) = (groups.len(), listed.join(" and "));
    if ambiguous.is_empty() {
        return format!(
            "the cameras fall into {count} groups that no view of the board joins: {listed}; place the board three times \
             or more where a camera of each of two groups sees it at once, in different tilts"
        );
    }
    let pairs: Vec<String> = ambiguous
        .iter()
        .take(10)
        .map(|[a, b]| format!("{a} and {b}"))
        .collect();
    format!(
        "the cameras cannot be joined ({listed}): {} see the board at the same placements, and these do not agree on how \
         the cameras lie to each other. Pictures of different moments, exchanged cables, a mirrored picture or a camera \
         that moved would do this; so would a single placement of a board that looks the same turned by 180°",
        pairs.join("; ")
    )
}

#[cfg(test)]
mod rig_tests;
#[cfg(test)]
mod synthetic;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod trial_tests;

//! Why a rig cannot be calibrated or checked.

use crate::calibration::response::ResponseError;
use crate::calibration::{FileError, fit};
use crate::frame::CameraId;
use crate::words::count;
use crate::{calibration, capture, recording};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Most reasons for pictures without a board that an error names.
const MOST_REASONS: usize = 40;

/// A picture without a board that can be used.
#[derive(Debug, serde::Serialize)]
pub struct Rejected {
    /// The camera.
    pub camera: CameraId,
    /// The board's placement.
    pub placement: String,
    /// Why.
    pub reason: String,
    #[serde(skip)]
    pub(super) cause: fit::Rejection,
}

/// Why a rig cannot be calibrated or checked.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Error {
    /// A recording that is not a session of placements, or a picture of one that cannot be read.
    #[error(transparent)]
    Session(#[from] capture::Error),
    /// A recording that cannot be read.
    #[error(transparent)]
    Recording(#[from] recording::Error),
    /// A calibration file that cannot be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// A recording without a calibration, where one was expected.
    #[error("{}: it has no calibration, expected /color/ID/calibration or /depth/ID/calibration", .0.display())]
    NoCalibration(PathBuf),
    /// A recording whose metadata describe a board that cannot be.
    #[error("{}: metadata record board: {cause}", path.display())]
    BadBoard {
        path: PathBuf,
        /// What is wrong with it.
        cause: calibration::Error,
    },
    /// Recordings of different boards.
    #[error("{}: the board is {found}, but {before} in an earlier recording: give \
        --board", path.display())]
    OtherBoard {
        path: PathBuf,
        found: String,
        /// The board of a recording before it.
        before: String,
    },
    /// No recording names its board.
    #[error(
        "nothing describes the board: give --board KIND:COLUMNSxROWS:SQUARE, such as checkerboard:11x8:25mm (in inner \
         corners)"
    )]
    NoBoard,
    /// A lens for pictures of another size.
    #[error(
        "camera {camera}: the given lens is for pictures of {}x{} pixels, but its pictures have {}x{}: a lens is valid only \
         for pictures of the size that it was calibrated with",
        lens[0], lens[1], found[0], found[1]
    )]
    LensSize {
        camera: CameraId,
        /// Width and height for which its lens is known.
        lens: [usize; 2],
        /// Width and height of its pictures.
        found: [usize; 2],
    },
    /// Most pictures show a board of another size.
    #[error(
        "the board in {} has {}x{} inner corners, and {}x{} in {views}: is --board right? (It counts \
         inner corners, one less than squares. If the rows of the board look bent in the pictures, parts of it are found: a \
         fisheye lens is beyond the lens models, so undistort its pictures first, or use another lens.)",
        count(*pictures, "picture"), found[0], found[1], expected[0], expected[1]
    )]
    BoardSize {
        /// Inner corners in most pictures: columns and rows.
        found: [usize; 2],
        /// How many pictures show them.
        pictures: usize,
        /// Inner corners of the board that was given or recorded.
        expected: [usize; 2],
        /// How many views show these.
        views: usize,
    },
    /// A placement to begin or end with that is not there.
    #[error("the session has no placement {name:?}, expected one of {known}")]
    NoSuchPlacement {
        /// The name that was given.
        name: String,
        known: String,
    },
    /// A last placement before the first one.
    #[error(
        "the last placement, {until:?}, comes before the first one, {from:?}: exchange \
        --from-placement and --until-placement"
    )]
    NoPlacements { from: String, until: String },
    /// A distance of a camera that is not in the session.
    #[error("--distance: the session has no camera {camera}, expected one of {known}")]
    NoSuchCamera {
        /// The camera that was named.
        camera: CameraId,
        known: String,
    },
    /// A depth table that cannot be read.
    #[error(transparent)]
    Table(ResponseError),
    /// A depth table from which no response can be fitted.
    #[error("depth table {}: {cause}", path.display())]
    Response { path: PathBuf, cause: ResponseError },
    /// Views that do not determine the rig.
    #[error("{cause}{}", details(.causes, .missing, .reasons, .hint))]
    Unfitted {
        cause: fit::Error,
        /// What the views that contradict each other agree on.
        causes: Vec<String>,
        /// What the session lacks.
        missing: Vec<String>,
        /// Why pictures show no board that can be used, and how many of each camera.
        reasons: Vec<String>,
        /// What may be amiss, if most pictures show no whole board.
        hint: Option<&'static str>,
    },
    /// A rig that cannot be checked.
    #[error(transparent)]
    Check(#[from] fit::CheckError),
}

/// What may be amiss where most pictures show no whole board.
const NO_WHOLE_BOARD: &str = "in most pictures no board was found, or only some of its corners. If it is in them, it may be \
                              another one than --board says, cut off, blurred or dark; or its rows look bent, as a fisheye \
                              lens makes them, which is beyond the lens models: undistort such pictures first";

/// Whether most of the pictures show no whole board; `views` of them show one.
fn most_show_no_whole_board(rejected: &[Rejected], views: usize) -> bool {
    let is_no_board = |rejected: &&Rejected| match rejected.cause {
        fit::Rejection::Nothing
        | fit::Rejection::NoMarkers
        | fit::Rejection::FewMarkers { .. }
        | fit::Rejection::Few { .. }
        | fit::Rejection::TooFewOfBoard { .. }
        | fit::Rejection::Size { .. } => true,
        fit::Rejection::Contrast { .. } => false,
    };
    let without = rejected.iter().filter(is_no_board).count();
    2 * without > rejected.len() + views
}

impl Error {
    /// An error of the fit with what explains it; `views` pictures show a board.
    pub(super) fn unfitted(
        cause: fit::Error,
        findings: Vec<fit::Finding>,
        missing: Vec<String>,
        rejected: &[Rejected],
        views: usize,
    ) -> Self {
        let mut counts: BTreeMap<(&CameraId, &str), usize> = BTreeMap::new();
        for rejected in rejected {
            *counts
                .entry((&rejected.camera, &rejected.reason))
                .or_default() += 1;
        }
        let reason = |((camera, reason), number)| {
            format!("camera {camera}: {reason} ({})", count(number, "picture"))
        };
        Self::Unfitted {
            cause,
            causes: findings.into_iter().map(|finding| finding.words).collect(),
            missing,
            reasons: counts.into_iter().take(MOST_REASONS).map(reason).collect(),
            hint: most_show_no_whole_board(rejected, views).then_some(NO_WHOLE_BOARD),
        }
    }
}

/// Lines below the reason: what explains it, what the session lacks, what was seen instead, and what may be amiss.
fn details(
    causes: &[String],
    missing: &[String],
    reasons: &[String],
    hint: &Option<&str>,
) -> String {
    let causes = causes.iter().map(|cause| format!("\n  {cause}"));
    let missing = missing.iter().map(|lack| format!("\n  missing: {lack}"));
    let reasons = reasons.iter().map(|reason| format!("\n  {reason}"));
    let hint = hint.iter().map(|hint| format!("\n  {hint}"));
    causes.chain(missing).chain(reasons).chain(hint).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_session_whose_pictures_mostly_show_no_board_is_told_what_may_be_amiss() {
        let told = |nothing: usize, few: usize, contrast: usize, views: usize| {
            let of = |count: usize, cause: fn() -> fit::Rejection| {
                (0..count).map(move |k| Rejected {
                    camera: CameraId::new("c00").unwrap(),
                    placement: format!("p{k}"),
                    reason: cause().to_string(),
                    cause: cause(),
                })
            };
            let nothing = of(nothing, || fit::Rejection::Nothing);
            let few = of(few, || fit::Rejection::Few {
                found: 9,
                needed: 32,
            });
            let contrast = of(contrast, || fit::Rejection::Contrast {
                contrast: 3.0,
                needed: 10.0,
            });
            let rejected: Vec<Rejected> = nothing.chain(few).chain(contrast).collect();
            let cause = fit::Error::Unsolvable("no lens explains it".into());
            let error = Error::unfitted(cause, Vec::new(), Vec::new(), &rejected, views);
            error.to_string().contains("as a fisheye lens makes them")
        };
        assert!(told(6, 4, 0, 3));
        assert!(!told(6, 4, 0, 10));
        assert!(!told(2, 0, 10, 3));
    }
}

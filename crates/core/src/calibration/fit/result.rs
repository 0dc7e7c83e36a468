//! The result of a fit: data, and the figures that are computed from residuals.

use super::change::ViewChange;
use super::projection::Projection;
use super::session::View;
use crate::calibration::{Board, BoardShape, Camera, Face, Volume};
use crate::frame::CameraId;
use crate::statistics::upper_median;
use nalgebra::{Isometry3, Matrix3, Point2, Vector2, Vector3};

/// A calibrated rig with its uncertainties.
#[derive(Clone, Debug)]
pub struct Fit {
    /// The board.
    pub board: Board,
    /// The cameras, in the order of the session, those aside that could not be fitted.
    pub cameras: Vec<FittedCamera>,
    /// The placements that were used, in their order.
    pub placements: Vec<FittedPlacement>,
    /// Of a two-sided board: from the back's frame to the front's.
    pub front_from_back: Isometry3<f64>,
    /// How the board differs from the stated one.
    pub shape: FittedShape,
    /// Name of the placement that the rig's frame lies on.
    pub table: String,
    /// Whether no camera, and the board at no placement whose front was seen, lies below that placement.
    pub table_is_lowest: bool,
    /// Of all corners that were used.
    pub figures: Figures,
    /// How well placements are predicted that the fit did not see.
    pub held_out: Option<HeldOut>,
    /// What all cameras see, from the table up.
    pub volume: Option<Volume>,
    /// Views, placements and cameras that were left out, and why.
    pub left_out: Vec<LeftOut>,
    /// The detected views of the board, without those that were left out.
    pub views: Vec<View>,
    /// Residuals of each of these views.
    pub residuals: Vec<ViewResiduals>,
    /// Cameras whose residuals say that something about them changed, the largest change first.
    pub changes: Vec<ViewChange>,
    /// Links of the cameras' tree: pairs of indices into the cameras.
    pub links: Vec<[usize; 2]>,
}

/// A camera that was fitted.
#[derive(Clone, Debug)]
pub struct FittedCamera {
    /// Lens and pose in the rig.
    pub camera: Camera,
    /// How uncertain they are.
    pub uncertainty: Uncertainty,
    /// What that amounts to where objects stand; `None` for a camera that sees nothing of where the board was.
    pub projection: Option<Projection>,
    /// Its residuals.
    pub figures: Figures,
    /// Views that were used.
    pub views: usize,
    /// Part of its picture where corners were seen, of a grid of 10 by 10, from 0 to 1.
    pub coverage: f64,
    /// Corners that are far from where they should be and were left out.
    pub false_corners: usize,
    /// Whether its lens was given and kept.
    pub is_lens_given: bool,
}

/// How the board differs from the stated one, as a [`BoardShape`].
#[derive(serde::Serialize, Clone, Copy, Debug, Default, PartialEq)]
pub struct FittedShape {
    /// Bends along the rows and down the columns, in metres.
    pub bend: [ShapeTerm; 2],
    /// The part by which squares are longer along the rows, and shorter down the columns.
    pub stretch: ShapeTerm,
    /// Of a board that looks the same after a quarter turn: both bends are their mean, and this is whether the views
    /// show that they differ. As it is not known which one is which, they are not fitted.
    pub bends_differ: Option<TermStatus>,
}

/// A term of the board's shape.
#[derive(serde::Serialize, Clone, Copy, Debug, Default, PartialEq)]
pub struct ShapeTerm {
    /// What the fit takes it for: 0 where it was not kept.
    pub value: f64,
    /// Its standard deviation; for a term that was not kept, how large it may be nevertheless.
    pub deviation: f64,
    /// Whether the fit uses it.
    pub fate: TermStatus,
    /// What the first and the last half of the placements say of it, each with its standard deviation; where that was
    /// asked.
    pub halves: Option<[[f64; 2]; 2]>,
}

/// Whether the fit uses a term of the board's shape.
#[derive(serde::Serialize, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub enum TermStatus {
    /// With it, held-out placements are not predicted better: it is 0.
    #[default]
    NotNeeded,
    /// It predicts them better, but the two halves of the placements disagree on its value or are too few: it is 0.
    NotHeld,
    /// It is part of the fit.
    Kept,
}

/// A placement that was used.
#[derive(Clone, Debug, PartialEq)]
pub struct FittedPlacement {
    /// Its name.
    pub name: String,
    /// From the board's frame to the rig's.
    pub rig_from_board: Isometry3<f64>,
    /// Its residuals.
    pub figures: Figures,
    /// Cameras that saw it.
    pub cameras: usize,
}

/// Residuals of corners in pixels: lengths of the differences from what is predicted.
#[derive(serde::Serialize, Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// How many corners.
    pub corners: usize,
    /// Root mean square.
    pub rms_px: f64,
    /// Median.
    pub median_px: f64,
    /// Largest.
    pub max_px: f64,
}

impl Figures {
    /// The figures of residuals.
    pub fn of(lengths: impl Iterator<Item = f64>) -> Self {
        let mut lengths: Vec<f64> = lengths.collect();
        let median_px = upper_median(&mut lengths).unwrap_or(0.0);
        lengths.sort_by(f64::total_cmp);
        let n = lengths.len();
        Self {
            corners: n,
            rms_px: (lengths.iter().fold(0.0, |sum, l| sum + l * l) / n.max(1) as f64).sqrt(),
            median_px,
            max_px: lengths.last().copied().unwrap_or(0.0),
        }
    }
}

/// Standard deviations of what was fitted, as the residuals let expect them.
#[derive(serde::Serialize, Clone, Copy, Debug, Default, PartialEq)]
pub struct Uncertainty {
    /// Of fx and fy.
    pub focal_px: [f64; 2],
    /// Of cx and cy.
    pub center_px: [f64; 2],
    /// Of k1, k2, p1, p2, k3, k4, k5, k6.
    pub distortion: [f64; 8],
    /// Of the camera's rotation about its own x, y and z, in degrees.
    pub rotation_degrees: [f64; 3],
    /// Of its centre along the rig's x, y and z, in metres.
    pub position: [f64; 3],
    /// Covariance of its centre in the rig, in square metres: what is unknown of it along one axis hangs together with
    /// what is unknown along another.
    #[serde(skip)]
    pub position_covariance: Matrix3<f64>,
}

impl Uncertainty {
    /// Standard deviation of the camera's centre along a direction of length 1 in the rig, in metres.
    pub fn position_along(&self, direction: &Vector3<f64>) -> f64 {
        let variance = direction.dot(&(self.position_covariance * direction));
        variance.max(0.0).sqrt()
    }
}

/// How well placements are predicted that the fit did not see.
#[derive(serde::Serialize, Clone, Copy, Debug, PartialEq)]
pub struct HeldOut {
    /// Residuals of the corners of placements that were held out.
    pub figures: Figures,
    /// Their root mean square over that of the same corners in the fit.
    pub ratio: f64,
    /// How often the fit was repeated.
    pub folds: usize,
}

/// What was left out.
#[derive(serde::Serialize, Clone, Debug, PartialEq)]
pub struct LeftOut {
    /// The camera; none for a whole placement.
    pub camera: Option<CameraId>,
    /// The placement; none for a whole camera.
    pub placement: Option<String>,
    /// Why.
    pub reason: String,
    /// Cameras whose views of the board were read, and thrown out with it because they contradict the others; none
    /// where the views only say nothing new.
    #[serde(skip)]
    pub views: Vec<CameraId>,
    /// How far these views show the board from where others of the placement do, over its distance from the camera;
    /// `None` where they do not contradict each other on that.
    #[serde(skip)]
    pub apart: Option<f64>,
}

/// Views of the board that were read, and those of them that the fit threw out.
#[derive(serde::Serialize, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LeftOutShare {
    /// Views that were read.
    pub read: usize,
    /// Views that were thrown out.
    pub left_out: usize,
}

impl LeftOutShare {
    /// The part that was thrown out, from 0 to 1.
    pub fn part(&self) -> f64 {
        self.left_out as f64 / self.read.max(1) as f64
    }
}

impl Fit {
    /// Standard deviation, in metres at the object, with which the cameras see points of the volume: the root mean
    /// square over all cameras.
    pub fn at_object(&self) -> Option<f64> {
        let of_cameras = self.cameras.iter().filter_map(|c| c.projection.as_ref());
        let squares: Vec<f64> = of_cameras.map(|p| p.at_object.powi(2)).collect();
        let mean = squares.iter().sum::<f64>() / squares.len() as f64;
        (!squares.is_empty()).then(|| mean.sqrt())
    }

    /// How many views of the board the fit threw out, of all cameras.
    pub fn left_out_share(&self) -> LeftOutShare {
        let left_out = self.left_out.iter().map(|l| l.views.len()).sum();
        LeftOutShare {
            read: self.residuals.len() + left_out,
            left_out,
        }
    }

    /// How many views of the board the fit threw out, of one camera.
    pub fn left_out_share_of(&self, camera: &FittedCamera) -> LeftOutShare {
        let id = &camera.camera.id;
        let views = self.left_out.iter().flat_map(|l| &l.views);
        let left_out = views.filter(|of| *of == id).count();
        LeftOutShare {
            read: camera.views + left_out,
            left_out,
        }
    }
}

impl FittedShape {
    /// Its terms, in the order of [`BoardShape::terms`].
    pub fn terms(&self) -> [ShapeTerm; BoardShape::TERMS] {
        [self.bend[0], self.bend[1], self.stretch]
    }

    /// The shape that the fit takes the board for.
    pub fn shape(&self) -> BoardShape {
        BoardShape::of_terms(self.terms().map(|term| term.value))
    }

    /// Standard deviation of [`BoardShape::depth`], in metres.
    pub fn depth_deviation(&self) -> f64 {
        let [along_rows, down_columns] = self.bend.map(|term| term.deviation);
        match self.bends_differ {
            // They have their errors in common.
            Some(_) => along_rows + down_columns,
            None => along_rows.hypot(down_columns),
        }
    }
}

impl FittedCamera {
    /// The part of its corners that were dropped, from 0 to 1.
    pub fn dropped_part(&self) -> f64 {
        let read = self.figures.corners + self.false_corners;
        self.false_corners as f64 / read.max(1) as f64
    }
}

impl LeftOut {
    /// The camera, the placement, or both, in words.
    pub fn subject(&self) -> String {
        let camera = self.camera.as_ref().map(|id| format!("camera {id}"));
        let placement = self.placement.as_ref().map(|p| format!("placement {p}"));
        let both: Vec<String> = [camera, placement].into_iter().flatten().collect();
        both.join(", ")
    }
}

/// A view's residuals.
#[derive(Clone, Debug)]
pub struct ViewResiduals {
    /// Index of the camera among the fitted ones.
    pub camera: usize,
    /// Index of the placement among the fitted ones.
    pub placement: usize,
    /// The side that was seen.
    pub face: Face,
    /// Each corner's pixel, and where it is predicted less where it was seen.
    pub corners: Vec<(Point2<f64>, Vector2<f64>)>,
}

impl ViewResiduals {
    /// Lengths of the residuals.
    pub fn lengths(&self) -> impl Iterator<Item = f64> + '_ {
        self.corners.iter().map(|(_, r)| r.norm())
    }
}

/// Part of a picture's cells, 10 by 10, that hold a corner.
pub(super) fn coverage(size: [usize; 2], pixels: impl Iterator<Item = Point2<f64>>) -> f64 {
    let mut cells = [false; 100];
    for pixel in pixels {
        let cell = |at: f64, side: usize| (at.max(0.0) / side as f64 * 10.0).min(9.0) as usize;
        cells[cell(pixel.y, size[1]) * 10 + cell(pixel.x, size[0])] = true;
    }
    cells.iter().filter(|&&seen| seen).count() as f64 / 100.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_a_position_that_hang_together_add_up_along_one_direction_and_cancel_along_another()
    {
        let error = Vector3::new(0.001, -0.001, 0.0);
        let uncertainty = Uncertainty {
            position: [0.001, 0.001, 0.0],
            position_covariance: error * error.transpose(),
            ..Uncertainty::default()
        };
        let along =
            |x: f64, y: f64| uncertainty.position_along(&Vector3::new(x, y, 0.0).normalize());
        assert!((along(1.0, 0.0) - 0.001).abs() < 1e-12);
        assert!((along(1.0, -1.0) - error.norm()).abs() < 1e-12);
        assert!(along(1.0, 1.0) < 1e-9);
    }
}

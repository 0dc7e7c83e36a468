//! Calibrates each camera by itself: its lens and the board's pose in each of its views, from which the fit of the
//! rig starts.

use super::adjust::{Bundle, CameraState, Loss, Observation, PlacementState, Prior};
use super::lens::{Lens, LensModel, PARAMETERS};
use super::planar::{self, PlanePose};
use super::session::{SessionCamera, View};
use super::sheet::Sheet;
use crate::calibration::Board;
use crate::statistics::upper_median;
use nalgebra::{Isometry3, Matrix3, Point2, Point3, Vector2};

/// The calibration of one camera from its own views only.
#[derive(Clone, Debug)]
pub(super) struct SingleCamera {
    pub lens: Lens,
    /// Pose of the seen face in each view; `None` where none fits.
    pub poses: Vec<Option<PlanePose>>,
}

/// Fits a camera's lens to its views; a known lens is kept. `None` if no lens can explain them.
pub(super) fn calibrate(
    subject: &SessionCamera,
    views: &[&View],
    board: &Board,
    model: LensModel,
) -> Option<SingleCamera> {
    let pairs: Vec<_> = views.iter().map(|v| v.pairs(board)).collect();
    if let Some(known) = &subject.known {
        let lens = Lens::from_intrinsics(known);
        let poses = pairs.iter().map(|p| planar::pose(&lens, p)).collect();
        return Some(SingleCamera { lens, poses });
    }
    let fitted = starts(subject, &pairs, model)
        .into_iter()
        .filter_map(|lens| from_start(board, &pairs, lens, model));
    let (_, lens) = fitted.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let poses = pairs.iter().map(|p| planar::pose(&lens, p)).collect();
    Some(SingleCamera { lens, poses })
}

/// Lenses to start from: the one that is given; else one of the focal length that the homographies give, where they
/// give one that a camera can have; and else several.
fn starts(
    subject: &SessionCamera,
    pairs: &[Vec<(Point3<f64>, Point2<f64>)>],
    model: LensModel,
) -> Vec<Lens> {
    if let Some(start) = &subject.start {
        let mut lens = Lens::from_intrinsics(start);
        let free = free_parameters(model);
        let fixed = lens.values.iter_mut().zip(free).filter(|(_, free)| !free);
        fixed.for_each(|(value, _)| *value = 0.0);
        return vec![lens];
    }
    let pinhole = Lens::pinhole(subject.size, 1.0);
    let center = Vector2::new(pinhole.values[2], pinhole.values[3]);
    let homography = |of_view: &Vec<(Point3<f64>, Point2<f64>)>| -> Option<Matrix3<f64>> {
        let flat: Vec<_> = of_view
            .iter()
            .map(|(p, px)| (p.xy(), px - center))
            .collect();
        planar::homography(&flat)
    };
    let homographies: Vec<_> = pairs.iter().filter_map(homography).collect();
    let side = pinhole.side();
    let closed = planar::focal_length(&homographies).filter(|f| (0.3..10.0).contains(&(f / side)));
    let focals = closed.map_or_else(
        || [0.6, 1.0, 1.6, 2.8].map(|f| f * side).into(),
        |f| vec![f],
    );
    let lens = |focal| Lens::pinhole(subject.size, focal);
    focals.into_iter().map(lens).collect()
}

/// The lens that fits from this start, and its cost.
fn from_start(
    board: &Board,
    pairs: &[Vec<(Point3<f64>, Point2<f64>)>],
    lens: Lens,
    model: LensModel,
) -> Option<(f64, Lens)> {
    let mut bundle = Bundle {
        cameras: vec![CameraState {
            lens,
            free: [false; PARAMETERS],
            camera_from_rig: Isometry3::identity(),
            pose_free: false,
            prior: priors(&lens),
        }],
        placements: Vec::new(),
        board_from_back: Isometry3::identity(),
        back_free: false,
        sheet: Sheet::flat(board),
        views: Vec::new(),
    };
    for points in pairs {
        let Some(pose) = planar::pose(&lens, points) else {
            continue;
        };
        let placement = bundle.placements.len();
        bundle.placements.push(PlacementState {
            rig_from_board: pose.camera_from_plane,
            free: true,
        });
        bundle.views.push(Observation {
            camera: 0,
            placement,
            back: false,
            weight: 1.0,
            points: points.clone(),
        });
    }
    if bundle.views.is_empty() {
        return None;
    }
    for parameter in [0, 1, 4] {
        bundle.cameras[0].free[parameter] = true;
    }
    bundle.adjust_robustly(2);
    bundle.cameras[0].free = free_parameters(model);
    let cost = bundle.adjust_robustly(4);
    let lens = bundle.cameras[0].lens;
    lens.intrinsics().is_ok().then_some((cost, lens))
}

/// The parameters that a model has.
pub(super) fn free_parameters(model: LensModel) -> [bool; PARAMETERS] {
    let terms = match model {
        LensModel::PlumbBob => 9,
        LensModel::Rational => PARAMETERS,
    };
    std::array::from_fn(|i| i < terms)
}

/// What any lens is believed to be like; so weak that a few good views overrule it, and enough to keep in bounds what
/// no view speaks of.
pub(super) fn priors(start: &Lens) -> [Option<Prior>; PARAMETERS] {
    let middle = Lens::pinhole(start.size, start.focal_px());
    let (side, focal) = (start.side(), start.focal_px());
    let deviations = [
        focal,
        focal,
        0.1 * side,
        0.1 * side,
        1.0,
        1.0,
        0.02,
        0.02,
        2.0,
        1.0,
        1.0,
        1.0,
    ];
    let prior = |i: usize| Prior {
        value: middle.values[i],
        deviation: deviations[i],
    };
    std::array::from_fn(|i| Some(prior(i)))
}

impl Bundle {
    /// All lengths of residuals that can be computed, ascending.
    pub(super) fn lengths(&self) -> Vec<f64> {
        let residuals = self.views.iter().flat_map(|view| self.residuals(view));
        let mut lengths: Vec<f64> = residuals.flatten().map(|r| r.norm()).collect();
        lengths.sort_by(f64::total_cmp);
        lengths
    }

    /// Standard deviation of a coordinate's residual, from the median, so that false corners do not count.
    pub(super) fn robust_deviation(&self) -> f64 {
        // The median of a Rayleigh distribution.
        upper_median(&mut self.lengths()).map_or(0.0, |median| median / 1.1774)
    }

    /// The loss under which residuals of three robust deviations count half.
    pub(super) fn robust_loss(&self) -> Loss {
        Loss {
            scale_px: (3.0 * self.robust_deviation()).max(0.02),
        }
    }

    /// Adjusts under ever sharper losses; returns the last cost.
    pub(super) fn adjust_robustly(&mut self, rounds: usize) -> f64 {
        (0..rounds)
            .map(|_| self.adjust(self.robust_loss(), 25))
            .last()
            .unwrap_or(0.0)
    }
}

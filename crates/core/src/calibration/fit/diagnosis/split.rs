//! Tests whether a camera's views agree if they are split in two at a placement: from there on, the camera has another
//! pose, another lens, or both. The reference cameras hold the placements, which may move within what those cameras
//! saw.

use super::super::Parameters;
use super::super::adjust::{Bundle, CameraState, Observation, PlacementState};
use super::super::lens::{Lens, PARAMETERS};
use super::super::outliers::rms;
use super::super::pose_graph::{AGREES, Comparison};
use super::super::session::View;
use super::super::sheet::Sheet;
use super::super::single_camera::{free_parameters, priors};
use super::suspects::{FEWEST_VIEWS, IndependentFit, Reference};
use crate::calibration::Face;
use crate::statistics::upper_median;
use nalgebra::Isometry3;

/// Fewest views on either side of a split.
const FEWEST: usize = 2;
/// Fewest views from which pose and lens can be estimated together.
const FEWEST_FOR_BOTH: usize = 3;
/// Part of the views after a split that must agree on it.
const MOST_AGREE: f64 = 0.75;
/// How many times better one explanation must be than another that would do as well.
const CLEARLY: f64 = 1.5;
/// How many times better than no change a change must be, for views that agree without one.
const BETTER: f64 = 1.25;
/// Turn in degrees and shift in metres below which a camera that was refocused has not moved.
const STILL: [f64; 2] = [0.05, 2e-3];

/// What changed: turn in degrees and shift in metres, part of the focal length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Change {
    Moved([f64; 2]),
    Refocused(f64),
    Either([f64; 2], f64),
    Both([f64; 2], f64),
}

/// A camera's views before and after a change.
#[derive(Clone, Debug)]
pub(super) struct Split {
    pub camera: usize,
    /// The last placement before the change and the first after it, of those that the camera saw.
    pub last_early: usize,
    pub first_late: usize,
    pub change: Change,
    /// Where the camera was before and after, from the rig's frame.
    poses: [Isometry3<f64>; 2],
    /// Whether most of its views are before the change.
    is_mostly_early: bool,
    /// Whether each view of the larger part agrees with the others of that part.
    is_larger_part_sound: bool,
}

impl Split {
    /// Whether both changes may be of one moment.
    pub(super) fn overlaps(&self, other: &Self) -> bool {
        self.last_early < other.first_late && other.last_early < self.first_late
    }

    /// The camera before the change, from the rig's frame.
    pub(super) fn early(&self) -> &Isometry3<f64> {
        &self.poses[0]
    }

    /// The camera after the change, from the rig's frame.
    pub(super) fn late(&self) -> &Isometry3<f64> {
        &self.poses[1]
    }

    /// By how many metres the camera's centre went.
    pub(super) fn distance(&self) -> f64 {
        change_of(&self.poses)[1]
    }

    pub(super) fn advice(&self, reference: &Reference) -> String {
        let (session, first) = (reference.session, self.first_late);
        let from = &session.placements[first];
        let is_enough = reference.least.is_left(session, first, &[self.camera]);
        match (self.is_mostly_early, is_enough) {
            (false, _) if !self.is_larger_part_sound => {
                format!("show the board again: its views since {from} do not all agree either")
            }
            (true, true) => format!(
                "show the board again, or calibrate from {from} on (--from-placement {from})"
            ),
            (false, true) => format!(
                "the rig has stayed as it is since {from}: calibrate from there on (--from-placement {from})"
            ),
            (_, false) => format!(
                "show the board again: too little was seen since {from} to calibrate from there on"
            ),
        }
    }
}

/// Turn in degrees and shift of the centre in metres between two poses of a camera.
fn change_of([early, late]: &[Isometry3<f64>; 2]) -> [f64; 2] {
    let [before, after] = [early, late].map(|pose| pose.inverse());
    let shift = before.translation.vector - after.translation.vector;
    [
        before.rotation.angle_to(&after.rotation).to_degrees(),
        shift.norm(),
    ]
}

/// Whether two poses are the same, to a quarter of how far their camera went: the other camera's lens, of which the
/// pose takes no account, displaces and turns it.
pub(super) fn is_near(a: &Isometry3<f64>, b: &Isometry3<f64>, went: f64) -> bool {
    let [degrees, metres] = change_of(&[*a, *b]);
    went > 0.02 && metres < 0.25 * went && degrees < 8.0
}

/// The splits after which a camera's views agree, at most two; empty if they agree without a split, or with no split.
pub(super) fn of(reference: &Reference, camera: usize, parameters: &Parameters) -> Vec<Split> {
    let Some(resection) = Resection::of(reference, camera, parameters) else {
        return Vec::new();
    };
    let all = &resection.views[..];
    let Some((_, at)) = resection.best_split(all) else {
        return Vec::new();
    };
    let (early, late) = all.split_at(at);
    if let Some(split) = resection.explained(camera, early, late) {
        return vec![split];
    }
    resection.twice(camera, early, late).unwrap_or_default()
}

impl<'a> Resection<'a> {
    /// A camera's views; `None` if too few can be compared with the reference.
    fn of(reference: &'a Reference<'a>, camera: usize, parameters: &Parameters) -> Option<Self> {
        let subject = &reference.session.cameras[camera];
        let all = reference.views(camera);
        let solo = IndependentFit::of(reference, subject, &all, parameters)?;
        let seen = |view: &View| reference.rig_from_board[view.placement].is_some();
        let views: Vec<_> = solo
            .views
            .iter()
            .filter(|(view, _)| seen(view))
            .cloned()
            .collect();
        if views.len() < FEWEST_VIEWS {
            return None;
        }
        let lens = match &subject.known {
            Some(known) => Lens::from_intrinsics(known),
            None => solo.lens,
        };
        Some(Self {
            reference,
            lens,
            lens_free: match subject.known {
                Some(_) => [false; PARAMETERS],
                None => free_parameters(parameters.model),
            },
            most_px: parameters.outlier_ratio * solo.usual_px,
            views,
        })
    }
}

/// The views of one camera against boards whose places are known.
struct Resection<'a> {
    reference: &'a Reference<'a>,
    lens: Lens,
    lens_free: [bool; PARAMETERS],
    /// Residual up to which a view agrees.
    most_px: f64,
    /// In the order of the placements, with the board's pose by the camera alone.
    views: Vec<(View, Isometry3<f64>)>,
}

/// What of a camera is free.
#[derive(Clone, Copy, PartialEq)]
enum FreeParameters {
    Nothing,
    Pose,
    Lens,
    Both,
}

impl Resection<'_> {
    /// The split that makes the views' residuals least likely to be chance, with the placements as they are.
    fn best_split(&self, views: &[(View, Isometry3<f64>)]) -> Option<(f64, usize)> {
        let n = views.len();
        let surprise = |part: &[(View, Isometry3<f64>)]| -> f64 {
            let Some(start) = self.start(part) else {
                return f64::MAX;
            };
            let (_, residuals) = self.fitted(part, &start, FreeParameters::Both, false);
            residuals
                .iter()
                .map(|r| (r / self.most_px).powi(2).ln_1p())
                .sum()
        };
        let splits = (FEWEST..=n.saturating_sub(FEWEST)).map(|at| {
            let (early, late) = views.split_at(at);
            (surprise(early) + surprise(late), at)
        });
        splits.min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// Two changes, where one of these parts splits once more and each of the three agrees with itself.
    fn twice(
        &self,
        camera: usize,
        early: &[(View, Isometry3<f64>)],
        late: &[(View, Isometry3<f64>)],
    ) -> Option<Vec<Split>> {
        let both = |first, second, third| {
            let changes = [self.explained(camera, first, second)?];
            let last = self.explained(camera, second, third)?;
            Some(changes.into_iter().chain([last]).collect::<Vec<_>>())
        };
        let in_early = || {
            let (first, second) = early.split_at(self.best_split(early)?.1);
            both(first, second, late)
        };
        let in_late = || {
            let (second, third) = late.split_at(self.best_split(late)?.1);
            both(early, second, third)
        };
        match early.len() >= late.len() {
            true => in_early().or_else(in_late),
            false => in_late().or_else(in_early),
        }
    }

    /// The lens and, by vote, the place on which most of these views agree.
    fn start(&self, part: &[(View, Isometry3<f64>)]) -> Option<CameraState> {
        let comparison = Comparison::new(self.reference.session);
        let candidates = part.iter().filter_map(|(view, own)| {
            let rig_from_board = self.reference.rig_from_board[view.placement]?;
            Some(
                comparison
                    .readings(own)
                    .map(move |own| own * rig_from_board.inverse()),
            )
        });
        let votes = candidates.flatten().map(|camera_from_rig| {
            let apart = |(view, own): &(View, Isometry3<f64>)| {
                let rig_from_board = self.reference.rig_from_board[view.placement];
                let predicted = camera_from_rig * rig_from_board.unwrap_or_default();
                comparison.nearest_turn(own, &predicted).1.min(AGREES)
            };
            (part.iter().map(apart).sum::<f64>(), camera_from_rig)
        });
        let (_, camera_from_rig) = votes.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(CameraState {
            lens: self.lens,
            free: [false; PARAMETERS],
            camera_from_rig,
            pose_free: false,
            prior: priors(&self.lens),
        })
    }

    /// The camera adjusted to some of its views, and their residuals. `jointly` lets the placements move within what
    /// the reference's cameras saw of them.
    fn fitted(
        &self,
        part: &[(View, Isometry3<f64>)],
        start: &CameraState,
        free: FreeParameters,
        jointly: bool,
    ) -> (CameraState, Vec<f64>) {
        let comparison = Comparison::new(self.reference.session);
        let board = &self.reference.session.board;
        let fit = &self.reference.fit;
        let state = |c: &super::super::result::FittedCamera| CameraState {
            lens: Lens::from_intrinsics(&c.camera.intrinsics),
            free: [false; PARAMETERS],
            camera_from_rig: c.camera.rig_from_camera.inverse(),
            pose_free: false,
            prior: [None; PARAMETERS],
        };
        let mut cameras: Vec<CameraState> = fit.cameras.iter().map(state).collect();
        let own = cameras.len();
        cameras.push(CameraState {
            free: match free {
                FreeParameters::Nothing | FreeParameters::Pose => [false; PARAMETERS],
                // Its centre would pass for a turn of the camera.
                FreeParameters::Lens => std::array::from_fn(|i| i < 2 && self.lens_free[i]),
                FreeParameters::Both => self.lens_free,
            },
            pose_free: matches!(free, FreeParameters::Pose | FreeParameters::Both),
            ..start.clone()
        });
        let mut placements = Vec::new();
        let mut views = Vec::new();
        for (view, own_pose) in part {
            let rig_from_board = self.reference.rig_from_board[view.placement].unwrap_or_default();
            let predicted = start.camera_from_rig * rig_from_board;
            let mut view = view.clone();
            view.turn(board, comparison.nearest_turn(own_pose, &predicted).0);
            views.push(observation(&view, own, placements.len(), board));
            let name = &self.reference.session.placements[view.placement];
            let of_fit = fit.placements.iter().position(|p| p.name == *name);
            if jointly {
                let others = fit.views.iter().filter(|v| Some(v.placement) == of_fit);
                views.extend(others.map(|v| observation(v, v.camera, placements.len(), board)));
            }
            placements.push(PlacementState {
                rig_from_board,
                free: jointly,
            });
        }
        let mut bundle = Bundle {
            cameras,
            placements,
            board_from_back: fit.front_from_back,
            back_free: false,
            sheet: Sheet::of(board, fit.shape.shape()),
            views,
        };
        bundle.adjust_robustly(2);
        let of_own = bundle.views.iter().filter(|v| v.camera == own);
        let residuals = of_own.map(|v| rms(&bundle, v)).collect();
        (bundle.cameras[own].clone(), residuals)
    }

    /// Whether most of these residuals are no larger than usual.
    fn agree(&self, residuals: &[f64]) -> bool {
        let agreeing = residuals.iter().filter(|r| **r <= self.most_px).count();
        agreeing >= FEWEST && agreeing as f64 >= MOST_AGREE * residuals.len() as f64
    }

    /// What explains the shorter part of the views by a change from the longer one; `None` if nothing needs to, or
    /// does.
    fn explained(
        &self,
        camera: usize,
        early: &[(View, Isometry3<f64>)],
        late: &[(View, Isometry3<f64>)],
    ) -> Option<Split> {
        let is_mostly_early = early.len() >= late.len();
        let (longer, shorter) = match is_mostly_early {
            true => (early, late),
            false => (late, early),
        };
        let (held, residuals) =
            self.fitted(longer, &self.start(longer)?, FreeParameters::Both, true);
        if !self.agree(&residuals) {
            return None;
        }
        let tried = |start: &CameraState, free: FreeParameters| {
            let (state, mut residuals) = self.fitted(shorter, start, free, true);
            let agrees = self.agree(&residuals);
            let median = upper_median(&mut residuals).unwrap_or(f64::MAX);
            (state, agrees, median)
        };
        let unchanged = tried(&held, FreeParameters::Nothing);
        let elsewhere = CameraState {
            camera_from_rig: self.start(shorter)?.camera_from_rig,
            ..held.clone()
        };
        let moved = tried(&elsewhere, FreeParameters::Pose);
        let refocused = tried(&held, FreeParameters::Lens);
        // Views that agree without a change may still show a small one.
        if unchanged.1 && unchanged.2 < BETTER * moved.2.min(refocused.2) {
            return None;
        }
        let both = tried(&elsewhere, FreeParameters::Both);
        let poses = |state: &CameraState| match is_mostly_early {
            true => [held.camera_from_rig, state.camera_from_rig],
            false => [state.camera_from_rig, held.camera_from_rig],
        };
        let zoom = |state: &CameraState| {
            let part = state.lens.focal_px() / held.lens.focal_px();
            if is_mostly_early {
                part - 1.0
            } else {
                1.0 / part - 1.0
            }
        };
        let motion = change_of(&poses(&moved.0));
        let (change, state) = if moved.1 || refocused.1 {
            let (better, worse) = (moved.2.min(refocused.2), moved.2.max(refocused.2));
            if moved.1 && refocused.1 && worse < CLEARLY * better && !is_still(motion) {
                (Change::Either(motion, zoom(&refocused.0)), moved.0)
            } else if moved.2 < refocused.2 {
                (Change::Moved(motion), moved.0)
            } else {
                (Change::Refocused(zoom(&refocused.0)), refocused.0)
            }
        } else if both.1 && shorter.len() >= FEWEST_FOR_BOTH {
            let motion = change_of(&poses(&both.0));
            (Change::Both(motion, zoom(&both.0)), both.0)
        } else {
            return None;
        };
        Some(Split {
            camera,
            last_early: early.last()?.0.placement,
            first_late: late.first()?.0.placement,
            change,
            poses: poses(&state),
            is_mostly_early,
            is_larger_part_sound: residuals.iter().all(|r| *r <= self.most_px),
        })
    }
}

fn is_still([degrees, metres]: [f64; 2]) -> bool {
    degrees < STILL[0] && metres < STILL[1]
}

fn observation(
    view: &View,
    camera: usize,
    placement: usize,
    board: &crate::calibration::Board,
) -> Observation {
    Observation {
        camera,
        placement,
        back: view.face == Face::Back,
        weight: 1.0,
        points: view.pairs(board),
    }
}

//! Finds the cameras that contradict the rig, and fits the placements from the other cameras alone.

use super::super::outliers::LEAST_USUAL;
use super::super::planar::PlanePose;
use super::super::result::Fit;
use super::super::session::{Session, SessionCamera, View};
use super::super::{Parameters, single_camera, solve};
use super::advice::Least;
use crate::calibration::Face;
use crate::frame::CameraId;
use crate::statistics::upper_median;
use nalgebra::Isometry3;

/// Views that a camera must have lost before it is asked why.
const FEWEST_LEFT_OUT: usize = 2;
/// Part of the largest change from which on a camera's own counts: a camera that changes pulls its neighbours along.
const AS_LARGE: f64 = 0.5;
/// Most cameras that are tried as the one that is sound.
const MOST_CANDIDATES: usize = 4;
/// Fewest views of a camera from which a cause is derived.
pub(super) const FEWEST_VIEWS: usize = 4;

/// A rig of the cameras that are not suspected.
pub(super) struct Reference<'a> {
    pub session: &'a Session,
    /// Indices in the session of the cameras that its fit holds.
    pub cameras: Vec<usize>,
    /// Indices of those that are suspected.
    pub suspects: Vec<usize>,
    pub fit: Fit,
    /// The board at each of the session's placements that its cameras saw.
    pub rig_from_board: Vec<Option<Isometry3<f64>>>,
    /// Whether either of two cameras may be at fault, because the rig is one camera and only one suspect can be
    /// compared with it.
    pub is_relative: bool,
    /// What has to be left of the session for a calibration from some placement on.
    pub least: Least,
}

impl<'a> Reference<'a> {
    /// Rigs without the cameras that contradict it: one, or, where all contradict each other, one for each of the least
    /// suspected cameras. A camera that saw too little counts as none.
    pub(super) fn candidates(
        session: &'a Session,
        fit: Option<&Fit>,
        parameters: &Parameters,
        least: Least,
    ) -> Vec<Self> {
        let mut suspects = suspects(session, fit, parameters);
        let all: Vec<usize> = (0..session.cameras.len()).collect();
        let views = |c: usize| session.views.iter().filter(|v| v.camera == c).count();
        let sees = |c: &usize| views(*c) >= FEWEST_VIEWS;
        suspects.retain(sees);
        let seeing: Vec<usize> = all.iter().copied().filter(sees).collect();
        let without = |suspects: Vec<usize>, cameras: &[usize]| {
            Self::without(session, cameras, suspects, parameters, least)
        };
        if suspects.is_empty() {
            return Vec::new();
        }
        if let [_, second] = seeing[..] {
            return without(vec![second], &seeing).into_iter().collect();
        }
        if suspects.len() < seeing.len() {
            return without(suspects, &all).into_iter().collect();
        }
        let least_suspected = suspects.iter().rev().take(MOST_CANDIDATES);
        let others = |&held: &usize| suspects.iter().copied().filter(|&c| c != held).collect();
        least_suspected
            .filter_map(|held| without(others(held), &all))
            .collect()
    }

    /// Fits the rig of these cameras without the suspected ones or, where nothing can be fitted without them all,
    /// without the first of them.
    fn without(
        session: &'a Session,
        of: &[usize],
        mut suspects: Vec<usize>,
        parameters: &Parameters,
        least: Least,
    ) -> Option<Self> {
        let quick = quick(parameters);
        while !suspects.is_empty() {
            let mut cameras = of.to_vec();
            cameras.retain(|c| !suspects.contains(c));
            if let Ok(fit) = solve::fit(&part(session, &cameras), &quick) {
                return Some(Self::of_fit(session, fit, suspects, least));
            }
            suspects.pop();
        }
        None
    }

    fn of_fit(session: &'a Session, fit: Fit, suspects: Vec<usize>, least: Least) -> Self {
        let index = |id: &CameraId| session.cameras.iter().position(|c| c.id == *id);
        let cameras = fit.cameras.iter().filter_map(|c| index(&c.camera.id));
        let pose = |name: &String| {
            let found = fit.placements.iter().find(|p| p.name == *name);
            found.map(|p| p.rig_from_board)
        };
        let rig_from_board: Vec<_> = session.placements.iter().map(pose).collect();
        let shared = |camera: usize| {
            let own = session.views.iter().filter(|v| v.camera == camera);
            own.filter(|v| rig_from_board[v.placement].is_some())
                .count()
        };
        let comparable = suspects.iter().filter(|&&c| shared(c) >= FEWEST_VIEWS);
        Self {
            is_relative: fit.cameras.len() == 1 && comparable.count() == 1,
            cameras: cameras.collect(),
            rig_from_board,
            session,
            suspects,
            least,
            fit,
        }
    }

    pub(super) fn id(&self, camera: usize) -> &CameraId {
        &self.session.cameras[camera].id
    }

    /// A camera's views, in the order of the placements.
    pub(super) fn views(&self, camera: usize) -> Vec<View> {
        let own = self.session.views.iter().filter(|v| v.camera == camera);
        let mut views: Vec<View> = own.cloned().collect();
        views.sort_by_key(|v| v.placement);
        views
    }
}

/// The parameters of a fit that is not judged.
pub(super) fn quick(parameters: &Parameters) -> Parameters {
    Parameters {
        folds: 0,
        table_placement: None,
        ..parameters.clone()
    }
}

/// Results from one camera's views only, which no other camera can affect.
pub(super) struct IndependentFit {
    pub lens: super::super::lens::Lens,
    /// The views that a pose explains, with the board's (the front's) pose in each.
    pub views: Vec<(View, Isometry3<f64>)>,
    /// What its residuals usually are.
    pub usual_px: f64,
}

impl IndependentFit {
    pub(super) fn of(
        reference: &Reference,
        subject: &SessionCamera,
        views: &[View],
        parameters: &Parameters,
    ) -> Option<Self> {
        let board = &reference.session.board;
        let all: Vec<&View> = views.iter().collect();
        let alone = single_camera::calibrate(subject, &all, board, parameters.model)?;
        let back_from_front = reference.fit.front_from_back.inverse();
        let front = |view: &View, pose: &PlanePose| match view.face {
            Face::Front => pose.camera_from_plane,
            Face::Back => pose.camera_from_plane * back_from_front,
        };
        let mut rms: Vec<f64> = alone.poses.iter().flatten().map(|p| p.rms_px).collect();
        let posed = views.iter().zip(&alone.poses);
        Some(Self {
            usual_px: upper_median(&mut rms)?.max(LEAST_USUAL),
            lens: alone.lens,
            views: posed
                .filter_map(|(view, pose)| Some((view.clone(), front(view, pose.as_ref()?))))
                .collect(),
        })
    }
}

/// The cameras that contradict the others, the worst first.
fn suspects(session: &Session, fit: Option<&Fit>, parameters: &Parameters) -> Vec<usize> {
    let Some(fit) = fit else {
        let mut all: Vec<usize> = (0..session.cameras.len()).collect();
        let views = |c: usize| session.views.iter().filter(|v| v.camera == c).count();
        all.sort_by_key(|&c| views(c));
        return all;
    };
    let mut medians: Vec<f64> = fit.cameras.iter().map(|c| c.figures.median_px).collect();
    let usual = upper_median(&mut medians).unwrap_or(0.0).max(LEAST_USUAL);
    let largest = fit.changes.first().map_or(0.0, |change| change.by_px);
    let changes = |id: &CameraId| {
        let own = (fit.changes.iter()).find(|c| fit.cameras[c.camera].camera.id == *id);
        own.is_some_and(|change| change.by_px >= AS_LARGE * largest)
    };
    let suspicion = |camera: usize| {
        let id = &session.cameras[camera].id;
        let Some(fitted) = fit.cameras.iter().find(|c| c.camera.id == *id) else {
            return Some(f64::INFINITY);
        };
        let share = fit.left_out_share_of(fitted);
        let is_off = fitted.figures.rms_px > parameters.outlier_ratio * usual;
        let suspected = share.left_out >= FEWEST_LEFT_OUT || is_off || changes(id);
        suspected.then(|| share.part() + if is_off { 1.0 } else { 0.0 })
    };
    let all = (0..session.cameras.len()).filter_map(|c| Some((suspicion(c)?, c)));
    let mut all: Vec<(f64, usize)> = all.collect();
    all.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    all.into_iter().map(|(_, camera)| camera).collect()
}

/// A session of some of its cameras.
fn part(session: &Session, cameras: &[usize]) -> Session {
    let renumbered = |v: &View| {
        let camera = cameras.iter().position(|&c| c == v.camera)?;
        Some(View {
            camera,
            ..v.clone()
        })
    };
    Session {
        board: session.board,
        cameras: cameras
            .iter()
            .map(|&c| session.cameras[c].clone())
            .collect(),
        placements: session.placements.clone(),
        views: session.views.iter().filter_map(renumbered).collect(),
    }
}

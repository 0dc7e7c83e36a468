//! Holds a rig's cameras at their calibrated poses, and places the board where most of them see it.

use super::Parameters;
use super::adjust::{Bundle, CameraState, Observation, PlacementState};
use super::lens::{Lens, PARAMETERS};
use super::planar;
use super::pose_graph::{Comparison, Tree, poses};
use super::result::Figures;
use super::session::{Session, View, both_faces_at_once};
use super::sheet::Sheet;
use crate::calibration::{Camera, Face, RigCalibration};
use nalgebra::{Isometry3, Point2, Point3};
use rayon::prelude::*;

/// The session without cameras that are not known, and the known ones.
pub(super) fn known_part(session: &Session, known: &RigCalibration) -> (Session, Vec<Camera>) {
    let of = |(index, subject): (usize, &super::SessionCamera)| {
        let (camera, _) = known.cameras.get(&subject.id)?;
        let size = [camera.intrinsics.width, camera.intrinsics.height];
        (size == subject.size).then(|| (index, camera.clone()))
    };
    let kept: Vec<(usize, Camera)> = session.cameras.iter().enumerate().filter_map(of).collect();
    let renumbered = |v: &View| {
        let camera = kept.iter().position(|(index, _)| *index == v.camera)?;
        Some(View {
            camera,
            ..v.clone()
        })
    };
    let part = Session {
        board: session.board,
        cameras: kept
            .iter()
            .map(|(index, _)| session.cameras[*index].clone())
            .collect(),
        placements: session.placements.clone(),
        views: session.views.iter().filter_map(renumbered).collect(),
    };
    (part, kept.into_iter().map(|(_, camera)| camera).collect())
}

/// All cameras where they were, the board where most of them see it. The board may be bent as far as the parameters
/// expect of any board, and its back lie behind its front as its placements show.
pub(super) fn start(mut session: Session, cameras: &[Camera], parameters: &Parameters) -> Bundle {
    let lenses: Vec<Lens> = cameras
        .iter()
        .map(|c| Lens::from_intrinsics(&c.intrinsics))
        .collect();
    let alone = |v: &View| planar::pose(&lenses[v.camera], &v.pairs(&session.board));
    let of_views: Vec<_> = session.views.par_iter().map(alone).collect();
    let poses = poses(&session, &of_views);
    let camera_from_root = cameras
        .iter()
        .map(|c| Some(c.rig_from_camera.inverse()))
        .collect();
    let tree = Tree {
        camera_from_root,
        links: Vec::new(),
    };
    let comparison = Comparison::new(&session);
    let equal = vec![1.0; poses.len()];
    let agreed: Vec<_> = (0..session.placements.len())
        .map(|p| comparison.agree(&poses, &tree, p, &equal))
        .collect();
    let board = session.board;
    session.views.retain_mut(|view| {
        let turns = agreed[view.placement].as_ref().map(|a| &a.turns);
        let reading = turns.and_then(|t| t.get(view.camera).copied().flatten());
        view.turn(&board, reading.map_or(0, |(quarters, _)| quarters));
        reading.is_some()
    });
    let state = |(camera, lens): (&Camera, &Lens)| CameraState {
        lens: *lens,
        free: [false; PARAMETERS],
        camera_from_rig: camera.rig_from_camera.inverse(),
        pose_free: false,
        prior: [None; PARAMETERS],
    };
    let placement = |agreed: &Option<super::pose_graph::PlacementEstimate>| PlacementState {
        rig_from_board: agreed
            .as_ref()
            .map_or_else(Isometry3::identity, |a| a.root_from_board),
        free: agreed.is_some(),
    };
    let seen = |v: &View| Observation {
        camera: v.camera,
        placement: v.placement,
        back: v.face == Face::Back,
        weight: 1.0,
        points: v.pairs(&session.board),
    };
    let mut sheet = Sheet::expected(&board, parameters);
    sheet.free.fill(true);
    Bundle {
        cameras: cameras.iter().zip(&lenses).map(state).collect(),
        placements: agreed.iter().map(placement).collect(),
        board_from_back: session.board.front_from_back(),
        back_free: both_faces_at_once(&session),
        sheet,
        views: session.views.iter().map(seen).collect(),
    }
}

pub(super) fn off_px(bundle: &Bundle, camera: usize) -> f64 {
    let views = bundle.views.iter().filter(|v| v.camera == camera);
    let residuals = views.flat_map(|v| bundle.residuals(v));
    Figures::of(residuals.map(|r| r.map_or(1e3, |r| r.norm()))).rms_px
}

/// Root mean square of all residuals in pixels.
pub(super) fn all_off_px(bundle: &Bundle) -> f64 {
    let residuals = bundle.views.iter().flat_map(|v| bundle.residuals(v));
    Figures::of(residuals.map(|r| r.map_or(1e3, |r| r.norm()))).rms_px
}

/// Root mean square in pixels that noise leaves of the board where each view may show it in a place of its own, so that
/// it does not depend on where the cameras are: the median of all views.
pub(super) fn noise_px(bundle: &Bundle) -> f64 {
    let of_view = |view: &Observation| {
        let camera = &bundle.cameras[view.camera];
        let rig_from_board = bundle.placements[view.placement].rig_from_board;
        let start = match view.back {
            true => camera.camera_from_rig * rig_from_board * bundle.board_from_back,
            false => camera.camera_from_rig * rig_from_board,
        };
        let points = bundle.sheet.shaped(view.back, &view.points);
        let alone = planar::refined(&camera.lens, &points, &start)?.camera_from_plane;
        let length = |(p, pixel): &(Point3<f64>, Point2<f64>)| {
            Some((camera.lens.project((alone * p).coords)? - pixel).norm())
        };
        let lengths: Vec<f64> = points.iter().map(length).collect::<Option<_>>()?;
        Some(Figures::of(lengths.into_iter()).rms_px)
    };
    let of_views: Vec<f64> = bundle.views.par_iter().filter_map(of_view).collect();
    Figures::of(of_views.into_iter()).median_px
}

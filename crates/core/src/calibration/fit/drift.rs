//! Finds which cameras of a rig have moved since its calibration, and by how much, from as little as one placement.

use super::adjust::{Bundle, CameraState, Observation, PlacementState, moved};
use super::lens::{Lens, PARAMETERS};
use super::outliers::mild_loss;
use super::planar;
use super::pose_graph::{Comparison, Tree, poses};
use super::result::Figures;
use super::session::{Session, View};
use crate::calibration::{Camera, Face, RigCalibration};
use crate::frame::CameraId;
use crate::number;
use nalgebra::{Isometry3, Matrix3, Point2, Point3, Vector3, Vector6};
use rayon::prelude::*;

/// When a camera counts as moved.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct Watch {
    /// Root mean square in pixels by which the board is elsewhere in its picture.
    /// Default 0.4, range 0.001 to 1000.
    #[serde(deserialize_with = "number::from_a_thousandth::<_, _, 1000>")]
    pub moved_px: f64,
    /// And how many times what is usual among the cameras, where that is less.
    /// Default 3, range 1 to 1000.
    #[serde(deserialize_with = "number::within::<_, _, 1, 1000>")]
    pub ratio: f64,
}

impl Default for Watch {
    fn default() -> Self {
        Self {
            moved_px: 0.4,
            ratio: 3.0,
        }
    }
}

/// A camera against its calibration.
#[derive(serde::Serialize, Clone, Debug, PartialEq)]
pub struct Checked {
    /// The camera.
    pub camera: CameraId,
    /// Views of the board in which it was checked; 0 for a camera that did not see it.
    pub views: usize,
    /// Root mean square in pixels by which the board is elsewhere in its picture than the other cameras say.
    pub off_px: f64,
    /// How it moved; none for one that did not.
    pub motion: Option<Motion>,
}

/// How a camera moved.
#[derive(serde::Serialize, Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// By how much it turned, in degrees.
    pub turn_degrees: f64,
    /// By how much its centre shifted, in metres; 0 where a turn alone explains what it sees.
    pub shift: f64,
    /// Root mean square of what the motion leaves unexplained, in pixels.
    pub rest_px: f64,
}

/// Why nothing can be said.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum CheckError {
    /// Too few cameras saw the board.
    #[error(
        "{found} calibrated cameras saw the board, expected at least {needed}, of which two agree"
    )]
    TooFew {
        /// How many did.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
    /// Nobody agrees with anybody.
    #[error(
        "of {seen} cameras that saw the board, {moved} disagree with the calibration ({names}): calibrate the rig anew"
    )]
    Disagree {
        /// Cameras that saw the board.
        seen: usize,
        /// Those that disagree.
        moved: usize,
        /// Their names.
        names: String,
    },
}

/// Checks the cameras of a session against their calibration. Cameras that are not in it are left out.
///
/// # Errors
/// If fewer than three cameras saw the board, or half of them and more disagree.
pub fn check(
    session: &Session,
    known: &RigCalibration,
    watch: &Watch,
) -> Result<Vec<Checked>, CheckError> {
    let (session, cameras) = known_part(session, known);
    let mut bundle = start(session, &cameras);
    let seen: Vec<usize> = (0..cameras.len())
        .filter(|&c| bundle.views.iter().any(|v| v.camera == c))
        .collect();
    if seen.len() < 3 {
        return Err(CheckError::TooFew {
            found: seen.len(),
            needed: 3,
        });
    }
    bundle.adjust_robustly(4);
    let mut movers: Vec<usize> = Vec::new();
    loop {
        let off: Vec<(f64, usize)> = seen.iter().map(|&c| (off_px(&bundle, c), c)).collect();
        let still = off.iter().filter(|(_, c)| !movers.contains(c));
        let usual = Figures::of(still.clone().map(|(off, _)| *off)).median_px;
        // Where all are far off, that is not usual.
        let most = watch.moved_px.max(watch.ratio * usual.min(watch.moved_px));
        let Some((_, worst)) = still
            .filter(|(off, _)| *off > most)
            .max_by(|a, b| a.0.total_cmp(&b.0))
        else {
            break;
        };
        bundle.cameras[*worst].pose_free = true;
        movers.push(*worst);
        if 2 * movers.len() >= seen.len() {
            let names: Vec<&str> = movers.iter().map(|&c| cameras[c].id.as_str()).collect();
            let (seen, moved) = (seen.len(), movers.len());
            return Err(CheckError::Disagree {
                seen,
                moved,
                names: names.join(", "),
            });
        }
        bundle.adjust(mild_loss(&bundle), 50);
    }
    let checked = |(index, camera): (usize, &Camera)| {
        let views = bundle.views.iter().filter(|v| v.camera == index).count();
        let pairs = in_rig(&bundle, index);
        let lens = Lens::from_intrinsics(&camera.intrinsics);
        let before = camera.rig_from_camera.inverse();
        Checked {
            camera: camera.id.clone(),
            views,
            off_px: rms(&lens, &pairs, &before),
            motion: movers
                .contains(&index)
                .then(|| motion(&lens, &pairs, camera, &bundle.cameras[index])),
        }
    };
    Ok(cameras.iter().enumerate().map(checked).collect())
}

/// The session without cameras that are not known, and the known ones.
fn known_part(session: &Session, known: &RigCalibration) -> (Session, Vec<Camera>) {
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

/// All cameras where they were, the board where most of them see it.
fn start(mut session: Session, cameras: &[Camera]) -> Bundle {
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
    let agreed: Vec<_> = (0..session.placements.len())
        .map(|p| comparison.agree(&poses, &tree, p))
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
    let placement = |agreed: &Option<super::pose_graph::Agreed>| PlacementState {
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
    Bundle {
        cameras: cameras.iter().zip(&lenses).map(state).collect(),
        placements: agreed.iter().map(placement).collect(),
        board_from_back: session.board.front_from_back(),
        back_free: false,
        views: session.views.iter().map(seen).collect(),
    }
}

fn off_px(bundle: &Bundle, camera: usize) -> f64 {
    let views = bundle.views.iter().filter(|v| v.camera == camera);
    let residuals = views.flat_map(|v| bundle.residuals(v));
    Figures::of(residuals.map(|r| r.map_or(1e3, |r| r.norm()))).rms_px
}

/// The corners that a camera saw: where they are in the rig, and their pixels.
fn in_rig(bundle: &Bundle, camera: usize) -> Vec<(Point3<f64>, Point2<f64>)> {
    let views = bundle.views.iter().filter(|v| v.camera == camera);
    let of_view = |view: &Observation| {
        let rig_from_board = bundle.placements[view.placement].rig_from_board;
        let pose = if view.back {
            rig_from_board * bundle.board_from_back
        } else {
            rig_from_board
        };
        view.points
            .iter()
            .map(|(p, pixel)| (pose * p, *pixel))
            .collect::<Vec<_>>()
    };
    views.flat_map(of_view).collect()
}

fn rms(lens: &Lens, pairs: &[(Point3<f64>, Point2<f64>)], camera_from_rig: &Isometry3<f64>) -> f64 {
    let length = |(p, pixel): &(Point3<f64>, Point2<f64>)| {
        let seen = lens.project((camera_from_rig * p).coords);
        seen.map_or(1e3, |seen| (seen - pixel).norm())
    };
    Figures::of(pairs.iter().map(length)).rms_px
}

/// A turn about the camera's centre where that explains as much as any motion does, and else both.
fn motion(
    lens: &Lens,
    pairs: &[(Point3<f64>, Point2<f64>)],
    before: &Camera,
    after: &CameraState,
) -> Motion {
    let old = before.rig_from_camera.inverse();
    let free = rms(lens, pairs, &after.camera_from_rig);
    let turned = turned_only(lens, pairs, &old);
    let turn_rms = rms(lens, pairs, &turned);
    let (pose, rest_px) = match turn_rms < 1.2 * free + 0.05 {
        true => (turned, turn_rms),
        false => (after.camera_from_rig, free),
    };
    let shift =
        (pose.inverse().translation.vector - before.rig_from_camera.translation.vector).norm();
    Motion {
        turn_degrees: pose.rotation.angle_to(&old.rotation).to_degrees(),
        shift: if turn_rms < 1.2 * free + 0.05 {
            0.0
        } else {
            shift
        },
        rest_px,
    }
}

/// The pose that explains the pixels best with the centre kept: Gauss–Newton on the rotation.
fn turned_only(
    lens: &Lens,
    pairs: &[(Point3<f64>, Point2<f64>)],
    start: &Isometry3<f64>,
) -> Isometry3<f64> {
    let mut turn = Isometry3::identity();
    for _ in 0..20 {
        let (mut h, mut g) = (Matrix3::zeros(), Vector3::zeros());
        for (p, pixel) in pairs {
            let in_camera = (turn * start * p).coords;
            let Some((seen, _, by_point)) = lens.derive(in_camera) else {
                continue;
            };
            let by_turn = by_point * -in_camera.cross_matrix();
            h += by_turn.transpose() * by_turn;
            g += by_turn.transpose() * (seen - pixel);
        }
        let Some(step) = h.cholesky().map(|factor| -factor.solve(&g)) else {
            break;
        };
        turn = moved(&turn, &Vector6::new(step.x, step.y, step.z, 0.0, 0.0, 0.0));
        if step.norm() < 1e-10 {
            break;
        }
    }
    turn * start
}

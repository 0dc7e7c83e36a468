//! Finds which cameras of a rig have moved since its calibration, and by how much, from as little as one placement.

use super::Parameters;
use super::adjust::{Bundle, CameraState, Observation, moved};
use super::as_calibrated::{all_off_px, known_part, noise_px, off_px, start};
use super::board_size::{self, OtherSize};
use super::lens::Lens;
use super::outliers::mild_loss;
use super::result::Figures;
use super::session::Session;
use crate::calibration::{Camera, RigCalibration};
use crate::frame::CameraId;
use crate::range;
use crate::words::count;
use nalgebra::{Isometry3, Matrix3, Point2, Point3, Vector3, Vector6};
use rayon::prelude::*;
use std::collections::BTreeSet;

/// When a camera counts as moved.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct DriftLimits {
    /// Root mean square displacement, in pixels, of the board in a camera's picture above which the camera moved.
    /// Default 0.4, range 0.001 to 1000.
    #[serde(deserialize_with = "range::from_a_thousandth::<_, _, 1000>")]
    pub moved_px: f64,
    /// It must also be more than this many times what noise leaves of the board in a view by itself, of which at most
    /// `moved_px` counts. Two cameras without a third one moved if they contradict each other by more than `moved_px`,
    /// or by more than this many times what a motion of one of them leaves, and if that motion leaves clearly less.
    /// Default 3, range 1 to 1000.
    #[serde(deserialize_with = "range::within::<_, _, 1, 1000>")]
    pub ratio: f64,
    /// Millimetres at 1 m by which a depth camera may read too deep or too near, in addition to its calibration's
    /// uncertainty; the limit grows with the square of the distance.
    /// Default 5, range 0 to 1000.
    #[serde(deserialize_with = "range::within::<_, _, 0, 1000>")]
    pub depth_mm: f64,
    /// Whether a check counts as incomplete if the boards that a depth camera read are too few, or tilted too little,
    /// to show whether its depth lies on its colour picture. Default yes.
    pub registration: bool,
}

impl Default for DriftLimits {
    fn default() -> Self {
        Self {
            moved_px: 0.4,
            ratio: 3.0,
            depth_mm: 5.0,
            registration: true,
        }
    }
}

/// A camera against its calibration.
#[derive(serde::Serialize, Clone, Debug, PartialEq)]
pub struct CheckedCamera {
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

/// Why the cameras cannot be checked.
#[derive(Debug, thiserror::Error, PartialEq)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum CheckError {
    /// The board is of another size.
    #[error("{}", other_board(*larger, board))]
    OtherBoard {
        /// By what part it looks larger.
        larger: f64,
        /// The stated board.
        board: String,
    },
    /// Cameras disagree, and it cannot be told which of them moved.
    #[error(
        "the {} that saw the board disagree by up to {off_px:.2} px on where it is ({most_px:.2} px are allowed), and \
         it cannot be told which of them moved: calibrate the rig again",
        count(*seen, "camera")
    )]
    Disagree {
        /// Cameras that saw the board.
        seen: usize,
        off_px: f64,
        most_px: f64,
    },
    /// A camera's pictures are mirrored.
    #[error(
        "the pictures of camera {camera} are mirrored: mirrored back they agree with the calibration, and no camera \
         moved; switch its mirroring off and show the board again"
    )]
    Mirrored {
        /// The camera, or those of which it may be any.
        camera: String,
    },
    /// Two cameras are at each other's place.
    #[error(
        "cameras {first} and {second} are exchanged: each shows what the calibration expects of the other, and no camera \
         moved. Check their cables and names; if they are to stay as they are, calibrate the rig again"
    )]
    Exchanged { first: CameraId, second: CameraId },
}

fn other_board(larger: f64, board: &str) -> String {
    format!(
        "the board looks {:.1} % {} than {board}; if it is another board, no camera moved: show the board that --board \
         names, or say with --board which one it is. If it is that board, the rig was calibrated with a wrong size of \
         the board: calibrate it again",
        100.0 * larger.abs(),
        if larger > 0.0 { "larger" } else { "smaller" },
    )
}

/// A rig against its calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct DriftResult {
    /// Each camera that is in both.
    pub cameras: Vec<CheckedCamera>,
    /// Those of them that saw the board, or a side of it, only where no other camera saw it, so that nothing shows
    /// whether they moved.
    pub alone: BTreeSet<CameraId>,
    /// How two cameras moved against each other, if no third camera shows which of them moved.
    pub against_each_other: Option<PairMotion>,
    /// From the board's front to the rig, for each of the session's placements that was seen.
    pub rig_from_board: Vec<Option<Isometry3<f64>>>,
    /// From each camera as it is now to the rig, in the order of `cameras`.
    pub rig_from_camera: Vec<Isometry3<f64>>,
    /// Of a two-sided board: from the back's frame to the front's.
    pub front_from_back: Isometry3<f64>,
}

/// How two cameras moved against each other.
#[derive(serde::Serialize, Clone, Debug, PartialEq)]
pub struct PairMotion {
    /// The cameras.
    pub cameras: [CameraId; 2],
    /// The motion of the second one, if the first one stayed.
    pub motion: Motion,
    /// By what share the board would have to be larger than stated to explain it as well; `None` if no size does.
    pub board_larger: Option<f64>,
}

/// Checks the cameras of a session against their calibration. Cameras that are not in it are left out. `parameters` say
/// how far a board may be bent.
///
/// # Errors
/// If the board has another size than stated, a camera's pictures are mirrored, two cameras are exchanged, or three or
/// more cameras disagree and it cannot be told which of them moved.
pub fn check(
    session: &Session,
    known: &RigCalibration,
    watch: &DriftLimits,
    parameters: &Parameters,
) -> Result<DriftResult, CheckError> {
    let (session, cameras) = known_part(session, known);
    let mut bundle = start(session.clone(), &cameras, parameters);
    let (seen, alone) = compared(&bundle);
    bundle.adjust_robustly(4);
    // A camera that moved draws the board with it, so that all are off: only a view by itself shows what is noise.
    let beyond_noise_px = watch.ratio * noise_px(&bundle).min(watch.moved_px);
    let most_px = beyond_noise_px.max(watch.moved_px);
    let watched = Watched {
        session: &session,
        cameras: &cameras,
        parameters,
        seen,
        most_of_pair_px: beyond_noise_px.max(LEAST_OFF),
    };
    if let Some(camera) = watched.mirrored(&bundle, most_px) {
        return Err(CheckError::Mirrored { camera });
    }
    if let Some([first, second]) = watched.exchanged(&bundle, most_px) {
        return Err(CheckError::Exchanged { first, second });
    }
    let (movers, against_each_other) = match watched.seen.as_slice() {
        [] => (Vec::new(), None),
        [first, second] => (
            Vec::new(),
            watched.moved_pair(&mut bundle, [*first, *second], watch),
        ),
        _ => (watched.movers(&mut bundle, most_px)?, None),
    };
    let checked = |(index, camera): (usize, &Camera)| {
        let views = bundle.views.iter().filter(|v| v.camera == index).count();
        let pairs = in_rig(&bundle, index);
        let lens = Lens::from_intrinsics(&camera.intrinsics);
        let before = camera.rig_from_camera.inverse();
        CheckedCamera {
            camera: camera.id.clone(),
            views,
            off_px: rms(&lens, &pairs, &before),
            motion: movers
                .contains(&index)
                .then(|| motion(&lens, &pairs, camera, &bundle.cameras[index])),
        }
    };
    let placements = bundle.placements.iter();
    let states = bundle.cameras.iter();
    Ok(DriftResult {
        cameras: cameras.iter().enumerate().map(checked).collect(),
        alone: alone.iter().map(|&c| cameras[c].id.clone()).collect(),
        against_each_other,
        rig_from_board: placements
            .map(|p| p.free.then_some(p.rig_from_board))
            .collect(),
        rig_from_camera: states.map(|c| c.camera_from_rig.inverse()).collect(),
        front_from_back: bundle.board_from_back,
    })
}

/// Least root mean square in pixels by which two cameras must contradict each other to count as moved.
const LEAST_OFF: f64 = 0.2;

/// One explanation is clearly better than another if it leaves this many times less.
const CLEARLY: f64 = 1.1;

/// Most cameras of which each two are tried as exchanged.
const MOST_EXCHANGED: usize = 6;

/// The cameras that saw the board at a place where another one saw it, and those that saw it only where no other did.
/// Cameras that saw different sides of it are compared only where other cameras tell how the sides lie to each other:
/// the back's pose would follow a camera that is the only one to tell it.
fn compared(bundle: &Bundle) -> (Vec<usize>, Vec<usize>) {
    let sees = |c: usize| bundle.views.iter().any(|v| v.camera == c);
    let shares = |c: &usize| {
        let (own, others): (Vec<&Observation>, Vec<&Observation>) =
            bundle.views.iter().partition(|v| v.camera == *c);
        let are_sides_told = others.iter().any(|a| {
            let mut same = others.iter().filter(|b| b.placement == a.placement);
            same.any(|b| b.back != a.back)
        });
        let is_compared = |v: &Observation, o: &Observation| {
            o.placement == v.placement && (o.back == v.back || are_sides_told)
        };
        own.iter().any(|v| others.iter().any(|o| is_compared(v, o)))
    };
    (0..bundle.cameras.len())
        .filter(|&c| sees(c))
        .partition(shares)
}

/// The cameras that are checked.
struct Watched<'a> {
    session: &'a Session,
    cameras: &'a [Camera],
    /// How far a board may be bent.
    parameters: &'a Parameters,
    /// Those that saw the board together with others.
    seen: Vec<usize>,
    /// Displacement in pixels above which two cameras contradict each other.
    most_of_pair_px: f64,
}

impl Watched<'_> {
    /// Two of the cameras that are farthest off, or the only two, if no camera is off by more than `most_px` once each
    /// of the two has the views of the other.
    fn exchanged(&self, bundle: &Bundle, most_px: f64) -> Option<[CameraId; 2]> {
        let all = self.seen.iter().map(|&c| (off_px(bundle, c), c));
        let mut off: Vec<(f64, usize)> = all.filter(|(off, _)| *off > most_px).collect();
        off.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut worst: Vec<usize> = off.into_iter().map(|(_, camera)| camera).collect();
        worst.truncate(MOST_EXCHANGED);
        if let (1, &[first, second]) = (worst.len(), &self.seen[..]) {
            // The board's poses may follow one of a pair, so that the other alone is off.
            worst = vec![first, second];
        }
        worst.sort_unstable();
        let pairs = worst.iter().enumerate().flat_map(|(k, &first)| {
            let others = worst[k + 1..].iter();
            others.map(move |&second| [first, second])
        });
        let mut explaining = pairs.filter(|pair| self.agree_exchanged(*pair, most_px));
        let found = explaining.next()?;
        Some(found.map(|camera| self.cameras[camera].id.clone()))
    }

    /// Whether all cameras agree with the calibration once two of them have each other's views.
    fn agree_exchanged(&self, [first, second]: [usize; 2], most_px: f64) -> bool {
        let mut session = self.session.clone();
        for view in &mut session.views {
            view.camera = match view.camera {
                camera if camera == first => second,
                camera if camera == second => first,
                camera => camera,
            };
        }
        self.agree(session, most_px)
    }

    /// The camera without whose mirror all cameras agree with the calibration, or all of which that is true.
    fn mirrored(&self, bundle: &Bundle, most_px: f64) -> Option<String> {
        // Mirrored views may show the board so far away that none of them counts.
        let are_all_used = bundle.views.len() == self.session.views.len();
        if are_all_used && self.farthest_px(bundle, &[]) <= most_px {
            return None;
        }
        let agree_mirrored = |camera: usize| {
            let mut session = self.session.clone();
            let width = session.cameras[camera].size[0];
            let own = session.views.iter_mut().filter(|v| v.camera == camera);
            let mut changed = 0;
            for view in own {
                *view = view.mirrored(&self.session.board, width);
                changed += 1;
            }
            changed > 0 && self.agree(session, most_px)
        };
        let found: Vec<usize> = (0..self.cameras.len())
            .into_par_iter()
            .filter(|&camera| agree_mirrored(camera))
            .collect();
        let names = found.iter().map(|&c| self.cameras[c].id.to_string());
        (!found.is_empty()).then(|| names.collect::<Vec<_>>().join(" or of camera "))
    }

    /// Whether all cameras agree with the calibration in all views of this session.
    fn agree(&self, session: Session, most_px: f64) -> bool {
        let count = session.views.len();
        let mut bundle = start(session, self.cameras, self.parameters);
        bundle.adjust_robustly(4);
        let is_near = |c: usize| off_px(&bundle, c) <= most_px;
        bundle.views.len() == count && (0..self.cameras.len()).all(is_near)
    }

    /// The largest displacement in pixels of a camera that is not one of these.
    fn farthest_px(&self, bundle: &Bundle, except: &[usize]) -> f64 {
        let held = self.seen.iter().filter(|c| !except.contains(c));
        held.map(|&c| off_px(bundle, c)).fold(0.0, f64::max)
    }

    /// The cameras that moved, freed in `bundle`: none, or so few that the others show it.
    fn movers(&self, bundle: &mut Bundle, most_px: f64) -> Result<Vec<usize>, CheckError> {
        let off_px = self.farthest_px(bundle, &[]);
        if off_px <= most_px {
            return Ok(Vec::new());
        }
        let moved = self.fewest_movers(bundle, most_px);
        let left_px = |(movers, freed): &(Vec<usize>, Bundle)| self.farthest_px(freed, movers);
        let is_likelier = |size: &OtherSize| {
            let by_moved = moved.as_ref().map(left_px);
            by_moved.is_none_or(|by_moved| size.left_px < CLEARLY * by_moved)
        };
        if let Some(size) = self.other_size(most_px).filter(is_likelier) {
            return Err(CheckError::OtherBoard {
                larger: size.larger,
                board: self.session.board.to_string(),
            });
        }
        let Some((movers, freed)) = moved else {
            return Err(CheckError::Disagree {
                seen: self.seen.len(),
                off_px,
                most_px,
            });
        };
        *bundle = freed;
        Ok(movers)
    }

    /// The fewest cameras, and less than half, without which the others agree, and a bundle in which they are free;
    /// `None` if there are none, or if others would do as well. A camera that moved draws the board with it, so that
    /// the one that is farthest off need not be it: each is freed in turn, and the one kept that lets all agree best.
    fn fewest_movers(&self, bundle: &Bundle, most_px: f64) -> Option<(Vec<usize>, Bundle)> {
        let (mut movers, mut bundle) = (Vec::new(), bundle.clone());
        let mut told = None;
        while 2 * (movers.len() + 1) < self.seen.len() {
            let freed = |&camera: &usize| {
                let mut freed = bundle.clone();
                freed.cameras[camera].pose_free = true;
                for _ in 0..2 {
                    freed.adjust(mild_loss(&freed), 50);
                }
                (all_off_px(&freed), camera, freed)
            };
            let held = self.seen.par_iter().filter(|c| !movers.contains(*c));
            let mut tried: Vec<(f64, usize, Bundle)> = held.map(freed).collect();
            tried.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let mut tried = tried.into_iter();
            let (best_px, camera, best) = tried.next()?;
            let others_px = tried.next().map(|(all_px, ..)| all_px);
            movers.push(camera);
            bundle = best;
            let left_px = self.farthest_px(&bundle, &movers);
            let is_whole = left_px <= self.most_of_pair_px;
            // The board follows two cameras that contradict each other.
            let is_pair_left = self.seen.len() - movers.len() == 2;
            let agree = is_whole || (left_px <= most_px && !is_pair_left && told.is_none());
            let is_clear = others_px.is_none_or(|others_px| CLEARLY * best_px < others_px);
            let moved = |&camera: &usize| self.moved_px(&bundle, camera) > most_px;
            if agree && is_clear && movers.iter().all(moved) {
                told = Some((movers.clone(), bundle.clone()));
            }
            // The others may agree only because the board lies between them and one more that moved.
            if is_whole {
                break;
            }
        }
        told
    }

    /// By how many pixels the board is elsewhere in a camera's picture than its calibration says.
    fn moved_px(&self, bundle: &Bundle, camera: usize) -> f64 {
        let known = &self.cameras[camera];
        let lens = Lens::from_intrinsics(&known.intrinsics);
        let before = known.rig_from_camera.inverse();
        rms(&lens, &in_rig(bundle, camera), &before)
    }

    /// The size of the board with which no camera is off by more than `most` pixels.
    fn other_size(&self, most: f64) -> Option<OtherSize> {
        board_size::explaining(self.session, self.cameras, self.parameters, most)
    }

    /// How two cameras moved against each other, the second one freed in `bundle`; `None` where they did not.
    fn moved_pair(
        &self,
        bundle: &mut Bundle,
        pair: [usize; 2],
        watch: &DriftLimits,
    ) -> Option<PairMotion> {
        let off = |bundle: &Bundle| {
            pair.map(|c| off_px(bundle, c))
                .into_iter()
                .fold(0.0, f64::max)
        };
        let held = off(bundle);
        let mut freed = bundle.clone();
        freed.cameras[pair[1]].pose_free = true;
        freed.adjust_robustly(4);
        let left = off(&freed);
        // The board's pose takes up much of what two cameras contradict each other in.
        let most = (watch.ratio * left).max(LEAST_OFF).min(watch.moved_px);
        // What is left of noisy pictures may be more than that by itself: a motion must explain a part of it.
        if held <= most || held <= CLEARLY * left {
            return None;
        }
        *bundle = freed;
        let second = &self.cameras[pair[1]];
        let lens = Lens::from_intrinsics(&second.intrinsics);
        let pairs = in_rig(bundle, pair[1]);
        Some(PairMotion {
            cameras: pair.map(|c| self.cameras[c].id.clone()),
            motion: motion(&lens, &pairs, second, &bundle.cameras[pair[1]]),
            board_larger: self.other_size(most).map(|size| size.larger),
        })
    }
}

/// The corners that a camera saw: where they are in the rig, and their pixels.
fn in_rig(bundle: &Bundle, camera: usize) -> Vec<(Point3<f64>, Point2<f64>)> {
    let views = bundle.views.iter().filter(|v| v.camera == camera);
    let of_view = |view: &Observation| {
        let rig_from_board = bundle.placements[view.placement].rig_from_board;
        let points = view.points.iter();
        points
            .map(|(p, pixel)| (rig_from_board * bundle.on_board(view, p), *pixel))
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

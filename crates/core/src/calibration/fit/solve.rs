//! The order of the fit's steps: each camera alone, the tree that joins them, one bundle adjustment, removal of
//! outliers, the rig's frame, and uncertainties.

use super::adjust::{Bundle, CAMERA, CameraState, Observation, PlacementState};
use super::change::changes;
use super::frame::{below, lowest_placement, rig_from_table, with_front_seen};
use super::holdout::is_connected;
use super::lens::PARAMETERS;
use super::outliers::{self, Omission, ViewDecision, mild_loss};
use super::planar::PlanePose;
use super::pose_graph::{Comparison, Link, PlacementEstimate, Tree, poses, tree};
use super::projection::projections;
use super::readings::Readings;
use super::result::{
    Figures, Fit, FittedCamera, FittedPlacement, LeftOut, Uncertainty, ViewResiduals, coverage,
};
use super::session::{Corner, Session, View, both_faces_at_once};
use super::sheet::Sheet;
use super::sheet_terms::{CrossValidation, settled};
use super::single_camera::{self, SingleCamera};
use super::volume::proposed;
use super::{Error, Parameters};
use crate::calibration::{Board, BoardKind, Camera, Face, Intrinsics};
use crate::words;
use nalgebra::{DMatrix, Isometry3, Matrix3, Point3, SMatrix, Vector3};
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Fits a rig to a session.
///
/// # Errors
/// If no camera has enough views, the cameras are not connected by shared placements, the table's placement is missing,
/// or the equations cannot be solved.
pub fn fit(session: &Session, parameters: &Parameters) -> Result<Fit, Error> {
    let mut left_out = Vec::new();
    let mut session = session.clone();
    // Each round leaves something out.
    loop {
        let usable = usable(&session, parameters, &mut left_out)?;
        let mut solver = Solver::start(usable, parameters, &mut left_out)?;
        solver.leave_out_what_does_not_belong(&mut left_out);
        if solver.is_well_seen() {
            return solver.finish(left_out);
        }
        session = solver.session;
    }
}

/// The session without cameras that have too few views, and without views that have too few corners.
fn usable(
    session: &Session,
    parameters: &Parameters,
    left_out: &mut Vec<LeftOut>,
) -> Result<Session, Error> {
    let enough = |v: &&View| v.corners.len() >= parameters.fewest_corners();
    let views: Vec<&View> = session.views.iter().filter(enough).collect();
    let count = |camera: usize| views.iter().filter(|v| v.camera == camera).count();
    let needed = |camera: usize| match session.cameras[camera].known {
        Some(_) => 1,
        None => parameters.min_views.max(1),
    };
    let mut kept = Vec::new();
    let mut details = Vec::new();
    for (camera, subject) in session.cameras.iter().enumerate() {
        let (found, needed) = (count(camera), needed(camera));
        if found >= needed {
            kept.push(camera);
            continue;
        }
        let reason = match found {
            0 => no_view(&session.board),
            _ => format!(
                "it has {} of the board that can be used, expected at least {needed}",
                words::count(found, "view")
            ),
        };
        details.push(format!("{}: {reason}", subject.id));
        left_out.push(LeftOut {
            camera: Some(subject.id.clone()),
            placement: None,
            reason,
            views: Vec::new(),
            apart: None,
        });
    }
    if kept.is_empty() {
        return Err(Error::NothingToFit {
            details: details.join("; "),
        });
    }
    let renumbered = |v: &&View| {
        let camera = kept.iter().position(|&c| c == v.camera)?;
        Some(View {
            camera,
            ..(*v).clone()
        })
    };
    Ok(Session {
        board: session.board,
        cameras: kept.iter().map(|&c| session.cameras[c].clone()).collect(),
        placements: session.placements.clone(),
        views: views.iter().filter_map(renumbered).collect(),
    })
}

/// Why a camera without a view of the board is left out, and what may have caused it.
fn no_view(board: &Board) -> String {
    let words = "it has no usable view of the board";
    match board.kind {
        BoardKind::Checkerboard => words.to_owned(),
        BoardKind::Charuco(_) => {
            format!("{words}; mirrored pictures do this too, as markers cannot be read in them")
        }
    }
}

/// A session and its bundle; views of both are the same in the same order.
struct Solver<'a> {
    session: Session,
    parameters: &'a Parameters,
    bundle: Bundle,
    links: Vec<[usize; 2]>,
    false_corners: Vec<usize>,
}

/// Calibrates each camera from its own views; views that fit no pose are left out.
fn alone(
    session: &mut Session,
    parameters: &Parameters,
    left_out: &mut Vec<LeftOut>,
) -> Result<(Vec<SingleCamera>, Vec<Option<PlanePose>>), Error> {
    let cameras: Vec<usize> = (0..session.cameras.len()).collect();
    let calibrate = |&camera: &usize| {
        let views: Vec<&View> = session
            .views
            .iter()
            .filter(|v| v.camera == camera)
            .collect();
        single_camera::calibrate(
            &session.cameras[camera],
            &views,
            &session.board,
            parameters.model,
        )
    };
    let found: Vec<Option<SingleCamera>> = cameras.par_iter().map(calibrate).collect();
    let mut alones = Vec::new();
    for (camera, found) in found.into_iter().enumerate() {
        let id = &session.cameras[camera].id;
        alones.push(found.ok_or_else(|| {
            Error::Unsolvable(format!(
                "no lens explains what camera {id} saw of the board"
            ))
        })?);
    }
    let mut next = vec![0; alones.len()];
    let mut poses = Vec::new();
    for view in &session.views {
        poses.push(alones[view.camera].poses[next[view.camera]]);
        next[view.camera] += 1;
    }
    let mut kept = Vec::new();
    for (view, pose) in session.views.iter().zip(&poses) {
        kept.push(pose.is_some());
        if pose.is_none() {
            left_out.push(LeftOut {
                camera: Some(session.cameras[view.camera].id.clone()),
                placement: Some(session.placements[view.placement].clone()),
                reason: "no pose of the board explains its corners".into(),
                views: vec![session.cameras[view.camera].id.clone()],
                apart: None,
            });
        }
    }
    let mut keep = kept.iter();
    session
        .views
        .retain(|_| keep.next().copied().unwrap_or(false));
    poses.retain(Option::is_some);
    Ok((alones, poses))
}

/// The tree of all cameras.
fn joined(session: &Session, links: &[Link]) -> Result<Tree, Error> {
    let n = session.cameras.len();
    let strength = |c: usize| -> f64 {
        links
            .iter()
            .filter(|l| l.cameras.contains(&c))
            .map(|l| l.score)
            .sum()
    };
    let root = (0..n).max_by(|&a, &b| strength(a).total_cmp(&strength(b)).then(b.cmp(&a)));
    let whole = tree(n, links, root.unwrap_or(0));
    if whole.camera_from_root.iter().all(Option::is_some) {
        return Ok(whole);
    }
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for camera in 0..n {
        if groups.iter().all(|g| !g.contains(&camera)) {
            let reached = tree(n, links, camera).camera_from_root;
            groups.push((0..n).filter(|&c| reached[c].is_some()).collect());
        }
    }
    let id = |c: usize| session.cameras[c].id.clone();
    let placements = |c: usize| -> BTreeSet<usize> {
        session
            .views
            .iter()
            .filter(|v| v.camera == c)
            .map(|v| v.placement)
            .collect()
    };
    let pairs = (0..n).flat_map(|a| (a + 1..n).map(move |b| [a, b]));
    let group = |c: usize| groups.iter().position(|g| g.contains(&c));
    let ambiguous =
        pairs.filter(|&[a, b]| group(a) != group(b) && !placements(a).is_disjoint(&placements(b)));
    Err(Error::Disjoint {
        ambiguous: ambiguous.map(|pair| pair.map(id)).collect(),
        groups: groups
            .iter()
            .map(|g| g.iter().map(|&c| id(c)).collect())
            .collect(),
    })
}

impl<'a> Solver<'a> {
    fn start(
        mut session: Session,
        parameters: &'a Parameters,
        left_out: &mut Vec<LeftOut>,
    ) -> Result<Self, Error> {
        let (alones, of_views) = alone(&mut session, parameters, left_out)?;
        let poses = poses(&session, &of_views);
        let comparison = Comparison::new(&session);
        let tree = joined(&session, &comparison.links(&poses))?;
        let readings = Readings::of(&comparison, &poses, &tree, session.placements.len());
        let state = |agreed: &Option<PlacementEstimate>| {
            let rig_from_board = agreed.as_ref().map(|a| a.root_from_board);
            PlacementState {
                rig_from_board: rig_from_board.unwrap_or_else(Isometry3::identity),
                free: rig_from_board.is_some(),
            }
        };
        let placements: Vec<PlacementState> = readings.placements.iter().map(state).collect();
        readings.apply(&mut session, left_out);
        let cameras = alones
            .iter()
            .zip(&tree.camera_from_root)
            .zip(&session.cameras);
        let cameras = cameras.map(|((alone, pose), subject)| CameraState {
            lens: alone.lens,
            free: match subject.known {
                Some(_) => [false; PARAMETERS],
                None => single_camera::free_parameters(parameters.model),
            },
            camera_from_rig: pose.unwrap_or_else(Isometry3::identity),
            pose_free: pose.is_some_and(|p| p != Isometry3::identity()),
            prior: single_camera::priors(&alone.lens),
        });
        let mut bundle = Bundle {
            cameras: cameras.collect(),
            placements,
            board_from_back: session.board.front_from_back(),
            back_free: both_faces_at_once(&session),
            sheet: Sheet::expected(&session.board, parameters),
            views: session.views.iter().map(|v| seen(&session, v)).collect(),
        };
        bundle.retain_views(|_, _| true);
        bundle.adjust_robustly(2);
        // What does not belong is to be told from a board that is bent.
        bundle.sheet.free.fill(true);
        bundle.adjust_robustly(2);
        let false_corners = vec![0; session.cameras.len()];
        Ok(Self {
            session,
            parameters,
            bundle,
            links: tree.links,
            false_corners,
        })
    }

    /// Removes views and placements, the worst first, until the rest is consistent.
    fn leave_out_what_does_not_belong(&mut self, left_out: &mut Vec<LeftOut>) {
        for (placement, reason) in outliers::duplicates(&self.bundle, &self.session.placements) {
            self.leave_out(&ViewDecision::Duplicate(placement, reason), left_out);
        }
        for _ in 0..self.session.views.len() {
            let Some(verdict) = outliers::worst(&self.bundle, self.parameters.outlier_ratio) else {
                break;
            };
            self.leave_out(&verdict, left_out);
            if !self.is_well_seen() {
                return;
            }
            self.bundle.adjust_robustly(2);
        }
        let deviations = self.parameters.false_corner_deviations;
        self.false_corners = outliers::drop_false_corners(&mut self.bundle, deviations);
        let fewest = self.parameters.fewest_corners();
        let poor: Vec<bool> = self
            .bundle
            .views
            .iter()
            .map(|v| v.points.len() < fewest)
            .collect();
        for index in (0..poor.len()).rev().filter(|&i| poor[i]) {
            let why = Omission {
                reason: "few of its corners are where they should be".to_owned(),
                apart: None,
            };
            self.leave_out(&ViewDecision::View(index, why), left_out);
        }
        self.bundle.adjust(mild_loss(&self.bundle), 30);
    }

    fn leave_out(&mut self, verdict: &ViewDecision, left_out: &mut Vec<LeftOut>) {
        let session = &mut self.session;
        let name = |placement: usize| Some(session.placements[placement].clone());
        let id = |view: &View| session.cameras[view.camera].id.clone();
        left_out.push(match verdict {
            ViewDecision::View(index, why) => LeftOut {
                camera: Some(id(&session.views[*index])),
                placement: name(session.views[*index].placement),
                reason: why.reason.clone(),
                views: vec![id(&session.views[*index])],
                apart: why.apart,
            },
            ViewDecision::Placement(placement, why) => LeftOut {
                camera: None,
                placement: name(*placement),
                reason: why.reason.clone(),
                views: (session.views.iter())
                    .filter(|v| v.placement == *placement)
                    .map(id)
                    .collect(),
                apart: why.apart,
            },
            ViewDecision::Duplicate(placement, reason) => LeftOut {
                camera: None,
                placement: name(*placement),
                reason: reason.clone(),
                views: Vec::new(),
                apart: None,
            },
        });
        let keep = |index: usize, placement: usize| match verdict {
            ViewDecision::View(out, _) => index != *out,
            ViewDecision::Placement(out, _) | ViewDecision::Duplicate(out, _) => placement != *out,
        };
        let mut index = 0;
        session.views.retain(|view| {
            index += 1;
            keep(index - 1, view.placement)
        });
        self.bundle
            .retain_views(|index, view| keep(index, view.placement));
    }

    /// Whether every camera has the views that it needs, and all cameras are connected.
    fn is_well_seen(&self) -> bool {
        let views = |c: usize| self.bundle.views.iter().filter(|v| v.camera == c).count();
        let enough = |c: usize| match self.session.cameras[c].known {
            Some(_) => views(c) >= 1,
            None => views(c) >= self.parameters.min_views.max(1),
        };
        (0..self.session.cameras.len()).all(enough) && is_connected(&self.bundle)
    }

    /// Index of the placement that becomes the rig's frame, and whether all else lies above it.
    fn table(&self) -> Result<(usize, bool), Error> {
        let (bundle, board) = (&self.bundle, &self.session.board);
        let (table, below) = match &self.parameters.table_placement {
            None => match lowest_placement(bundle, board) {
                Some(lowest) => lowest,
                None => (self.any_table()?, f64::INFINITY),
            },
            Some(name) => {
                let table = self.named_table(name)?;
                (table, below(bundle, board, &with_front_seen(bundle), table))
            }
        };
        // Smaller errors are noise.
        Ok((table, below < 0.005))
    }

    /// A placement for want of one whose front was seen, if it may be the table like one that a person names.
    fn any_table(&self) -> Result<usize, Error> {
        let first = self.used().first().copied().unwrap_or(0);
        self.named_table(&self.session.placements[first])
    }

    /// Index of the placement that a person says lies on the table.
    fn named_table(&self, name: &str) -> Result<usize, Error> {
        let names = &self.session.placements;
        let joined = |placements: &[usize]| {
            let names: Vec<&str> = placements.iter().map(|&p| names[p].as_str()).collect();
            names.join(", ")
        };
        let used = self.used();
        let Some(table) = used.iter().copied().find(|&p| names[p] == name) else {
            return Err(Error::NoSuchPlacement {
                name: name.to_owned(),
                known: joined(&used),
            });
        };
        let with_front_seen = with_front_seen(&self.bundle);
        let mut views = self.bundle.views.iter();
        match views.find(|v| v.placement == table) {
            Some(view) if !with_front_seen.contains(&table) => Err(Error::TableUpsideDown {
                name: name.to_owned(),
                camera: self.session.cameras[view.camera].id.clone(),
                known: joined(&with_front_seen),
            }),
            _ => Ok(table),
        }
    }

    /// Puts the back to where the board's description has it if what told its pose was left out: nothing would hold it,
    /// and the equations could not be solved. What was seen of it stays where it is.
    fn hold_back_that_nothing_tells(&mut self) {
        if !self.bundle.back_free || both_faces_at_once(&self.session) {
            return;
        }
        let bundle = &mut self.bundle;
        let nominal = self.session.board.front_from_back();
        let stays = bundle.board_from_back * nominal.inverse();
        let of_back = bundle.views.iter().filter(|v| v.back);
        let placements: BTreeSet<usize> = of_back.map(|v| v.placement).collect();
        for placement in placements {
            bundle.placements[placement].rig_from_board *= stays;
        }
        bundle.board_from_back = nominal;
        bundle.back_free = false;
    }

    fn finish(mut self, mut left_out: Vec<LeftOut>) -> Result<Fit, Error> {
        self.hold_back_that_nothing_tells();
        let (table, table_is_lowest) = self.table()?;
        let board_from_rig = self.bundle.placements[table].rig_from_board.inverse();
        self.bundle.reframe(&(rig_from_table() * board_from_rig));
        for camera in &mut self.bundle.cameras {
            camera.pose_free = true;
        }
        self.bundle.placements[table].free = false;
        self.bundle.adjust_weighted();
        let folds = CrossValidation {
            count: self.parameters.folds,
            min_views: self.parameters.min_views,
        };
        let settled = settled(self.bundle, folds).ok_or_else(|| {
            Error::Unsolvable(
                "the views do not determine all lenses and poses; show the board at more places, tilted in different \
                 directions"
                    .into(),
            )
        })?;
        self.bundle = settled.bundle;
        let covariance = settled.covariance;
        let residuals = self.residuals();
        let mut cameras = (0..self.session.cameras.len())
            .map(|c| self.camera(c, &residuals, &covariance))
            .collect::<Result<Vec<_>, _>>()?;
        let volume = self.volume(&cameras);
        let space = volume.map_or_else(|| self.space(), |v| Some([v.min, v.max]));
        if let Some(space) = space {
            let found = projections(&self.bundle.cameras, &covariance, space);
            for (camera, projection) in cameras.iter_mut().zip(found) {
                camera.projection = projection;
            }
        }
        let changes = changes(&self.bundle);
        let placements = self.placements(&residuals);
        let unseen = self.unseen(&left_out);
        left_out.extend(unseen);
        Ok(Fit {
            board: self.session.board,
            volume,
            figures: Figures::of(residuals.iter().flat_map(ViewResiduals::lengths)),
            front_from_back: self.bundle.board_from_back,
            shape: settled.shape,
            table: self.session.placements[table].clone(),
            table_is_lowest,
            held_out: settled.held_out,
            left_out,
            changes,
            views: self.views(),
            links: self.links.clone(),
            cameras,
            placements,
            residuals: self.renumbered(residuals),
        })
    }

    /// Residuals of all views; cameras and placements as the bundle numbers them.
    fn residuals(&self) -> Vec<ViewResiduals> {
        let of_view = |view: &Observation| ViewResiduals {
            camera: view.camera,
            placement: view.placement,
            face: if view.back { Face::Back } else { Face::Front },
            corners: (view.points.iter().zip(self.bundle.residuals(view)))
                .filter_map(|((_, pixel), r)| Some((*pixel, r?)))
                .collect(),
        };
        self.bundle.views.iter().map(of_view).collect()
    }

    /// The placements that are used.
    fn used(&self) -> Vec<usize> {
        let used: BTreeSet<usize> = self.bundle.views.iter().map(|v| v.placement).collect();
        used.into_iter().collect()
    }

    /// Placements without any used view that are not in the list of omissions yet.
    fn unseen(&self, left_out: &[LeftOut]) -> Vec<LeftOut> {
        let used = self.used();
        let is_said = |name: &String| {
            let as_a_whole = |l: &&LeftOut| l.camera.is_none();
            let mut said = left_out.iter().filter(as_a_whole);
            said.any(|l| l.placement.as_ref() == Some(name))
        };
        let all = self.session.placements.iter().enumerate();
        all.filter(|(index, name)| !used.contains(index) && !is_said(name))
            .map(|(_, name)| LeftOut {
                camera: None,
                placement: Some(name.clone()),
                reason: "no camera saw enough of the board to say where it was".into(),
                views: Vec::new(),
                apart: None,
            })
            .collect()
    }

    /// Placements numbered as in the result, where only those that are used are left.
    fn renumbered(&self, residuals: Vec<ViewResiduals>) -> Vec<ViewResiduals> {
        let used = self.used();
        let number = |p: usize| used.iter().position(|&u| u == p).unwrap_or(0);
        residuals
            .into_iter()
            .map(|r| ViewResiduals {
                placement: number(r.placement),
                ..r
            })
            .collect()
    }

    fn views(&self) -> Vec<View> {
        let used = self.used();
        let square = self.session.board.square;
        let index = |length: f64| (length / square).round() as usize;
        let view = |v: &Observation| View {
            camera: v.camera,
            placement: used.iter().position(|&u| u == v.placement).unwrap_or(0),
            face: if v.back { Face::Back } else { Face::Front },
            corners: (v.points.iter())
                .map(|(p, pixel)| Corner {
                    column: index(p.x),
                    row: index(p.y),
                    pixel: *pixel,
                })
                .collect(),
        };
        self.bundle.views.iter().map(view).collect()
    }

    fn camera(
        &self,
        camera: usize,
        residuals: &[ViewResiduals],
        covariance: &DMatrix<f64>,
    ) -> Result<FittedCamera, Error> {
        let state = &self.bundle.cameras[camera];
        let id = self.session.cameras[camera].id.clone();
        let unsound = |e| Error::Unsolvable(format!("camera {id}: {e}"));
        let lens = state.lens.intrinsics();
        let lens = lens.and_then(Intrinsics::checked).map_err(unsound)?;
        let own = || residuals.iter().filter(|r| r.camera == camera);
        let start = camera * CAMERA;
        let block = covariance
            .view((start, start), (CAMERA, CAMERA))
            .into_owned();
        Ok(FittedCamera {
            uncertainty: uncertainty(&state.camera_from_rig, &block),
            projection: None,
            figures: Figures::of(own().flat_map(ViewResiduals::lengths)),
            views: own().count(),
            coverage: coverage(
                state.lens.size,
                own().flat_map(|r| r.corners.iter().map(|c| c.0)),
            ),
            false_corners: self.false_corners[camera],
            is_lens_given: self.session.cameras[camera].known.is_some(),
            camera: Camera::new(id, lens, state.camera_from_rig.inverse()),
        })
    }

    fn placements(&self, residuals: &[ViewResiduals]) -> Vec<FittedPlacement> {
        let of = |placement: usize| {
            let own = || residuals.iter().filter(move |r| r.placement == placement);
            FittedPlacement {
                name: self.session.placements[placement].clone(),
                rig_from_board: self.bundle.placements[placement].rig_from_board,
                figures: Figures::of(own().flat_map(ViewResiduals::lengths)),
                cameras: own().map(|r| r.camera).collect::<BTreeSet<_>>().len(),
            }
        };
        self.used().into_iter().map(of).collect()
    }

    /// The box in which the board was.
    fn space(&self) -> Option<[Point3<f64>; 2]> {
        let corners = self.used().into_iter().flat_map(|p| {
            let pose = self.bundle.placements[p].rig_from_board;
            super::session::outermost(&self.session.board).map(|corner| pose * corner)
        });
        let (mut low, mut high) = (
            Point3::from(Vector3::repeat(f64::MAX)),
            Point3::from(Vector3::repeat(f64::MIN)),
        );
        for corner in corners {
            low = low.inf(&corner);
            high = high.sup(&corner);
        }
        ((high - low).max() > 1e-3).then_some([low, high])
    }

    /// What all cameras see of the space in which the board was.
    fn volume(&self, cameras: &[FittedCamera]) -> Option<crate::calibration::Volume> {
        let [mut low, mut high] = self.space()?;
        let margin = 0.25 * (high - low).max();
        low -= Vector3::repeat(margin);
        high += Vector3::repeat(margin);
        low.z = low.z.max(0.0);
        let cameras: Vec<&Camera> = cameras.iter().map(|c| &c.camera).collect();
        ((high - low).min() > 1e-3)
            .then(|| proposed(&cameras, [low, high]))
            .flatten()
    }
}

fn seen(session: &Session, view: &View) -> Observation {
    Observation {
        camera: view.camera,
        placement: view.placement,
        back: view.face == Face::Back,
        weight: 1.0,
        points: view.pairs(&session.board),
    }
}

/// Standard deviations from a camera's covariance; its pose's columns are those of the camera's rotation vector and of
/// the translation of `camera_from_rig`.
fn uncertainty(camera_from_rig: &Isometry3<f64>, covariance: &DMatrix<f64>) -> Uncertainty {
    let deviation = |i: usize| covariance[(i, i)].max(0.0).sqrt();
    let of_pose = covariance.fixed_view::<6, 6>(PARAMETERS, PARAMETERS);
    // The centre is -Rᵀt: it moves by Rᵀ(-[t]× w - dt).
    let back = camera_from_rig.rotation.inverse().to_rotation_matrix();
    let mut by_pose = SMatrix::<f64, 3, 6>::zeros();
    let turned: Matrix3<f64> = -(back.matrix() * camera_from_rig.translation.vector.cross_matrix());
    by_pose.fixed_view_mut::<3, 3>(0, 0).copy_from(&turned);
    by_pose
        .fixed_view_mut::<3, 3>(0, 3)
        .copy_from(&-back.matrix());
    let of_center = by_pose * of_pose * by_pose.transpose();
    Uncertainty {
        focal_px: [deviation(0), deviation(1)],
        center_px: [deviation(2), deviation(3)],
        distortion: std::array::from_fn(|i| deviation(4 + i)),
        rotation_degrees: std::array::from_fn(|i| deviation(PARAMETERS + i).to_degrees()),
        position: std::array::from_fn(|i| of_center[(i, i)].max(0.0).sqrt()),
        position_covariance: of_center,
    }
}

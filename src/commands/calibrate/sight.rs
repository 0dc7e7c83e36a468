//! From recordings to what each camera saw of the board: opens them, decodes and detects on all cores.

use crate::calibration::fit::{Rejection, Session, Subject, View, find_corners};
use crate::calibration::{Board, Intrinsics, RigCalibration};
use crate::frame::CameraId;
use crate::job::{Placements, Shot};
use crate::sync;
use anyhow::Context;
use indicatif::ProgressBar;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

/// What the cameras of some recordings saw.
pub(super) struct Sight {
    pub(super) session: Session,
    /// Cameras that measure depth.
    pub(super) depth_cameras: Vec<CameraId>,
    /// Pictures in which there is no board that can be used, and why.
    pub(super) rejected: Vec<Rejected>,
    /// Pictures that could not be read, and other losses.
    pub(super) lost: Vec<String>,
    pub(super) warnings: Vec<String>,
}

/// A picture without a board that can be used.
#[derive(Debug, serde::Serialize)]
pub(super) struct Rejected {
    pub(super) camera: CameraId,
    pub(super) placement: String,
    pub(super) reason: String,
    #[serde(skip)]
    cause: Rejection,
}

/// Opens the recordings.
pub(super) fn open(
    paths: &[PathBuf],
    parameters: &sync::Parameters,
) -> anyhow::Result<Vec<Placements>> {
    let open = |path: &PathBuf| Ok(Placements::open(path, parameters)?);
    paths.iter().map(open).collect()
}

/// The board that the recordings name, or the one that was given.
pub(super) fn board(given: Option<Board>, recordings: &[Placements]) -> anyhow::Result<Board> {
    let mut named: Option<Board> = None;
    for recording in recordings {
        let path = recording.recording().path().display();
        let metadata = recording
            .recording()
            .metadata()
            .iter()
            .filter(|(name, _)| name == "board");
        for (_, pairs) in metadata {
            if given.is_some() {
                continue;
            }
            let board = Board::from_pairs(pairs)
                .with_context(|| format!("{path}: metadata record board"))?;
            if let Some(other) = named.filter(|other| *other != board) {
                anyhow::bail!(
                    "{path}: the board is {board}, and {other} in a recording before it: give --board"
                );
            }
            named = Some(board);
        }
    }
    given.or(named).context(
        "no recording says what the board is: give --board KIND:COLUMNSxROWS:SQUARE, such as \
         checkerboard:11x8:25mm (in inner corners)",
    )
}

/// What a picture shows.
struct Look<'a> {
    shot: &'a Shot,
    placement: String,
    size: [usize; 2],
    found: Result<View, Rejection>,
}

/// Looks for the board in all pictures. `lenses` are those to keep, and those to start from.
pub(super) fn look(
    recordings: &[Placements],
    board: &Board,
    lenses: [Option<&RigCalibration>; 2],
    progress: &ProgressBar,
) -> anyhow::Result<Sight> {
    let placements = placement_names(recordings);
    let mut cameras: BTreeMap<CameraId, bool> = BTreeMap::new();
    let mut sight = Sight {
        session: Session {
            board: *board,
            cameras: Vec::new(),
            placements: Vec::new(),
            views: Vec::new(),
        },
        depth_cameras: Vec::new(),
        rejected: Vec::new(),
        lost: Vec::new(),
        warnings: Vec::new(),
    };
    let mut looks = Vec::new();
    let all_shots: Vec<Vec<Shot>> = recordings.iter().map(Placements::shots).collect();
    progress.set_length(all_shots.iter().map(Vec::len).sum::<usize>() as u64);
    for ((recording, names), shots) in recordings.iter().zip(&placements).zip(&all_shots) {
        let path = recording.recording().path().display().to_string();
        cameras.extend(recording.cameras());
        sight
            .warnings
            .extend(recording.warnings().iter().map(|w| format!("{path}: {w}")));
        sight
            .lost
            .extend(recording.damage().iter().map(|d| format!("{path}: {d}")));
        let look = |shot| {
            let look = look_at(recording, shot, board, names);
            progress.inc(1);
            look
        };
        let done: Vec<anyhow::Result<Look>> = shots.par_iter().map(look).collect();
        for look in done {
            match look {
                Ok(look) => looks.push(look),
                Err(error) => sight.lost.push(format!("{error:#}")),
            }
        }
    }
    sight.session.placements = placements
        .iter()
        .flat_map(|names| names.values().cloned())
        .collect();
    let ids: Vec<CameraId> = cameras.keys().cloned().collect();
    sight.depth_cameras = cameras
        .into_iter()
        .filter(|(_, depth)| *depth)
        .map(|(id, _)| id)
        .collect();
    for id in &ids {
        let size = looks
            .iter()
            .find(|l| l.shot.camera == *id)
            .map_or([1, 1], |l| l.size);
        let [known, start] = lenses.map(|lenses| lens_of(lenses?, id, size).transpose());
        sight.session.cameras.push(Subject {
            id: id.clone(),
            size,
            known: known.transpose()?,
            start: start.transpose()?,
        });
    }
    for look in looks {
        sight.take(look, &ids);
    }
    sight.check_size()?;
    Ok(sight)
}

/// The lens that a calibration has for a camera whose pictures have this size.
fn lens_of(
    calibration: &RigCalibration,
    id: &CameraId,
    size: [usize; 2],
) -> anyhow::Result<Option<Intrinsics>> {
    let lens = calibration.cameras.get(id).map(|(c, _)| c.intrinsics);
    if let Some(lens) = lens.filter(|lens| [lens.width, lens.height] != size) {
        anyhow::bail!(
            "camera {id}: its known lens is of pictures of {}x{} pixels, and its pictures have {}x{}",
            lens.width,
            lens.height,
            size[0],
            size[1]
        );
    }
    Ok(lens)
}

/// Names of each recording's placements by their ids; where two recordings share one, the recording's name is added.
pub(super) fn placement_names(recordings: &[Placements]) -> Vec<BTreeMap<String, String>> {
    let mut taken = BTreeSet::new();
    let mut all = Vec::new();
    for (index, recording) in recordings.iter().enumerate() {
        let mut names = BTreeMap::new();
        for id in recording.names() {
            let stem = recording
                .recording()
                .path()
                .file_stem()
                .unwrap_or_default()
                .to_string_lossy();
            let candidates = [
                id.clone(),
                format!("{stem}/{id}"),
                format!("{}:{stem}/{id}", index + 1),
            ];
            let free = candidates.into_iter().find(|name| !taken.contains(name));
            let name = free.unwrap_or_else(|| id.clone());
            taken.insert(name.clone());
            names.insert(id, name);
        }
        all.push(names);
    }
    all
}

fn look_at<'a>(
    recording: &Placements,
    shot: &'a Shot,
    board: &Board,
    names: &BTreeMap<String, String>,
) -> anyhow::Result<Look<'a>> {
    let picture = recording.grey(shot)?;
    let found = find_corners(&picture, board);
    // Indices are given once all pictures have been seen.
    let view = |(face, corners)| View {
        camera: 0,
        placement: 0,
        face,
        corners,
    };
    Ok(Look {
        shot,
        placement: names.get(&shot.placement).cloned().unwrap_or_default(),
        size: [picture.width(), picture.height()],
        found: found.map(view),
    })
}

impl Sight {
    fn take(&mut self, look: Look, ids: &[CameraId]) {
        let camera = ids.iter().position(|id| *id == look.shot.camera);
        let placement = self
            .session
            .placements
            .iter()
            .position(|p| *p == look.placement);
        let (Some(camera), Some(placement)) = (camera, placement) else {
            return;
        };
        let expected = self.session.cameras[camera].size;
        if look.size != expected {
            self.lost.push(format!(
                "camera {}: its picture of {} has {}x{} pixels, its first one {}x{}; it is left out",
                look.shot.camera, look.placement, look.size[0], look.size[1], expected[0], expected[1]
            ));
            return;
        }
        match look.found {
            Ok(view) => self.session.views.push(View {
                camera,
                placement,
                ..view
            }),
            Err(cause) => self.rejected.push(Rejected {
                camera: look.shot.camera.clone(),
                placement: look.placement,
                reason: cause.to_string(),
                cause,
            }),
        }
    }

    /// Refuses a session whose boards mostly are of one other size than was said.
    fn check_size(&self) -> anyhow::Result<()> {
        let mut sizes: BTreeMap<[usize; 2], usize> = BTreeMap::new();
        for rejected in &self.rejected {
            if let Rejection::Size { found, .. } = &rejected.cause {
                *sizes.entry(*found).or_default() += 1;
            }
        }
        let Some(([columns, rows], count)) = sizes.into_iter().max_by_key(|(_, count)| *count)
        else {
            return Ok(());
        };
        let board = &self.session.board;
        anyhow::ensure!(
            count <= self.session.views.len().max(1),
            "the board in {count} pictures has {columns}x{rows} inner corners, and {}x{} in {}: is --board right? \
             (it counts inner corners, one less than squares)",
            board.columns,
            board.rows,
            self.session.views.len()
        );
        Ok(())
    }
}

//! Opens recordings, decodes their pictures and detects the board in them, on all cores.

use super::error::{Error, Rejected};
use crate::calibration::fit::{Rejection, Session, SessionCamera, View, find_corners};
use crate::calibration::{Board, Intrinsics, RigCalibration};
use crate::capture::{PictureFiles, Placements, Shot};
use crate::frame::CameraId;
use crate::sync;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

/// What the cameras of some recordings saw.
#[derive(Debug)]
pub struct Detections {
    /// The corners that were found.
    pub session: Session,
    /// Cameras that measure depth.
    pub depth_cameras: Vec<CameraId>,
    /// Pictures without a usable board, with the reason.
    pub rejected: Vec<Rejected>,
    /// Pictures that could not be read, and other losses.
    pub lost: Vec<String>,
    /// What a person should know of the recordings.
    pub warnings: Vec<String>,
}

/// Opens the recordings.
///
/// # Errors
/// If one cannot be read or has no trigger.
pub fn open(paths: &[PathBuf], parameters: &sync::Parameters) -> Result<Vec<Placements>, Error> {
    let open = |path: &PathBuf| Ok(Placements::open(path, parameters)?);
    paths.iter().map(open).collect()
}

/// Takes picture files for a session of placements. Nothing is read yet.
///
/// # Errors
/// If a camera has no picture, or two have unequal numbers of them.
pub fn open_pictures(cameras: BTreeMap<CameraId, Vec<PathBuf>>) -> Result<Placements, Error> {
    Ok(Placements::of_files(PictureFiles::new(cameras)?))
}

/// The board that was given, or the one that the recordings name.
///
/// # Errors
/// If none is named, one cannot be, or two differ.
pub fn board(given: Option<Board>, recordings: &[Placements]) -> Result<Board, Error> {
    if let Some(board) = given {
        return Ok(board);
    }
    let mut named: Option<Board> = None;
    for recording in recordings.iter().filter_map(Placements::recording) {
        let path = recording.path();
        for (_, pairs) in recording
            .metadata()
            .iter()
            .filter(|(name, _)| name == "board")
        {
            let found = Board::from_pairs(pairs).map_err(|cause| Error::BadBoard {
                path: path.into(),
                cause,
            })?;
            if let Some(before) = named.filter(|before| *before != found) {
                return Err(Error::OtherBoard {
                    path: path.into(),
                    found: found.to_string(),
                    before: before.to_string(),
                });
            }
            named = Some(found);
        }
    }
    named.ok_or(Error::NoBoard)
}

/// What a picture shows.
struct Detection<'a> {
    shot: &'a Shot,
    placement: String,
    size: [usize; 2],
    found: Result<View, Rejection>,
}

/// Looks for the board in all pictures, on all cores; `on_picture` is called after each. `lenses` are those to keep,
/// and those to start from. A picture that cannot be read is lost, not an error.
///
/// # Errors
/// If a lens belongs to pictures of another size, or most pictures show a board of another size.
pub fn detect_boards(
    recordings: &[Placements],
    board: &Board,
    lenses: [Option<&RigCalibration>; 2],
    on_picture: &(dyn Fn() + Sync),
) -> Result<Detections, Error> {
    let placements = placement_names(recordings);
    let mut detections = Detections::new(board, &placements);
    let shots: Vec<Vec<Shot>> = recordings.iter().map(Placements::shots).collect();
    let mut found = Vec::new();
    for ((recording, names), shots) in recordings.iter().zip(&placements).zip(&shots) {
        detections.take_problems(recording);
        let detect = |shot| {
            let detection = detect(recording, shot, board, names);
            on_picture();
            detection
        };
        let done: Vec<Result<Detection, Error>> = shots.par_iter().map(detect).collect();
        for detection in done {
            match detection {
                Ok(detection) => found.push(detection),
                Err(error) => detections.lost.push(error.to_string()),
            }
        }
    }
    let cameras: BTreeMap<CameraId, bool> =
        recordings.iter().flat_map(Placements::cameras).collect();
    let depths = cameras.iter().filter(|(_, depth)| **depth);
    detections.depth_cameras = depths.map(|(id, _)| id.clone()).collect();
    let ids: Vec<CameraId> = cameras.into_keys().collect();
    for id in &ids {
        detections
            .session
            .cameras
            .push(subject(id, &found, lenses)?);
    }
    for detection in found {
        detections.take(detection, &ids);
    }
    detections.check_size()?;
    Ok(detections)
}

/// A camera as the fit takes it, whose pictures are as large as its first.
fn subject(
    id: &CameraId,
    found: &[Detection],
    lenses: [Option<&RigCalibration>; 2],
) -> Result<SessionCamera, Error> {
    let first = found.iter().find(|l| l.shot.camera == *id);
    let size = first.map_or([1, 1], |l| l.size);
    let [known, start] = lenses.map(|lenses| lens_of(lenses?, id, size).transpose());
    Ok(SessionCamera {
        id: id.clone(),
        size,
        known: known.transpose()?,
        start: start.transpose()?,
    })
}

/// The lens that a calibration has for a camera whose pictures have this size.
fn lens_of(
    calibration: &RigCalibration,
    id: &CameraId,
    size: [usize; 2],
) -> Result<Option<Intrinsics>, Error> {
    let lens = calibration.cameras.get(id).map(|(c, _)| c.intrinsics);
    match lens {
        Some(lens) if [lens.width, lens.height] != size => Err(Error::LensSize {
            camera: id.clone(),
            lens: [lens.width, lens.height],
            found: size,
        }),
        lens => Ok(lens),
    }
}

/// The pictures by their placements' names and cameras.
pub fn shots(recordings: &[Placements]) -> BTreeMap<(String, String), (&Placements, Shot)> {
    let mut all = BTreeMap::new();
    for (recording, names) in recordings.iter().zip(placement_names(recordings)) {
        for shot in recording.shots() {
            let name = names.get(&shot.placement).cloned().unwrap_or_default();
            all.insert((name, shot.camera.to_string()), (recording, shot));
        }
    }
    all
}

/// Names of each recording's placements by their ids; where two recordings share one, the recording's name is added.
pub(super) fn placement_names(recordings: &[Placements]) -> Vec<BTreeMap<String, String>> {
    let mut taken = BTreeSet::new();
    let mut all = Vec::new();
    for (index, recording) in recordings.iter().enumerate() {
        let mut names = BTreeMap::new();
        for id in recording.names() {
            let stem = recording
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

fn detect<'a>(
    recording: &Placements,
    shot: &'a Shot,
    board: &Board,
    names: &BTreeMap<String, String>,
) -> Result<Detection<'a>, Error> {
    let picture = recording.grey(shot)?;
    let found = find_corners(&picture, board);
    // Indices are given once all pictures have been seen.
    let view = |(face, corners)| View {
        camera: 0,
        placement: 0,
        face,
        corners,
    };
    Ok(Detection {
        shot,
        placement: names.get(&shot.placement).cloned().unwrap_or_default(),
        size: [picture.width(), picture.height()],
        found: found.map(view),
    })
}

impl Detections {
    /// Nothing is seen yet.
    fn new(board: &Board, placements: &[BTreeMap<String, String>]) -> Self {
        Self {
            session: Session {
                board: *board,
                cameras: Vec::new(),
                placements: placements
                    .iter()
                    .flat_map(|names| names.values().cloned())
                    .collect(),
                views: Vec::new(),
            },
            depth_cameras: Vec::new(),
            rejected: Vec::new(),
            lost: Vec::new(),
            warnings: Vec::new(),
        }
    }

    /// What a person should know of a recording, and what of it is damaged.
    fn take_problems(&mut self, recording: &Placements) {
        let path = recording.path().display();
        let warnings = recording.warnings().iter();
        self.warnings
            .extend(warnings.map(|w| format!("{path}: {w}")));
        let damage = recording.damage().iter();
        self.lost.extend(damage.map(|d| format!("{path}: {d}")));
    }

    fn take(&mut self, detection: Detection, ids: &[CameraId]) {
        let camera = ids.iter().position(|id| *id == detection.shot.camera);
        let placement = self
            .session
            .placements
            .iter()
            .position(|p| *p == detection.placement);
        let (Some(camera), Some(placement)) = (camera, placement) else {
            return;
        };
        let expected = self.session.cameras[camera].size;
        if detection.size != expected {
            self.lost.push(format!(
                "camera {}: its picture of {} has {}x{} pixels, its first one {}x{}; it is left out",
                detection.shot.camera, detection.placement, detection.size[0], detection.size[1], expected[0], expected[1]
            ));
            return;
        }
        match detection.found {
            Ok(view) => self.session.views.push(View {
                camera,
                placement,
                ..view
            }),
            Err(cause) => self.rejected.push(Rejected {
                camera: detection.shot.camera.clone(),
                placement: detection.placement,
                reason: cause.to_string(),
                cause,
            }),
        }
    }

    /// Keeps the placements from one to another, both of them included, in the order of the session.
    ///
    /// # Errors
    /// If one is not there, or the last comes before the first.
    pub fn keep_placements(
        &mut self,
        from: Option<&str>,
        until: Option<&str>,
    ) -> Result<(), Error> {
        let names = &self.session.placements;
        let index = |name: &str| {
            let found = names.iter().position(|known| known == name);
            found.ok_or_else(|| Error::NoSuchPlacement {
                name: name.to_owned(),
                known: names.join(", "),
            })
        };
        let first = from.map_or(Ok(0), index)?;
        let last = until.map_or(Ok(names.len().saturating_sub(1)), index)?;
        if first > last {
            return Err(Error::NoPlacements {
                from: from.unwrap_or_default().to_owned(),
                until: until.unwrap_or_default().to_owned(),
            });
        }
        let kept = names.get(first..=last).unwrap_or_default().to_vec();
        self.rejected.retain(|r| kept.contains(&r.placement));
        self.session
            .views
            .retain(|v| (first..=last).contains(&v.placement));
        for view in &mut self.session.views {
            view.placement -= first;
        }
        self.session.placements = kept;
        Ok(())
    }

    /// Refuses a session whose boards mostly have one other size than the stated one.
    fn check_size(&self) -> Result<(), Error> {
        let mut sizes: BTreeMap<[usize; 2], usize> = BTreeMap::new();
        for rejected in &self.rejected {
            if let Rejection::Size { found, .. } = &rejected.cause {
                *sizes.entry(*found).or_default() += 1;
            }
        }
        let Some((found, count)) = sizes.into_iter().max_by_key(|(_, count)| *count) else {
            return Ok(());
        };
        let (board, views) = (&self.session.board, self.session.views.len());
        match count <= views.max(1) {
            true => Ok(()),
            false => Err(Error::BoardSize {
                found,
                pictures: count,
                expected: [board.columns, board.rows],
                views,
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::Face;
    use crate::calibration::fit::Rejection;

    /// A camera that saw the board at each of p0 to p5 but p3.
    fn detections() -> Detections {
        let board = Board::checkerboard(9, 6, 0.025).unwrap();
        let camera = CameraId::new("c00").unwrap();
        let view = |placement| View {
            camera: 0,
            placement,
            face: Face::Front,
            corners: Vec::new(),
        };
        let cause = Rejection::Size {
            found: [3, 3],
            expected: [9, 6],
        };
        Detections {
            session: Session {
                board,
                cameras: Vec::new(),
                placements: (0..6).map(|k| format!("p{k}")).collect(),
                views: [0, 1, 2, 4, 5].map(view).to_vec(),
            },
            depth_cameras: Vec::new(),
            rejected: vec![Rejected {
                camera,
                placement: "p3".into(),
                reason: cause.to_string(),
                cause,
            }],
            lost: Vec::new(),
            warnings: Vec::new(),
        }
    }

    #[test]
    fn the_sound_part_of_a_session_is_kept_alone() {
        let kept = |from, until| {
            let mut detections = detections();
            detections.keep_placements(from, until).map(|()| {
                let session = &detections.session;
                let seen = session
                    .views
                    .iter()
                    .map(|v| session.placements[v.placement].clone());
                (
                    seen.collect::<Vec<_>>().join(" "),
                    detections.rejected.len(),
                )
            })
        };
        assert_eq!(kept(None, None).unwrap(), ("p0 p1 p2 p4 p5".to_owned(), 1));
        assert_eq!(kept(Some("p2"), None).unwrap(), ("p2 p4 p5".to_owned(), 1));
        assert_eq!(kept(None, Some("p2")).unwrap(), ("p0 p1 p2".to_owned(), 0));
        assert_eq!(kept(Some("p4"), Some("p4")).unwrap(), ("p4".to_owned(), 0));
        let error = kept(Some("p9"), None).unwrap_err().to_string();
        assert!(
            error.contains("\"p9\"") && error.contains("p0, p1"),
            "{error}"
        );
        let error = kept(Some("p4"), Some("p2")).unwrap_err().to_string();
        assert!(
            error.contains("\"p2\", comes before the first one, \"p4\""),
            "{error}"
        );
    }
}

//! Opens recordings, decodes their pictures and detects the board in them, on all cores.

use super::error::{Error, Rejected};
use crate::calibration::fit::{Rejection, Session, SessionCamera, View, find_corners};
use crate::calibration::{Board, Intrinsics, RigCalibration};
use crate::capture::{PictureFiles, Placements, Shot};
use crate::frame::CameraId;
use crate::image::AS_STORED;
use crate::sync;
use crate::words::count;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// What the cameras of some recordings saw.
#[derive(Debug)]
pub struct Detections {
    /// The corners that were found.
    pub session: Session,
    /// Cameras that measure depth.
    pub depth_cameras: Vec<CameraId>,
    /// Depth cameras without colour pictures, so that they cannot have seen the board: they are not in the session.
    pub without_color: BTreeSet<CameraId>,
    /// Pictures without a usable board, with the reason.
    pub rejected: Vec<Rejected>,
    /// Pictures that could not be read, and other losses.
    pub lost: Vec<String>,
    /// What a person should know of the recordings.
    pub warnings: Vec<String>,
}

/// Opens the recordings, and puts them into the order in which they were made: a camera that moved stays moved.
///
/// # Errors
/// If one cannot be read or has no trigger.
pub fn open(paths: &[PathBuf], parameters: &sync::Parameters) -> Result<Vec<Placements>, Error> {
    let open = |path: &PathBuf| Ok(Placements::open(path, parameters)?);
    let mut recordings = paths.iter().map(open).collect::<Result<Vec<_>, Error>>()?;
    recordings.sort_by_key(Placements::first_time);
    Ok(recordings)
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
    /// The EXIF orientation that its file states.
    orientation: u8,
    found: Result<View, Rejection>,
}

/// Looks for the board in the pictures of the placements from the first to the last one of `range`, both included, on
/// all cores; `on_picture` is called after each with their number. `lenses` are those to keep, and those to start from.
/// A picture that cannot be read is lost, not an error.
///
/// # Errors
/// If a placement of the range is not there, its last one comes before the first, a lens belongs to pictures of another
/// size, or most pictures show a board of another size.
pub fn detect_boards(
    recordings: &[Placements],
    board: &Board,
    lenses: [Option<&RigCalibration>; 2],
    range: [Option<&str>; 2],
    on_picture: &(dyn Fn(usize) + Sync),
) -> Result<Detections, Error> {
    let placements = placement_names(recordings);
    let kept = kept_placements(&placements, range)?;
    // What lies outside must not count anywhere: it is not read at all.
    let of_range = |(recording, names): (&Placements, &PlacementNames)| {
        let is_kept = |shot: &Shot| {
            let name = names.get(&shot.placement);
            name.is_some_and(|name| kept.contains(name))
        };
        let shots = recording.shots().into_iter().filter(is_kept);
        shots.collect::<Vec<Shot>>()
    };
    let named = recordings.iter().zip(&placements);
    let shots: Vec<Vec<Shot>> = named.map(of_range).collect();
    let pictures: usize = shots.iter().map(Vec::len).sum();
    let mut detections = Detections::new(board, kept);
    let mut found = Vec::new();
    for ((recording, names), shots) in recordings.iter().zip(&placements).zip(&shots) {
        detections.take_problems(recording);
        let detect = |shot| {
            let detection = detect(recording, shot, board, names);
            on_picture(pictures);
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
    let without = recordings
        .iter()
        .flat_map(Placements::depth_cameras_without_color);
    detections.without_color = without.filter(|id| !cameras.contains_key(id)).collect();
    let words = detections.without_color.iter().map(without_color_words);
    detections.warnings.extend(words);
    let ids: Vec<CameraId> = cameras.into_keys().collect();
    for id in &ids {
        let own = found.iter().filter(|d| d.shot.camera == *id);
        let files = own.filter_map(|d| Some((d.shot.file()?, d.orientation)));
        detections
            .warnings
            .extend(turned_words(id, &files.collect::<Vec<_>>()));
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

/// That a depth camera cannot be calibrated or checked.
fn without_color_words(id: &CameraId) -> String {
    format!(
        "depth camera {id} {WITHOUT_COLOR}: it is neither calibrated nor checked. Let it record colour pictures, too, and \
         show the board again"
    )
}

/// Why nothing is known of a depth camera that was recorded.
pub(super) const WITHOUT_COLOR: &str = "has no colour pictures, in which the board could be found";

/// That some of a camera's files are marked to be shown turned or mirrored; `files` has the EXIF orientation of each.
fn turned_words(id: &CameraId, files: &[(&Path, u8)]) -> Option<String> {
    let turned = files.iter().filter(|(_, stated)| *stated != AS_STORED);
    let (first, _) = turned.clone().next()?;
    let stated: BTreeSet<u8> = turned.clone().map(|(_, stated)| *stated).collect();
    let stated: Vec<String> = stated.iter().map(u8::to_string).collect();
    let turned = turned.count();
    Some(format!(
        "camera {id}: {turned} of its {} {} marked to be shown turned or mirrored (EXIF orientation {}; the first is {}). \
         scand uses the pixels as they are stored, so the calibration is for pictures that no program turns. If those that \
         you will use it for are turned, turn these files in the same way, remove the mark and calibrate again",
        count(files.len(), "picture"),
        if turned == 1 { "is" } else { "are" },
        stated.join(" or "),
        first.display(),
    ))
}

/// That a picture is left out because of its size, in pixels.
fn size_words(detection: &Detection, expected: [usize; 2]) -> String {
    let [width, height] = detection.size;
    let turned = match [height, width] == expected {
        true => " (it seems to be turned)",
        false => "",
    };
    format!(
        "camera {}: its picture of {} has {width}x{height} pixels{turned}, but pictures of {}x{} are used; it is left out",
        detection.shot.camera, detection.placement, expected[0], expected[1]
    )
}

/// A camera as the fit takes it, whose pictures are as large as most of them are. A camera of which no picture can be
/// read has no view, and so no use for a lens: these pictures are lost, but no others.
fn subject(
    id: &CameraId,
    found: &[Detection],
    lenses: [Option<&RigCalibration>; 2],
) -> Result<SessionCamera, Error> {
    let own = found.iter().filter(|l| l.shot.camera == *id);
    let Some(size) = usual(own.map(|l| l.size)) else {
        return Ok(SessionCamera {
            id: id.clone(),
            size: [1, 1],
            known: None,
            start: None,
        });
    };
    let [known, start] = lenses.map(|lenses| lens_of(lenses?, id, size).transpose());
    Ok(SessionCamera {
        id: id.clone(),
        size,
        known: known.transpose()?,
        start: start.transpose()?,
    })
}

/// The size that most pictures have; of two that equally many have, the one that comes first.
fn usual(sizes: impl Iterator<Item = [usize; 2]>) -> Option<[usize; 2]> {
    let mut counts: Vec<([usize; 2], usize)> = Vec::new();
    for size in sizes {
        match counts.iter_mut().find(|(known, _)| *known == size) {
            Some((_, count)) => *count += 1,
            None => counts.push((size, 1)),
        }
    }
    let most = counts.iter().map(|(_, count)| *count).max()?;
    let usual = counts.into_iter().find(|(_, count)| *count == most);
    usual.map(|(size, _)| size)
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

/// The names of a recording's placements.
#[derive(Debug, Default)]
pub(super) struct PlacementNames {
    /// In the order of their triggers.
    names: Vec<String>,
    /// Index of the name by the placement's id.
    by_id: BTreeMap<String, usize>,
}

impl PlacementNames {
    /// The name of the placement with this id.
    pub(super) fn get(&self, id: &str) -> Option<&String> {
        self.by_id.get(id).and_then(|&index| self.names.get(index))
    }

    fn insert(&mut self, id: String, name: String) {
        self.by_id.insert(id, self.names.len());
        self.names.push(name);
    }
}

/// Names of each recording's placements; where two recordings share an id, the recording's name is added.
pub(super) fn placement_names(recordings: &[Placements]) -> Vec<PlacementNames> {
    let mut taken = BTreeSet::new();
    let mut all = Vec::new();
    for (index, recording) in recordings.iter().enumerate() {
        let mut names = PlacementNames::default();
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

/// The names of the placements from one to another, both of them included, in the order of the session.
///
/// # Errors
/// If one is not there, or the last comes before the first.
fn kept_placements(
    all: &[PlacementNames],
    [from, until]: [Option<&str>; 2],
) -> Result<Vec<String>, Error> {
    let names: Vec<String> = all.iter().flat_map(|n| n.names.iter().cloned()).collect();
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
    Ok(names.get(first..=last).unwrap_or_default().to_vec())
}

fn detect<'a>(
    recording: &Placements,
    shot: &'a Shot,
    board: &Board,
    names: &PlacementNames,
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
        orientation: shot.orientation(),
        found: found.map(view),
    })
}

impl Detections {
    /// Nothing is seen yet of these placements.
    fn new(board: &Board, placements: Vec<String>) -> Self {
        Self {
            session: Session {
                board: *board,
                cameras: Vec::new(),
                placements,
                views: Vec::new(),
            },
            depth_cameras: Vec::new(),
            without_color: BTreeSet::new(),
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
            self.lost.push(size_words(&detection, expected));
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

    /// Counts views with fewer corners than are needed among the pictures without a board that can be used.
    pub(super) fn reject_views_with_few_corners(&mut self, needed: usize) {
        let session = &mut self.session;
        let (kept, poor): (Vec<View>, Vec<View>) = std::mem::take(&mut session.views)
            .into_iter()
            .partition(|view| view.corners.len() >= needed);
        session.views = kept;
        self.rejected.extend(poor.iter().map(|view| {
            let found = view.corners.len();
            let cause = Rejection::TooFewOfBoard { found, needed };
            Rejected {
                camera: session.cameras[view.camera].id.clone(),
                placement: session.placements[view.placement].clone(),
                reason: cause.to_string(),
                cause,
            }
        }));
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
    use super::super::{DepthMethod, Options, run};
    use super::*;
    use crate::calibration::fit::{Corner, Parameters, Reason, Rejection, diagnose, fit};
    use crate::calibration::{CalibrationLevel, Camera, Distortion, Face};
    use crate::frame::Stream;
    use crate::recording::{Compression, Writer, testing};
    use nalgebra::{Isometry3, Vector2, Vector3};

    #[test]
    fn a_camera_has_the_size_that_most_of_its_pictures_have() {
        let (large, small) = ([640, 480], [320, 240]);
        assert_eq!(usual([small, large, large].into_iter()), Some(large));
        assert_eq!(usual([small, large].into_iter()), Some(small));
        assert_eq!(usual(std::iter::empty()), None);
    }

    #[test]
    fn files_that_are_marked_as_turned_are_told_of() {
        let id = CameraId::new("left").unwrap();
        let [a, b, c] = ["l/1.jpg", "l/2.jpg", "l/3.jpg"].map(Path::new);
        assert_eq!(turned_words(&id, &[(a, 1), (b, 1), (c, 1)]), None);
        let one = turned_words(&id, &[(a, 1), (b, 6), (c, 1)]).unwrap();
        let expected = "camera left: 1 of its 3 pictures is marked to be shown turned or mirrored (EXIF orientation 6; \
                        the first is l/2.jpg). scand uses the pixels as they are stored";
        assert!(one.starts_with(expected), "{one}");
        let some = turned_words(&id, &[(a, 8), (b, 3), (c, 8)]).unwrap();
        assert!(some.contains("3 of its 3 pictures are marked"), "{some}");
        assert!(
            some.contains("orientation 3 or 8; the first is l/1.jpg"),
            "{some}"
        );
    }

    /// A camera's pictures of p1 to p3, as files of these sizes that are marked to be shown with this orientation.
    fn detections_of_files(sizes: [[u32; 2]; 3], orientation: u8) -> Detections {
        let folder = tempfile::tempdir().unwrap();
        let file = |(index, [width, height]): (usize, &[u32; 2])| {
            let path = folder.path().join(format!("{}.png", index + 1));
            std::fs::write(&path, png_file(*width, *height, orientation)).unwrap();
            path
        };
        let files = sizes.iter().enumerate().map(file).collect();
        let cameras = BTreeMap::from([(CameraId::new("left").unwrap(), files)]);
        let recordings = [open_pictures(cameras).unwrap()];
        let board = Board::checkerboard(9, 6, 0.025).unwrap();
        detect_boards(&recordings, &board, [None, None], ALL, &|_| {}).unwrap()
    }

    /// All placements.
    const ALL: [Option<&str>; 2] = [None, None];

    /// A black PNG that is marked to be shown with this orientation.
    fn png_file(width: u32, height: u32, orientation: u8) -> Vec<u8> {
        // A TIFF header, and one entry: the orientation, a single number of 16 bits.
        let mut exif = b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0".to_vec();
        exif.extend([orientation, 0, 0, 0, 0, 0, 0]);
        let mut info = png::Info::with_size(width, height);
        info.exif_metadata = Some(exif.into());
        let mut data = Vec::new();
        let encoder = png::Encoder::with_info(&mut data, info).unwrap();
        let black = vec![0; (width * height) as usize];
        let mut writer = encoder.write_header().unwrap();
        writer.write_image_data(&black).unwrap();
        writer.finish().unwrap();
        data
    }

    #[test]
    fn pictures_of_another_size_are_left_out_and_turned_ones_named() {
        let found = detections_of_files([[32, 24], [32, 24], [24, 32]], 1);
        let words = "camera left: its picture of p3 has 24x32 pixels (it seems to be turned), but pictures of 32x24 are used; \
                     it is left out";
        assert_eq!(found.lost, [words]);
        assert!(found.warnings.is_empty(), "{:?}", found.warnings);
        let found = detections_of_files([[32, 24], [32, 24], [16, 12]], 8);
        assert!(
            found.lost[0].contains("has 16x12 pixels, but"),
            "{:?}",
            found.lost
        );
        assert_eq!(found.warnings.len(), 1);
        let words = "camera left: 3 of its 3 pictures are marked to be shown turned or mirrored (EXIF orientation 8";
        assert!(found.warnings[0].starts_with(words), "{:?}", found.warnings);
    }

    #[test]
    fn a_depth_camera_without_colour_pictures_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("session.mcap");
        let mut writer = Writer::create(&path, "scand test", Compression::None).unwrap();
        writer.trigger(&testing::trigger("p0", 100)).unwrap();
        let kinect = testing::camera_id("kinect");
        for k in 0..3 {
            let frame = testing::frame(kinect.clone(), Stream::Depth, 110 + 33 * k);
            writer.frame(&frame).unwrap();
        }
        writer.finish().unwrap();
        let recordings = open(&[path], &sync::Parameters::default()).unwrap();
        let board = Board::checkerboard(9, 6, 0.025).unwrap();
        let found = detect_boards(&recordings, &board, [None, None], ALL, &|_| {}).unwrap();
        assert_eq!(found.without_color, BTreeSet::from([kinect]));
        assert!(found.session.cameras.is_empty() && found.depth_cameras.is_empty());
        let expected =
            "depth camera kinect has no colour pictures, in which the board could be found";
        let mut warnings = found.warnings.iter();
        assert!(
            warnings.any(|words| words.starts_with(expected)),
            "{:?}",
            found.warnings
        );
    }

    #[test]
    fn a_camera_whose_picture_cannot_be_read_is_lost_alone() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str, bytes: &[u8]| {
            let path = folder.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            vec![path]
        };
        let [left, right] = pair(20, 0);
        let files = BTreeMap::from([
            (left.id.clone(), file("left.png", &png_file(1280, 960, 1))),
            (right.id.clone(), file("right.png", b"no picture")),
        ]);
        let recordings = [open_pictures(files).unwrap()];
        let board = Board::checkerboard(9, 6, 0.025).unwrap();
        let known = RigCalibration {
            cameras: [&left, &right]
                .map(|c| (c.id.clone(), (c.clone(), None)))
                .into(),
            ..RigCalibration::default()
        };
        for lenses in [[Some(&known), None], [None, Some(&known)]] {
            let found = detect_boards(&recordings, &board, lenses, ALL, &|_| {}).unwrap();
            assert_eq!(found.lost.len(), 1, "{:?}", found.lost);
            assert!(found.lost[0].contains("right.png"), "{:?}", found.lost);
            let lens = |c: &SessionCamera| c.known.or(c.start);
            let lenses: Vec<_> = found.session.cameras.iter().map(lens).collect();
            assert_eq!(lenses, [Some(left.intrinsics), None]);
        }
    }

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
            without_color: BTreeSet::new(),
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

    /// Two cameras side by side, the second one turned by half a degree from the placement at index `bumped` on.
    fn pair(bumped: usize, placement: usize) -> [Camera; 2] {
        [0.0, 0.1].map(|x| {
            let id = CameraId::new(if x == 0.0 { "left" } else { "right" }).unwrap();
            let (focal, center) = (Vector2::repeat(1200.0), Vector2::new(639.5, 479.5));
            let lens = Intrinsics::new(1280, 960, focal, center, Distortion::default()).unwrap();
            let degrees: f64 = if x > 0.0 && placement >= bumped {
                0.5
            } else {
                0.0
            };
            let turn = Vector3::new(0.3, 0.9, 0.1).normalize() * degrees.to_radians();
            Camera::new(id, lens, Isometry3::new(Vector3::new(x, 0.0, 0.0), turn))
        })
    }

    /// What a camera sees at a placement, to a twentieth of a pixel.
    fn seen(board: &Board, camera: &Camera, placement: usize) -> View {
        let at = 2.4 * placement as f64;
        let tilt = Vector3::new(at.cos(), at.sin(), 0.0) * (0.3 + 0.02 * placement as f64);
        let middle = Vector3::new(
            0.06 * (1.7 * at).sin(),
            0.04 * at.cos(),
            0.7 + 0.01 * at.sin(),
        );
        let rig_from_board = Isometry3::new(middle, tilt)
            * Isometry3::translation(-0.1, -0.0625, 0.0)
            * Isometry3::rotation(Vector3::z() * 0.1 * at.sin());
        let corner = |(column, row): (usize, usize)| {
            let at = board.corner_position(column, row);
            let pixel = camera.project(rig_from_board * at).unwrap().0;
            let odd = (placement * 131 + column * 17 + row * 7) as f64 + pixel.x;
            let noise = Vector2::new((12.9 * odd).sin(), (78.2 * odd).cos()) * 0.05;
            Corner {
                column,
                row,
                pixel: pixel + noise,
            }
        };
        let all =
            (0..board.rows).flat_map(|row| (0..board.columns).map(move |column| (column, row)));
        View {
            camera: 0,
            placement: 0,
            face: Face::Front,
            corners: all.map(corner).collect(),
        }
    }

    #[test]
    fn views_with_few_corners_count_as_pictures_without_a_board() {
        let mut detections = detections();
        detections.session.cameras = vec![SessionCamera {
            id: CameraId::new("c00").unwrap(),
            size: [640, 480],
            known: None,
            start: None,
        }];
        let corner = Corner {
            column: 0,
            row: 0,
            pixel: nalgebra::Point2::origin(),
        };
        for (view, corners) in detections.session.views.iter_mut().zip([6, 5, 54, 4, 6]) {
            view.corners = vec![corner; corners];
        }
        detections.reject_views_with_few_corners(6);
        assert_eq!(detections.session.views.len(), 3);
        let told: Vec<(&str, &str)> = (detections.rejected[1..].iter())
            .map(|r| (r.placement.as_str(), r.reason.as_str()))
            .collect();
        let words =
            |found| format!("only {found} of the board's corners were found, expected 6 or more");
        assert_eq!(told, [("p1", &words(5) as &str), ("p4", &words(4))]);
    }

    #[test]
    fn placements_stay_in_the_order_in_which_they_were_shown() {
        let board = Board::checkerboard(9, 6, 0.025).unwrap();
        let files = |camera: &str| -> Vec<PathBuf> {
            (1..=20)
                .map(|k| PathBuf::from(format!("{camera}/{k}.png")))
                .collect()
        };
        let cameras = ["left", "right"].map(|id| (CameraId::new(id).unwrap(), files(id)));
        let recordings = [open_pictures(cameras.into_iter().collect()).unwrap()];
        let names = placement_names(&recordings);
        let all = kept_placements(&names, ALL).unwrap();
        let mut detections = Detections::new(&board, all);
        let in_order: Vec<String> = (1..=20).map(|k| format!("p{k}")).collect();
        assert_eq!(detections.session.placements, in_order);
        assert_eq!(names[0].get("p12").map(String::as_str), Some("p12"));
        let ids = pair(20, 0).map(|camera| camera.id);
        detections.session.cameras = ids
            .iter()
            .map(|id| SessionCamera {
                id: id.clone(),
                size: [1280, 960],
                known: None,
                start: None,
            })
            .collect();
        for shot in &recordings[0].shots() {
            let placement = in_order
                .iter()
                .position(|name| *name == shot.placement)
                .unwrap();
            let cameras = pair(11, placement);
            let camera = cameras
                .iter()
                .find(|camera| camera.id == shot.camera)
                .unwrap();
            let detection = Detection {
                shot,
                placement: shot.placement.clone(),
                size: [1280, 960],
                orientation: AS_STORED,
                found: Ok(seen(&board, camera, placement)),
            };
            detections.take(detection, &ids);
        }
        let parameters = Parameters {
            folds: 0,
            ..Parameters::default()
        };
        let session = &detections.session;
        let findings = diagnose(
            session,
            fit(session, &parameters).ok().as_ref(),
            &parameters,
            4,
        );
        let words: Vec<&str> = findings.iter().map(|f| f.words.as_str()).collect();
        assert_eq!(words.len(), 1, "{words:?}");
        for part in ["between p11 and p12", "--from-placement p12"] {
            assert!(words[0].contains(part), "{words:?}");
        }
        let sound = kept_placements(&names, [Some("p12"), None]).unwrap();
        assert_eq!(sound, in_order[11..]);
    }

    #[test]
    fn a_depth_camera_that_cannot_be_calibrated_makes_a_calibration_doubtful() {
        let board = Board::checkerboard(9, 6, 0.025).unwrap();
        let cameras = pair(20, 0);
        let subject = |camera: &Camera| SessionCamera {
            id: camera.id.clone(),
            size: [1280, 960],
            known: None,
            start: None,
        };
        let views = (0..12).flat_map(|placement| {
            let of = |(index, camera): (usize, &Camera)| View {
                camera: index,
                placement,
                ..seen(&board, camera, placement)
            };
            cameras.iter().enumerate().map(of).collect::<Vec<_>>()
        });
        let session = Session {
            board,
            cameras: cameras.iter().map(subject).collect(),
            placements: (0..12).map(|k| format!("p{k}")).collect(),
            views: views.collect(),
        };
        let judged = |without_color: BTreeSet<CameraId>| {
            let detections = Detections {
                session: session.clone(),
                without_color,
                rejected: Vec::new(),
                ..detections()
            };
            let options = Options {
                fit: Parameters::default(),
                depth: DepthMethod::None,
                responses: BTreeMap::new(),
                wanted: Default::default(),
                limits: Default::default(),
                witnesses: Default::default(),
                measured: Default::default(),
            };
            let outcome = run(detections, &[], options).unwrap();
            outcome.judgement
        };
        let kinect = CameraId::new("kinect").unwrap();
        let judgement = judged(BTreeSet::from([kinect]));
        assert!(judgement.level >= CalibrationLevel::Doubtful);
        let words = "camera kinect is not calibrated: it has no colour pictures, ";
        let is_told = |r: &Reason| r.words.starts_with(words);
        assert!(judgement.reasons.iter().any(is_told), "{judgement:?}");
        assert!(!judged(BTreeSet::new()).reasons.iter().any(is_told));
    }

    #[test]
    fn the_sound_part_of_a_session_is_kept_alone() {
        let mut names = PlacementNames::default();
        for name in ["p0", "p1", "p2", "p4", "p5"] {
            names.insert(name.into(), name.into());
        }
        let names = [names];
        let kept = |from, until| {
            let kept = kept_placements(&names, [from, until]);
            kept.map(|kept| kept.join(" "))
        };
        assert_eq!(kept(None, None).unwrap(), "p0 p1 p2 p4 p5");
        assert_eq!(kept(Some("p2"), None).unwrap(), "p2 p4 p5");
        assert_eq!(kept(None, Some("p2")).unwrap(), "p0 p1 p2");
        assert_eq!(kept(Some("p4"), Some("p4")).unwrap(), "p4");
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

    #[test]
    fn what_lies_outside_the_sound_part_is_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let file = |(index, bytes): (usize, Vec<u8>)| {
            let path = folder.path().join(format!("{}.png", index + 1));
            std::fs::write(&path, bytes).unwrap();
            path
        };
        let pictures = [
            png_file(32, 24, 1),
            png_file(32, 24, 1),
            b"no picture".to_vec(),
            png_file(16, 12, 1),
        ];
        let files = pictures.into_iter().enumerate().map(file).collect();
        let cameras = BTreeMap::from([(CameraId::new("left").unwrap(), files)]);
        let recordings = [open_pictures(cameras).unwrap()];
        let board = Board::checkerboard(9, 6, 0.025).unwrap();
        let found = |until: Option<&str>| {
            let lenses = [None, None];
            detect_boards(&recordings, &board, lenses, [None, until], &|_| {}).unwrap()
        };
        assert_eq!(found(None).lost.len(), 2, "{:?}", found(None).lost);
        let sound = found(Some("p2"));
        assert!(sound.lost.is_empty(), "{:?}", sound.lost);
        assert_eq!(sound.session.placements, ["p1", "p2"]);
        assert_eq!(sound.rejected.len(), 2);
    }
}

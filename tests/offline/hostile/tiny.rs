//! A recording of a few pixels, small enough to be cut at every byte and to have thousands of its bits flipped:
//! opened, assembled, loaded and reconstructed through the library.

use super::recording::Messages;
use crate::support::torture::times;
use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use scand::calibration::{Camera, DepthCamera, DepthResponse, Distortion, Intrinsics, Volume};
use scand::capture::CaptureSession;
use scand::frame::{CameraId, CaptureId, Frame, Picture, Stream, Timestamp, Trigger};
use scand::image::Grid;
use scand::queue;
use scand::reconstruct::{NoProgress, Parameters, Progress, Stage, reconstruct};
use scand::recording::{Compression, Recording, Writer};
use scand::sync;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

const SIZE: usize = 12;

/// A camera 0.5 m away that looks at the origin.
fn camera(name: &str, from: [f64; 3]) -> Camera {
    let lens = Intrinsics::new(
        SIZE,
        SIZE,
        Vector2::new(24.0, 24.0),
        Vector2::new(5.5, 5.5),
        Distortion::default(),
    );
    let eye = Point3::from(from);
    let pose = Isometry3::face_towards(&eye, &Point3::origin(), &Vector3::new(0.1, 0.2, -1.0));
    Camera::new(CameraId::new(name).unwrap(), lens.unwrap(), pose)
}

fn at(ms: u64) -> Timestamp {
    Timestamp(1_760_000_000_000_000_000 + ms * 1_000_000)
}

fn raw(encoding: &str, data: Vec<u8>) -> Picture {
    Picture::Raw {
        width: SIZE as u32,
        height: SIZE as u32,
        encoding: encoding.into(),
        step: (data.len() / SIZE) as u32,
        data: data.into(),
    }
}

/// A ball in the middle of three colour pictures with masks and of a depth picture.
fn write(path: &Path) {
    let mut writer = Writer::create(path, "test", Compression::None).unwrap();
    let colors = [[0.5, 0.0, 0.1], [-0.2, 0.45, 0.1], [-0.2, -0.4, 0.2]];
    let colors: Vec<Camera> = ["c0", "c1", "c2"]
        .iter()
        .zip(colors)
        .map(|(name, from)| camera(name, from))
        .collect();
    let depth = DepthCamera {
        camera: camera("d0", [0.0, 0.05, 0.5]),
        response: DepthResponse::default(),
    };
    for camera in &colors {
        writer.color_camera(camera, at(0)).unwrap();
    }
    writer.depth_camera(&depth, at(0)).unwrap();
    let volume = Volume::new(Point3::new(-0.1, -0.1, -0.1), Point3::new(0.1, 0.1, 0.1));
    writer.volume(&volume.unwrap(), at(0)).unwrap();
    let trigger = Trigger {
        id: CaptureId::new("ball").unwrap(),
        time: at(10),
        source: "test".into(),
        press_id: None,
        subject: None,
        placement: None,
    };
    writer.trigger(&trigger).unwrap();
    let inside = |x: usize, y: usize| (x as f64 - 5.5).hypot(y as f64 - 5.5) < 3.5;
    for camera in &colors {
        let mask = Grid::from_fn(SIZE, SIZE, |x, y| u8::from(inside(x, y)) * 255);
        writer.mask(&camera.id, &mask, at(11)).unwrap();
        frame(
            &mut writer,
            camera,
            Stream::Color,
            11,
            raw("mono8", mask.pixels().to_vec()),
        );
    }
    let readings = (0..SIZE * SIZE).flat_map(|i| {
        let reading: u16 = if inside(i % SIZE, i / SIZE) {
            440 + i as u16 % 7
        } else {
            600
        };
        reading.to_le_bytes()
    });
    let readings: Vec<u8> = readings.collect();
    frame(
        &mut writer,
        &depth.camera,
        Stream::Depth,
        12,
        raw("16UC1", readings),
    );
    writer.finish().unwrap();
}

fn frame(writer: &mut Writer, camera: &Camera, stream: Stream, ms: u64, picture: Picture) {
    let frame = Frame {
        camera: camera.id.clone(),
        stream,
        timestamp: at(ms),
        picture,
    };
    writer.frame(&frame).unwrap();
}

struct Place {
    folder: TempDir,
    path: PathBuf,
    sound: Vec<u8>,
}

/// What became of a broken file.
#[derive(Debug, Default, PartialEq)]
struct Fates {
    refused: usize,
    damaged: usize,
    failed: usize,
    loaded: usize,
    models: usize,
}

impl Place {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sound.mcap");
        write(&path);
        let sound = std::fs::read(&path).unwrap();
        let path = folder.path().join("broken.mcap");
        Self {
            folder,
            path,
            sound,
        }
    }

    /// Opens a file of these bytes and makes of it what can be made. Errors must name the file.
    fn try_all(&self, bytes: &[u8], fates: &mut Fates, reconstructing: bool) {
        std::fs::write(&self.path, bytes).unwrap();
        let parameters = sync::Parameters {
            min_depth_frames: 1,
            go_on_without_missing: true,
            ..sync::Parameters::default()
        };
        let named = |error: &dyn std::error::Error| {
            assert!(error.to_string().contains("broken.mcap"), "{error}");
        };
        let session = match Recording::open(&self.path) {
            Ok(recording) => {
                fates.damaged += usize::from(!recording.verify().unwrap().is_empty());
                CaptureSession::of(recording, &parameters)
            }
            Err(error) => {
                named(&error);
                fates.refused += 1;
                return;
            }
        };
        let session = match session {
            Ok(session) => session,
            Err(error) => {
                named(&error);
                fates.refused += 1;
                return;
            }
        };
        for capture in session.captures() {
            match session.load(&capture.id) {
                Ok((scene, _)) => {
                    fates.loaded += 1;
                    if reconstructing {
                        let mut parameters = Parameters::default();
                        parameters.hull.resolution = 24.0;
                        let model = reconstruct(&scene, &parameters, &NoProgress);
                        fates.models += usize::from(model.is_ok());
                    }
                }
                Err(error) => {
                    named(&error);
                    fates.failed += 1;
                }
            }
        }
    }
}

#[test]
fn the_sound_one_becomes_a_model() {
    let place = Place::new();
    let mut fates = Fates::default();
    place.try_all(&place.sound, &mut fates, true);
    let expected = Fates {
        loaded: 1,
        models: 1,
        ..Fates::default()
    };
    assert_eq!(fates, expected, "{}", place.folder.path().display());
}

/// Panics where a stage begins.
struct PanicsAt(Option<Stage>);

impl Progress for PanicsAt {
    fn stage(&self, stage: Stage) {
        assert!(Some(stage) != self.0, "a bug in {}", stage.name());
    }
}

#[test]
fn a_panic_in_any_stage_fails_one_capture_alone() {
    let place = Place::new();
    let session = Recording::open(&place.folder.path().join("sound.mcap")).unwrap();
    let parameters = sync::Parameters {
        min_depth_frames: 1,
        ..sync::Parameters::default()
    };
    let session = CaptureSession::of(session, &parameters).unwrap();
    let (scene, _) = session.load(&session.captures()[0].id).unwrap();
    let mut parameters = Parameters::default();
    parameters.hull.resolution = 24.0;
    let made = |stage| reconstruct(&scene, &parameters, &PanicsAt(stage)).map(|r| r.model.mesh);
    let sound = made(None).unwrap();
    for workers in [1, 3] {
        // Each stage's panic between two that are sound.
        let count = 2 * Stage::ALL.len() + 1;
        let ends = queue::run(workers, count, |i| {
            made((i % 2 == 1).then(|| Stage::ALL[i / 2]))
        });
        for (i, end) in ends.into_iter().enumerate() {
            match end {
                Ok(mesh) => assert!(i % 2 == 0 && mesh.unwrap() == sound, "{i}"),
                Err(panicked) => {
                    let stage = Stage::ALL[i / 2].name();
                    assert!(i % 2 == 1 && panicked.0.contains(stage), "{i}: {panicked}");
                }
            }
        }
    }
    println!(
        "shown: a panic in each of {} stages fails one capture, and no other",
        Stage::ALL.len()
    );
}

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;

    #[test]
    fn flipped_bits_that_the_checksums_do_not_know_do_no_harm() {
        let place = Place::new();
        let mut fates = Fates::default();
        let sound = Messages::read(&place.sound);
        for (i, message) in sound.0.iter().enumerate() {
            let bits = 8 * message.data.len();
            for bit in (0..bits).step_by((bits / times(50, 200) as usize) | 1) {
                let mut broken = sound.clone();
                broken.0[i].data[bit / 8] ^= 1 << (bit % 8);
                place.try_all(&broken.bytes(), &mut fates, true);
            }
        }
        println!("shown: bits flipped behind the checksums: {fates:?}");
        assert_eq!(fates.damaged, 0);
        assert!(fates.models > 100 && fates.failed > 50, "{fates:?}");
    }

    #[test]
    fn a_file_cut_off_at_any_byte_is_refused_or_read_up_to_there() {
        let place = Place::new();
        let mut fates = Fates::default();
        let mut loaded = 0;
        for length in 0..place.sound.len() {
            place.try_all(&place.sound[..length], &mut fates, false);
            assert!(fates.loaded >= loaded, "cut at {length}");
            loaded = fates.loaded;
        }
        println!(
            "shown: cut at each of {} bytes: {fates:?}",
            place.sound.len()
        );
        // All but the magic bytes are damaged files; only the very end may be missing.
        assert_eq!(fates.damaged, place.sound.len() - 8);
        assert!(fates.loaded > 0 && fates.refused > 100, "{fates:?}");
    }

    #[test]
    fn thousands_of_flipped_bits_do_no_harm() {
        let place = Place::new();
        let mut fates = Fates::default();
        let bits = 8 * place.sound.len();
        // A step that shares no factor with 8, so that every bit of a byte has its turn.
        for bit in (0..bits).step_by((bits / times(4000, 40_000) as usize) | 1) {
            let mut broken = place.sound.clone();
            broken[bit / 8] ^= 1 << (bit % 8);
            place.try_all(&broken, &mut fates, false);
        }
        println!("shown: bits flipped one by one in a file of {bits}: {fates:?}");
        assert!(
            fates.loaded > 0 && fates.refused > 0 && fates.damaged > 1000,
            "{fates:?}"
        );
    }
}

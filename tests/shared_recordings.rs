//! Recordings that others wrote must load. They are found through SCAND_SHARED_RECORDINGS, or beside the
//! repository; where they are not, these tests say so and pass.

use scand::job::{Session, Silhouette};
use scand::reconstruct::{Scene, SilhouetteSource};
use scand::sync;
use std::path::PathBuf;

fn shared(name: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("SCAND_SHARED_RECORDINGS").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/recordings"),
        PathBuf::from,
    );
    let path = folder.join(name);
    if path.is_file() {
        return Some(path);
    }
    eprintln!("skipped: {} is not there", path.display());
    None
}

/// The only capture of a recording.
fn load(name: &str) -> Option<(Scene, scand::job::CaptureFacts)> {
    let session = Session::open(&shared(name)?, &sync::Parameters::default()).unwrap();
    assert_eq!(session.damage(), []);
    let captures = session.captures();
    assert_eq!(captures.len(), 1);
    assert_eq!(captures[0].failure, None);
    Some(session.load(&captures[0].id).unwrap())
}

#[test]
fn a_raw_bayer_recording_loads() {
    let Some((scene, facts)) = load("cup.mcap") else {
        return;
    };
    assert_eq!(scene.colors.len(), 11);
    assert_eq!(facts.warnings, Vec::<String>::new());
    assert_eq!(facts.left_out, []);
    assert_eq!(facts.depths[0].color_frames, 30);
    assert_eq!(scene.depths[0].frames.len(), 30);
    let first = &scene.colors[0];
    assert_eq!(first.image.width(), first.camera.intrinsics.width);
    assert!(matches!(
        facts.colors[0].silhouette,
        Silhouette::Background { .. }
    ));
    let readings = scene.depths[0].frames[0].readings.pixels();
    let seen = readings.iter().filter(|&&r| r > 0);
    let mean = seen.clone().map(|&r| f64::from(r)).sum::<f64>() / seen.clone().count() as f64;
    assert!(
        seen.count() > 30_000 && (mean - 890.8).abs() < 0.1,
        "{mean}"
    );
}

#[test]
fn a_jpeg_recording_loads() {
    let Some((scene, _)) = load("bowl_with_fruit.mcap") else {
        return;
    };
    assert_eq!((scene.colors.len(), scene.depths.len()), (11, 1));
    assert_eq!(scene.depths[0].frames.len(), 30);
    assert!((scene.depths[0].camera.response.slope - 0.00104).abs() < 1e-12);
}

#[test]
fn a_recording_of_masks_without_depth_loads() {
    let Some((scene, facts)) = load("dino.mcap") else {
        return;
    };
    assert_eq!((scene.colors.len(), scene.depths.len()), (16, 0));
    assert!(
        facts
            .colors
            .iter()
            .all(|c| c.silhouette == Silhouette::Mask)
    );
    for color in &scene.colors {
        let SilhouetteSource::Mask(mask) = &color.silhouette else {
            panic!("a mask was recorded")
        };
        let inside = mask.pixels().iter().filter(|&&m| m >= 128).count();
        assert!(inside > 1000, "{}", color.camera.id);
    }
}

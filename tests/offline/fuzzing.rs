//! The fuzzer's targets on stable Rust, with intact files that are damaged slightly, and with every input that a
//! fuzzer ever found. `make torture` asks for more of them; CONTRIBUTING.md tells how to run the fuzzer itself.

#[path = "../../fuzz/bodies.rs"]
#[allow(dead_code, reason = "targets are called by their names in the list")]
mod bodies;

use crate::support::dice::Dice;
use crate::support::torture::times;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Ends an input that hangs: a thousand times what most take, so that no busy machine breaks it.
const LONGEST: Duration = Duration::from_secs(100);

fn below_here(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten();
    let mut files: Vec<_> = entries.map(|e| e.unwrap().path()).collect();
    files.sort();
    files
}

/// Sound inputs of a target.
fn seeds(target: &str) -> Vec<Vec<u8>> {
    let read = |path: PathBuf| std::fs::read(path).unwrap();
    match target {
        "calibration" => vec![calibration().into_bytes(), KALIBR.into(), ROS.into()],
        "configuration" => files(&below_here("config")).into_iter().map(read).collect(),
        "picture" => vec![png(), jpeg()],
        "recording" => {
            let golden = files(&below_here("tests/golden/format-1"));
            let golden = golden
                .into_iter()
                .filter(|f| f.extension().is_some_and(|e| e == "mcap"));
            golden.map(read).collect()
        }
        "socket" => {
            let page = std::fs::read_to_string(below_here("docs/socket.md")).unwrap();
            let quoted = page.split('`').filter(|piece| piece.starts_with('{'));
            quoted.map(|piece| piece.as_bytes().to_vec()).collect()
        }
        "solid" => vec![vec![0, 200], (0..=255).collect(), ball()],
        other => panic!("{other} has no seeds"),
    }
}

/// The calibration of a recording of ours.
fn calibration() -> String {
    let recording = below_here("recordings/cup.mcap");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.toml");
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_scand"));
    let made = command
        .arg("info")
        .arg(recording)
        .arg("--calibration")
        .arg(&path)
        .output();
    assert!(made.unwrap().status.success());
    std::fs::read_to_string(path).unwrap()
}

const ROS: &str = "image_width: 640\nimage_height: 480\ncamera_name: c00\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: \
    [600.0, 0.0, 319.5, 0.0, 600.0, 239.5, 0.0, 0.0, 1.0]\ndistortion_model: plumb_bob\ndistortion_coefficients:\n  rows: \
    1\n  cols: 5\n  data: [0.01, -0.02, 0.0, 0.0, 0.0]\n";

const KALIBR: &str = "cam0:\n  camera_model: pinhole\n  distortion_coeffs: [0.01, -0.02, 0.0, 0.0]\n  distortion_model: \
    radtan\n  intrinsics: [600.0, 600.0, 319.5, 239.5]\n  resolution: [640, 480]\n  rostopic: /c00\n";

/// Discs in all masks.
fn ball() -> Vec<u8> {
    let inside = |i: usize| ((i % 12) as f64 - 5.5).hypot((i / 12) as f64 - 5.5) < 4.0;
    let discs = (0..3 * 144).map(|i| u8::from(inside(i % 144)) * 255);
    [0].into_iter().chain(discs).chain([90; 144]).collect()
}

fn pixels() -> Vec<u8> {
    (0..64 * 48 * 3u32).map(|i| (i * i / 7) as u8).collect()
}

fn png() -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 64, 48);
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&pixels()).unwrap();
    writer.finish().unwrap();
    bytes
}

fn jpeg() -> Vec<u8> {
    let mut bytes = Vec::new();
    let encoder = jpeg_encoder::Encoder::new(&mut bytes, 75);
    let color = jpeg_encoder::ColorType::Rgb;
    encoder.encode(&pixels(), 64, 48, color).unwrap();
    bytes
}

/// Numbers that programs stumble over.
const MAGIC: [&[u8]; 8] = [
    &[0xff; 8],
    &[0; 8],
    &[0, 0, 0, 0, 0, 1, 0, 0],
    &[0xff, 0xff, 0xff, 0x7f],
    b"nan",
    b"-1e308",
    b"99999999999999999999",
    b"[[[[[[[[",
];

/// Damages bytes at one to eight places.
fn damage(sound: &[u8], other: &[u8], dice: &mut Dice) -> Vec<u8> {
    let mut bytes = sound.to_vec();
    for _ in 0..1 + dice.index(8) {
        let at = dice.index(bytes.len());
        let end = (at + 1 + dice.index(64)).min(bytes.len());
        match dice.index(7) {
            0 if !bytes.is_empty() => bytes[at] ^= 1 << dice.index(8),
            1 if !bytes.is_empty() => bytes[at] = dice.index(256) as u8,
            2 => bytes.truncate(at),
            3 => drop(bytes.drain(at..end)),
            4 => {
                let piece = bytes[at..end].to_vec();
                bytes.splice(at..at, piece);
            }
            5 => {
                let from = dice.index(other.len());
                let piece = &other[from..(from + dice.index(200)).min(other.len())];
                bytes.splice(at..at, piece.iter().copied());
            }
            _ => {
                let piece = MAGIC[dice.index(MAGIC.len())];
                let end = (at + piece.len()).min(bytes.len());
                bytes.splice(at..end, piece.iter().copied());
            }
        }
    }
    bytes
}

/// Gives bytes to a target. Ones that do harm are kept, and named.
fn give(target: &bodies::Target, bytes: &[u8]) {
    let begin = Instant::now();
    let done = catch_unwind(AssertUnwindSafe(|| target.1(bytes)));
    let took = begin.elapsed();
    if done.is_err() || took > LONGEST {
        let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("found-{}", target.0));
        std::fs::write(&kept, bytes).unwrap();
        panic!(
            "{} is harmed, or takes {took:?}, by {}: keep it in fuzz/found/{}",
            target.0,
            kept.display(),
            target.0
        );
    }
}

#[test]
fn what_was_found_before_does_no_harm_any_more() {
    let mut count = 0;
    for target in &bodies::TARGETS {
        for path in files(&below_here("fuzz/found").join(target.0)) {
            give(target, &std::fs::read(path).unwrap());
            count += 1;
        }
    }
    println!("shown: {count} inputs that fuzzers found do no harm");
}

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;

    #[test]
    fn sound_inputs_with_random_damage_do_no_harm() {
        let seconds = times(2, 15);
        for target in &bodies::TARGETS {
            let seeds = seeds(target.0);
            assert!(!seeds.is_empty(), "{}", target.0);
            seeds.iter().for_each(|sound| give(target, sound));
            let (mut dice, mut count) = (Dice(seconds), 0u64);
            let begin = Instant::now();
            while begin.elapsed() < Duration::from_secs(seconds) {
                let [sound, other] = [(); 2].map(|()| &seeds[dice.index(seeds.len())]);
                give(target, &damage(sound, other, &mut dice));
                count += 1;
            }
            println!("shown: {count} damaged inputs of {}: no panic", target.0);
            assert!(count > seconds, "{}: {count} inputs alone", target.0);
        }
    }
}

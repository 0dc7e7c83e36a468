//! Disasters of the real program while it makes models or recovers recordings: it is killed at random moments, or
//! the disk refuses calls. A file under its final name is complete, and a second run makes what the first would
//! have made. `make torture` asks for more of each.

use super::desk::{Desk, said};
use crate::support::dice::Dice;
use crate::support::program::scand;
use crate::support::torture::{self, times};
use scand::capture::CaptureSession;
use scand::config::Config;
use scand::frame::CaptureId;
use scand::make_model::{ModelMaker, ModelOutcome, Settings};
use std::collections::BTreeMap;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::time::Instant;

/// A recording that is simulated once, with these arguments.
fn simulated(name: &str, arguments: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let path = folder.join(format!("{name}.mcap"));
    static ONE: Mutex<()> = Mutex::new(());
    let _one = ONE.lock();
    if !path.exists() {
        let own = folder.join(format!("{name}-{}.mcap", std::process::id()));
        let mut simulate = scand();
        simulate
            .args(["simulate", "--shape", "cup"])
            .args(arguments.split(' '));
        let made = simulate.arg("--out").arg(&own).output().unwrap();
        let said = String::from_utf8_lossy(&made.stderr);
        assert!(made.status.success(), "{said}");
        std::fs::rename(&own, &path).unwrap();
    }
    path
}

/// Three captures that take no time worth mentioning.
fn small() -> PathBuf {
    let arguments =
        "--cameras 4 --size 160x120 --depth-frames 3 --captures 3 --masks --encoding bayer";
    simulated("disasters", arguments)
}

fn replay(recording: &Path, out: &Path) -> Command {
    let mut command = scand();
    command
        .args([Path::new("--replay"), recording])
        .args([Path::new("--out"), out])
        .args([
            "--set",
            "hull.resolution=30",
            "--set",
            "sync.min_depth_frames=1",
            "--quiet",
        ])
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    command
}

#[test]
fn a_model_that_another_process_puts_into_place_meanwhile_stays() {
    let set = ["hull.resolution=30", "sync.min_depth_frames=1"].map(String::from);
    let config = Config::load(None, &set).unwrap();
    let settings = Settings {
        reconstruction: config.reconstruction(),
        verdict: config.verdict.clone(),
        glb: config.glb.clone(),
        text: config.replay_toml().unwrap(),
    };
    let session = CaptureSession::open(&small(), &config.sync).unwrap();
    let id = session.captures()[0].id.clone();
    let home = tempfile::tempdir().unwrap();
    let make = |on_stage: &(dyn Fn(&CaptureId, &str) + Sync)| {
        let maker = ModelMaker {
            settings: &settings,
            calibration: None,
            force: false,
            folder: home.path().to_owned(),
            on_stage,
        };
        maker.make(&session, &id)
    };
    let inode = || {
        let model = home.path().join(id.as_str()).join("model.glb");
        std::fs::metadata(model).unwrap().ino()
    };
    let placed = Mutex::new(None);
    let other = |_: &CaptureId, stage: &str| {
        if stage == "files" {
            assert!(matches!(make(&|_, _| ()), ModelOutcome::Made { .. }));
            *placed.lock().unwrap() = Some(inode());
        }
    };
    assert!(matches!(make(&other), ModelOutcome::Unchanged { .. }));
    assert_eq!(placed.into_inner().unwrap(), Some(inode()));
    assert_eq!(std::fs::read_dir(home.path()).unwrap().count(), 1);
}

/// Fuses the three captures, between which the object did not move; the model has the frame of capture `upright`.
fn fuse(recording: &Path, out: &Path, poses: &Path, upright: &str) -> Command {
    let mut command = scand();
    command.arg("fuse").arg(recording);
    for capture in 0..3 {
        command.args(["--capture", &format!("cup-{capture:03}")]);
    }
    command
        .args([Path::new("--poses"), poses, Path::new("--out"), out])
        .args(["--upright", upright, "--force", "--quiet"])
        .args(["--set", "hull.resolution=30"])
        .args(["--set", "sync.min_depth_frames=1"])
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    command
}

/// The files of each capture below `out`, by their names, a report without what may differ between two runs; only those
/// under final names.
fn captures(out: &Path) -> BTreeMap<PathBuf, BTreeMap<String, Vec<u8>>> {
    let entries = |folder: &Path| -> Vec<PathBuf> {
        let read = std::fs::read_dir(folder).into_iter().flatten();
        let all = read.map(|entry| entry.unwrap().path());
        let hidden = |path: &PathBuf| path.file_name().unwrap().to_str().unwrap().starts_with('.');
        all.filter(|path| !hidden(path)).collect()
    };
    let mut found = BTreeMap::new();
    for capture in entries(out).iter().flat_map(|recording| entries(recording)) {
        let files = entries(&capture).into_iter().map(|file| {
            let name = file.file_name().unwrap().to_str().unwrap().to_owned();
            let mut bytes = std::fs::read(&file).unwrap();
            if name == "report.json" {
                let mut report: serde_json::Value = serde_json::from_slice(&bytes).unwrap();
                report.as_object_mut().unwrap().remove("timing");
                bytes = report.to_string().into_bytes();
            }
            (name, bytes)
        });
        let place = capture.strip_prefix(out).unwrap().to_owned();
        found.insert(place, files.collect());
    }
    found
}

/// All files below a folder, also those under temporary names.
fn left(folder: &Path) -> Vec<PathBuf> {
    let mut folders = vec![folder.to_owned()];
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                &mut folders
            } else {
                &mut files
            }
            .push(path);
        }
    }
    files
}

/// A replay by way of strace, which lets a call of any thread fail at its `number`th time for a file below `out`.
fn refused(recording: &Path, out: &Path, call: &str, error: &str, number: u64) -> Command {
    let inner = replay(recording, out);
    let mut strace = Command::new("strace");
    strace
        .args(["-f", "--seccomp-bpf", "-qq", "-o", "/dev/null", "-e"])
        .arg(format!("trace={call}"))
        .arg("-e")
        .arg(format!("inject={call}:error={error}:when={number}"))
        .arg(inner.get_program())
        .args(inner.get_args())
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    strace
}

fn seconds(command: &mut Command) -> f64 {
    let begin = Instant::now();
    let done = command.output().unwrap();
    // 3: what a cut left of the file's end is kept apart.
    assert!(matches!(done.status.code(), Some(0 | 3)), "{done:?}");
    begin.elapsed().as_secs_f64()
}

/// The ratio depends on the machine and on what runs beside this test: `make test` prints it, `make torture` holds it.
#[test]
fn a_recording_that_was_cut_off_is_recovered_about_as_fast_as_it_is_copied() {
    // A capture of a rig's size, several times.
    let arguments = "--cameras 4 --size 1280x960 --encoding bayer --captures 1 --depth-frames 30";
    let sound = std::fs::read(simulated("recovered", arguments)).unwrap();
    let cut_off = &sound[..sound.len() - 100];
    // Blocks that never came to the disk.
    let mut damaged = cut_off.to_vec();
    damaged[sound.len() / 2..][..4096].fill(0);
    let size = sound.len() / 1_000_000;
    let is_alone = torture::asked().is_some();
    for (what, bytes) in [("cut off", cut_off), ("damaged in the middle", &damaged)] {
        let mut ratio = recovery_over_copying(bytes);
        if is_alone && ratio < 0.5 {
            // A disk that was busy with something else is given a second chance.
            ratio = recovery_over_copying(bytes);
        }
        println!("shown: recovery of {size} MB, {what}, at {ratio:.2} times the speed of copying");
        assert!(!is_alone || ratio >= 0.5, "{what}: {ratio}");
    }
}

/// How fast a `.part` of these bytes is recovered, over how fast it is copied: the median of several times.
fn recovery_over_copying(bytes: &[u8]) -> f64 {
    let mut ratios: Vec<f64> = (0..times(3, 7))
        .map(|_| {
            let home = tempfile::tempdir().unwrap();
            let [part, copy] = ["a.mcap.part", "copy"].map(|name| home.path().join(name));
            std::fs::write(&part, bytes).unwrap();
            std::fs::File::open(&part).unwrap().sync_all().unwrap();
            let copying = seconds(
                Command::new("sh")
                    .args(["-c", "cp \"$0\" \"$1\" && sync \"$1\""])
                    .args([&part, &copy]),
            );
            copying / seconds(scand().arg("recover").arg(&part))
        })
        .collect();
    ratios.sort_by(f64::total_cmp);
    ratios[ratios.len() / 2]
}

#[test]
fn a_file_that_may_not_be_read_says_who_can_help() {
    let desk = Desk::new();
    std::fs::rename(desk.path("ball.mcap"), desk.path("secret.mcap")).unwrap();
    let nobody = PermissionsExt::from_mode(0o000);
    std::fs::set_permissions(desk.path("secret.mcap"), nobody).unwrap();
    let is_root = std::fs::File::open(desk.path("secret.mcap")).is_ok();
    for line in ["info secret.mcap", "replay secret.mcap"] {
        let program = assert_cmd::cargo::cargo_bin("scand");
        // Root may read everything, unless it gives up that right.
        let mut command = match is_root {
            true => Command::new("setpriv"),
            false => Command::new(&program),
        };
        if is_root {
            let rights = "--bounding-set=-dac_override,-dac_read_search";
            command.arg(rights).arg("--").arg(&program);
        }
        let arguments = line.split(' ');
        let output = command.args(arguments).current_dir(desk.path("."));
        let output = output.output().unwrap();
        let said = said(&output);
        assert_eq!(output.status.code(), Some(1), "{line}: {said}");
        for word in ["secret.mcap", "Permission denied", "ask its owner"] {
            assert!(said.contains(word), "{line}: {word:?} is not in: {said}");
        }
    }
}

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;

    #[test]
    fn a_replay_whose_disk_refuses_any_call_leaves_whole_models_and_says_why_there_are_no_more() {
        let recording = small();
        let home = tempfile::tempdir().unwrap();
        let whole = home.path().join("whole");
        assert!(replay(&recording, &whole).status().unwrap().success());
        let expected = captures(&whole);
        let (mut count, mut failed) = (0, 0);
        for (call, error) in [
            ("fsync", "EIO"),
            ("fsync", "ENOSPC"),
            ("rename", "EIO"),
            ("mkdir", "ENOSPC"),
        ] {
            for number in 1..=times(2, 6) {
                let out = home.path().join("out");
                let ended = refused(&recording, &out, call, error, number)
                    .output()
                    .unwrap();
                let said = String::from_utf8_lossy(&ended.stderr).into_owned();
                let place = format!("{call} {number}: {error}");
                assert!(
                    matches!(ended.status.code(), Some(0 | 1 | 3)),
                    "{place}: {said}"
                );
                assert!(!said.contains("panicked"), "{place}: {said}");
                let found = captures(&out);
                let models = found
                    .iter()
                    .filter(|(_, files)| files.contains_key("model.glb"));
                for (capture, files) in models.clone() {
                    assert!(
                        files == &expected[capture],
                        "{place}: {}",
                        capture.display()
                    );
                }
                if models.count() < expected.len() {
                    failed += 1;
                    assert_ne!(ended.status.code(), Some(0), "{place}: nothing was said");
                    assert!(said.contains("os error"), "{place}: {said}");
                }
                count += 1;
                assert!(
                    replay(&recording, &out).status().unwrap().success(),
                    "{place}"
                );
                assert!(captures(&out) == expected, "{place}");
                std::fs::remove_dir_all(&out).unwrap();
            }
        }
        assert!(failed > 0, "nothing was refused");
        println!(
            "shown: {count} refused calls of a replay (fsync, rename, mkdir): {failed} runs failed and said so, 0 half outputs"
        );
    }

    #[test]
    fn a_disk_that_is_full_at_the_first_write_is_named_with_what_to_do() {
        let recording = small();
        let home = tempfile::tempdir().unwrap();
        let written = |name: &str| home.path().join(name).display().to_string();
        let recording = recording.display().to_string();
        let (calibration, model) = (written("calibration.toml"), written("out"));
        let again = written("again.mcap");
        #[rustfmt::skip]
        let commands = [
            ("write", vec!["info", &recording, "--calibration", &calibration]),
            ("write", vec!["simulate", "--shape", "ball", "--cameras", "3", "--size", "160x120", "--out", &again]),
            // Another thread than that which tells of it writes models, and the first call of each fails.
            ("fsync", vec!["replay", &recording, "-q", "--set", "hull.resolution=40", "--out", &model]),
        ];
        for (call, arguments) in commands {
            let mut strace = Command::new("strace");
            strace
                .args(["-f", "--seccomp-bpf", "-qq", "-o", "/dev/null", "-e"])
                .arg(format!("inject={call}:error=ENOSPC:when=1"))
                .args(["-e", &format!("trace={call}")])
                .arg(scand().get_program())
                .args(&arguments);
            let output = strace.output().unwrap();
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(1), "{arguments:?}: {said}");
            for word in ["No space left", "the disk is full: free some space"] {
                assert!(said.contains(word), "{arguments:?}: {said}");
            }
        }
    }

    #[test]
    fn a_replay_that_is_killed_leaves_whole_models_or_none_and_the_next_one_makes_the_rest() {
        let recording = small();
        let home = tempfile::tempdir().unwrap();
        let whole = home.path().join("whole");
        let begin = Instant::now();
        assert!(replay(&recording, &whole).status().unwrap().success());
        let takes = begin.elapsed();
        let expected = captures(&whole);
        assert_eq!(expected.len(), 3);
        let (kills, mut dice) = (times(4, 40), Dice(21));
        let mut of_each = BTreeMap::<usize, u64>::new();
        let out = home.path().join("out");
        for kill in 0..kills {
            let mut process = replay(&recording, &out).spawn().unwrap();
            std::thread::sleep(takes.mul_f64(dice.below(1000) as f64 / 900.0));
            process.kill().unwrap();
            process.wait().unwrap();
            let found = captures(&out);
            for (capture, files) in &found {
                assert!(
                    files == &expected[capture],
                    "{}: {:?}",
                    capture.display(),
                    files.keys()
                );
            }
            *of_each.entry(found.len()).or_default() += 1;
            // Every other time the next one goes on where this one was.
            if kill % 2 == 1 || kill + 1 == kills {
                assert!(replay(&recording, &out).status().unwrap().success());
                assert!(captures(&out) == expected);
                assert_eq!(left(&out).len(), left(&whole).len(), "{:?}", left(&out));
                std::fs::remove_dir_all(&out).unwrap();
            }
        }
        assert!(
            kills < 20 || of_each.len() > 1,
            "all kills came at one place: {of_each:?}"
        );
        println!(
            "shown: {kills} kills of a replay: whole models or none, the next run makes the same bytes"
        );
    }

    #[test]
    fn a_fusion_that_is_killed_leaves_a_whole_model_or_none_and_the_next_one_makes_it() {
        let recording = small();
        let home = tempfile::tempdir().unwrap();
        let poses = home.path().join("poses.json");
        let still = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";
        std::fs::write(
            &poses,
            format!("{{\"rig_from_object\":[{still},{still},{still}]}}"),
        )
        .unwrap();
        let mut takes = std::time::Duration::ZERO;
        let [old, new] = ["cup-000", "cup-001"].map(|upright| {
            let (begin, out) = (Instant::now(), home.path().join(upright));
            let made = fuse(&recording, &out, &poses, upright).output().unwrap();
            let said = String::from_utf8_lossy(&made.stderr);
            assert!(made.status.success(), "{said}");
            takes = begin.elapsed();
            captures(&out)
        });
        assert!(old.len() == 1 && new.len() == 1 && old != new);
        let files = left(&home.path().join("cup-000")).len();
        let (kills, mut dice) = (times(6, 40), Dice(22));
        let mut made = 0;
        let out = home.path().join("out");
        for kill in 0..kills {
            // Every other time a model lies there, and another one is to take its place.
            let is_replaced = kill % 2 == 1;
            let upright = if is_replaced { "cup-001" } else { "cup-000" };
            let mut process = fuse(&recording, &out, &poses, upright).spawn().unwrap();
            std::thread::sleep(takes.mul_f64(dice.below(1000) as f64 / 900.0));
            process.kill().unwrap();
            process.wait().unwrap();
            let found = captures(&out);
            let (wanted, is_as_before) = match is_replaced {
                true => (&new, found == old),
                false => (&old, found.is_empty()),
            };
            assert!(is_as_before || found == *wanted, "{:?}", found.keys());
            made += u64::from(!is_as_before);
            let again = fuse(&recording, &out, &poses, "cup-000").output().unwrap();
            assert!(again.status.success(), "{again:?}");
            assert!(captures(&out) == old);
            assert_eq!(left(&out).len(), files, "{:?}", left(&out));
            if is_replaced {
                std::fs::remove_dir_all(&out).unwrap();
            }
        }
        assert!(
            kills < 20 || (made > 0 && made < kills),
            "all kills came at one place: {made} of {kills} models were made"
        );
        println!(
            "shown: {kills} kills of a fusion: a whole model or none, the next run makes the same bytes"
        );
    }
}

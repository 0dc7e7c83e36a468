//! Sessions with one fault each, rendered, recorded and calibrated by the command: the messages, and the exit code. No
//! fault that a session can show may end in *good* or *accepted*. The same faults are tried on corners without pictures
//! beside the code that finds them; this takes minutes and is run by `make calibration-trial`, with eleven cameras of 5
//! megapixels where `SCAND_TRIAL=full` is in the environment.

use assert_cmd::Command;
use scand::calibration::Board;
use scand::frame::{Frame, Picture, Stream};
use scand::recording::{Compression, Writer};
use scand_lab::{
    BoardOptions, BoardSession, CameraFault, Capture, Encoding, Options, PlacementFault,
};
use serde_json::Value;
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::{Path, PathBuf};

const PLACEMENTS: usize = 30;
/// Fewest views of each camera, and placements, from which a part of a session is calibrated.
const FEWEST: [usize; 2] = [3, 4];
/// Views of a camera of which four, and not three, may be changed without a refusal.
const MANY_VIEWS: usize = 12;

/// Exit codes of the command: *good* or *accepted*; *doubtful*; and *doubtful* or *refused*.
const GOOD: &[i32] = &[0];
const DOUBTFUL: &[i32] = &[3];
const NOT_GOOD: &[i32] = &[1, 3];

fn is_full() -> bool {
    std::env::var_os("SCAND_TRIAL").is_some_and(|size| size == "full")
}

/// What the cameras of a rig hand over, with whatever is changed of it.
fn captures(change: impl Fn(&mut Options, &mut BoardOptions)) -> (Vec<Capture>, Board) {
    let mut options = Options::for_boards();
    let mut boards = BoardOptions {
        board: "checkerboard:9x6:25mm".into(),
        ..BoardOptions::default()
    };
    if !is_full() {
        (options.width, options.height, options.cameras) = (1280, 960, 6);
        boards.placements = PLACEMENTS;
    }
    options.color.encoding = Encoding::Mono;
    change(&mut options, &mut boards);
    let session = BoardSession::new(options, boards).unwrap();
    let count = session.placements().len();
    let captures = (0..count).map(|index| session.capture(index).unwrap());
    (captures.collect(), *session.board())
}

/// The session in which a camera was changed, of that camera alone.
fn only(camera: &str, change: impl Fn(&mut Options)) -> Vec<Capture> {
    let all = captures(|options, _| {
        let others = (0..options.cameras).map(|k| format!("c{k:02}"));
        let others = others.chain(["kinect".to_owned()]);
        options.faults.missing = others.filter(|id| id != camera).collect();
        change(options);
    });
    all.0
}

/// A rig that has no fault, and the folder of its sessions.
struct Trial {
    folder: tempfile::TempDir,
    base: Vec<Capture>,
    board: Board,
    /// What went otherwise than it must; all faults are tried before the test fails.
    failures: RefCell<Vec<String>>,
}

/// Indices of the placements at which each camera sees the board.
struct Visibility(BTreeMap<String, Vec<usize>>);

impl Visibility {
    /// The first placement from this one on at which a camera sees the board.
    fn since(&self, camera: &str, from: usize) -> usize {
        let mut seen = self.0[camera].iter();
        *seen.find(|&&at| at >= from).unwrap()
    }

    /// A placement from which on a camera may be changed late: enough is seen since then to calibrate from, and most of
    /// what the camera saw is before.
    fn late(&self, camera: &str, count: usize) -> usize {
        let seen = &self.0[camera];
        let after = FEWEST[0] + usize::from(seen.len() >= MANY_VIEWS);
        let mut candidates = seen[..=seen.len() - after].iter();
        *candidates.rfind(|&&at| at + FEWEST[1] <= count).unwrap()
    }

    /// A placement until which a camera may have been another one, so that all cameras see enough since then.
    fn early(&self, camera: &str) -> usize {
        let is_enough = |from: usize| {
            let since = |seen: &Vec<usize>| seen.iter().filter(|at| **at >= from).count();
            self.0.values().all(|seen| since(seen) >= FEWEST[0])
        };
        let seen = &self.0[camera];
        let mut candidates = [3, 2].into_iter().map(|before| seen[before]);
        candidates.find(|from| is_enough(*from)).unwrap()
    }
}

fn name(placement: usize) -> String {
    format!("placement-{placement:03}")
}

/// What the command said.
struct Told {
    code: Option<i32>,
    words: String,
}

impl Trial {
    fn new() -> Self {
        let (base, board) = captures(|_, _| {});
        Self {
            folder: tempfile::tempdir().unwrap(),
            base,
            board,
            failures: RefCell::default(),
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, captures: &[Capture], name: &str) -> PathBuf {
        let path = self.path(name);
        let _ = std::fs::remove_file(&path);
        let mut writer = Writer::create(&path, "a trial", Compression::None).unwrap();
        writer.board(&self.board).unwrap();
        for capture in captures {
            writer.trigger(&capture.trigger).unwrap();
            for frame in &capture.frames {
                writer.frame(frame).unwrap();
            }
        }
        writer.finish().unwrap();
        path
    }

    /// The base with each frame of a placement changed or taken from elsewhere.
    fn with(&self, change: impl Fn(usize, &mut Frame)) -> Vec<Capture> {
        let mut all = self.base.clone();
        for (index, capture) in all.iter_mut().enumerate() {
            capture
                .frames
                .iter_mut()
                .for_each(|frame| change(index, frame));
        }
        all
    }

    /// The base with a camera's frames of another session from a placement on.
    fn starting_at(&self, camera: &str, from: usize, other: &[Capture]) -> Vec<Capture> {
        self.with(|index, frame| {
            if index >= from && frame.camera.as_str() == camera {
                let found = other[index].frames.iter();
                let mut same =
                    found.filter(|f| f.camera == frame.camera && f.stream == frame.stream);
                // Depth frames keep their order.
                let nth = same
                    .position(|f| f.timestamp == frame.timestamp)
                    .unwrap_or(0);
                let mut same = other[index]
                    .frames
                    .iter()
                    .filter(|f| f.camera == frame.camera && f.stream == frame.stream);
                frame.picture = same.nth(nth).unwrap().picture.clone();
            }
        })
    }

    fn calibrate(&self, captures: &[Capture], more: &[&str]) -> Told {
        let session = self.write(captures, "session.mcap");
        let out = self.path("out.toml");
        // `--force` would take a refused calibration.
        for name in ["out.toml", "out.doubtful.toml"] {
            let _ = std::fs::remove_file(self.path(name));
        }
        let mut arguments = vec!["calibrate", session.to_str().unwrap()];
        arguments.extend(["--out", out.to_str().unwrap()]);
        arguments.extend(more);
        run(&arguments)
    }

    /// Calibrates a session: which exit codes are right, and what must be said.
    fn row(&self, fault: &str, captures: &[Capture], more: &[&str], codes: &[i32], said: &[&str]) {
        let told = self.calibrate(captures, more);
        self.judge(fault, &told, codes, said);
    }

    /// Notes whether the command said what it must.
    fn judge(&self, fault: &str, told: &Told, codes: &[i32], said: &[&str]) {
        // A camera of the large rig sees the board six times: three views that were left out are enough for a refusal.
        let codes = match codes {
            DOUBTFUL if is_full() => NOT_GOOD,
            codes => codes,
        };
        println!("shown: {fault}: exit {:?}: {}", told.code, told.summary());
        let is_right = told.code.is_some_and(|code| codes.contains(&code));
        let unsaid: Vec<_> = said
            .iter()
            .filter(|words| !told.words.contains(**words))
            .collect();
        if !is_right || !unsaid.is_empty() {
            let failure = format!(
                "{fault}: exit {:?}, expected one of {codes:?}; unsaid: {unsaid:?}: {}",
                told.code, told.words
            );
            println!("FAILED: {failure}");
            self.failures.borrow_mut().push(fault.to_owned());
        }
    }

    /// Notes whether the command named, behind these words, one of the placements from which the rig is another one.
    fn judge_place(&self, fault: &str, told: &Told, behind: &str, expected: &[usize]) {
        let named = told.words.split(behind).nth(1).and_then(|rest| {
            let digits = rest.strip_prefix("placement-")?.get(..3)?;
            digits.parse().ok()
        });
        if !named.is_some_and(|named: usize| expected.contains(&named)) {
            println!("FAILED: {fault}: {named:?} is named, expected one of {expected:?}");
            self.failures.borrow_mut().push(fault.to_owned());
        }
    }

    /// Which placements each camera sees while nothing is wrong.
    fn visibility(&self) -> Visibility {
        let told = self.calibrate(&self.base, &["--json"]);
        let mut values = serde_json::Deserializer::from_str(&told.words).into_iter::<Value>();
        let found = values.next().unwrap().unwrap();
        let text = |value: &Value| value.as_str().unwrap().to_owned();
        let pair = |r: &Value| (text(&r["camera"]), text(&r["placement"]));
        let rejected = found["rejected"].as_array().unwrap();
        let unseen: BTreeSet<(String, String)> = rejected.iter().map(pair).collect();
        let cameras = found["cameras"].as_object().unwrap().keys();
        let seen = |camera: &String| {
            let is_seen = |at: &usize| !unseen.contains(&(camera.clone(), name(*at)));
            let seen = (0..self.base.len()).filter(is_seen).collect();
            (camera.clone(), seen)
        };
        Visibility(cameras.map(seen).collect())
    }

    /// Ends the test: with the names of what failed, if anything did.
    fn end(self) {
        let failures = self.failures.into_inner();
        assert!(failures.is_empty(), "{failures:#?}");
    }
}

impl Told {
    /// The verdict and its first reason.
    fn summary(&self) -> String {
        let levels = ["good:", "accepted:", "doubtful:", "refused:"];
        let mut lines = self.words.lines();
        let verdict = lines.find(|line| levels.iter().any(|level| line.starts_with(level)));
        let verdict = verdict.map_or("", |line| line.split(',').next().unwrap_or(line));
        format!("{verdict} | {}", lines.next().unwrap_or_default().trim())
    }
}

fn run(arguments: &[&str]) -> Told {
    let output = Command::new(env!("CARGO_BIN_EXE_scand"))
        .args(arguments)
        .output()
        .unwrap();
    let [out, errors] =
        [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    Told {
        code: output.status.code(),
        words: out + &errors,
    }
}

/// A picture's rows, mirrored.
fn mirrored(picture: &Picture) -> Picture {
    let mut mirrored = picture.clone();
    if let Picture::Raw { step, data, .. } = &mut mirrored {
        let rows = data.chunks_exact(*step as usize);
        let turned: Vec<u8> = rows.flat_map(|row| row.iter().rev().copied()).collect();
        *data = turned.into();
    }
    mirrored
}

/// A picture whose focal length is larger, by so many times.
fn zoomed(picture: &Picture, times: f64) -> Picture {
    let mut zoomed = picture.clone();
    if let Picture::Raw {
        width,
        height,
        step,
        data,
        ..
    } = &mut zoomed
    {
        let (w, h, step) = (*width as usize, *height as usize, *step as usize);
        let at = |x: f64, y: f64| {
            let (x, y) = (
                x.clamp(0.0, w as f64 - 1.001),
                y.clamp(0.0, h as f64 - 1.001),
            );
            let (i, j) = (x as usize, y as usize);
            let (u, v) = (x - i as f64, y - j as f64);
            let pixel = |i: usize, j: usize| f64::from(data[j * step + i]);
            (1.0 - v) * ((1.0 - u) * pixel(i, j) + u * pixel(i + 1, j))
                + v * ((1.0 - u) * pixel(i, j + 1) + u * pixel(i + 1, j + 1))
        };
        let (cx, cy) = (0.5 * (w as f64 - 1.0), 0.5 * (h as f64 - 1.0));
        let row = |j: usize| (0..step).map(move |i| (i, j));
        let pixels = (0..h).flat_map(row).map(|(i, j)| {
            at(cx + (i as f64 - cx) / times, cy + (j as f64 - cy) / times).round() as u8
        });
        *data = pixels.collect::<Vec<u8>>().into();
    }
    zoomed
}

/// A depth frame with other readings: of a distance in metres, and of the squared distance from the picture's middle,
/// 1 at its corners. What was not read stays so.
fn misread(picture: &Picture, wrong: impl Fn(f64, f64) -> f64) -> Picture {
    let mut misread = picture.clone();
    if let Picture::Raw {
        width,
        height,
        data,
        ..
    } = &mut misread
    {
        let half = [*width, *height].map(|side| 0.5 * f64::from(side));
        let columns = *width as usize;
        let reading = |(index, bytes): (usize, &[u8])| {
            let reading = f64::from(u16::from_le_bytes([bytes[0], bytes[1]]));
            let from = [index % columns, index / columns];
            let squares = [0, 1].map(|k| (from[k] as f64 + 0.5 - half[k]).powi(2));
            let corner = half[0].powi(2) + half[1].powi(2);
            let read = 1e3 * wrong(1e-3 * reading, (squares[0] + squares[1]) / corner);
            let read = if reading > 0.0 { read.round() } else { 0.0 };
            (read as u16).to_le_bytes()
        };
        let readings = data.chunks_exact(2).enumerate().flat_map(reading);
        *data = readings.collect::<Vec<u8>>().into();
    }
    misread
}

fn turned(camera: &str, degrees: f64) -> Vec<Capture> {
    only(camera, |options| {
        options.faults.turned_deg.push(CameraFault {
            camera: camera.into(),
            amount: degrees,
        });
    })
}

/// The session in which the depth camera was pushed aside, of that camera alone: as if the board were elsewhere for it.
fn pushed(millimetres: f64, placements: usize) -> Vec<Capture> {
    let all = captures(|options, boards| {
        options.faults.missing = (0..options.cameras).map(|k| format!("c{k:02}")).collect();
        // A board that moves has gone all its way before the last camera, which is the depth camera, sees it.
        let moved = |placement| PlacementFault {
            placement,
            amount: millimetres,
        };
        boards.faults.moved_mm = (0..placements).map(moved).collect();
    });
    all.0
}

fn is(frame: &Frame, camera: &str) -> bool {
    frame.camera.as_str() == camera
}

#[test]
#[ignore = "takes minutes: make calibration-trial"]
fn every_fault_that_a_session_can_show_is_doubted_and_named() {
    let trial = Trial::new();
    let count = trial.base.len();

    let nominal = "m per unit; 0.001 ±1.0 % is nominal: they differ by";
    trial.row("sound", &trial.base, &[], GOOD, &[nominal]);
    let sound = trial.path("sound.toml");
    std::fs::rename(trial.path("out.toml"), &sound).unwrap();
    let visibility = trial.visibility();
    let (first, last) = (visibility.early("c04"), visibility.late("c04", count));
    println!("shown: c04 is another camera before {first} or from {last} on");

    for degrees in [0.1, 0.7] {
        let other = turned("c04", degrees);
        let moved = format!("camera c04 moved by {degrees:.2}°");
        let late = trial.starting_at("c04", last, &other);
        let from = format!("--from-placement {}", name(last));
        trial.row(
            &format!("bumped by {degrees}° late"),
            &late,
            &[],
            DOUBTFUL,
            &[&moved, &from],
        );
        let early = trial.with(|index, frame| {
            if index < first && is(frame, "c04") {
                frame.picture = other[index].frames[0].picture.clone();
            }
        });
        let fault = format!("bumped by {degrees}° early");
        let told = trial.calibrate(&early, &[]);
        trial.judge(&fault, &told, DOUBTFUL, &[&moved]);
        let words = "the rig has stayed as it is since ";
        trial.judge_place(&fault, &told, words, &[first]);
        let advised = ["--from-placement", &name(first)];
        trial.row("the sound part of it", &early, &advised, GOOD, &[]);
    }

    let exchanged = |placements: Range<usize>| {
        trial.with(|index, frame| {
            let other = ["c01", "c02"].iter().position(|id| is(frame, id));
            if let (Some(k), true) = (other, placements.contains(&index)) {
                let source = ["c02", "c01"][k];
                let mut frames = trial.base[index].frames.iter();
                let same = frames.find(|f| is(f, source)).unwrap();
                frame.picture = same.picture.clone();
            }
        })
    };
    // A camera may see the board too rarely in a third of the session for the cause to be named.
    let early = exchanged(0..count / 3);
    trial.row("exchanged in the first third", &early, &[], NOT_GOOD, &[]);
    let back = exchanged(count / 3..2 * count / 3);
    // In the large rig only the placements that contradict each other are named: "show the board there again".
    let again = if is_full() {
        "again"
    } else {
        "show the board again"
    };
    trial.row("exchanged and put back", &back, &[], NOT_GOOD, &[again]);
    let told = trial.calibrate(&exchanged(count / 2..count), &[]);
    let words = "cameras c01 and c02 are exchanged from ";
    trial.judge("exchanged", &told, NOT_GOOD, &[words]);
    let since = ["c01", "c02"].map(|camera| visibility.since(camera, count / 2));
    trial.judge_place("exchanged", &told, words, &since);

    let late = trial.with(|index, frame| {
        if is(frame, "c04") && index > 0 {
            let before = trial.base[index - 1].frames.iter();
            frame.picture = before
                .clone()
                .find(|f| is(f, "c04"))
                .unwrap()
                .picture
                .clone();
        }
    });
    let words = "camera c04: its pictures are one placement late";
    trial.row("late by one", &late, &[], NOT_GOOD, &[words]);

    let mirror = trial.with(|_, frame| {
        if is(frame, "c02") {
            frame.picture = mirrored(&frame.picture);
        }
    });
    trial.row("mirrored", &mirror, &[], NOT_GOOD, &["c02", "mirrored"]);

    let refocused = trial.with(|index, frame| {
        if is(frame, "c04") && index >= last {
            frame.picture = zoomed(&frame.picture, 1.005);
        }
    });
    let told = trial.calibrate(&refocused, &[]);
    let words = "the focal length of camera c04 changed by +0.";
    trial.judge("refocused by 0.5 %", &told, DOUBTFUL, &[words]);
    let words = "show the board again, or calibrate from ";
    trial.judge_place("refocused by 0.5 %", &told, words, &[last]);

    let told = trial.calibrate(&trial.base[..3], &[]);
    // Where not all cameras can be joined, what is missing is said.
    let words = match told.code {
        Some(1) => "missing: ",
        _ => "the session has 3 placements, expected 4 or more",
    };
    trial.judge("three placements", &told, NOT_GOOD, &[words]);

    let wrong = ["--board", "checkerboard:9x6:24mm"];
    let both = [
        "either the board's squares have 2",
        "and not 24 mm",
        "or the depth camera reads 4.",
    ];
    trial.row(
        "squares of 24 for 25 mm",
        &trial.base,
        &wrong,
        DOUBTFUL,
        &both,
    );
    for times in [1.03, 1.04] {
        let deep = trial.with(|_, frame| {
            if frame.stream == Stream::Depth {
                frame.picture = misread(&frame.picture, |z, _| times * z);
            }
        });
        let percent = format!("depth {:.0} % too deep", 100.0 * (times - 1.0));
        trial.row(
            &percent,
            &deep,
            &[],
            DOUBTFUL,
            &["or the depth camera reads", "too deep"],
        );
        let today = trial.write(&deep[4..6], "today.mcap");
        let told = check(&today, &sound);
        let checked = format!("{percent}, --check");
        trial.judge(&checked, &told, &[1], &["mm too deep at"]);
    }
    let seen = &visibility.0["kinect"];
    let (half, late) = (seen[seen.len() / 2], seen[seen.len() - seen.len() / 3]);
    for (when, from) in [("half-way", half), ("late", late)] {
        let changed = trial.with(|index, frame| {
            if index >= from && frame.stream == Stream::Depth {
                frame.picture = misread(&frame.picture, |z, _| 1.03 * z);
            }
        });
        let fault = format!("depth 3 % too deep, {when}");
        let words = [
            "depth camera kinect: its readings changed between ",
            " % deeper)",
        ];
        trial.row(&fault, &changed, &[], NOT_GOOD, &words);
    }
    let aside = trial.starting_at("kinect", half, &pushed(10.0, count));
    let words = "camera kinect moved by ";
    trial.row(
        "depth camera pushed by 10 mm half-way",
        &aside,
        &[],
        NOT_GOOD,
        &[words],
    );
    for pixels in [3.0, 6.0] {
        let beside = only("kinect", |options| {
            options.depth.misregistration_px = pixels;
        });
        let beside = trial.starting_at("kinect", 0, &beside);
        trial.row(
            &format!("depth beside its colour by {pixels} px"),
            &beside,
            &[],
            DOUBTFUL,
            &["depth that is displaced against its colour picture"],
        );
        let late = trial.starting_at("kinect", half, &beside);
        trial.row(
            &format!("depth beside its colour by {pixels} px, from half-way on"),
            &late,
            &[],
            NOT_GOOD,
            &["depth that is displaced against its colour picture"],
        );
    }
    let misread = |wrong: &dyn Fn(f64, f64) -> f64| {
        trial.with(|_, frame| {
            if frame.stream == Stream::Depth {
                frame.picture = misread(&frame.picture, wrong);
            }
        })
    };
    let bowl = misread(&|z, radius_squared| z + 0.012 * radius_squared * z * z);
    let words = "an error that grows from the picture's middle to its corners";
    trial.row("depth as a bowl of 12 mm", &bowl, &[], DOUBTFUL, &[words]);
    let quartic = misread(&|z, _| {
        let z_squared = ((z - 1.0) / 0.3).powi(2);
        z + 0.006 * (1.0 - 4.0 * z_squared + 3.0 * z_squared.powi(2))
    });
    let words = "a response that is not linear in the distance";
    trial.row("a quartic of 6 mm", &quartic, &[], DOUBTFUL, &[words]);
    let whole = trial.write(&trial.base, "whole.mcap");
    let told = check(&whole, &sound);
    trial.judge("sound, --check", &told, GOOD, &[]);
    trial.end();
}

fn check(session: &Path, against: &Path) -> Told {
    let [session, against] = [session, against].map(|path| path.to_str().unwrap());
    run(&["calibrate", "--check", session, "--against", against])
}

#[test]
#[ignore = "takes minutes: make calibration-trial"]
fn no_sound_session_is_doubted() {
    let trial = Trial::new();
    for seed in 0..20 {
        let (session, _) = captures(|options, boards| {
            options.seed = seed;
            if !is_full() {
                (options.width, options.height, options.cameras) = (800, 600, 8);
                boards.placements = PLACEMENTS;
            }
            options.depth.bias_mm = 12.0;
        });
        trial.row(&format!("seed {seed}"), &session, &[], GOOD, &[]);
    }
    trial.end();
}

//! `scand info`: lists the contents of a recording, its cameras and captures, and its damage.

use super::replay::find_recordings;
use super::{EXIT_INCOMPLETE, first_aid, refuse_to_replace, wrong_usage};
use crate::calibrate::of_recording;
use crate::calibration::{Camera, DepthResponse, Volume};
use crate::capture::{
    CaptureSession, CaptureSummary, LeftOutCamera, RigAt, calibration_digest, input_digest,
};
use crate::frame::{CameraId, CaptureId, Timestamp};
use crate::notes::CaptureNotes;
use crate::recording::noted_recording;
use crate::recording::{Attachment, ChannelInfo, ColorPart, Damage, DepthPart, Recording, Topic};
use crate::storage::write_atomically;
use crate::sync;
use crate::words::{at_most, count, printable};
use serde::{Serialize, Serializer};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// List what a recording has: channels, captures, cameras, calibration, damage
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  scand info cup.mcap
  scand info /archive
  scand info --json cup.mcap
  scand info cup.mcap --digests
  scand info cup.mcap --calibration calibration.toml")]
pub struct Args {
    /// The recordings, or folders with recordings; if there are several, one line is printed for each
    #[arg(required = true, value_name = "FILE|FOLDER")]
    files: Vec<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    /// Also print the SHA-256 digests of each capture's input and calibration, as its model's files state them; this
    /// decodes all pictures
    #[arg(long)]
    digests: bool,
    /// Write the calibration at the first trigger into a file that --replay --calibration and scand run read
    #[arg(long, value_name = "FILE.toml")]
    calibration: Option<PathBuf>,
    /// Replace an existing file
    #[arg(short, long, requires = "calibration")]
    force: bool,
}

/// Reads the whole recording and lists its contents. The exit code is 3 if parts of it are damaged.
///
/// # Errors
/// If it cannot be read at all, or the calibration's file already exists.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    refuse_to_replace("--calibration", args.calibration.as_deref(), args.force)?;
    let (files, warnings) = find_recordings(&args.files)?;
    for warning in warnings {
        eprintln!("scand: {}", printable(&warning));
    }
    let [file] = &files[..] else {
        if args.calibration.is_some() || args.digests {
            return Err(wrong_usage(
                "--calibration and --digests are about one recording: name one",
            ));
        }
        return Ok(lines(&files, args.json));
    };
    let recording = open(file)?;
    if let Some(path) = &args.calibration {
        let calibration = of_recording(&recording)?;
        write_atomically(path, calibration.to_toml().as_bytes())?;
        eprintln!("scand: the calibration is in {} (TOML)", path.display());
    }
    let session = CaptureSession::of_any(recording, &sync::Parameters::default())?;
    let mut info = Info::of(&session)?;
    if args.digests {
        info.digests = info
            .captures
            .iter()
            .map(|c| digests(&session, &c.id))
            .collect();
    }
    let text = if args.json {
        serde_json::to_string_pretty(&info)? + "\n"
    } else {
        info.in_words()
    };
    outln!("{text}");
    Ok(if info.damage.is_empty() {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(EXIT_INCOMPLETE)
    })
}

/// Opens a recording; a file of notes leads to the recording that it is about.
fn open(file: &Path) -> anyhow::Result<Recording> {
    match noted_recording(file) {
        Some(recording) if recording.exists() => Ok(Recording::open(&recording)?),
        Some(recording) => anyhow::bail!(
            "{}: its recording {} does not exist, so these notes belong to no recording",
            file.display(),
            recording.display()
        ),
        None => Ok(Recording::open(file)?),
    }
}

/// Prints one line for each recording. The exit code is 3 if one is damaged or cannot be read.
fn lines(files: &[PathBuf], in_json: bool) -> ExitCode {
    let mut code = ExitCode::SUCCESS;
    for file in files {
        let info = open(file).and_then(|recording| {
            let session = CaptureSession::of_any(recording, &sync::Parameters::default())?;
            Info::of(&session)
        });
        match info {
            Ok(info) => {
                if !info.damage.is_empty() {
                    code = ExitCode::from(EXIT_INCOMPLETE);
                }
                match in_json {
                    true => outln!("{}", serde_json::to_string(&info).unwrap_or_default()),
                    false => outln!("{}", line_of(&info.line())),
                }
            }
            Err(error) => {
                code = ExitCode::from(EXIT_INCOMPLETE);
                let problem = format!("{error:#}");
                if in_json {
                    let file = file.to_string_lossy();
                    outln!("{}", serde_json::json!({ "file": file, "error": problem }));
                }
                eprintln!("scand: {}", printable(&problem));
            }
        }
    }
    code
}

/// Everything that is printed about a recording.
#[derive(Serialize)]
struct Info {
    #[serde(serialize_with = "path_text")]
    file: PathBuf,
    bytes: u64,
    cut_off: bool,
    profile: String,
    library: String,
    metadata: Vec<(String, BTreeMap<String, String>)>,
    attachments: Vec<Attachment>,
    channels: Vec<ChannelInfo>,
    cameras: Vec<CameraInfo>,
    volume: Result<[[f64; 3]; 2], String>,
    /// People's notes on the session.
    session_notes: CaptureNotes,
    captures: Vec<CaptureSummary>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    digests: Vec<CaptureDigests>,
    left_out: Vec<LeftOutCamera>,
    warnings: Vec<String>,
    damage: Vec<Damage>,
}

/// A path as a text; JSON has none for what is not UTF-8.
fn path_text<S: Serializer>(path: &Path, into: S) -> Result<S::Ok, S::Error> {
    into.serialize_str(&path.to_string_lossy())
}

/// What a capture's model states of its input.
#[derive(Serialize)]
struct CaptureDigests {
    capture: CaptureId,
    #[serde(flatten)]
    found: DigestsOrProblem,
}

#[derive(Serialize)]
#[serde(rename_all = "snake_case")]
enum DigestsOrProblem {
    Sha256(Digests),
    /// Why the capture cannot be read.
    Problem(String),
}

#[derive(Serialize)]
struct Digests {
    input: String,
    calibration: String,
}

fn digests(session: &CaptureSession, id: &CaptureId) -> CaptureDigests {
    let found = match session.load(id) {
        Ok((scene, _)) => DigestsOrProblem::Sha256(Digests {
            input: input_digest(&scene),
            calibration: calibration_digest(&scene),
        }),
        Err(error) => DigestsOrProblem::Problem(error.to_string()),
    };
    CaptureDigests {
        capture: id.clone(),
        found,
    }
}

impl CaptureDigests {
    fn line(&self) -> String {
        match &self.found {
            DigestsOrProblem::Sha256(digests) => format!(
                "{}: input {}, calibration {}",
                self.capture, digests.input, digests.calibration
            ),
            DigestsOrProblem::Problem(problem) => format!("{}: {problem}", self.capture),
        }
    }
}

/// A camera with its newest calibration.
#[derive(Serialize)]
struct CameraInfo {
    id: CameraId,
    kind: &'static str,
    images: usize,
    backgrounds: usize,
    masks: usize,
    #[serde(skip_serializing_if = "is_zero")]
    ignore_masks: usize,
    calibration: Result<CalibrationInfo, String>,
}

fn is_zero(count: &usize) -> bool {
    *count == 0
}

/// A lens at a pose.
#[derive(Serialize)]
struct CalibrationInfo {
    width: usize,
    height: usize,
    focal_px: [f64; 2],
    center_px: [f64; 2],
    radial: [f64; 6],
    tangential: [f64; 2],
    position_m: [f64; 3],
    looks_along: [f64; 3],
    #[serde(skip_serializing_if = "Option::is_none")]
    response: Option<ResponseInfo>,
}

/// What a depth camera's readings mean.
#[derive(Serialize)]
struct ResponseInfo {
    slope: f64,
    intercept: f64,
    scale: [f64; 5],
    range_m: Option<[f64; 2]>,
    uncertainty_m: f64,
}

impl Info {
    fn of(session: &CaptureSession) -> anyhow::Result<Self> {
        let recording = session.recording();
        let (profile, library) = recording.written_by();
        let ids: BTreeSet<&CameraId> = recording.topics().filter_map(camera_of).collect();
        let rig = RigAt::new(recording, Timestamp(u64::MAX), ids.iter().copied());
        let of_rig = |volume: Volume| [volume.min.into(), volume.max.into()];
        let (cameras, volume) = match &rig {
            Ok(rig) => (
                cameras(recording, rig),
                rig.volume().map(of_rig).map_err(|e| e.to_string()),
            ),
            Err(error) => (Vec::new(), Err(error.to_string())),
        };
        let mut warnings = session.warnings().to_vec();
        warnings.extend(rig.err().map(|e| e.to_string()));
        warnings.extend(session.notes().problems().iter().cloned());
        Ok(Self {
            file: recording.path().into(),
            bytes: recording.file_length(),
            cut_off: recording.is_cut_off()?,
            profile: profile.into(),
            library: library.into(),
            metadata: recording.metadata().to_vec(),
            attachments: recording.attachments().to_vec(),
            channels: recording.channels(),
            cameras,
            volume,
            session_notes: session.notes().on_session(recording),
            captures: session.captures(),
            digests: Vec::new(),
            left_out: session.left_out().to_vec(),
            warnings,
            damage: recording.verify()?,
        })
    }
}

fn camera_of(topic: &Topic) -> Option<&CameraId> {
    match topic {
        Topic::Color(id, _) | Topic::Depth(id, _) => Some(id),
        _ => None,
    }
}

/// The cameras that have a calibration, colour before depth.
fn cameras(recording: &Recording, rig: &RigAt<'_>) -> Vec<CameraInfo> {
    let count = |topic: Topic| recording.messages(&topic).len();
    let camera = |topic: &Topic| match topic {
        Topic::Color(id, ColorPart::Calibration) => Some(CameraInfo {
            id: id.clone(),
            kind: "colour",
            images: count(Topic::Color(id.clone(), ColorPart::Image)),
            backgrounds: count(Topic::Color(id.clone(), ColorPart::Background)),
            masks: count(Topic::Color(id.clone(), ColorPart::Mask)),
            ignore_masks: count(Topic::Color(id.clone(), ColorPart::Ignore)),
            calibration: match rig.color(id) {
                Ok(camera) => Ok(calibration(&camera, None)),
                Err(error) => Err(error.to_string()),
            },
        }),
        Topic::Depth(id, DepthPart::Calibration) => Some(CameraInfo {
            id: id.clone(),
            kind: "depth",
            images: count(Topic::Depth(id.clone(), DepthPart::Image)),
            backgrounds: 0,
            masks: 0,
            ignore_masks: 0,
            calibration: match rig.depth(id) {
                Ok(depth) => Ok(calibration(&depth.camera, Some(&depth.response))),
                Err(error) => Err(error.to_string()),
            },
        }),
        _ => None,
    };
    recording.topics().filter_map(camera).collect()
}

fn calibration(camera: &Camera, response: Option<&DepthResponse>) -> CalibrationInfo {
    let lens = &camera.intrinsics;
    let forward = camera.rig_from_camera.rotation * nalgebra::Vector3::z();
    CalibrationInfo {
        width: lens.width,
        height: lens.height,
        focal_px: lens.focal_px.into(),
        center_px: lens.center_px.into(),
        radial: lens.distortion.radial,
        tangential: lens.distortion.tangential,
        position_m: camera.center().into(),
        looks_along: forward.into(),
        response: response.map(|r| ResponseInfo {
            slope: r.slope,
            intercept: r.intercept,
            scale: r.scale,
            range_m: r.range,
            uncertainty_m: r.uncertainty,
        }),
    }
}

/// Most lines of one kind that are printed as text; JSON has them all.
const MOST_LINES: usize = 500;

/// Text for the terminal, a heading and its lines at a time.
#[derive(Default)]
struct Sections(String);

impl Sections {
    fn section(&mut self, heading: &str, lines: impl IntoIterator<Item = String>) {
        let mut lines = lines.into_iter();
        let shown: Vec<String> = lines.by_ref().take(MOST_LINES).collect();
        if shown.is_empty() {
            return;
        }
        self.0 += &format!("\n{heading}\n");
        for line in shown {
            self.0 += &format!("  {}\n", line_of(&line));
        }
        let left = lines.count();
        if left > 0 {
            self.0 += &format!("  … and {left} more\n");
        }
    }
}

/// Most letters of a value that are printed, and of a line, which has several.
const MOST_LETTERS: usize = 400;
const LONGEST_LINE: usize = 1000;

/// A line without letters that a terminal would obey, and not endless.
fn line_of(text: &str) -> String {
    printable(&at_most(LONGEST_LINE, text))
}

/// A value that anybody may have written.
fn value(text: &str) -> String {
    at_most(MOST_LETTERS, text)
}

impl Info {
    /// The recording in a line.
    fn line(&self) -> String {
        let failed = self
            .captures
            .iter()
            .filter(|capture| capture.failure.is_some())
            .count();
        let rejected = self
            .captures
            .iter()
            .filter(|capture| capture.notes.is_rejected())
            .count();
        let first = self
            .captures
            .first()
            .map(|capture| format!(", from {}", capture.time.iso_8601()));
        let counted = [(failed, "failed"), (rejected, "rejected")].into_iter();
        let counted = counted.filter(|(number, _)| *number > 0);
        let counted: String = counted
            .map(|(number, what)| format!(", {number} {what}"))
            .collect();
        let state = match (self.cut_off, self.damage.len()) {
            (true, _) => ", CUT OFF".to_owned(),
            (false, 0) => String::new(),
            (false, places) => format!(", DAMAGED in {}", count(places, "place")),
        };
        format!(
            "{}: {}{}{counted}, {}, {} bytes{state}",
            self.file.display(),
            count(self.captures.len(), "capture"),
            first.unwrap_or_default(),
            count(self.cameras.len(), "camera"),
            self.bytes
        )
    }

    /// What is missing, and what to do about it.
    fn first_aid(&self) -> Option<String> {
        first_aid::words(&self.file, self.bytes, self.cut_off, &self.damage)
    }

    fn in_words(&self) -> String {
        let title = line_of(&format!(
            "{}: {} bytes, profile {:?}, written by {:?}",
            self.file.display(),
            self.bytes,
            self.profile,
            self.library
        ));
        let first_aid = self
            .first_aid()
            .map(|aid| line_of(&aid) + "\n\n")
            .unwrap_or_default();
        let mut words = Sections(first_aid + &title + "\n");
        words.section("Metadata", self.metadata.iter().flat_map(metadata_lines));
        words.section(
            "Attachments",
            self.attachments
                .iter()
                .map(|a| format!("{} ({}, {} bytes)", a.name, a.media_type, a.length)),
        );
        words.section("Channels", self.channels.iter().map(channel_line));
        words.section("Cameras", self.cameras.iter().map(CameraInfo::line));
        words.section(
            "Volume",
            [match &self.volume {
                Ok([min, max]) => format!("{min:.4?} to {max:.4?} m"),
                Err(error) => error.clone(),
            }],
        );
        words.section("Notes on the session", self.session_notes.lines());
        words.section("Captures", self.captures.iter().flat_map(capture_lines));
        words.section(
            "Digests (SHA-256)",
            self.digests.iter().map(CaptureDigests::line),
        );
        words.section("Left out", self.left_out.iter().map(|l| l.reason.clone()));
        words.section("Warnings", self.warnings.iter().cloned());
        words.section("Damage", self.damage.iter().map(ToString::to_string));
        words.0
    }
}

fn metadata_lines((name, pairs): &(String, BTreeMap<String, String>)) -> Vec<String> {
    let pairs = pairs
        .iter()
        .map(|(k, v)| format!("  {} = {}", value(k), value(v)));
    std::iter::once(value(name)).chain(pairs).collect()
}

fn channel_line(channel: &ChannelInfo) -> String {
    let ChannelInfo {
        topic,
        schema,
        encoding,
        messages,
        known,
    } = channel;
    let remark = if *known {
        ""
    } else {
        " (not a topic of the format)"
    };
    format!("{messages:6} {topic:28} {schema} in {encoding}{remark}")
}

/// A capture, and below it the notes on it.
fn capture_lines(capture: &CaptureSummary) -> Vec<String> {
    let CaptureSummary {
        id,
        time,
        source,
        subject,
        placement,
        notes,
        failure,
        skew_ns,
        color_frames,
        depth_frames,
    } = capture;
    let outcome = match failure {
        None => "complete".to_owned(),
        Some(reason) => format!("failed: {}", value(reason)),
    };
    // Of one picture alone there is none.
    let skew = match *color_frames {
        0 | 1 => String::new(),
        _ => format!(", skew {:.2} ms", *skew_ns as f64 / 1e6),
    };
    let object = subject.as_ref().map_or_else(String::new, |number| {
        format!(" of object {}", value(number))
    });
    let placed = placement
        .as_ref()
        .map_or_else(String::new, |words| format!(", {}", value(words)));
    let line = format!(
        "{id}{object}{placed} at {} by {}: {} and {}{skew}, {outcome}",
        time.iso_8601(),
        value(source),
        count(*color_frames, "colour frame"),
        count(*depth_frames, "depth frame"),
    );
    let said = notes.lines().into_iter().map(|line| format!("  {line}"));
    std::iter::once(line).chain(said).collect()
}

impl CameraInfo {
    fn line(&self) -> String {
        let Self {
            id,
            kind,
            images,
            backgrounds,
            masks,
            ignore_masks,
            ..
        } = self;
        let lens = match &self.calibration {
            Ok(lens) => lens.words(),
            Err(error) => error.clone(),
        };
        let plates = match (backgrounds, masks) {
            (0, 0) => String::new(),
            _ => format!(
                ", {}, {}",
                count(*backgrounds, "background"),
                count(*masks, "mask")
            ),
        };
        let plates = match ignore_masks {
            0 => plates,
            some => format!("{plates}, {}", count(*some, "ignore mask")),
        };
        format!("{id} ({kind}, {}{plates}): {lens}", count(*images, "image"))
    }
}

impl CalibrationInfo {
    fn words(&self) -> String {
        let [x, y, z] = self.position_m;
        let [dx, dy, dz] = self.looks_along;
        let bent = self.radial != [0.0; 6] || self.tangential != [0.0; 2];
        let lens = if bent { "distorted" } else { "no distortion" };
        let response = self.response.as_ref().map_or_else(String::new, |r| {
            let ResponseInfo {
                slope, intercept, ..
            } = r;
            format!(", depth = {slope} r + {intercept} m, scale {:?}", r.scale)
        });
        format!(
            "{}x{}, focal {:.1} {:.1} px, {lens}, at {x:.3} {y:.3} {z:.3} m, looks along {dx:.3} {dy:.3} \
             {dz:.3}{response}",
            self.width, self.height, self.focal_px[0], self.focal_px[1]
        )
    }
}

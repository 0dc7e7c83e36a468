//! Measures what recording costs compared with plain `write(2)` of the same bytes: captures of eleven 2560x1920
//! Bayer frames and a burst of 30 depth and colour frames, 100 MB, each synced to the disk (fdatasync), one after
//! the other into an open session and into an open file. The two take turns in one process, so that other load
//! affects them alike; the result is the ratio of the medians. A separate process for each measures the peak of its
//! memory. `SCAND_BENCH_FOLDER` names the disk (by default that of the folder for temporary files).

use bytes::Bytes;
use rustix::time::{ClockId, clock_gettime};
use scand::frame::{CameraId, CaptureId, Frame, Picture, Stream, Timestamp, Trigger};
use scand::recording::{
    CaptureOutcome, CaptureRecord, FinishedCapture, RecordingSession, SessionHeader,
};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

const ROUNDS: usize = 10;
const WAYS: [&str; 2] = ["write(2) and fdatasync", "recording"];

fn main() {
    // What cargo passes to benchmarks and tests means nothing here; `cargo test` shall not write gigabytes.
    let arguments: Vec<String> = std::env::args().collect();
    if let [_, flag, way] = arguments.as_slice()
        && flag == "--peak"
    {
        return print_peak(way);
    }
    if arguments.iter().any(|a| a == "--test") || !arguments.iter().any(|a| a == "--bench") {
        return;
    }
    let folder = folder();
    let mut ways = open_all(folder.path());
    let mut rounds = vec![Vec::new(); ways.len()];
    // The first of each warms up.
    for round in 0..=ROUNDS {
        let capture = capture(round as u64);
        for turn in 0..ways.len() {
            // Each comes first in its turn: what comes first finds warm memory.
            let way = (round + turn) % ways.len();
            let cost = measured(|| ways[way].append(&capture));
            if round > 0 {
                rounds[way].push(cost);
            }
        }
    }
    let megabytes = capture(0).bytes() as f64 / 1e6;
    println!("a capture of {megabytes:.0} MB, median of {ROUNDS} alternating runs");
    let [wall, cpu] = median(&rounds[0]);
    for (name, rounds) in WAYS.iter().zip(&rounds) {
        let [its_wall, its_cpu] = median(rounds);
        println!(
            "{name:24} wall {:6.1} ms ({:4.2})  processor {:6.1} ms ({:4.2})  peak {:6.1} MB",
            its_wall * 1e3,
            its_wall / wall,
            its_cpu * 1e3,
            its_cpu / cpu,
            peak_of_a_process(name)
        );
    }
    println!("in brackets: so many times what write(2) takes");
}

fn folder() -> tempfile::TempDir {
    let folder =
        std::env::var_os("SCAND_BENCH_FOLDER").map_or_else(std::env::temp_dir, PathBuf::from);
    tempfile::tempdir_in(folder).unwrap()
}

/// A way to bring captures to the disk.
trait Way {
    fn append(&mut self, capture: &FinishedCapture);
}

/// All of them, in the order of [`WAYS`].
fn open_all(folder: &Path) -> [Box<dyn Way>; 2] {
    let begin = Timestamp(1);
    let header = SessionHeader::default();
    let session = RecordingSession::begin(folder, "session", "bench", begin, u64::MAX, header);
    [
        Box::new(File::create_new(folder.join("plain")).unwrap()),
        Box::new(session.unwrap()),
    ]
}

impl Way for File {
    fn append(&mut self, capture: &FinishedCapture) {
        for frame in &capture.frames {
            if let Picture::Raw { data, .. } = &frame.picture {
                self.write_all(data).unwrap();
            }
        }
        self.sync_data().unwrap();
    }
}

impl Way for RecordingSession {
    fn append(&mut self, capture: &FinishedCapture) {
        self.append(capture).unwrap();
    }
}

/// Largest memory in megabytes of a process that records two captures in this way, the capture itself included.
fn peak_of_a_process(way: &str) -> f64 {
    let mut process = std::process::Command::new(std::env::current_exe().unwrap());
    let output = process.args(["--peak", way]).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    text.trim().parse().unwrap()
}

fn print_peak(way: &str) {
    let folder = folder();
    let ways = open_all(folder.path());
    let mut way = WAYS.into_iter().zip(ways).find(|(name, _)| *name == way);
    let capture = capture(0);
    for _ in 0..2 {
        way.as_mut().unwrap().1.append(&capture);
    }
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kilobytes = peak.unwrap().trim().trim_end_matches(" kB");
    println!("{}", kilobytes.parse::<f64>().unwrap() * 1024.0 / 1e6);
}

fn median(rounds: &[[f64; 2]]) -> [f64; 2] {
    [0, 1].map(|i| {
        let mut sorted: Vec<f64> = rounds.iter().map(|r| r[i]).collect();
        sorted.sort_by(f64::total_cmp);
        sorted[sorted.len() / 2]
    })
}

/// Wall and processor time in seconds.
fn measured(work: impl FnOnce()) -> [f64; 2] {
    let cpu = || {
        let t = clock_gettime(ClockId::ProcessCPUTime);
        t.tv_sec as f64 + t.tv_nsec as f64 * 1e-9
    };
    let (begin, begin_cpu) = (Instant::now(), cpu());
    work();
    [begin.elapsed().as_secs_f64(), cpu() - begin_cpu]
}

fn capture(seed: u64) -> FinishedCapture {
    let mut frames = Vec::new();
    for i in 0..11 {
        let name = format!("c{i:02}");
        frames.push(frame(&name, Stream::Color, [2560, 1920], 1, seed + i));
    }
    for i in 0..30 {
        frames.push(frame("kinect", Stream::Depth, [640, 480], 2, seed + i));
        frames.push(frame("kinect", Stream::DepthColor, [640, 480], 3, seed + i));
    }
    let id = CaptureId::new("bench").unwrap();
    FinishedCapture {
        trigger: Trigger {
            id: id.clone(),
            time: Timestamp(2),
            source: "bench".into(),
            press_id: None,
            subject: None,
            placement: None,
        },
        frames,
        record: CaptureRecord {
            id: id.to_string(),
            outcome: CaptureOutcome::Complete,
            reason: None,
            skew_ns: Some(0),
            cameras: BTreeMap::new(),
        },
        time: Timestamp(3),
    }
}

fn frame(camera: &str, stream: Stream, size: [u32; 2], bytes: u32, seed: u64) -> Frame {
    let encoding = match stream {
        Stream::Color => "bayer_rggb8",
        Stream::Depth => "16UC1",
        Stream::DepthColor => "rgb8",
    };
    let length = (size[0] * size[1] * bytes) as usize;
    // Noise, as sensors give it: nothing on the way can make it smaller.
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let noise = std::iter::repeat_with(|| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    });
    let data: Vec<u8> = noise.take(length / 8).flat_map(u64::to_le_bytes).collect();
    Frame {
        camera: CameraId::new(camera).unwrap(),
        stream,
        timestamp: Timestamp(10 + seed),
        picture: Picture::Raw {
            width: size[0],
            height: size[1],
            encoding: encoding.into(),
            step: size[0] * bytes,
            data: Bytes::from(data),
        },
    }
}

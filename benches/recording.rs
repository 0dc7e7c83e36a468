//! What recording costs beside plain `write(2)` of the same bytes: captures of eleven 2560x1920 Bayer frames and a burst
//! of 30 depth and colour frames, each brought to the disk, one after the other into an open session and into an open
//! file. Both are measured by turns in one run; what counts are the ratios. `SCAND_BENCH_FOLDER` names the disk (the folder for temporary files unless given).

use bytes::Bytes;
use rustix::time::{ClockId, clock_gettime};
use scand::frame::{CameraId, CaptureId, Frame, Picture, Stream, Timestamp, Trigger};
use scand::recording::{CaptureRecord, Kept, Outcome, Preamble, Session};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

const ROUNDS: usize = 20;

fn main() {
    // What cargo passes to benchmarks and tests means nothing here; `cargo test` shall not write gigabytes.
    if std::env::args().any(|a| a == "--test") || !std::env::args().any(|a| a == "--bench") {
        return;
    }
    let folder =
        std::env::var_os("SCAND_BENCH_FOLDER").map_or_else(std::env::temp_dir, PathBuf::from);
    let folder = tempfile::tempdir_in(folder).unwrap();
    let mut file = File::create_new(folder.path().join("plain")).unwrap();
    let begin = Timestamp(1);
    let session = Session::begin(
        folder.path(),
        "session",
        "bench",
        begin,
        u64::MAX,
        Preamble::default(),
    );
    let mut session = session.unwrap();
    let mut plain = Vec::new();
    let mut recorded = Vec::new();
    // The first of each warms up.
    for round in 0..=ROUNDS {
        let capture = capture(round as u64);
        let mut plainly = || measured(|| write_plainly(&mut file, &capture));
        let mut recording = || measured(|| drop(session.keep(&capture).unwrap()));
        // By turns the other one first: what comes first finds warm memory.
        let (a, b) = if round % 2 == 0 {
            let a = plainly();
            (a, recording())
        } else {
            let b = recording();
            (plainly(), b)
        };
        if round > 0 {
            plain.push(a);
            recorded.push(b);
        }
    }
    let megabytes = capture(0).bytes() as f64 / 1e6;
    println!("a capture of {megabytes:.0} MB, median of {ROUNDS}");
    for (name, rounds) in [("write(2) and fdatasync", &plain), ("recording", &recorded)] {
        let [wall, cpu] = median(rounds);
        println!(
            "{name:24} wall {:6.1} ms  processor {:6.1} ms",
            wall * 1e3,
            cpu * 1e3
        );
    }
    let ratios: Vec<[f64; 2]> = plain
        .iter()
        .zip(&recorded)
        .map(|(a, b)| [b[0] / a[0], b[1] / a[1]])
        .collect();
    let [wall, cpu] = median(&ratios);
    println!("ratio                    wall {wall:6.2}     processor {cpu:6.2}");
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

fn write_plainly(file: &mut File, capture: &Kept) {
    for frame in &capture.frames {
        if let Picture::Raw { data, .. } = &frame.picture {
            file.write_all(data).unwrap();
        }
    }
    file.sync_data().unwrap();
}

fn capture(seed: u64) -> Kept {
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
    Kept {
        trigger: Trigger {
            id: id.clone(),
            time: Timestamp(2),
            source: "bench".into(),
            press_id: None,
            subject: None,
        },
        frames,
        record: CaptureRecord {
            id: id.to_string(),
            outcome: Outcome::Complete,
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

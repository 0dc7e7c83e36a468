//! A rig over hours and on bad networks: nothing grows, and no picture is wrong.

use super::stand::{Stand, served};
use super::{color, network, pixels, recordings};
use crate::support::torture::{self, times};
use scand::recording::{CaptureOutcome, ColorPart, Recording, Topic};
use scand::trigger::Reply;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

/// The packets of pictures, and no commands.
const PICTURES: &str = "udp length > 500";
/// Where nft changes packets.
const TABLE: &str = "nft add table ip t && nft add chain ip t i '{ type filter hook input priority 0; }' && \
    nft add chain ip t o '{ type filter hook output priority 0; }'";

/// What the network of this namespace does to the packets of pictures. GVSP's head is status, block, format and packet
/// (GigE Vision 2.0, chapter 24); there is no checksum over it, or over what follows, but Ethernet's and UDP's.
const NETWORKS: [(&str, &str); 4] = [
    (
        "loses 2 %",
        "nft add rule ip t i 'PICTURES numgen random mod 1000 < 20 drop'",
    ),
    (
        "repeats 10 %",
        "nft add rule ip t o 'PICTURES numgen random mod 100 < 10 dup to 127.0.1.100 device lo'",
    ),
    (
        "spoils the heads of 1 %",
        "nft add rule ip t i 'PICTURES numgen random mod 100 < 1 @th,96,8 set 0x7f'",
    ),
    // Each eighth packet goes a slower way.
    (
        "reorders",
        "tc qdisc add dev lo root handle 1: htb default 10 && \
         tc class add dev lo parent 1: classid 1:10 htb rate 10gbit quantum 60000 && \
         tc class add dev lo parent 1: classid 1:20 htb rate 300mbit burst 9k quantum 9000 && \
         tc filter add dev lo parent 1: protocol ip u32 match ip protocol 17 0xff match u32 3 0x0f000007 at 32 flowid 1:20",
    ),
];

fn shell(script: &str) {
    let done = Command::new("sh").args(["-c", script]).output().unwrap();
    assert!(
        done.status.success(),
        "{script}: {}",
        String::from_utf8_lossy(&done.stderr)
    );
}

/// Holds every colour picture in the recordings against the one that was served; complete captures.
fn check_pictures(folder: &Path) -> usize {
    let original = Recording::open(&served().0).unwrap();
    let mut complete = 0;
    for file in recordings(folder) {
        let recording = Recording::open(&file).unwrap();
        for message in recording.messages(&Topic::Capture) {
            let record = recording.capture_record(message).unwrap();
            complete += usize::from(record.outcome == CaptureOutcome::Complete);
        }
        for i in 0..11 {
            let topic = color(i, ColorPart::Image);
            let right = &pixels(&original, &topic)[0];
            for picture in pixels(&recording, &topic) {
                assert!(picture == *right, "{topic} in {}", file.display());
            }
        }
    }
    complete
}

#[test]
fn a_network_that_loses_repeats_spoils_or_reorders_packets_shows_no_wrong_picture() {
    network::alone(
        "faults::a_network_that_loses_repeats_spoils_or_reorders_packets_shows_no_wrong_picture",
        || {
            let presses = times(2, 15);
            for (what, script) in NETWORKS {
                let stand = Stand::start(&["sync.depth_frames=10", "capture.retry=0"]);
                shell(&format!(
                    "{TABLE} && {}",
                    script.replace("PICTURES", PICTURES)
                ));
                let mut durable = 0;
                for _ in 0..presses {
                    match stand.press() {
                        Reply::Durable { .. } => durable += 1,
                        Reply::Failed { reason, .. } => {
                            assert!(reason.contains("camera c"), "{what}: {reason}");
                        }
                        other => panic!("{what}: {other:?}"),
                    }
                }
                let seen = "nft list ruleset; tc -s class show dev lo";
                let seen = Command::new("sh").args(["-c", seen]).output().unwrap();
                shell("nft flush ruleset; tc qdisc del dev lo root 2>/dev/null || true");
                stand.until_durable();
                let folder = stand.end();
                let complete = check_pictures(&folder.path().join("recordings"));
                assert_eq!(
                    complete,
                    durable + 1,
                    "{what}: {}",
                    String::from_utf8_lossy(&seen.stdout)
                );
                println!(
                    "shown: a network that {what}: {durable} of {presses} captures whole, the others named their cameras; 0 wrong pictures"
                );
            }
        },
    );
}

/// What a daemon has at a moment.
struct Sample {
    seconds: f64,
    memory_mb: f64,
    files: f64,
    threads: f64,
    latency_ms: f64,
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Removes complete recordings, like a person who moves them away.
fn clear(folder: &Path) {
    for file in recordings(folder) {
        std::fs::remove_file(file).unwrap();
    }
}

/// Presses for so long, with a sample a capture.
fn soak(stand: &Stand, long: Duration) -> Vec<Sample> {
    let (begin, mut samples) = (Instant::now(), Vec::new());
    while begin.elapsed() < long {
        let pressed = Instant::now();
        let reply = stand.press();
        assert!(
            matches!(reply, Reply::Durable { .. }),
            "{reply:?}: {}",
            stand.log()
        );
        let (memory, files, threads) = stand.daemon_holds();
        samples.push(Sample {
            seconds: begin.elapsed().as_secs_f64(),
            memory_mb: memory as f64 / 1e6,
            files: files as f64,
            threads: threads as f64,
            latency_ms: pressed.elapsed().as_secs_f64() * 1e3,
        });
        clear(&stand.recordings());
    }
    samples
}

/// A curve's name, what it shows of a sample, and how much it may grow.
type Curve = (&'static str, fn(&Sample) -> f64, f64);

/// Writes a line a sample: its time, then its value in each curve.
fn write_table(path: &Path, curves: &[Curve], samples: &[Sample]) {
    let mut text = "seconds".to_owned();
    curves
        .iter()
        .for_each(|(name, ..)| text += &format!(",{name}"));
    for sample in samples {
        text += &format!("\n{:.3}", sample.seconds);
        curves
            .iter()
            .for_each(|(_, of, _)| text += &format!(",{:.3}", of(sample)));
    }
    std::fs::write(path, text + "\n").unwrap();
}

/// `target/tmp/soak.csv` has the samples of the last run.
#[test]
fn soak_memory_files_threads_and_latency_stay_flat() {
    network::alone(
        "faults::soak_memory_files_threads_and_latency_stay_flat",
        || {
            let stand = Stand::start(&["sync.depth_frames=10", "recording.largest_file_mb=40"]);
            // The first captures find their memory.
            soak(&stand, Duration::from_secs(times(2, 10)));
            let samples = soak(&stand, Duration::from_secs(times(5, 60)));
            assert!(samples.len() >= 6, "{} captures", samples.len());
            // Beside other tests a machine is as fast as they leave it.
            let slower_ms = torture::asked().map_or(f64::INFINITY, |_| 100.0);
            let curves: [Curve; 4] = [
                ("memory MB", |s| s.memory_mb, 30.0),
                ("open files", |s| s.files, 3.0),
                ("threads", |s| s.threads, 2.0),
                ("press to durable ms", |s| s.latency_ms, slower_ms),
            ];
            let table = Path::new(env!("CARGO_TARGET_TMPDIR")).join("soak.csv");
            write_table(&table, &curves, &samples);
            let third = samples.len() / 3;
            let mut words = String::new();
            for (name, of, growth) in curves {
                let [first, last] = [&samples[..third], &samples[samples.len() - third..]]
                    .map(|part| median(part.iter().map(of)));
                assert!(
                    last <= first + growth,
                    "{name}: {first:.1}, then {last:.1}: {}",
                    table.display()
                );
                words += &format!(", {name} {first:.0} then {last:.0}");
            }
            println!(
                "shown: {} captures in {:.0} s{words} ({})",
                samples.len(),
                samples[samples.len() - 1].seconds,
                table.display()
            );
            stand.end();
        },
    );
}

//! The simulated rig still makes the project's own recordings from the options that they carry; if the rig changes,
//! they have to be made again. They are compared bit for bit: pictures and readings are whole numbers, and the last
//! bit of a sine, in which mathematical libraries may differ, changes one of them in about 10^10.

use scand::frame::{Frame, Picture, Stream};
use scand::recording::{ColorPart, DepthPart, Recording, Topic};
use scand_lab::{Options, Simulation, ply};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings")
}

/// What one colour camera and the depth camera of a recording's session give when it is simulated again.
fn simulated_again(recording: &Recording) -> Simulation {
    let metadata = recording.metadata().iter();
    let session = metadata
        .filter(|(name, _)| name == "session")
        .map(|(_, pairs)| pairs)
        .next();
    let mut options: Options = serde_json::from_str(&session.unwrap()["simulation"]).unwrap();
    let others = (1..options.cameras).map(|k| format!("c{k:02}"));
    options.faults.missing.extend(others.clone());
    options.faults.no_background.extend(others);
    Simulation::new(options).unwrap()
}

fn digest(pictures: impl Iterator<Item = Picture>) -> Vec<u8> {
    let mut digest = Sha256::new();
    for picture in pictures {
        match picture {
            Picture::Raw { data, encoding, .. } => {
                digest.update(encoding);
                digest.update(data);
            }
            Picture::Compressed { data, format } => {
                digest.update(format);
                digest.update(data);
            }
        }
    }
    digest.finalize().to_vec()
}

fn recorded(recording: &Recording, topic: &Topic) -> Vec<u8> {
    let messages = recording.messages(topic).iter();
    assert!(messages.len() > 0, "{topic:?}");
    digest(messages.map(|m| recording.picture(topic, m).unwrap()))
}

fn made(frames: &[Frame], stream: Stream) -> Vec<u8> {
    let frames = frames.iter().filter(|f| f.stream == stream);
    digest(frames.map(|f| f.picture.clone()))
}

#[test]
fn the_recordings_are_what_their_options_make() {
    for name in ["cup", "bowl_with_fruit"] {
        let path = folder().join(format!("{name}.mcap"));
        assert!(
            path.metadata().unwrap().len() <= 8 << 20,
            "{name} is too large"
        );
        let recording = Recording::open(&path).unwrap();
        let simulation = simulated_again(&recording);
        let frames = simulation.capture(0).unwrap().frames;
        let color = simulation.rig().colors[0].actual.id.clone();
        let depth = simulation.rig().depths[0].actual.camera.id.clone();
        for (topic, made) in [
            (
                Topic::Color(color.clone(), ColorPart::Image),
                made(&frames, Stream::Color),
            ),
            (
                Topic::Color(color, ColorPart::Background),
                made(&simulation.backgrounds(), Stream::Color),
            ),
            (
                Topic::Depth(depth.clone(), DepthPart::Image),
                made(&frames, Stream::Depth),
            ),
            (
                Topic::Depth(depth, DepthPart::Color),
                made(&frames, Stream::DepthColor),
            ),
        ] {
            assert_eq!(recorded(&recording, &topic), made, "{name}: {topic:?}");
        }
        let truth = std::fs::read(folder().join(format!("{name}.truth.ply"))).unwrap();
        assert!(ply(simulation.truth()) == truth, "{name}: another truth");
    }
}

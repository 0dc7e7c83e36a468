//! Any bytes as a recording: opened, assembled into captures, each of them loaded. Nothing may panic.

#![no_main]

use libfuzzer_sys::fuzz_target;
use scand::job::Session;
use scand::recording::Recording;
use scand::sync;

fuzz_target!(|bytes: &[u8]| {
    let file = tempfile::NamedTempFile::new().expect("room for a file");
    std::fs::write(file.path(), bytes).expect("room for a file");
    let Ok(recording) = Recording::open(file.path()) else {
        return;
    };
    let _damage = recording.verify();
    let parameters = sync::Parameters {
        go_on_without_missing: true,
        min_depth_frames: 1,
        ..sync::Parameters::default()
    };
    if let Ok(session) = Session::of(recording, &parameters) {
        for capture in session.captures().into_iter().take(4) {
            let _scene = session.load(&capture.id);
        }
    }
});

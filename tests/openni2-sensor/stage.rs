//! A place where the test sensor can be loaded without root; `stage.sh` lays it out. For tests, by
//! `#[path = "openni2-sensor/stage.rs"] mod stage;`.

use std::path::{Path, PathBuf};
use std::process::Command;

/// Builds the test sensor and lays out the folder that `LD_LIBRARY_PATH` must name; returns it.
///
/// # Panics
/// If OpenNI2 is not installed or the sensor does not build.
pub fn folder() -> PathBuf {
    // Beside the binary of this test, wherever the target folder is.
    let own = std::env::current_exe().unwrap();
    let target = own.ancestors().nth(3).unwrap().join("openni2-sensor");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/openni2-sensor/stage.sh");
    let made = Command::new(script)
        .arg(&target)
        .env("CARGO", env!("CARGO"))
        .output()
        .unwrap();
    let words = String::from_utf8_lossy(&made.stderr);
    assert!(made.status.success(), "the test sensor: {words}");
    PathBuf::from(String::from_utf8(made.stdout).unwrap().trim())
}

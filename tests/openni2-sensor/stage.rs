//! A place where the test sensor can be loaded without root: a folder with a link to Debian's libOpenNI2 and the
//! drivers beside it, which a process takes when `LD_LIBRARY_PATH` names it as it starts. For tests, by
//! `#[path = "openni2-sensor/stage.rs"] mod stage;`.

use std::path::{Path, PathBuf};
use std::process::Command;

/// Where Debian keeps OpenNI2.
const LIBRARIES: [&str; 2] = ["/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu"];

/// Builds the test sensor and lays out the folder; returns it.
///
/// # Panics
/// If OpenNI2 is not installed or the sensor does not build.
pub fn folder() -> PathBuf {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    // Beside the binary of this test, wherever the target folder is.
    let own = std::env::current_exe().unwrap();
    let target = own.ancestors().nth(3).unwrap().join("openni2-sensor");
    let built = Command::new(env!("CARGO"))
        .args(["build", "--quiet", "--locked", "--manifest-path"])
        .arg(package.join("tests/openni2-sensor/Cargo.toml"))
        .arg("--target-dir")
        .arg(&target)
        .status();
    assert!(built.unwrap().success(), "the test sensor does not build");
    let debian = LIBRARIES.iter().map(Path::new);
    let debian = debian
        .into_iter()
        .find(|l| l.join("libOpenNI2.so.0").exists());
    let debian = debian.expect("libOpenNI2.so.0 is missing: apt-get install libopenni2-dev");
    let stage = target.join("stage");
    let drivers = stage.join("OpenNI2/Drivers");
    std::fs::create_dir_all(&drivers).unwrap();
    link(
        &debian.join("libOpenNI2.so.0"),
        &stage.join("libOpenNI2.so.0"),
    );
    let file = debian.join("OpenNI2/Drivers/libOniFile.so.0");
    link(&file, &drivers.join("libOniFile.so.0"));
    let sensor = target.join("debug/libopenni2_sensor.so");
    link(&sensor, &drivers.join("libScandSensor.so.0"));
    stage
}

/// Other tests may lay out the same at the same time.
fn link(from: &Path, to: &Path) {
    if let Err(why) = std::os::unix::fs::symlink(from, to) {
        let there = std::fs::read_link(to).is_ok_and(|found| found == from);
        assert!(there, "{}: {why}", to.display());
    }
}

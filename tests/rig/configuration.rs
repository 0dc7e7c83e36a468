//! Configurations that are refused before a camera is opened: exit code 78, and a message that names what is wrong.

use super::stand::{scand, served};
use std::path::Path;

const CAMERAS: &str = "[aravis.cameras.c00]\naddress = \"127.0.1.1\"\n[aravis.cameras.c01]\naddress = \"127.0.1.2\"\n";

fn check(folder: &Path, text: &str) -> (Option<i32>, String) {
    std::fs::write(folder.join("rig.toml"), text).unwrap();
    let output = scand()
        .args(["run", "--check", "--config", "rig.toml"])
        .current_dir(folder)
        .output()
        .unwrap();
    let words = String::from_utf8_lossy(&output.stderr).into_owned();
    (output.status.code(), words)
}

#[test]
fn what_is_wrong_is_named_and_nothing_touched() {
    let folder = tempfile::tempdir().unwrap();
    let (recording, _) = served();
    let exported = scand()
        .arg("info")
        .args([
            &recording,
            Path::new("--calibration"),
            &folder.path().join("calibration.toml"),
        ])
        .output();
    assert!(exported.unwrap().status.success());
    let rig = "[rig]\ncalibration = \"calibration.toml\"\n";
    let sound = format!("{rig}{CAMERAS}");
    let (code, words) = check(folder.path(), &sound);
    assert_eq!(code, Some(0), "{words}");
    let (code, words) = check(folder.path(), CAMERAS);
    assert_eq!(code, Some(0), "{words}");
    assert!(words.contains("there is no rig.calibration"), "{words}");
    let cases = [
        (sound.replace("calibration.toml", "none.toml"), "none.toml"),
        (format!("{sound}[capture]\nretyr = 1\n"), "retyr"),
        (format!("{sound}exposure = nan\n"), "exposure"),
        (format!("{sound}exposure = nan\n"), "line 7"),
        (format!("{sound}{CAMERAS}"), "duplicate key"),
        (
            sound.replace("127.0.1.2", "127.0.1.1"),
            "aravis.cameras.c01: address 127.0.1.1 is already used by c00",
        ),
        (
            sound
                .replace("\"127.0.1.1\"", "\"127.0.1.1\"\nserial = \"A7\"")
                .replace("\"127.0.1.2\"", "\"127.0.1.2\"\nserial = \"A7\""),
            "aravis.cameras.c01: serial \"A7\" is already used by c00",
        ),
        (
            format!("{sound}[openni2.cameras.kinect]\n[openni2.cameras.xtion]\n"),
            "openni2.cameras.xtion: device \"any\" is already used by kinect",
        ),
        (
            format!("{sound}[capture]\npatience_ms = 60000\n"),
            "60000, expected 0 to 30000",
        ),
        (
            sound.replace("cameras.c01", "cameras.c77"),
            "camera c77 is not in rig.calibration",
        ),
        (
            format!("{sound}[links.a]\nspeed_mbit = 1\ncameras = [\"c00\", \"c01\"]\n"),
            "1 Mbit/s",
        ),
        (
            format!("{sound}[openni2.cameras.kinect]\nrate = -3\n"),
            "rate",
        ),
    ];
    for (text, named) in cases {
        let (code, words) = check(folder.path(), &text);
        assert_eq!(code, Some(78), "{text}\n{words}");
        assert!(
            words.contains(named) && words.contains("toml"),
            "{named}: {words}"
        );
    }
    let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().collect();
    assert_eq!(left.len(), 2, "{left:?}");
}

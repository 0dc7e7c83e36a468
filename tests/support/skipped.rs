//! The one list of what a machine may lack for a test, and the one way to skip a test. A test that cannot run
//! prints a line that begins with `skipped:` and passes. Under `SCAND_REQUIRE_ALL=1` it fails, unless the list
//! names another place where the same is tested.

use std::fmt::Display;
use std::io::Write;

/// Something outside this repository that a test needs. `tests/deps.sh` installs what can be installed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Needed {
    /// The Khronos glTF validator, which runs in node.
    GltfValidator,
    /// OpenCV's pictures of a chessboard.
    OpencvPictures,
    /// Root, `mkfs.ext4` and a loop device: a file system whose power can be cut.
    LoopDevice,
    /// Root, to run a program as another user.
    OtherUsers,
    /// `/dev/uinput`, through which a test makes a foot switch.
    InputDevices,
    /// Recordings of other people.
    OtherRecordings,
    /// The server of a fleet.
    NatsServer,
}

impl Needed {
    /// How to get it.
    fn remedy(self) -> &'static str {
        match self {
            Self::GltfValidator => "install node and npm, then run tests/deps.sh",
            Self::OpencvPictures => "run tests/deps.sh, or name a folder in SCAND_OPENCV_STEREO",
            Self::LoopDevice => "run the test as root where /dev/loop-control is, with mkfs.ext4",
            Self::OtherUsers => "run the test as root",
            Self::InputDevices => "run the test where the kernel has /dev/uinput",
            Self::NatsServer => "run tests/deps.sh, or install nats-server",
            Self::OtherRecordings => "name their folder in SCAND_SHARED_RECORDINGS",
        }
    }

    /// Where the same is shown on a machine that cannot have it, or why nothing is lost without it. `None` if this test
    /// alone shows it: then the machine must have it under `SCAND_REQUIRE_ALL=1`.
    fn shown_elsewhere(self) -> Option<&'static str> {
        match self {
            Self::InputDevices => Some("`make rig-vm CHAPTERS=pedal` shows the same in a guest"),
            Self::OtherRecordings => Some("these recordings are not part of scand"),
            Self::GltfValidator
            | Self::OpencvPictures
            | Self::LoopDevice
            | Self::NatsServer
            | Self::OtherUsers => None,
        }
    }
}

/// What to print for a test that cannot run, or the reason why it fails.
fn judged(needed: Needed, cause: &dyn Display, require_all: bool) -> Result<String, String> {
    let remedy = needed.remedy();
    match needed.shown_elsewhere() {
        Some(instead) => Ok(format!("skipped: {cause}; {instead} (else {remedy})")),
        None if require_all => Err(format!("SCAND_REQUIRE_ALL is set, but {cause}: {remedy}")),
        None => Ok(format!("skipped: {cause}: {remedy}")),
    }
}

/// Skips the calling test, which returns after this call. `cause` says what was not found, as the start of a sentence.
///
/// # Panics
///
/// Under `SCAND_REQUIRE_ALL=1`, if the machine must have what is `needed`.
pub fn skip(needed: Needed, cause: impl Display) {
    let require_all = std::env::var_os("SCAND_REQUIRE_ALL").is_some_and(|value| value == "1");
    match judged(needed, &cause, require_all) {
        // Not by `eprintln!`: the test runner shows what that prints only where a test fails.
        Ok(words) => std::io::stderr()
            .write_all(format!("{words}\n").as_bytes())
            .unwrap(),
        Err(words) => panic!("{words}"),
    }
}

#[test]
fn a_skip_fails_where_all_is_required_unless_it_is_shown_elsewhere() {
    let words = judged(Needed::OpencvPictures, &"no left01.jpg", false).unwrap();
    assert!(words.starts_with("skipped: no left01.jpg"), "{words}");
    let words = judged(Needed::OpencvPictures, &"no left01.jpg", true).unwrap_err();
    assert!(words.contains("but no left01.jpg"), "{words}");
    for require_all in [false, true] {
        let words = judged(Needed::InputDevices, &"no uinput", require_all).unwrap();
        assert!(words.contains("make rig-vm CHAPTERS=pedal"), "{words}");
    }
}

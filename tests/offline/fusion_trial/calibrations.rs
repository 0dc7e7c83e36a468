//! Captures of one object in two recordings, each under a calibration of its own: lengths that differ are named and not
//! fused, and a doubtful calibration makes the model amber.

use super::{SUBJECT, is_wanted, session};
use crate::desk::{Desk, said};
use scand::recording::Compression;
use scand_lab::{Options, Shape, Simulation, write};
use serde_json::Value;

/// What `scand fuse` made of two recordings.
struct Made {
    code: Option<i32>,
    /// The line of JSON.
    told: Value,
    words: String,
    has_model: bool,
}

impl Made {
    /// What is said of the second recording's capture.
    fn second(&self) -> &Value {
        let captures = self.told["fusion"]["captures"].as_array();
        let second = captures
            .into_iter()
            .flatten()
            .find(|c| c["recording"] == "two.mcap");
        second.unwrap_or(&Value::Null)
    }
}

/// A mug, upright and upside-down. Its calibration errs in scale alone, because what is asked is what is said of that.
fn mug(width: usize) -> Options {
    let mut options = session(Shape::Mug, false, width, "upright,flip", 1);
    options.faults.calibration_px = 0.0;
    options
}

/// Records the same captures under two calibrations, and fuses the first capture of the first recording with the second
/// capture of the second.
fn fused([one, two]: [Options; 2]) -> Made {
    let desk = Desk::new();
    for (options, name, not_wanted) in [(one, "one.mcap", "mug-001"), (two, "two.mcap", "mug-000")]
    {
        let simulation = Simulation::new(options).unwrap();
        write(&simulation, &desk.path(name), Compression::None).unwrap();
        desk.done(&["note", not_wanted, "reject", "--recording", name]);
    }
    let fused = desk.run(&[
        "fuse",
        "two.mcap",
        "one.mcap",
        "--subject",
        SUBJECT,
        "--json",
    ]);
    let folder = desk.path(&format!("out/one/{SUBJECT}.object"));
    Made {
        code: fused.status.code(),
        told: serde_json::from_slice(&fused.stdout).unwrap_or_default(),
        words: said(&fused),
        has_model: folder.join("model.glb").exists(),
    }
}

/// The same, where the second calibration's lengths are larger by some per cent.
fn fused_at_scale(width: usize, percent: f64) -> Made {
    let mut larger = mug(width);
    larger.faults.calibration_scale_percent = percent;
    fused([mug(width), larger])
}

/// A row of the trial: calibrations that differ by 0.4 %, at 1280x960. What is not so.
pub(super) fn trial() -> Vec<String> {
    let mut wrong = Vec::new();
    for percent in [0.4, -0.4] {
        let name = format!("calibrations that differ by {percent} %");
        if !is_wanted(&name) {
            continue;
        }
        let made = fused_at_scale(1280, percent);
        let second = made.second();
        println!("{name}: exit code {:?}: {}", made.code, second["words"]);
        if made.has_model {
            wrong.push(format!("{name}: fused"));
        }
        let found = second["larger_by"].as_f64().unwrap_or(f64::NAN);
        let is_named = second["refused"] == "scale" && (100.0 * found - percent).abs() < 0.1;
        if !is_named {
            wrong.push(format!("{name}: not named"));
        }
    }
    wrong
}

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;

    #[test]
    fn calibrations_whose_lengths_differ_are_named_and_not_fused() {
        let made = fused_at_scale(640, 1.0);
        let (second, words) = (made.second(), &made.words);
        assert_eq!(made.code, Some(1), "{words}");
        assert!(!made.has_model, "{words}");
        assert_eq!(second["id"], "mug-001", "{words}");
        assert_eq!(second["refused"], "scale", "{words}");
        let found = second["larger_by"].as_f64().unwrap();
        // A third of a per cent of a mug is half a pixel here.
        assert!((found - 0.01).abs() < 0.003, "{words}");
        let told = second["words"].as_str().unwrap();
        assert!(told.contains("only if lengths differ by"), "{told}");
        assert!(told.contains("the calibrations may differ"), "{told}");
        // The first capture is not blamed.
        assert_eq!(made.told["fusion"]["captures"][0]["refused"], Value::Null);
    }

    #[test]
    fn a_doubtful_calibration_of_one_capture_makes_the_model_amber() {
        let reason = "camera c02 moved by 0.70 degrees";
        let mut doubtful = mug(640);
        // Another calibration: not that of the first recording.
        doubtful.faults.calibration_px = 0.05;
        doubtful.faults.doubtful_calibration = Some(reason.to_owned());
        let made = fused([mug(640), doubtful]);
        assert_eq!(made.code, Some(0), "{}", made.words);
        assert!(made.has_model, "{}", made.words);
        assert_ne!(made.told["verdict"], "green", "{}", made.words);
        let told = format!("the calibration is doubtful: {reason}");
        let mut reasons = made.told["reasons"].as_array().unwrap().iter();
        assert!(reasons.any(|r| *r == told.as_str()), "{}", made.words);
        // The pose itself is as good as any.
        assert_eq!(made.second()["held_by"], "silhouettes", "{}", made.words);
    }
}

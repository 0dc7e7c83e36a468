//! Poses that a person gives: nothing else is tried, and silhouettes, colours and depth are asked all the same.

use super::{SUBJECT, session};
use crate::desk::{Desk, said};
use nalgebra::{Isometry3, Vector3};
use scand::recording::Compression;
use scand_lab::{Shape, Simulation, write};
use serde_json::Value;
use std::path::Path;

/// Writes a file of the poses of two captures, of which the first one's rig is the frame.
fn write_poses(path: &Path, second: &Isometry3<f64>) {
    let rows = |pose: &Isometry3<f64>| {
        let matrix = pose.to_homogeneous();
        [0, 1, 2, 3].map(|i| [0, 1, 2, 3].map(|j| matrix[(i, j)]))
    };
    let poses = [rows(&Isometry3::identity()), rows(second)];
    let text = serde_json::json!({ "rig_from_object": poses }).to_string();
    std::fs::write(path, text).unwrap();
}

#[test]
fn of_a_plain_cup_a_turn_that_is_given_is_called_so_and_a_wrong_place_is_refused() {
    let desk = Desk::new();
    let mut options = session(Shape::Cup, false, 640, "upright,turn:75", 3);
    // What is asked is what is said, and not how well a rig is calibrated.
    options.faults.calibration_px = 0.0;
    let simulation = Simulation::new(options).unwrap();
    write(&simulation, &desk.path("cup.mcap"), Compression::None).unwrap();
    let truth = simulation.rig_from_object(1);
    let fuse = |second: &Isometry3<f64>| {
        write_poses(&desk.path("poses.json"), second);
        #[rustfmt::skip]
        let fused = desk.run(&[
            "fuse", "cup.mcap", "--subject", SUBJECT, "--poses", "poses.json", "--set", "hull.resolution=60", "-f",
        ]);
        (fused.status.code(), said(&fused))
    };
    let folder = desk.path(&format!("out/cup/{SUBJECT}.object"));
    // The cup is round about the vertical, so that the form bears both turns; only the file tells them apart.
    let about_its_axis = Isometry3::rotation(Vector3::z() * 40_f64.to_radians());
    for second in [truth, truth * about_its_axis] {
        let (code, words) = fuse(&second);
        assert_eq!(code, Some(0), "{words}");
        assert!(folder.join("model.glb").is_file());
        let report = std::fs::read(folder.join("report.json")).unwrap();
        let report: Value = serde_json::from_slice(&report).unwrap();
        let capture = &report["fusion"]["captures"][1];
        assert_eq!(capture["held_by"], "given", "{capture}");
        let told = capture["words"].as_str().unwrap();
        assert!(told.starts_with("its pose was given"), "{told}");
        assert!(
            told.contains("silhouettes leave the turn about its axis open"),
            "{told}"
        );
        assert!(words.contains(told), "{words}");
        // The pose is not changed.
        let place = capture["rig_from_object"]["translation"][0].as_f64();
        let moved = place.unwrap() - second.translation.x;
        assert!(moved.abs() < 1e-9, "{capture}");
        // And its witnesses were asked.
        assert!(capture["disagreement_mm"].is_number(), "{capture}");
        assert!(capture["colours"].is_object(), "{capture}");
    }
    let beside = Isometry3::translation(0.004, 0.0, 0.0) * truth;
    let (code, words) = fuse(&beside);
    assert_eq!(code, Some(1), "{words}");
    assert!(words.contains("in the pose that was given"), "{words}");
    assert!(!folder.join("model.glb").exists());
}

//! What lies in an object's folder: a report as the published schema has it, a preview with the underside and a column
//! a capture, and models that say which captures made them.

use crate::desk::{Desk, said};
use serde_json::Value;

/// Fuses two captures of a ball that did not move, with given poses, of which the second has this first row. The exit
/// code.
fn fused(desk: &Desk, second: &str) -> Option<i32> {
    let rest = "[0,1,0,0],[0,0,1,0],[0,0,0,1]";
    let poses = format!("{{\"rig_from_object\":[[[1,0,0,0],{rest}],[{second},{rest}]]}}");
    std::fs::write(desk.path("poses.json"), poses).unwrap();
    #[rustfmt::skip]
    let fused = desk.run(&[
        "fuse", "ball.mcap", "--capture", "ball-000", "--capture", "ball-001", "--poses", "poses.json",
        "--set", "hull.resolution=40", "-q", "-f",
    ]);
    println!("{}", said(&fused));
    fused.status.code()
}

/// The report in the object's folder, which must be as the schema has it.
fn report(desk: &Desk) -> Value {
    let schema = include_str!("../../../docs/report.schema.json");
    let schema: Value = serde_json::from_str(schema).unwrap();
    let schema = jsonschema::validator_for(&schema).unwrap();
    let report = std::fs::read(desk.path("out/ball/ball-000.object/report.json")).unwrap();
    let report: Value = serde_json::from_slice(&report).unwrap();
    let part = &report["fusion"];
    let faults: Vec<String> = schema.iter_errors(&report).map(|e| e.to_string()).collect();
    assert!(faults.is_empty(), "{faults:?}: {part}");
    // The check itself can fail.
    let mut spoiled = report.clone();
    spoiled["fusion"]["captures"][1]["held_by"] = "guesswork".into();
    assert!(!schema.is_valid(&spoiled));
    report
}

#[test]
fn the_report_of_an_object_is_as_its_schema_has_it_whether_or_not_there_is_a_model() {
    let desk = Desk::new();
    assert_eq!(fused(&desk, "[1,0,0,0]"), Some(0));
    let made = report(&desk);
    assert_eq!(made["fusion"]["captures"][1]["held_by"], "given");
    assert_eq!(fused(&desk, "[1,0,0,0.02]"), Some(1));
    let none = report(&desk);
    let second = &none["fusion"]["captures"][1];
    assert!(second["refused"].is_string(), "{second}");
    let folder = std::fs::read_dir(desk.path("out/ball/ball-000.object")).unwrap();
    assert_eq!(folder.count(), 1, "a report alone");
}

#[test]
fn the_preview_shows_the_underside_and_a_column_a_capture_and_vertices_say_whose_they_are() {
    let desk = Desk::new();
    assert_eq!(fused(&desk, "[1,0,0,0]"), Some(0));
    #[rustfmt::skip]
    desk.done(&["replay", "ball.mcap", "--capture", "ball-000", "--set", "hull.resolution=40", "-q"]);
    let [own, object] =
        ["ball-000", "ball-000.object"].map(|name| desk.path("out/ball").join(name));
    let size =
        |folder: &std::path::Path| image::image_dimensions(folder.join("preview.png")).unwrap();
    let ((width, alone), (also_width, with_columns)) = (size(&own), size(&object));
    assert_eq!(width, also_width);
    // Two rows of pictures more: below and above, and for each capture a photograph and the model.
    assert!(with_columns > alone + 200, "{with_columns} for {alone}");
    let has_captures = |folder: &std::path::Path| {
        let glb = std::fs::read(folder.join("model.glb")).unwrap();
        glb.windows(9).any(|bytes| bytes == b"_CAPTURES")
    };
    assert_eq!([has_captures(&own), has_captures(&object)], [false, true]);
}

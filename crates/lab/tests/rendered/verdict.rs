//! The room `report` on simulated rigs: captures without faults are green, faults are named, the report follows its
//! schema, and the sheet can be drawn.

use nalgebra::{Vector2, Vector3};
use scand_core::calibration::Volume;
use scand_core::capture::CaptureFacts;
use scand_core::description::Description;
use scand_core::frame::{CameraId, CaptureId, Timestamp};
use scand_core::image::RgbImage;
use scand_core::level::Level;
use scand_core::notes::CaptureNotes;
use scand_core::reconstruct::{
    self, Method, NoProgress, Reconstruction, Scene, SilhouetteSource, reconstruct,
};
use scand_core::report::{
    FailedCapture, Failure, Origin, Parameters, ReasonCode, Report, StageTime, Timing, Verdict,
    judge, measure, preview, to_json,
};
use scand_lab::{CameraFault, Options, Shape, Simulation};
use serde_json::Value;

/// A cup among eight small cameras, one depth camera above it.
fn simulated(change: impl Fn(&mut Options)) -> (Scene, Reconstruction) {
    simulated_at(60.0, change)
}

fn simulated_at(resolution: f64, change: impl Fn(&mut Options)) -> (Scene, Reconstruction) {
    let mut options = Options {
        shape: Shape::Cup,
        cameras: 8,
        width: 480,
        height: 360,
        masks: true,
        ..Options::default()
    };
    options.depth.frames = 4;
    change(&mut options);
    let scene = Simulation::new(options).unwrap().scene(0);
    let mut parameters = reconstruct::Parameters::default();
    parameters.hull.resolution = resolution;
    let made = reconstruct(&scene, &parameters, &NoProgress).unwrap();
    (scene, made)
}

pub(crate) fn facts() -> CaptureFacts {
    CaptureFacts {
        id: CaptureId::new("cup-000").unwrap(),
        time_ns: Timestamp(1_700_000_000_000_000_000),
        source: "replay".into(),
        subject: None,
        placement: None,
        skew_ns: 0,
        colors: Vec::new(),
        depths: Vec::new(),
        calibration: None,
        left_out: Vec::new(),
        warnings: Vec::new(),
        damage: Vec::new(),
    }
}

fn judged(scene: &Scene, made: &Reconstruction) -> Verdict {
    let measured = measure(scene, made, Method::Hybrid);
    judge(&measured, &facts(), &Parameters::default())
}

#[test]
fn a_box_that_the_volume_cuts_is_named_and_one_that_fills_it_is_not() {
    for masks in [true, false] {
        let options = Options {
            shape: Shape::Box,
            cameras: 8,
            width: 480,
            height: 360,
            masks,
            depth_cameras: 0,
            ..Options::default()
        };
        let whole = Simulation::new(options).unwrap().scene(0);
        let is_named = |change: &dyn Fn(&mut Volume)| {
            let mut scene = whole.clone();
            change(&mut scene.volume);
            let mut parameters = reconstruct::Parameters::default();
            parameters.hull.resolution = 60.0;
            let made = reconstruct(&scene, &parameters, &NoProgress).unwrap();
            let reasons = judged(&scene, &made).reasons;
            reasons.iter().any(|r| r.code == ReasonCode::VolumeCut)
        };
        assert!(!is_named(&|_| {}), "masks {masks}");
        assert!(is_named(&|volume| volume.max.z *= 0.6), "masks {masks}");
        assert!(is_named(&|volume| volume.min.x *= 0.4), "masks {masks}");
    }
}

#[test]
fn a_sound_capture_is_green_and_its_report_is_as_published() {
    // Of a deep cup the sensor reads too little for green, and rightly; in large cells a bowl has a hole at its rim.
    let (scene, made) = simulated_at(150.0, |o| o.shape = Shape::Bowl);
    let measured = measure(&scene, &made, Method::Hybrid);
    let verdict = judge(&measured, &facts(), &Parameters::default());
    assert_eq!(verdict.level, Level::Green, "{:#?}", verdict.reasons);
    let covered = measured.colors.iter().map(|c| c.consistency.coverage);
    assert!(covered.fold(1.0, f64::min) > 0.98);
    let regions = measured.depths[0].regions.as_ref().unwrap();
    assert!(
        regions.greatest_depth > 0.04 && regions.disagreement < 2e-3,
        "{regions:?}"
    );

    let origin = Origin::new("cup.mcap", Method::Hybrid, "abc");
    let timing = Timing {
        stages: vec![StageTime {
            stage: "visual hull".into(),
            seconds: 0.25,
        }],
        ..Timing::default()
    };
    let capture = facts();
    let about = Description {
        capture: "cup-000".into(),
        time: "2026-01-31T23:59:59.000Z".into(),
        program: "scand".into(),
        ..Description::default()
    };
    let notes = CaptureNotes::default();
    let report = Report::new(
        (&origin, &about),
        (&capture, &notes),
        &measured,
        &verdict,
        timing,
    );
    let report: Value = serde_json::from_str(&to_json(&report).unwrap()).unwrap();
    assert_eq!(violations(&report, "done"), [""; 0]);
    let model = &report["model"];
    let is_told = model["fairing_remark"]
        .as_str()
        .is_some_and(|remark| remark.starts_with("Relief that shows in no outline"));
    assert_eq!(is_told, model["fairing"].is_object(), "{model}");

    let sheet = preview(&scene, &made, &verdict, &about);
    assert_eq!(sheet.width(), 1920);
    let colors: std::collections::BTreeSet<_> = sheet.pixels().iter().collect();
    assert!(colors.len() > 500, "{} colours", colors.len());
    assert!(
        has_scale_bar(&sheet),
        "the model's panels have no scale bar"
    );
}

/// The sensor reads some materials too near. The table shows no bias then, and of a bowl only the rim tells.
#[test]
fn a_bowl_that_is_read_too_near_is_named_by_its_rim_and_one_that_is_read_right_is_not() {
    let found = |object_bias_mm: f64| {
        let (scene, made) = simulated_at(150.0, |o| {
            o.shape = Shape::Bowl;
            o.depth.object_bias_mm = object_bias_mm;
        });
        let measured = measure(&scene, &made, Method::Hybrid);
        let reasons = judge(&measured, &facts(), &Parameters::default()).reasons;
        let is_named = reasons.iter().any(|r| r.code == ReasonCode::DepthElsewhere);
        (is_named, measured.depths[0].in_front_of_hull.unwrap())
    };
    let (is_named, right) = found(0.0);
    assert!(!is_named && right.pixels < 5, "{right:?}");
    let (is_named, near) = found(-5.0);
    assert!(is_named, "{near:?}");
    assert!((near.median - 5e-3).abs() < 2e-3, "{near:?}");
}

/// Whether a bar of three rows with a taller end lies in the lower left corner of a picture of the model, the second
/// panel of a row.
fn has_scale_bar(sheet: &RgbImage) -> bool {
    const INK: [u8; 3] = [232, 234, 238];
    let left = 18 + (1920 - 2 * 18 - 5 * 8) / 6 + 8 + 8;
    let is_ink = |x: usize, y: usize| sheet[(x, y)] == INK;
    let is_bar = |y: usize| {
        let rows = y..y + 3;
        rows.clone()
            .all(|y| (left..left + 20).all(|x| is_ink(x, y)))
            && (y - 4..y).all(|y| is_ink(left, y) && !is_ink(left + 10, y))
    };
    (4..sheet.height() - 3).any(is_bar)
}

#[test]
fn a_volume_that_no_object_stands_in_is_named_and_no_background_is_blamed() {
    let with = |change: &dyn Fn(&mut Scene)| {
        let mut options = Options::small(Shape::Ball);
        options.cameras = 6;
        let mut scene = Simulation::new(options).unwrap().scene(0);
        change(&mut scene);
        let mut parameters = reconstruct::Parameters::default();
        parameters.hull.resolution = 30.0;
        let made = reconstruct(&scene, &parameters, &NoProgress);
        made.map(|_| ()).map_err(|error| error.to_string())
    };
    assert_eq!(with(&|_| {}), Ok(()));
    for away in [Vector3::new(0.0, 0.0, 0.4), Vector3::new(30.0, 0.0, 0.0)] {
        let moved = |scene: &mut Scene| {
            scene.volume.min += away;
            scene.volume.max += away;
        };
        let words = with(&moved).unwrap_err();
        assert!(words.starts_with("the volume ["), "{words}");
        assert!(
            words.contains("of 6 colour cameras see no object in it"),
            "{words}"
        );
    }
    // Of one camera alone the volume is not to blame.
    let blind = |scene: &mut Scene| {
        let SilhouetteSource::Background(plate) = &scene.colors[2].silhouette else {
            unreachable!()
        };
        scene.colors[2].image = (**plate).clone();
    };
    let words = with(&blind).unwrap_err();
    assert!(
        words.starts_with("camera c02: its silhouette is empty"),
        "{words}"
    );
}

/// Exchanges the pictures of two cameras.
fn exchange(scene: &mut Scene, a: usize, b: usize) {
    let camera_of_a = scene.colors[a].camera.clone();
    let camera_of_b = std::mem::replace(&mut scene.colors[b].camera, camera_of_a);
    scene.colors[a].camera = camera_of_b;
}

#[test]
fn a_camera_out_of_focus_is_named() {
    let blurred = CameraFault {
        camera: "c05".into(),
        amount: 5.0,
    };
    let (scene, made) = simulated(|o| {
        o.shape = Shape::Bowl;
        (o.masks, o.width, o.height) = (false, 960, 720);
        o.faults.blurred_px = vec![blurred.clone()];
    });
    let verdict = judged(&scene, &made);
    let found = verdict
        .reasons
        .iter()
        .find(|r| r.code == ReasonCode::Blurred);
    let reason = found.unwrap_or_else(|| panic!("{verdict:#?}"));
    assert_eq!(reason.cameras, [CameraId::new("c05").unwrap()]);
    assert!(verdict.level > Level::Green);
}

#[test]
fn depth_without_readings_and_a_rig_without_depth_are_told_apart() {
    let (scene, made) = simulated(|o| o.faults.no_depth = true);
    let verdict = judged(&scene, &made);
    assert_eq!(
        (verdict.level, verdict.reasons[0].code),
        (Level::Amber, ReasonCode::NoDepth)
    );
    preview(&scene, &made, &verdict, &Description::default());
    let (scene, made) = simulated(|o| o.depth_cameras = 0);
    let verdict = judged(&scene, &made);
    assert_eq!(
        (verdict.level, verdict.reasons[0].code),
        (Level::Amber, ReasonCode::NoDepthCamera)
    );
    preview(&scene, &made, &verdict, &Description::default());
}

#[test]
fn the_report_of_a_failure_is_as_published() {
    let origin = Origin::new("cup.mcap", Method::Hybrid, "");
    let id = CaptureId::new("cup-000").unwrap();
    let capture = FailedCapture {
        id: &id,
        time_ns: Timestamp(5),
        source: "pedal",
    };
    let failure = Failure::new(
        &origin,
        capture,
        "camera c03: no background",
        Timing::default(),
    );
    let mut failure = serde_json::to_value(&failure).unwrap();
    assert_eq!(violations(&failure, "failed"), [""; 0]);
    failure["reason"] = Value::Null;
    failure["surplus"] = 1.into();
    failure["capture"]["time_ns"] = 5.into();
    assert_eq!(
        violations(&failure, "failed").len(),
        3,
        "the check itself can fail"
    );
}

/// Where a value breaks a definition of the published schema.
fn violations(value: &Value, definition: &str) -> Vec<String> {
    let schema: Value =
        serde_json::from_str(include_str!("../../../../docs/report.schema.json")).unwrap();
    let mut found = Vec::new();
    validate(
        value,
        &schema["$defs"][definition],
        &schema,
        definition,
        &mut found,
    );
    found
}

/// The part of JSON Schema that the published one uses, without lengths and patterns.
fn validate(value: &Value, rule: &Value, schema: &Value, at: &str, found: &mut Vec<String>) {
    if let Some(name) = rule["$ref"].as_str() {
        let name = name.trim_start_matches("#/$defs/");
        return validate(value, &schema["$defs"][name], schema, at, found);
    }
    if let Some(rules) = rule["anyOf"].as_array() {
        let fits = |rule| {
            let mut found = Vec::new();
            validate(value, rule, schema, at, &mut found);
            found.is_empty()
        };
        if !rules.iter().any(fits) {
            found.push(format!("{at}: {value} fits none"));
        }
        return;
    }
    let choices = rule["enum"].as_array();
    let fixed = rule.get("const");
    if choices.is_some_and(|c| !c.contains(value)) || fixed.is_some_and(|c| c != value) {
        found.push(format!("{at}: {value} is not allowed"));
    }
    let types = match &rule["type"] {
        Value::Array(types) => types.clone(),
        Value::Null => Vec::new(),
        one => vec![one.clone()],
    };
    if !types.is_empty() && !types.iter().any(|t| is_of_type(value, t.as_str().unwrap())) {
        found.push(format!("{at}: {value} is not {types:?}"));
    }
    if let (Some(low), Some(v)) = (rule["minimum"].as_f64(), value.as_f64())
        && v < low
    {
        found.push(format!("{at}: {v} is below {low}"));
    }
    for (index, item) in value.as_array().into_iter().flatten().enumerate() {
        validate(
            item,
            &rule["items"],
            schema,
            &format!("{at}[{index}]"),
            found,
        );
    }
    if let Some(members) = value.as_object() {
        validate_members(members, rule, schema, at, found);
    }
}

fn validate_members(
    members: &serde_json::Map<String, Value>,
    rule: &Value,
    schema: &Value,
    at: &str,
    found: &mut Vec<String>,
) {
    for name in rule["required"].as_array().into_iter().flatten() {
        if !members.contains_key(name.as_str().unwrap()) {
            found.push(format!("{at}: {name} is missing"));
        }
    }
    for (name, member) in members {
        match rule["properties"].get(name) {
            Some(rule) => validate(member, rule, schema, &format!("{at}.{name}"), found),
            None => found.push(format!("{at}.{name} is not in the schema")),
        }
    }
}

fn is_of_type(value: &Value, name: &str) -> bool {
    match name {
        "null" => value.is_null(),
        "boolean" => value.is_boolean(),
        "string" => value.is_string(),
        "number" => value.is_number(),
        "integer" => value.is_u64() || value.is_i64(),
        "array" => value.is_array(),
        _ => value.is_object(),
    }
}

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;

    #[test]
    fn a_camera_turned_by_a_tenth_of_a_degree_or_by_a_whole_one_is_named() {
        for (camera, degrees) in [("c00", 0.1), ("c08", 0.1), ("c03", 1.0)] {
            let turned = CameraFault {
                camera: camera.into(),
                amount: degrees,
            };
            let (scene, made) = simulated_at(120.0, |o| {
                (o.cameras, o.width, o.height) = (11, 960, 720);
                o.faults.turned_deg = vec![turned.clone()];
            });
            let verdict = judged(&scene, &made);
            let mut reasons = verdict.reasons.iter();
            let reason = reasons.find(|r| r.code == ReasonCode::CameraDisplaced);
            let reason = reason.unwrap_or_else(|| panic!("{camera}: {verdict:#?}"));
            assert_eq!(reason.cameras, [CameraId::new(camera).unwrap()]);
            // The camera was turned about (0.6, 0.8, 0) of its own frame.
            let focal_px = scene.colors[0].camera.intrinsics.focal_px;
            let expected =
                (focal_px * f64::to_radians(degrees)).component_mul(&Vector2::new(-0.8, 0.6));
            let measured = measure(&scene, &made, Method::Hybrid);
            let found = Vector2::from(measured.moved.unwrap().shift_px);
            assert!(
                (found - expected).norm() < 0.35 * expected.norm(),
                "{camera}: {found} {expected}"
            );
        }
    }

    #[test]
    fn two_cameras_that_are_exchanged_are_named_and_a_calibration_of_another_rig_is_red() {
        let options = |seed| Options {
            shape: Shape::Mug,
            cameras: 8,
            width: 640,
            height: 480,
            masks: true,
            depth_cameras: 0,
            seed,
            ..Options::default()
        };
        let scene = Simulation::new(options(1)).unwrap().scene(0);
        let of = |scene: &Scene| {
            let mut parameters = reconstruct::Parameters::default();
            parameters.hull.resolution = 100.0;
            let made = reconstruct(scene, &parameters, &NoProgress).unwrap();
            judged(scene, &made)
        };
        let codes = |verdict: &Verdict| -> Vec<ReasonCode> {
            let red = verdict.reasons.iter().filter(|r| r.level == Level::Red);
            red.map(|r| r.code).collect()
        };
        assert_eq!(codes(&of(&scene)), []);
        let mut exchanged = scene.clone();
        exchange(&mut exchanged, 1, 4);
        let verdict = of(&exchanged);
        assert_eq!(
            codes(&verdict),
            [ReasonCode::CamerasExchanged],
            "{verdict:#?}"
        );
        let mut names: Vec<String> = verdict.reasons[0]
            .cameras
            .iter()
            .map(ToString::to_string)
            .collect();
        names.sort();
        assert_eq!(names, ["c01", "c04"]);
        // The places of another rig of the same design.
        let other = Simulation::new(options(2)).unwrap().scene(0);
        let mut foreign = scene.clone();
        for (view, of_other) in foreign.colors.iter_mut().zip(&other.colors) {
            view.camera = of_other.camera.clone();
        }
        let verdict = of(&foreign);
        assert_eq!(
            codes(&verdict),
            [ReasonCode::CalibrationForeign],
            "{verdict:#?}"
        );
    }
}

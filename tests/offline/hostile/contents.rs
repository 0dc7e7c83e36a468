//! Recordings whose container is intact but whose messages are not: each is refused with the topic or camera and
//! the value, or only its capture fails.

use super::command::{replay_refused, replay_whole};
use super::recording::{Message, Messages, bowl, fine_ball, one_bowl};
use foxglove::messages::{CameraCalibration, CompressedImage, FrameTransform, RawImage};
use serde_json::json;

const C01: &str = "/color/c01/image";
const LENS: &str = "/color/c01/calibration";

/// Each case is refused in these words.
fn all_refused(cases: Vec<(&str, Messages, &[&str])>) {
    for (name, messages, words) in cases {
        replay_refused(name, &messages).is_refused(words);
    }
}

#[test]
fn pictures_that_are_none_are_refused() {
    let image = |change: fn(&mut RawImage)| one_bowl().with(C01, change);
    let depth = one_bowl().depth_camera();
    let depth_image = format!("/depth/{depth}/image");
    let webp = CompressedImage {
        format: "webp".into(),
        data: vec![1, 2, 3].into(),
        ..CompressedImage::default()
    };
    let jpeg = CompressedImage {
        format: "jpeg".into(),
        data: vec![0xff, 0xd8, 0xff, 0xd9].into(),
        ..CompressedImage::default()
    };
    let garbage = |mut messages: Messages| {
        messages.of_mut(C01).for_each(|m| m.data = vec![0xff; 100]);
        messages
    };
    all_refused(vec![
        (
            "unknown-encoding",
            image(|i| i.encoding = "rgb48".into()),
            &[C01, "\"rgb48\""],
        ),
        (
            "unknown-format",
            one_bowl().replaced(C01, &webp),
            &[C01, "\"webp\""],
        ),
        (
            "no-jpeg",
            one_bowl().replaced(C01, &jpeg),
            &[C01, "jpeg data"],
        ),
        (
            "short-image",
            image(|i| i.data.truncate(1000)),
            &[C01, "1000 bytes, expected 76800"],
        ),
        (
            "no-data",
            image(|i| i.data.clear()),
            &[C01, "0 bytes, expected 76800"],
        ),
        ("small-step", image(|i| i.step = 10), &[C01, "step is 10"]),
        (
            "large-step",
            image(|i| i.step = u32::MAX),
            &[C01, "expected 1026497"],
        ),
        (
            "other-size",
            image(|i| i.width = 319),
            &[C01, "319x240, expected 320x240"],
        ),
        (
            "huge-size",
            image(|i| i.width = u32::MAX),
            &[C01, "4294967295x240"],
        ),
        (
            "no-size",
            image(|i| (i.width, i.height) = (0, 0)),
            &[C01, "0x0"],
        ),
        (
            "no-image",
            garbage(one_bowl()),
            &[C01, "is not a foxglove.RawImage message"],
        ),
        (
            "short-depth",
            one_bowl().with(&depth_image, |i: &mut RawImage| i.data.truncate(7)),
            &[&depth_image, "7 bytes, expected 614400"],
        ),
        (
            "depth-encoding",
            one_bowl().with(&depth_image, |i: &mut RawImage| i.encoding = "32FC1".into()),
            &[&depth_image, "\"32FC1\""],
        ),
    ]);
}

#[test]
fn calibrations_that_no_camera_has_are_refused() {
    let lens = |change: fn(&mut CameraCalibration)| one_bowl().with(LENS, change);
    let pose = |change: fn(&mut FrameTransform)| {
        one_bowl().with("/tf", move |t: &mut FrameTransform| {
            if t.child_frame_id == "c01" {
                change(t);
            }
        })
    };
    let mirror = [-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let mirrored = one_bowl().with(LENS, |c: &mut CameraCalibration| c.r = mirror.to_vec());
    all_refused(vec![
        (
            "nan-focal",
            lens(|c| c.k[0] = f64::NAN),
            &[LENS, "focal length", "NaN"],
        ),
        (
            "mirrored-focal",
            lens(|c| c.k[0] = -300.0),
            &[LENS, "focal length", "-300"],
        ),
        (
            "huge-focal",
            lens(|c| c.k[4] = 1e300),
            &[LENS, "focal length"],
        ),
        (
            "huge-centre",
            lens(|c| c.k[2] = 1e12),
            &[LENS, "principal point", "1000000000000"],
        ),
        (
            "nan-centre",
            lens(|c| c.k[5] = f64::NAN),
            &[LENS, "principal point", "NaN"],
        ),
        ("skew", lens(|c| c.k[1] = 0.5), &[LENS, "K is", "0.5"]),
        (
            "short-k",
            lens(|c| c.k.truncate(4)),
            &[LENS, "K has 4 numbers"],
        ),
        ("mirrored-r", mirrored, &[LENS, "R is [-1.0"]),
        (
            "fisheye",
            lens(|c| c.distortion_model = "fisheye".into()),
            &[LENS, "\"fisheye\""],
        ),
        (
            "nan-distortion",
            lens(|c| (c.distortion_model, c.d) = ("plumb_bob".into(), vec![f64::NAN])),
            &[LENS, "distortion D", "NaN"],
        ),
        (
            "huge-distortion",
            lens(|c| (c.distortion_model, c.d) = ("plumb_bob".into(), vec![1e100])),
            &[LENS, "distortion D", "1e100"],
        ),
        (
            "many-distortions",
            lens(|c| (c.distortion_model, c.d) = ("plumb_bob".into(), vec![0.0; 100_000])),
            &[LENS, "distortion D", "100000 values"],
        ),
        ("no-size-lens", lens(|c| c.width = 0), &[LENS, "0x240"]),
        (
            "huge-lens",
            lens(|c| c.width = 1 << 30),
            &[LENS, "1073741824x240"],
        ),
        (
            "nan-pose",
            pose(|t| t.translation.as_mut().unwrap().x = f64::NAN),
            &["/tf", "camera c01", "NaN"],
        ),
        (
            "far-pose",
            pose(|t| t.translation.as_mut().unwrap().x = 1e9),
            &["/tf", "camera c01", "1000000000"],
        ),
        (
            "no-rotation",
            pose(|t| t.rotation = None),
            &["/tf", "camera c01", "rotation"],
        ),
        (
            "zero-rotation",
            pose(|t| t.rotation = Some(foxglove::messages::Quaternion::default())),
            &["/tf", "camera c01", "[0.0, 0.0, 0.0, 0.0]"],
        ),
        (
            "other-parent",
            pose(|t| t.parent_frame_id = "world".into()),
            &["/tf", "camera c01", "\"world\""],
        ),
        (
            "no-pose",
            pose(|t| t.child_frame_id = "elsewhere".into()),
            &["/tf", "camera c01", "none"],
        ),
    ]);
}

#[test]
fn volumes_that_hold_no_object_are_refused() {
    let volume = |min: [f64; 3], max: [f64; 3]| {
        one_bowl().with_json("/volume", move |v| {
            (v["min"], v["max"]) = (json!(min), json!(max));
        })
    };
    let (here, there) = ([-0.2, -0.2, 0.0], [0.2, 0.2, 0.3]);
    let nan = one_bowl().with_json("/volume", |v| v["min"] = json!([null, 0, 0]));
    let frame = one_bowl().with_json("/volume", |v| v["frame_id"] = json!("world"));
    let above = volume([-0.1, -0.1, 0.35], [0.1, 0.1, 0.4]);
    all_refused(vec![
        (
            "volume-of-zero",
            volume(here, here),
            &["/volume", "[-0.2, -0.2, 0.0]"],
        ),
        (
            "volume-of-a-kilometre",
            volume([-500.0; 3], [500.0; 3]),
            &["/volume", "-500.0"],
        ),
        (
            "volume-turned-over",
            volume(there, here),
            &["/volume", "[0.2, 0.2, 0.3]"],
        ),
        ("volume-of-null", nan, &["/volume", "null"]),
        ("volume-elsewhere", frame, &["/volume", "\"world\""]),
        (
            "no-volume",
            one_bowl().without("/volume"),
            &["/volume has no message"],
        ),
        (
            "volume-aside",
            volume([40.0, 0.0, 0.0], [40.2, 0.2, 0.2]),
            &["camera c0", "volume"],
        ),
        ("volume-above", above, &["camera c0"]),
    ]);
}

#[test]
fn cameras_that_see_no_object_are_refused() {
    let mut empty = one_bowl();
    let plate = empty
        .of("/color/c01/background")
        .next()
        .unwrap()
        .data
        .clone();
    empty.of_mut(C01).for_each(|m| m.data = plate.clone());
    let mut masked = one_bowl();
    let frame = masked.of(C01).next().unwrap().clone();
    masked.0.push(Message {
        topic: "/color/c01/mask".into(),
        ..frame
    });
    let masked = masked.with("/color/c01/mask", |m: &mut RawImage| {
        (m.encoding, m.step) = ("mono8".into(), 320);
        m.data = vec![127; 320 * 240].into();
    });
    let alone = ["c01", "c02", "c03"]
        .iter()
        .fold(one_bowl(), |m, id| m.without(&format!("/color/{id}/")));
    all_refused(vec![
        (
            "empty-silhouette",
            empty,
            &["camera c01", "silhouette is empty"],
        ),
        (
            "empty-mask",
            masked,
            &["camera c01", "silhouette is empty", "mask"],
        ),
        (
            "neither-mask-nor-background",
            one_bowl().without("/color/c01/background"),
            &["camera c01", "neither a mask"],
        ),
        (
            "one-camera",
            alone,
            &["1 colour camera, expected at least 2"],
        ),
        (
            "others-uncalibrated",
            ["c01", "c02", "c03"].iter().fold(one_bowl(), |m, id| {
                m.without(&format!("/color/{id}/calibration"))
            }),
            &[
                "1 colour camera, expected at least 2; ",
                "colour camera c01 has images and no calibration",
            ],
        ),
        (
            "no-cameras",
            one_bowl().without("/color"),
            &["0 colour cameras"],
        ),
    ]);
}

#[test]
fn masks_that_no_object_has_are_refused() {
    let speckled = ["c00", "c01", "c02"].iter().fold(fine_ball(), |m, id| {
        m.with(&format!("/color/{id}/mask"), |mask: &mut RawImage| {
            let value = |i: u32| {
                if i.wrapping_mul(2_654_435_761) >> 29 == 0 {
                    0
                } else {
                    255
                }
            };
            mask.data = (0..mask.data.len() as u32).map(value).collect();
        })
    });
    all_refused(vec![(
        "speckled-masks",
        speckled,
        &["speckled", "camera c0"],
    )]);
}

#[test]
fn what_would_take_all_memory_is_refused() {
    let large = ["c00", "c01", "c02", "c03"]
        .iter()
        .fold(one_bowl(), |m, id| {
            m.with(
                &format!("/color/{id}/calibration"),
                |c: &mut CameraCalibration| {
                    (c.width, c.height) = (16384, 16384);
                },
            )
        });
    let mut many = one_bowl();
    let trigger = many.of("/trigger").next().unwrap().clone();
    for i in 0..210_000u64 {
        let data = format!(r#"{{"id": "t{i}", "source": "pedal"}}"#).into_bytes();
        many.0.push(Message {
            log_time: trigger.log_time + i,
            data,
            ..trigger.clone()
        });
    }
    all_refused(vec![
        (
            "large-pictures",
            large,
            &["/color/c03/", "16384x16384 pixels", "expected at most"],
        ),
        (
            "many-triggers",
            many,
            &["210001 messages on /trigger", "5 cameras"],
        ),
    ]);
}

#[test]
fn triggers_and_responses_that_make_no_sense_are_refused() {
    const HOUR: u64 = 3_600_000_000_000;
    let mut late = one_bowl();
    late.of_mut("/trigger").for_each(|m| m.log_time += HOUR);
    let mut broken = one_bowl();
    broken
        .of_mut("/trigger")
        .for_each(|m| m.data = b"{\"id\": ".to_vec());
    let climbing = one_bowl().with_json("/trigger", |t| t["id"] = json!("../../up"));
    let depth = one_bowl().depth_camera();
    let response = format!("/depth/{depth}/response");
    let responding = |member: &str, value: serde_json::Value| {
        one_bowl().with_json(&response, |r| r[member] = value.clone())
    };
    let mut other_schema = one_bowl();
    other_schema
        .of_mut("/volume")
        .for_each(|m| m.schema = "scand.Trigger".into());
    all_refused(vec![
        (
            "no-trigger",
            one_bowl().without("/trigger"),
            &["no /trigger"],
        ),
        ("late-trigger", late, &["camera c00 gave no frame", "c03"]),
        ("broken-trigger", broken, &["/trigger", "scand.Trigger"]),
        ("climbing-trigger", climbing, &["/trigger", "../../up"]),
        (
            "no-slope",
            responding("slope", json!(0.0)),
            &[&response, "slope is 0"],
        ),
        (
            "huge-slope",
            responding("slope", json!(1e300)),
            &[&response, "slope is 1"],
        ),
        (
            "no-scale",
            responding("scale", json!([])),
            &[&response, "scale is 0"],
        ),
        (
            "range",
            responding("range", json!([2.0, 1.0])),
            &[&response, "2 to 1 m"],
        ),
        (
            "other-schema",
            other_schema,
            &["/volume", "\"scand.Trigger\""],
        ),
    ]);
}

#[test]
fn one_capture_of_two_fails_alone() {
    let mut messages = bowl();
    let image = messages.of_mut(C01).nth(1).unwrap();
    let mut content: RawImage = prost::Message::decode(&image.data[..]).unwrap();
    content.data.truncate(100);
    image.data = prost::Message::encode_to_vec(&content);
    let ended = replay_whole("one-of-two", &messages);
    assert_eq!(ended.code, 3, "{}", ended.stderr);
    ended.says(&[C01, "100 bytes, expected 76800"]);
    let failed = ended.report("bowl-001");
    assert_eq!(failed["outcome"], "failed");
    assert!(failed["reason"].as_str().unwrap().contains(C01), "{failed}");
    assert_eq!(ended.report("bowl-000")["outcome"], "done");
}

#[test]
fn a_trigger_without_frames_fails_alone() {
    let mut messages = one_bowl();
    let mut trigger = messages.of("/trigger").next().unwrap().clone();
    trigger.log_time += 60_000_000_000;
    trigger.data = br#"{"id": "again", "source": "pedal"}"#.to_vec();
    messages.0.push(trigger);
    let ended = replay_whole("no-frames", &messages);
    assert_eq!(ended.code, 3, "{}", ended.stderr);
    ended.says(&["again", "camera c00 gave no frame"]);
    assert_eq!(ended.report("again")["outcome"], "failed");
    assert_eq!(ended.report("bowl-000")["outcome"], "done");
}

#[test]
fn depth_that_is_missing_or_zero_gives_the_hull() {
    let depth = one_bowl().depth_camera();
    let image = format!("/depth/{depth}/image");
    let zero = one_bowl().with(&image, |i: &mut RawImage| {
        i.data = vec![0; i.data.len()].into();
    });
    for (name, messages) in [
        ("no-depth", one_bowl().without("/depth")),
        ("zero-depth", zero),
    ] {
        let ended = replay_whole(name, &messages);
        assert_eq!(ended.code, 0, "{}", ended.stderr);
        let report = ended.report("bowl-000");
        let reasons = report["verdict"]["reasons"].to_string();
        assert!(reasons.contains("depth"), "{name}: {reasons}");
    }
}

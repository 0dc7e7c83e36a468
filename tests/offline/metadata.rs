//! What is known of an object arrives where its model arrives: in the GLB, in the PLY, and on the terminal.

use super::desk::Desk;
use serde_json::Value;

/// All that a session can say of its object.
const SAID: [(&str, &str); 7] = [
    ("name", "monday"),
    ("subject", "1884.3"),
    ("title", "A krater with dancers"),
    ("operator", "Ann Example"),
    ("project", "Loans of 2026"),
    ("rights", "CC BY 4.0, Museum of Examples"),
    ("rig", "rig-2"),
];

/// The lines of a PLY's header.
fn ply_header(bytes: &[u8]) -> Vec<String> {
    let end = b"end_header\n";
    let at = bytes.windows(end.len()).position(|part| part == end);
    let text = String::from_utf8(bytes[..at.unwrap()].to_vec()).unwrap();
    text.lines().map(str::to_owned).collect()
}

/// The JSON of a binary glTF, its first chunk.
fn glb_json(bytes: &[u8]) -> Value {
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    assert_eq!(&bytes[16..20], b"JSON");
    serde_json::from_slice(&bytes[20..20 + length]).unwrap()
}

#[test]
fn all_that_is_known_is_in_the_model_and_on_the_terminal() {
    let desk = Desk::new();
    desk.tell("ball.mcap", &SAID);
    desk.done(&[
        "replay",
        "ball.mcap",
        "--capture",
        "ball-000",
        "--set",
        "hull.resolution=40",
        "-q",
    ]);
    let info = desk.done(&["info", "ball.mcap", "--digests"]);
    let digests = info.lines().find_map(|line| {
        let line = line.trim().strip_prefix("ball-000: input ")?;
        line.split_once(", calibration ")
    });
    let (input, calibration) = digests.unwrap_or_else(|| panic!("{info}"));
    assert_eq!([input.len(), calibration.len()], [64, 64]);
    let model = |name: &str| std::fs::read(desk.path("out/ball/ball-000").join(name)).unwrap();
    let (ply, glb) = (
        ply_header(&model("model.ply")),
        glb_json(&model("model.glb")),
    );
    let program = concat!("scand ", env!("CARGO_PKG_VERSION"));
    let of_capture = [
        ("capture", "ball-000"),
        ("time", "2026-01-01T00:00:05.000Z"),
        ("input_sha256", input),
        ("calibration_sha256", calibration),
        ("program", program),
    ];
    // The session's name is what models say as their session.
    let of_session = SAID.map(|(name, text)| match name {
        "name" => ("session", text),
        other => (other, text),
    });
    let extras = &glb["asset"]["extras"];
    for (name, text) in of_session.into_iter().chain(of_capture) {
        let comment = format!("comment {name} {text}");
        assert!(ply.contains(&comment), "{comment}: {ply:#?}");
        assert_eq!(extras[name], text, "{name}: {extras:#}");
    }
    let packet = glb["extensions"]["KHR_xmp_json_ld"]["packets"].to_string();
    for (name, text) in SAID {
        assert!(info.contains(&format!("{name} = {text}")), "{name}: {info}");
        assert!(packet.contains(text), "{name}: {packet}");
    }
    for text in [input, calibration, program, "2026-01-01T00:00:05.000Z"] {
        assert!(packet.contains(text), "{text}: {packet}");
    }
    assert!(
        info.contains("ball-000 of object 1884.3 at 2026-01-01T00:00:05.000Z"),
        "{info}"
    );
}

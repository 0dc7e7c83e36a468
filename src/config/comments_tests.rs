//! Compares the comments on settings with the settings themselves: defaults and ranges in config/replay.toml, and
//! the same lines in the rooms' own parameters.

use super::Config;
use crate::daemon::{
    CaptureParameters, HooksParameters, RecordingParameters, ServiceParameters, SocketParameters,
};
use crate::workers;
use std::path::Path;
use toml::Table;

/// Each section of numbers, and the source of its parameters.
const SECTIONS: [(&str, &str); 8] = [
    ("sync", "crates/core/src/sync/mod.rs"),
    (
        "silhouette",
        "crates/core/src/reconstruct/silhouette/mod.rs",
    ),
    ("hull", "crates/core/src/reconstruct/hull/mod.rs"),
    ("depth", "crates/core/src/reconstruct/depth/mod.rs"),
    ("region", "crates/core/src/reconstruct/region/mod.rs"),
    ("restoration", "crates/core/src/reconstruct/restore/mod.rs"),
    ("texture", "crates/core/src/reconstruct/texture/mod.rs"),
    ("glb", "crates/core/src/output/glb.rs"),
];

/// The same of a calibration, with the name of its parameters.
const CALIBRATION: [(&str, &str, &str); 6] = [
    (
        "fit",
        "crates/core/src/calibration/fit/mod.rs",
        "pub struct Parameters",
    ),
    (
        "limits",
        "crates/core/src/calibration/fit/verdict.rs",
        "pub struct Limits",
    ),
    (
        "wanted",
        "crates/core/src/calibration/fit/coverage.rs",
        "pub struct CoverageLimits",
    ),
    (
        "watch",
        "crates/core/src/calibration/fit/drift.rs",
        "pub struct DriftLimits",
    ),
    (
        "witness",
        "crates/core/src/calibration/fit/scale.rs",
        "pub struct ScaleWitnessLimits",
    ),
    (
        "plane",
        "crates/core/src/calibration/response/plane_view.rs",
        "pub struct PlaneParameters",
    ),
];

fn text(file: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).unwrap()
}

/// The line above that of a setting.
fn line_above<'a>(text: &'a str, setting: &str) -> &'a str {
    let lines: Vec<&str> = text.lines().collect();
    let at = lines
        .iter()
        .position(|line| line.trim().starts_with(setting));
    let at = at.unwrap_or_else(|| panic!("no line begins with {setting:?}"));
    // What reads a setting stands between it and its comment.
    let above = lines[..at].iter().rev();
    above
        .map(|line| line.trim())
        .find(|line| !line.starts_with("#["))
        .unwrap()
}

/// Default and range of a comment such as `Default 4, range 0.001 to 1000.`
fn said(comment: &str) -> Option<[f64; 3]> {
    let said = comment
        .trim_start_matches(['/', '#', ' '])
        .strip_prefix("Default ")?;
    let (default, range) = said.strip_suffix('.')?.split_once(", range ")?;
    let (least, most) = range.split_once(" to ")?;
    Some([default, least, most].map(|number| number.parse().unwrap()))
}

/// Whether a section takes a value.
fn is_read(section: &str, key: &str, value: f64) -> bool {
    // Two have to agree with each other: both are extreme at once.
    let other = match key {
        "depth_frames" => "sync.min_depth_frames=0",
        _ => "sync.depth_frames=1000",
    };
    let settings = [other.to_owned(), format!("{section}.{key}={value}")];
    Config::load(None, &settings).is_ok_and(|config| config.calibration.checked().is_ok())
}

/// Holds a comment's default and range against the value that is shipped and against what is read.
fn check(section: &str, key: &str, shipped: f64, [default, least, most]: [f64; 3]) {
    let name = format!("{section}.{key}");
    assert_eq!(default, shipped, "{name}");
    for bound in [least, most] {
        assert!(is_read(section, key, bound), "{name}={bound} is refused");
    }
    for beyond in [least - 1.0, most + 1.0] {
        assert!(!is_read(section, key, beyond), "{name}={beyond} is read");
        if let Some(words) = refused_in_a_file(section, key, beyond) {
            let is_named = words.contains(key) && words.contains("expected");
            assert!(is_named, "{name}={beyond}: {words}");
        }
    }
}

/// Why a file with a value is refused; `None` where it is read, and only what comes after refuses the value.
fn refused_in_a_file(section: &str, key: &str, value: f64) -> Option<String> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("scand.toml");
    std::fs::write(&file, format!("[{section}]\n{key} = {value}\n")).unwrap();
    let refused = Config::load(Some(&file), &[]).err();
    refused.map(|error| error.to_string())
}

/// The numbers of a section and their values.
fn numbers(section: &Table) -> impl Iterator<Item = (&String, f64)> {
    section.iter().filter_map(|(key, value)| {
        let whole = value.as_integer().map(|whole| whole as f64);
        Some((key, whole.or(value.as_float())?))
    })
}

#[test]
fn a_number_says_its_default_and_its_range_as_they_are_read() {
    let shipped = text("config/replay.toml");
    let defaults: Table = toml::from_str(&shipped).unwrap();
    for (section, source) in SECTIONS {
        let source = text(source);
        let shown = &shipped[shipped.find(&format!("[{section}]\n")).unwrap()..];
        let parameters = &source[source.find("pub struct Parameters").unwrap()..];
        for (key, value) in numbers(defaults[section].as_table().unwrap()) {
            let comment = line_above(shown, &format!("{key} = "));
            let found = said(comment).unwrap_or_else(|| {
                panic!("{section}.{key}: {comment:?}, expected \"Default N, range N to N.\"")
            });
            check(section, key, value, found);
            let refused = refused_in_a_file(section, key, found[2] + 1.0);
            assert!(refused.is_some(), "{section}.{key}");
            let of_source = line_above(parameters, &format!("pub {key}: "));
            assert_eq!(said(of_source), Some(found), "{section}.{key}: {of_source}");
        }
    }
}

#[test]
fn a_number_of_a_calibration_says_them_too() {
    let defaults: Table = toml::from_str(&text("config/calibrate.toml")).unwrap();
    let mut ranges = 0;
    for (section, source, parameters) in CALIBRATION {
        let source = text(source);
        let parameters = &source[source.find(parameters).unwrap()..];
        for (key, value) in numbers(defaults["calibration"][section].as_table().unwrap()) {
            let comment = line_above(parameters, &format!("pub {key}: "));
            assert!(comment.contains("Default "), "{section}.{key}: {comment:?}");
            // Limits that bound each other have no range of their own.
            if let Some(found) = said(comment) {
                check(&format!("calibration.{section}"), key, value, found);
                ranges += 1;
            }
        }
    }
    assert!(ranges >= 20, "{ranges}");
}

/// The words of the whole comment above a line.
fn comment_above<'a>(text: &'a str, begin: &str) -> Vec<&'a str> {
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    let at = lines.iter().position(|line| line.starts_with(begin));
    let at = at.unwrap_or_else(|| panic!("no line begins with {begin:?}"));
    // What reads a setting stands between it and its comment.
    let above = lines[..at].iter().rev();
    let above = above.skip_while(|line| line.starts_with("#["));
    let is_comment = |line: &&&str| line.starts_with("# ") || line.starts_with("/// ");
    let mut comment: Vec<&str> = above.take_while(is_comment).copied().collect();
    comment.reverse();
    let words = comment.into_iter();
    words
        .flat_map(|line| line.split_whitespace().skip(1))
        .collect()
}

/// The defaults of the whole comment above a line, such as `… Default 0.005 and 0.03.`
fn defaults_above(text: &str, begin: &str) -> Vec<f64> {
    let words = comment_above(text, begin).into_iter();
    let after = words.skip_while(|word| *word != "Default").skip(1);
    let numbers =
        after.take_while(|word| *word == "and" || word.starts_with(|c: char| c.is_ascii_digit()));
    numbers
        .filter_map(|word| word.trim_end_matches(['.', ':']).parse().ok())
        .collect()
}

#[test]
fn the_verdicts_limits_say_their_defaults() {
    let shipped = text("config/replay.toml");
    let source = text("crates/core/src/report/verdict/parameters.rs");
    let defaults: Table = toml::from_str(&shipped).unwrap();
    let limits = defaults["verdict"].as_table().unwrap();
    for (name, limits) in limits.iter().filter_map(|(n, l)| Some((n, l.as_table()?))) {
        let sides = ["amber", "red"].into_iter();
        let expected: Vec<f64> = sides
            .filter_map(|side| limits.get(side)?.as_float())
            .collect();
        let shown = defaults_above(&shipped, &format!("[verdict.{name}]"));
        assert_eq!(shown, expected, "config/replay.toml: verdict.{name}");
        let documented = defaults_above(&source, &format!("pub {name}: "));
        assert_eq!(documented, expected, "verdict.{name}");
    }
}

/// The numbers of the rig, of the workers and of the page: their comments say their defaults, and have a range.
#[test]
fn a_number_of_the_rig_says_its_default_and_has_a_range() {
    let daemon = "src/daemon/parameters.rs";
    let shown: Table = toml::from_str(&text("config/page.toml")).unwrap();
    let all = [
        (
            daemon,
            "CaptureParameters",
            of(CaptureParameters::default()),
        ),
        (
            daemon,
            "RecordingParameters",
            of(RecordingParameters::default()),
        ),
        (
            daemon,
            "ServiceParameters",
            of(ServiceParameters::default()),
        ),
        (daemon, "SocketParameters", of(SocketParameters::default())),
        (daemon, "HooksParameters", of(HooksParameters::default())),
        (
            "src/workers/parameters.rs",
            "Parameters",
            of(workers::Parameters::default()),
        ),
        ("src/page/parameters.rs", "Parameters", shown),
    ];
    let mut seen = 0;
    for (source, name, defaults) in all {
        let source = text(source);
        let parameters = &source[source.find(&format!("pub struct {name} ")).unwrap()..];
        for (key, value) in numbers(&defaults) {
            let begin = format!("pub {key}: ");
            assert_eq!(defaults_above(parameters, &begin), [value], "{name}.{key}");
            let words = comment_above(parameters, &begin).join(" ");
            let has_range = words.contains(" to ") || words.contains("0 or more");
            assert!(has_range, "{name}.{key}: {words}");
            seen += 1;
        }
    }
    assert!(seen >= 18, "{seen}");
}

fn of(parameters: impl serde::Serialize) -> Table {
    Table::try_from(parameters).unwrap()
}

//! What comments say of settings, held against what is read: defaults and ranges in config/replay.toml, and the same lines in
//! the rooms' own parameters.

use super::Config;
use std::path::Path;
use toml::Table;

/// Each section of numbers, and the source of its parameters.
const SECTIONS: [(&str, &str); 8] = [
    ("sync", "src/sync/mod.rs"),
    ("silhouette", "src/reconstruct/silhouette/mod.rs"),
    ("hull", "src/reconstruct/hull/mod.rs"),
    ("depth", "src/reconstruct/depth/mod.rs"),
    ("region", "src/reconstruct/region/mod.rs"),
    ("restoration", "src/reconstruct/restore/mod.rs"),
    ("texture", "src/reconstruct/texture/mod.rs"),
    ("glb", "src/output/glb.rs"),
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

fn is_read(section: &str, key: &str, value: f64) -> bool {
    Config::load(None, &[format!("{section}.{key}={value}")]).is_ok()
}

#[test]
fn a_number_says_its_default_and_its_range_as_they_are_read() {
    let shipped = text("config/replay.toml");
    let defaults: Table = toml::from_str(&shipped).unwrap();
    for (section, source) in SECTIONS {
        let (start, source) = (format!("[{section}]\n"), text(source));
        let start = shipped.find(&start).unwrap();
        let shown = &shipped[start..];
        let parameters = &source[source.find("pub struct Parameters").unwrap()..];
        let mut numbers = 0;
        for (key, value) in defaults[section].as_table().unwrap() {
            let whole = value.as_integer().map(|whole| whole as f64);
            let Some(value) = whole.or(value.as_float()) else {
                continue;
            };
            let comment = line_above(shown, &format!("{key} = "));
            let name = format!("{section}.{key}");
            let [default, least, most] = said(comment).unwrap_or_else(|| {
                panic!("{name}: {comment:?}, expected \"Default N, range N to N.\"")
            });
            assert_eq!(default, value, "{name}");
            for bound in [least, most] {
                assert!(is_read(section, key, bound), "{name}={bound} is refused");
            }
            for beyond in [least - 1.0, most + 1.0] {
                assert!(!is_read(section, key, beyond), "{name}={beyond} is read");
            }
            let of_source = line_above(parameters, &format!("pub {key}: "));
            assert_eq!(said(of_source), said(comment), "{name}: {of_source}");
            numbers += 1;
        }
        assert!(numbers > 0, "{section} has no number");
    }
}

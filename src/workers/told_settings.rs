//! The settings of models that clients are told: those that a remake may change, and the limits of the background
//! pictures' age.

use super::remakes;
use serde_json::Value;
use std::collections::BTreeMap;
use toml::Table;

/// When a model has the age of its background pictures as a reason, in hours.
const BACKGROUND_AGE: &str = "verdict.background_age_h";

/// What clients are told of the settings of a reconstruction (TOML), by the settings' names. A limit that no figure
/// reaches is `null`. `hull.resolution` is left out where `hull.cell_size` takes its place.
pub(super) fn told(settings: &str) -> BTreeMap<String, Value> {
    // What is not TOML has no settings that could be told; who makes a model says what is wrong with it.
    let all: Table = toml::from_str(settings).unwrap_or_default();
    let is_used = |key: &str| key != remakes::RESOLUTION || !has_cell_size(&all);
    let keys = remakes::keys().chain([BACKGROUND_AGE]);
    let found = keys.filter(|&key| is_used(key)).filter_map(|key| {
        let value = serde_json::to_value(value_of(&all, key)?);
        Some((key.to_owned(), value.ok()?))
    });
    found.collect()
}

/// Whether the hull's cells have a size of their own.
fn has_cell_size(all: &Table) -> bool {
    let size = value_of(all, remakes::CELL_SIZE).and_then(toml::Value::as_float);
    size.is_some_and(|size| size > 0.0)
}

/// The value of `section.key`.
fn value_of<'a>(all: &'a Table, key: &str) -> Option<&'a toml::Value> {
    let (section, name) = key.split_once('.')?;
    all.get(section)?.get(name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use serde_json::json;

    fn told_of(settings: &[&str]) -> BTreeMap<String, Value> {
        let settings: Vec<String> = settings.iter().map(ToString::to_string).collect();
        let config = Config::load(None, &settings).unwrap();
        told(&config.replay_toml().unwrap())
    }

    #[test]
    fn what_may_be_changed_is_told_as_it_is_configured() {
        let found = told_of(&["silhouette.spill=0.07", "verdict.background_age_h.amber=6"]);
        let expected = json!({ "hull.resolution": 200.0, "hull.fairing": "touch", "silhouette.significance": 4.0,
            "silhouette.darkest_shadow": 0.12, "silhouette.spill": 0.07, "silhouette.smallest_hole_px": 40.0,
            "verdict.background_age_h": { "amber": 6.0 } });
        assert_eq!(json!(found), expected);
    }

    #[test]
    fn a_limit_that_nothing_reaches_is_null() {
        let found = told_of(&[
            "verdict.background_age_h.amber=inf",
            "verdict.background_age_h.red=48",
        ]);
        assert_eq!(found[BACKGROUND_AGE], json!({ "amber": null, "red": 48.0 }));
    }

    #[test]
    fn a_resolution_that_is_not_used_is_not_told() {
        let found = told_of(&["hull.cell_size=0.002"]);
        assert!(!found.contains_key(remakes::RESOLUTION), "{found:?}");
        assert_eq!(found["hull.fairing"], "touch");
    }

    #[test]
    fn of_what_is_not_toml_nothing_is_told() {
        for bad in ["", "# nothing", "[", "hull = 3"] {
            assert!(told(bad).is_empty(), "{bad}");
        }
    }
}

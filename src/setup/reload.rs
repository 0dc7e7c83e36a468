//! Reloads the configuration at SIGHUP: compares it key by key with the one in use, and applies all of it or
//! nothing, so that the copy in a recording is always true.

use super::prepare::ConfigSource;
use crate::clock::Clock;
use crate::config::Config;
use crate::daemon::{ReloadedSettings, ServiceParameters};
use crate::recording::SessionHeader;
use crate::workers::Jobs;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use toml::{Table, Value};

/// Keys and sections that may change while the daemon runs, and the calibration's contents. All others belong to
/// cameras and workers that were started with them.
const MAY_CHANGE: &[&str] = &[
    "capture.largest_skew_ms",
    "capture.patience_ms",
    "capture.retry",
    "depth",
    "glb",
    "hull",
    "recording.keep_free_mb",
    "recording.largest_file_mb",
    "region",
    "restoration",
    "rig.calibration",
    "rig.name",
    "rig.volume",
    "service",
    "silhouette",
    "texture",
    "verdict",
    "vertices",
];

/// What the daemon was started with.
pub struct ReloadableConfig {
    /// Where its configuration is.
    pub source: ConfigSource,
    /// The configuration.
    pub config: Config,
    /// What every recording begins with.
    pub header: SessionHeader,
    /// Where models' settings go.
    pub jobs: Option<Arc<Jobs>>,
    /// Bytes of the disk that models and packing leave to others.
    pub keep_free_bytes: Arc<AtomicU64>,
}

impl ReloadableConfig {
    /// Reads configuration and calibration again.
    ///
    /// # Errors
    /// If they are bad, or something has changed that may not: each key by its name.
    pub fn reload(&self, clock: Clock) -> Result<(ReloadedSettings, ServiceParameters), String> {
        let now = self.source.prepare(clock).map_err(|e| e.to_string())?;
        both_calibrated_or_not(&self.config, &now.config)?;
        let mut fixed = changed(&self.config, &now.config)?;
        fixed.retain(|key| !may_change(key));
        if !fixed.is_empty() {
            let keys = fixed.into_iter().collect::<Vec<_>>().join(", ");
            return Err(format!("{keys}: restart the daemon to change this"));
        }
        same_sizes(&self.header, &now.header)?;
        if let Some(jobs) = &self.jobs {
            let settings = now.config.replay_toml().map_err(|e| e.to_string())?;
            jobs.set_settings(&settings).map_err(|e| e.to_string())?;
        }
        let keep_free_bytes = now.config.recording.keep_free_bytes();
        self.keep_free_bytes
            .store(keep_free_bytes, Ordering::Relaxed);
        let reloaded = ReloadedSettings {
            capture: now.config.capture,
            recording: now.config.recording,
            calibration: now.calibration,
            header: now.header,
            cutting: now.cutting,
        };
        Ok((reloaded, now.config.service))
    }
}

fn may_change(key: &str) -> bool {
    let within = |section: &&&str| {
        key.strip_prefix(**section)
            .is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
    };
    MAY_CHANGE.iter().find(within).is_some()
}

/// Refuses a calibration of a daemon that was started without one, and the reverse: whether models are made is decided
/// at the start. The setting of the workers would differ with it, and be named in its place.
fn both_calibrated_or_not(before: &Config, now: &Config) -> Result<(), String> {
    let is_calibrated = |config: &Config| !config.rig.calibration.as_os_str().is_empty();
    let does = match (is_calibrated(before), is_calibrated(now)) {
        (false, true) => "begin",
        (true, false) => "end",
        _ => return Ok(()),
    };
    Err(format!(
        "rig.calibration: restart the daemon to {does} making models"
    ))
}

/// The keys that differ, in full.
fn changed(before: &Config, now: &Config) -> Result<BTreeSet<String>, String> {
    let table = |config| Table::try_from(config).map_err(|e: toml::ser::Error| e.to_string());
    let mut keys = BTreeSet::new();
    compare("", &table(before)?, &table(now)?, &mut keys);
    Ok(keys)
}

fn compare(within: &str, before: &Table, now: &Table, keys: &mut BTreeSet<String>) {
    let names: BTreeSet<&String> = before.keys().chain(now.keys()).collect();
    for name in names {
        let key = format!("{within}{name}");
        match (before.get(name), now.get(name)) {
            (Some(Value::Table(before)), Some(Value::Table(now))) => {
                compare(&format!("{key}."), before, now, keys);
            }
            (before, now) if before != now => drop(keys.insert(key)),
            _ => {}
        }
    }
}

/// The cameras' pictures must stay as large as memory and links were planned for.
fn same_sizes(before: &SessionHeader, now: &SessionHeader) -> Result<(), String> {
    let sizes = |header: &SessionHeader| {
        let depths = header.depths.iter().map(|d| &d.camera);
        let cameras = header.colors.iter().chain(depths);
        let size = |c: &crate::calibration::Camera| {
            (c.id.clone(), [c.intrinsics.width, c.intrinsics.height])
        };
        cameras.map(size).collect::<Vec<_>>()
    };
    let (before, now) = (sizes(before), sizes(now));
    match before.iter().zip(&now).find(|(b, n)| b != n) {
        None if before.len() == now.len() => Ok(()),
        None => Err(
            "the calibration has other cameras than before: restart the daemon to use it".into(),
        ),
        Some(((id, b), (_, n))) => Err(format!(
            "the calibration of camera {id} is for {}x{} pixels, and the calibration so far is for {}x{}: restart the daemon \
             to use it",
            n[0], n[1], b[0], b[1]
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(settings: &[&str]) -> Config {
        let settings: Vec<String> = settings.iter().map(ToString::to_string).collect();
        Config::load(None, &settings).unwrap()
    }

    #[test]
    fn every_key_that_differs_is_named() {
        let before = config(&["rig.name=a", "aravis.cameras.c00.address=10.0.0.1"]);
        let now = config(&[
            "rig.name=b",
            "aravis.cameras.c00.address=10.0.0.2",
            "sync.window_ms=100",
            "capture.memory_mb=7",
        ]);
        let keys: Vec<String> = changed(&before, &now).unwrap().into_iter().collect();
        let all = [
            "aravis.cameras.c00.address",
            "capture.memory_mb",
            "rig.name",
            "sync.window_ms",
        ];
        assert_eq!(keys, all);
        let fixed: Vec<_> = keys.into_iter().filter(|key| !may_change(key)).collect();
        assert_eq!(fixed, [all[0], all[1], all[3]]);
        assert!(changed(&before, &before).unwrap().is_empty());
    }

    #[test]
    fn a_first_calibration_and_the_loss_of_one_are_named() {
        let without = config(&[]);
        let with = config(&["rig.calibration=a.toml"]);
        let another = config(&["rig.calibration=b.toml"]);
        assert_eq!(both_calibrated_or_not(&without, &without), Ok(()));
        assert_eq!(both_calibrated_or_not(&with, &another), Ok(()));
        for (before, now, does) in [(&without, &with, "begin"), (&with, &without, "end")] {
            let words = format!("rig.calibration: restart the daemon to {does} making models");
            assert_eq!(both_calibrated_or_not(before, now), Err(words));
        }
    }

    #[test]
    fn what_may_change_is_there() {
        let all = Table::try_from(Config::default()).unwrap();
        for key in MAY_CHANGE {
            let mut at = Some(&Value::Table(all.clone())).cloned();
            for part in key.split('.') {
                at = at.and_then(|value| value.get(part).cloned());
            }
            // What is left out by default has no key.
            assert!(at.is_some() || *key == "rig.volume", "{key}");
        }
    }
}

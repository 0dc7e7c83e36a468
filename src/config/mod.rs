//! One TOML file made of each room's own parameters, with single values set over it from the command line.

mod calibration;
mod cameras;
#[cfg(test)]
mod comments_tests;
mod lengths;
mod nan;

pub use calibration::Calibration;
pub use cameras::Cameras;

use crate::daemon::{
    BoxCorners, CaptureParameters, HooksParameters, RecordingParameters, RigParameters,
    ServiceParameters, SocketParameters,
};
use crate::drivers::link::Link;
use crate::drivers::{aravis, openni2, v4l2};
use crate::{output, reconstruct, report, storage, sync, words, workers};
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Everything that can be configured. Each section is its room's `Parameters`; those of a live rig mean nothing to a
/// replay, so that the file that a rig ran with replays its recordings.
#[derive(Clone, Debug, Default, PartialEq, serde::Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Which frames make a capture.
    pub sync: sync::Parameters,
    /// Which model is made.
    pub method: reconstruct::Method,
    /// Vertices to simplify models to; 0 leaves them as they are.
    pub vertices: usize,
    /// Silhouettes.
    pub silhouette: reconstruct::silhouette::Parameters,
    /// The visual hull.
    pub hull: reconstruct::hull::Parameters,
    /// Depth enhancement.
    pub depth: reconstruct::depth::Parameters,
    /// Concave regions.
    pub region: reconstruct::region::Parameters,
    /// Their restoration.
    pub restoration: reconstruct::restore::Parameters,
    /// Its colours.
    pub texture: reconstruct::texture::Parameters,
    /// How far a model can be trusted.
    pub verdict: report::Parameters,
    /// The model as glTF.
    pub glb: output::glb::Parameters,
    /// How the rig is calibrated.
    pub calibration: Calibration,
    /// The live rig.
    pub rig: RigParameters,
    /// How captures are taken.
    pub capture: CaptureParameters,
    /// Where they are kept.
    pub recording: RecordingParameters,
    /// Where the daemon listens.
    pub socket: SocketParameters,
    /// When it is ready.
    pub service: ServiceParameters,
    /// What is run when something happens.
    pub hooks: HooksParameters,
    /// How models are made meanwhile.
    pub workers: workers::Parameters,
    /// Network links that cameras share, by names of one's own.
    pub links: BTreeMap<String, Link>,
    /// GigE Vision cameras.
    pub aravis: Cameras<aravis::Parameters>,
    /// V4L2 cameras.
    pub v4l2: Cameras<v4l2::Parameters>,
    /// Depth cameras.
    pub openni2: Cameras<openni2::Parameters>,
}

/// Why a configuration is refused.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Error {
    /// The file cannot be read.
    #[error("configuration {}: {cause}", path.display())]
    Read {
        path: PathBuf,
        cause: std::io::Error,
    },
    /// The file is not what it should be: the message has the line and the field.
    #[error("configuration {}: {message}", path.display())]
    Parse {
        path: PathBuf,
        /// Line, field and what was expected.
        message: String,
    },
    /// A value set on the command line is not what it should be.
    #[error("--set {setting}: {message}")]
    Setting {
        setting: String,
        /// What is wrong with it.
        message: String,
    },
}

impl Config {
    /// Reads `file`, if there is one, and sets `settings` (`section.key=value`) over it.
    ///
    /// # Errors
    /// If the file cannot be read, it or a setting has an unknown key or a value of the wrong kind, or values
    /// contradict each other.
    pub fn load(file: Option<&Path>, settings: &[String]) -> Result<Self, Error> {
        let mut config = Self::default();
        let defaults = Table::try_from(Self::with_every_length()).map_err(|e| setting("", e))?;
        let mut table = match file {
            Some(path) => read(path, &defaults)?,
            None => Table::new(),
        };
        if file.is_some() {
            config = of_table(&table).map_err(|e| setting("", e))?;
        }
        let file_agrees = config.sync.checked().is_ok();
        for text in settings {
            set(&mut table, text, &defaults)?;
            // Checked one by one, so that the message names the one that is wrong.
            config = of_table(&table)
                .map_err(|e| setting(text, in_sections(text, &e, &defaults).unwrap_or(e)))?;
        }
        config.sync.checked().map_err(|message| match file {
            Some(path) if !file_agrees => Error::Parse {
                path: path.to_owned(),
                message,
            },
            _ => setting(&settings.join(" --set "), message),
        })?;
        Ok(config)
    }

    /// The defaults, and a value for each length that has no default: it shows where lengths with units may stand.
    fn with_every_length() -> Self {
        let corners = BoxCorners {
            min: [0.0; 3],
            max: [0.0; 3],
        };
        Self {
            rig: RigParameters {
                volume: Some(corners),
                ..RigParameters::default()
            },
            ..Self::default()
        }
    }

    /// What a replay takes of it; the live rig's part is as if nothing had been set.
    pub fn of_replay(&self) -> Self {
        let all = self.clone();
        Self {
            sync: all.sync,
            method: all.method,
            vertices: all.vertices,
            silhouette: all.silhouette,
            hull: all.hull,
            depth: all.depth,
            region: all.region,
            restoration: all.restoration,
            texture: all.texture,
            verdict: all.verdict,
            glb: all.glb,
            ..Self::default()
        }
    }

    /// What a replay takes of it, as the text of a file.
    ///
    /// # Errors
    /// If a value has no form in TOML, which none that was read has.
    pub fn replay_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(&self.of_replay())
    }

    /// The parameters of the reconstruction's stages.
    pub fn reconstruction(&self) -> reconstruct::Parameters {
        reconstruct::Parameters {
            method: self.method,
            vertices: self.vertices,
            silhouette: self.silhouette.clone(),
            hull: self.hull.clone(),
            depth: self.depth.clone(),
            region: self.region.clone(),
            restoration: self.restoration.clone(),
            texture: self.texture.clone(),
        }
    }
}

/// A value with an `@` may be an address with a password, under whatever key, and is not quoted.
fn setting(text: &str, error: impl std::fmt::Display) -> Error {
    let message = plain(error.to_string().trim_end());
    let secret = text
        .split_once('=')
        .filter(|(_, value)| value.contains('@'));
    let (setting, message) = match secret {
        Some((key, value)) => {
            let value = value.trim_matches(['"', '\'']);
            (format!("{key}=…"), message.replace(value, "…"))
        }
        None => (text.into(), message),
    };
    Error::Setting { setting, message }
}

/// An error's words without the names that Rust has for numbers, and with the known word that is closest to a wrong
/// one.
pub(crate) fn plain(message: &str) -> String {
    let message = message
        .replace("expected f64", "expected a number")
        .replace("floating point", "the number");
    match closest_name(&message) {
        Some((found, closest)) => {
            format!("there is no {found:?}: did you mean {closest:?}? {message}")
        }
        None => message,
    }
}

/// The key or word that is not known, and the known one that is close to it, of a message that quotes both.
fn closest_name(message: &str) -> Option<(&str, &str)> {
    let begins = ["unknown field", "unknown variant"];
    let is_unknown = begins.iter().any(|begin| message.starts_with(begin));
    let mut quoted = message.split('`').skip(1).step_by(2);
    let found = quoted.next().filter(|_| is_unknown)?;
    Some((found, words::closest(found, quoted)?))
}

/// Of a setting that is not known because its section is missing: the settings that may be meant.
fn in_sections(text: &str, error: &str, defaults: &Table) -> Option<String> {
    let key = text.split_once('=')?.0.trim();
    let is_unknown = error.starts_with(&format!("unknown field `{key}`"));
    let sections = defaults
        .iter()
        .filter(|(_, section)| section.get(key).is_some());
    let places: Vec<String> = sections.map(|(name, _)| format!("{name}.{key}")).collect();
    (is_unknown && !places.is_empty()).then(|| {
        format!(
            "there is no {key:?} outside of a section: did you mean {}?",
            places.join(" or ")
        )
    })
}

/// What a table says. By way of its text, so that what reads a configuration is compiled for texts alone.
fn of_table<T: DeserializeOwned>(table: &Table) -> Result<T, String> {
    let text = toml::to_string(table).map_err(|e| e.to_string())?;
    // The position in that text would mean nothing to the author of another file.
    let read = toml::from_str(&text).map_err(|e| e.message().to_owned())?;
    match nan::first(&text) {
        Some((field, _)) => Err(format!("{field} is nan, expected a number")),
        None => Ok(read),
    }
}

/// Largest configuration file, in bytes.
const LONGEST_FILE: u64 = 1 << 20;

fn read(path: &Path, defaults: &Table) -> Result<Table, Error> {
    let failed = |cause| Error::Read {
        path: path.into(),
        cause,
    };
    let parse = |message: String| Error::Parse {
        path: path.into(),
        message,
    };
    let text = storage::read_text(path, LONGEST_FILE).map_err(failed)?;
    let text = lengths::as_numbers(&text, defaults);
    // Read as the configuration first: only then do messages have line numbers.
    toml::from_str::<Config>(&text).map_err(|e| parse(shown(&e, &text)))?;
    if let Some((field, at)) = nan::first(&text) {
        let line = 1 + text[..at].matches('\n').count();
        return Err(parse(format!(
            "line {line}: {field} is nan, expected a number"
        )));
    }
    toml::from_str(&text).map_err(|e| parse(shown(&e, &text)))
}

/// A parser's message. It quotes the wrong line, except one with an address that may hold a password: logs and support
/// bundles keep the message.
fn shown(error: &toml::de::Error, text: &str) -> String {
    let tip = closest_name(error.message());
    let tip = tip.map_or_else(String::new, |(_, known)| {
        format!("\ndid you mean {known:?}?")
    });
    let quoting = error.to_string();
    let may_hold_secret = |line: &str| line.contains("://") && line.contains('@');
    if !quoting.lines().any(may_hold_secret) {
        return quoting.trim_end().to_owned() + &tip;
    }
    let before = error.span().and_then(|span| text.get(..span.start));
    let line = 1 + before.unwrap_or_default().matches('\n').count();
    format!("line {line}: {}{tip}", error.message())
}

/// Sets `a.b=value`; a value that is not TOML is taken as a string.
fn set(table: &mut Table, text: &str, defaults: &Table) -> Result<(), Error> {
    let bad = |message: &str| setting(text, message);
    let (path, value) = text
        .split_once('=')
        .ok_or_else(|| bad("expected section.key=value"))?;
    let parsed = toml::from_str::<Table>(&format!("value = {value}"));
    let value = parsed
        .ok()
        .and_then(|mut t| t.remove("value"))
        .unwrap_or_else(|| Value::String(value.into()));
    let mut keys: Vec<&str> = path.split('.').map(str::trim).collect();
    let last = keys
        .pop()
        .filter(|k| !k.is_empty())
        .ok_or_else(|| bad("the key is empty"))?;
    let default = keys
        .iter()
        .try_fold(defaults, |section, key| section.get(*key)?.as_table())
        .and_then(|section| section.get(last));
    let name = lengths::Name {
        section: keys.last().copied().unwrap_or_default(),
        key: last,
    };
    let value = lengths::as_number(name, value, default);
    let mut section = table;
    for key in keys {
        let entry = section
            .entry(key)
            .or_insert_with(|| Value::Table(Table::new()));
        section = entry
            .as_table_mut()
            .ok_or_else(|| bad(&format!("{key} is not a section")))?;
    }
    section.insert(last.into(), value);
    Ok(())
}

#[cfg(test)]
mod tests;

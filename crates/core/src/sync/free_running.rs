//! Which colour cameras run freely: all of a rig, none, or a list of names. A configuration has true, false, or the
//! list.

use crate::frame::CameraId;
use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::BTreeSet;
use std::fmt;

/// Colour cameras whose frame nearest to a trigger counts, rather than the first one after it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FreeRunning {
    /// Every one.
    All,
    /// These, which may be none.
    Some(BTreeSet<CameraId>),
}

impl Default for FreeRunning {
    fn default() -> Self {
        Self::Some(BTreeSet::new())
    }
}

impl FreeRunning {
    /// Whether this camera is one of them.
    pub fn contains(&self, camera: &CameraId) -> bool {
        match self {
            Self::All => true,
            Self::Some(cameras) => cameras.contains(camera),
        }
    }
}

impl Serialize for FreeRunning {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::All => serializer.serialize_bool(true),
            Self::Some(cameras) if cameras.is_empty() => serializer.serialize_bool(false),
            Self::Some(cameras) => serializer.collect_seq(cameras.iter().map(CameraId::as_str)),
        }
    }
}

impl<'de> Deserialize<'de> for FreeRunning {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(Reader)
    }
}

struct Reader;

impl<'de> Visitor<'de> for Reader {
    type Value = FreeRunning;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("true for all colour cameras, false for none, or a list of their names")
    }

    fn visit_bool<E: Error>(self, all: bool) -> Result<FreeRunning, E> {
        Ok(match all {
            true => FreeRunning::All,
            false => FreeRunning::default(),
        })
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut names: A) -> Result<FreeRunning, A::Error> {
        let mut cameras = BTreeSet::new();
        while let Some(name) = names.next_element::<String>()? {
            let camera = CameraId::new(&name).map_err(A::Error::custom)?;
            if !cameras.insert(camera) {
                return Err(A::Error::custom(format!("{name} is named twice")));
            }
        }
        Ok(FreeRunning::Some(cameras))
    }
}

#[cfg(test)]
mod tests {
    use crate::sync::Parameters;

    fn read(text: &str) -> Result<Parameters, String> {
        toml::from_str(text).map_err(|e| e.to_string())
    }

    #[test]
    fn it_is_all_none_or_some_and_is_written_as_it_was_read() {
        for text in ["true", "false", "[\"c01\", \"web-2\"]"] {
            let parameters = read(&format!("nearest_color = {text}")).unwrap();
            let written = toml::to_string(&parameters).unwrap();
            assert!(
                written.contains(&format!("nearest_color = {text}\n")),
                "{written}"
            );
            assert_eq!(read(&written).unwrap(), parameters);
        }
        assert_eq!(read("nearest_color = []").unwrap(), Parameters::default());
    }

    #[test]
    fn what_is_none_of_these_is_refused_with_its_line() {
        for (text, expected) in [
            ("3", "true for all colour cameras"),
            ("[\"c1\", \"c1\"]", "c1 is named twice"),
            ("[\"C 1\"]", "C 1"),
            ("[true]", "string"),
        ] {
            let error = read(&format!("window_ms = 1\nnearest_color = {text}")).unwrap_err();
            assert!(
                error.contains("line 2") && error.contains(expected),
                "{error}"
            );
        }
    }
}

//! The sections of a driver's cameras: the defaults that they share, and what each camera sets over them. A camera
//! with a wrong setting is named before any camera is opened.

use super::of_table;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use toml::{Table, Value};

/// The cameras of one driver.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct Cameras<P: Default> {
    /// What all of them have.
    pub defaults: P,
    /// The settings of each camera, which add to the defaults or override them; by the cameras' ids.
    pub cameras: BTreeMap<String, P>,
}

impl<P: Default> Default for Cameras<P> {
    fn default() -> Self {
        Self {
            defaults: P::default(),
            cameras: BTreeMap::new(),
        }
    }
}

impl<P: Default + Serialize + DeserializeOwned> Cameras<P> {
    /// Each camera with what it shares put in.
    ///
    /// # Errors
    /// If what comes out cannot be read: it names the camera and the field.
    pub fn each(&self) -> Result<BTreeMap<String, P>, String> {
        let defaults = table(&self.defaults)?;
        let one = |(id, own): (&String, &P)| {
            let mut all = defaults.clone();
            lay_over(&mut all, table(own)?);
            let merged = of_table(&all).map_err(|e| format!("camera {id}: {e}"))?;
            Ok((id.clone(), merged))
        };
        self.cameras.iter().map(one).collect()
    }
}

/// What is set of it; what is not set has no key.
fn table<P: Serialize>(parameters: &P) -> Result<Table, String> {
    let text = toml::to_string(parameters).map_err(|e| e.to_string())?;
    toml::from_str(&text).map_err(|e| e.to_string())
}

fn lay_over(below: &mut Table, above: Table) {
    for (key, value) in above {
        match (below.get_mut(&key), value) {
            (Some(Value::Table(below)), Value::Table(above)) => lay_over(below, above),
            (_, value) => drop(below.insert(key, value)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(serde::Deserialize, serde::Serialize, Clone, Debug, Default, PartialEq)]
    #[serde(deny_unknown_fields, default)]
    struct Set {
        address: Option<String>,
        exposure: Option<f64>,
        features: Option<BTreeMap<String, i64>>,
    }

    #[test]
    fn a_camera_has_what_all_have_and_its_own_over_it() {
        let text = "[defaults]\nexposure = 0.01\nfeatures = { a = 1, b = 2 }\n\
                    [cameras.c00]\naddress = 'x'\n[cameras.c01]\nexposure = 0.02\nfeatures = { b = 3 }\n";
        let cameras: Cameras<Set> = toml::from_str(text).unwrap();
        let each = cameras.each().unwrap();
        assert_eq!(each["c00"].exposure, Some(0.01));
        assert_eq!(each["c00"].address.as_deref(), Some("x"));
        assert_eq!(each["c01"].exposure, Some(0.02));
        let features = each["c01"].features.as_ref().unwrap();
        assert_eq!((features["a"], features["b"]), (1, 3));
    }
}

//! A camera's features by name: writes them, reads them back, and fails with the camera's own answer if they differ.
//! Knows no feature's meaning.

use super::parameters::FeatureValue;
use crate::drivers::live::Fault;
use aravis::prelude::*;
use aravis::{Camera, DeviceError};

/// How many pixels a camera joins in each direction.
pub(super) const BINNING: [&str; 2] = ["BinningHorizontal", "BinningVertical"];

/// Sets features of one camera, and keeps what was asked and found.
pub(super) struct Features<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// Each feature that was set: its name, what was asked, what was read back.
    pub table: Vec<[String; 3]>,
}

/// The camera's answer as a fault: away if it gave none.
pub(super) fn fault(field: &str, asked: &str, error: &aravis::glib::Error) -> Fault {
    if no_answer(error) {
        return Fault::Away(format!(
            "the camera did not answer when {field} was asked for: {}",
            error.message()
        ));
    }
    Fault::Refused {
        field: field.into(),
        asked: asked.into(),
        found: error.message().into(),
    }
}

/// Whether an error says that the camera is not there.
pub(super) fn no_answer(error: &aravis::glib::Error) -> bool {
    let kind = error.kind::<DeviceError>();
    matches!(
        kind,
        Some(DeviceError::Timeout | DeviceError::NotConnected | DeviceError::NotFound)
    )
}

impl<'a> Features<'a> {
    /// Nothing set yet.
    pub(super) fn of(camera: &'a Camera) -> Self {
        Self {
            camera,
            table: Vec::new(),
        }
    }

    /// Whether the camera has a feature, and it can be used now.
    pub(super) fn has(&self, name: &str) -> bool {
        self.camera.is_feature_available(name).unwrap_or(false)
    }

    /// The first of several names that the camera has.
    pub(super) fn first_of(&self, names: &[&'static str]) -> Option<&'static str> {
        names.iter().copied().find(|name| self.has(name))
    }

    /// The first of several names that the camera has.
    ///
    /// # Errors
    /// If it has none of them.
    pub(super) fn need(
        &self,
        names: &[&'static str],
        asked: impl ToString,
    ) -> Result<&'static str, Fault> {
        self.first_of(names).ok_or_else(|| Fault::Refused {
            field: names.join(" or "),
            asked: asked.to_string(),
            found: "no such feature".into(),
        })
    }

    /// Sets an enumeration, or a text.
    ///
    /// # Errors
    /// For all of these: if the camera declines, or has something else afterwards.
    pub(super) fn text(&mut self, name: &str, asked: &str) -> Result<(), Fault> {
        let written = self.camera.set_string(name, asked);
        written.map_err(|e| fault(name, asked, &e))?;
        let found = self
            .camera
            .string(name)
            .map_err(|e| fault(name, asked, &e))?;
        self.took(name, asked, &found, found == asked)
    }

    /// Sets a whole number, which must be within what the camera says it takes.
    pub(super) fn integer(&mut self, name: &str, asked: i64) -> Result<(), Fault> {
        if let Ok((low, high)) = self.camera.integer_bounds(name) {
            within(name, asked, low, high)?;
        }
        self.integer_unbounded(name, asked)
    }

    /// Sets a whole number and ignores the bounds that the camera reports, because some cameras report wrong ones.
    pub(super) fn integer_unbounded(&mut self, name: &str, asked: i64) -> Result<(), Fault> {
        let words = asked.to_string();
        let written = self.camera.set_integer(name, asked);
        written.map_err(|e| fault(name, &words, &e))?;
        let found = self
            .camera
            .integer(name)
            .map_err(|e| fault(name, &words, &e))?;
        self.took(name, asked, found, found == asked)
    }

    /// Sets a number; cameras round it to their own steps, by `tolerance` at most. Returns what it became.
    pub(super) fn float(&mut self, name: &str, asked: f64, tolerance: f64) -> Result<f64, Fault> {
        if let Ok((low, high)) = self.camera.float_bounds(name) {
            within(name, asked, low, high)?;
        }
        let words = asked.to_string();
        let written = self.camera.set_float(name, asked);
        written.map_err(|e| fault(name, &words, &e))?;
        let found = self
            .camera
            .float(name)
            .map_err(|e| fault(name, &words, &e))?;
        self.took(name, asked, found, (found - asked).abs() <= tolerance)?;
        Ok(found)
    }

    /// Sets a yes or no.
    pub(super) fn boolean(&mut self, name: &str, asked: bool) -> Result<(), Fault> {
        let words = asked.to_string();
        let written = self.camera.set_boolean(name, asked);
        written.map_err(|e| fault(name, &words, &e))?;
        let found = self
            .camera
            .boolean(name)
            .map_err(|e| fault(name, &words, &e))?;
        self.took(name, asked, found, found == asked)
    }

    /// Sets a feature that only the configuration knows.
    pub(super) fn value(&mut self, name: &str, asked: &FeatureValue) -> Result<(), Fault> {
        if !self.has(name) {
            return Err(Fault::Refused {
                field: name.into(),
                asked: format!("{asked:?}"),
                found: "no such feature".into(),
            });
        }
        match asked {
            FeatureValue::Boolean(asked) => self.boolean(name, *asked),
            // A whole number may be meant for a feature that takes any.
            FeatureValue::Integer(asked) if self.camera.integer(name).is_err() => {
                let asked = *asked as f64;
                self.float(name, asked, asked.abs() * 0.01).map(drop)
            }
            FeatureValue::Integer(asked) => self.integer(name, *asked),
            FeatureValue::Float(asked) => self.float(name, *asked, asked.abs() * 0.01).map(drop),
            FeatureValue::Text(asked) => self.text(name, asked),
        }
    }

    /// Notes what became of a setting.
    pub(super) fn took(
        &mut self,
        name: &str,
        asked: impl ToString,
        found: impl ToString,
        is_so: bool,
    ) -> Result<(), Fault> {
        let (asked, found) = (asked.to_string(), found.to_string());
        if !is_so {
            let field = name.into();
            return Err(Fault::Refused {
                field,
                asked,
                found,
            });
        }
        self.table.push([name.into(), asked, found]);
        Ok(())
    }
}

/// Refuses what the camera would not take, with what it would.
fn within<T: PartialOrd + std::fmt::Display>(
    name: &str,
    asked: T,
    low: T,
    high: T,
) -> Result<(), Fault> {
    if low <= asked && asked <= high {
        return Ok(());
    }
    Err(Fault::Refused {
        field: name.into(),
        asked: asked.to_string(),
        found: format!("a range of {low} to {high}"),
    })
}

//! The section of `scand calibrate`: how it fits, and when it is content. Each part is its room's own parameters.

use crate::calibration::fit::{self, Limits, Wanted, Watch};
use crate::calibration::response::PlaneParameters;

/// How a rig is calibrated.
#[derive(Clone, Debug, Default, PartialEq, serde::Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Calibration {
    /// How lenses and poses are fitted.
    pub fit: fit::Parameters,
    /// What the verdict is held against.
    pub limits: Limits,
    /// What a session should have.
    pub wanted: Wanted,
    /// When `--check` takes a camera for one that moved.
    pub watch: Watch,
    /// How depth cameras' responses are fitted to boards.
    pub plane: PlaneParameters,
}

impl Calibration {
    /// Refuses values that contradict each other.
    ///
    /// # Errors
    /// If there is one: its section, field, value, and what was expected.
    pub fn checked(&self) -> Result<(), String> {
        let named = |part: &str| {
            let part = part.to_owned();
            move |words: String| format!("calibration.{part}.{words}")
        };
        self.limits.checked().map_err(named("limits"))?;
        self.wanted.checked().map_err(named("wanted"))
    }
}

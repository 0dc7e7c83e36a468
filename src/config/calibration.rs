//! The section of the configuration for `scand calibrate`: how it fits, and the limits of its verdict. Each part is
//! the `Parameters` of a room.

use crate::calibration::fit::{self, CoverageLimits, DriftLimits, Limits, ScaleWitnessLimits};
use crate::calibration::response::PlaneParameters;

/// How a rig is calibrated.
#[derive(Clone, Debug, Default, PartialEq, serde::Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Calibration {
    /// How lenses and poses are fitted.
    pub fit: fit::Parameters,
    /// The limits of the verdict.
    pub limits: Limits,
    /// What a session should have.
    pub wanted: CoverageLimits,
    /// When `--check` reports that a camera moved.
    pub watch: DriftLimits,
    /// What witnesses of the scale are expected to know.
    pub witness: ScaleWitnessLimits,
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

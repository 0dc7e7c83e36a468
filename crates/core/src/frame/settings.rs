//! A camera's settings, as a driver reads them back and as a recording keeps them. Data only.

use serde::{Deserialize, Serialize};

/// How a camera's colours are encoded.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Transfer {
    /// As on a screen.
    #[default]
    Srgb,
    /// Proportional to light.
    Linear,
}

/// How a camera was set, as read back from it. A recording holds it as a `scand.CameraSettings` message.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct CameraSettings {
    /// How its colours are encoded.
    #[serde(default)]
    pub transfer: Transfer,
    /// Exposure in seconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exposure: Option<f64>,
    /// Gain in decibels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain_db: Option<f64>,
    /// Gains of red, green and blue.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub white_balance: Option<[f64; 3]>,
    /// What starts an exposure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trigger: Option<String>,
}

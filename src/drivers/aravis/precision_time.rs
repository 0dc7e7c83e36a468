//! The network's clock (PTP, IEEE 1588): switches it on in a camera, and watches how the camera follows it. No time
//! is converted here.

use super::features::Features;
use super::parameters::{Parameters, TriggerMode};
use crate::drivers::live::Fault;
use aravis::Camera;
use aravis::prelude::*;

/// The names of a camera's features: standard (SFNC 2) or older.
struct FeatureNames {
    enable: &'static str,
    latch: &'static str,
    status: &'static str,
    offset: &'static str,
}

const NAMES: [FeatureNames; 2] = [
    FeatureNames {
        enable: "PtpEnable",
        latch: "PtpDataSetLatch",
        status: "PtpStatus",
        offset: "PtpOffsetFromMaster",
    },
    FeatureNames {
        enable: "GevIEEE1588",
        latch: "GevIEEE1588DataSetLatch",
        status: "GevIEEE1588Status",
        offset: "GevIEEE1588OffsetFromMaster",
    },
];

/// A camera that follows the network's clock.
pub(super) struct PrecisionTime {
    names: &'static FeatureNames,
    within_ns: u64,
}

impl PrecisionTime {
    /// Switches PTP on or off as configured; `None` if the camera does not use it.
    ///
    /// # Errors
    /// If PTP is asked for and the camera does not have it, or refuses it.
    pub(super) fn set_up(
        features: &mut Features<'_>,
        parameters: &Parameters,
    ) -> Result<Option<Self>, Fault> {
        let wanted = parameters.ptp;
        let wanted = wanted.or((parameters.trigger_mode() == TriggerMode::Action).then_some(true));
        let names = NAMES.iter().find(|names| features.has(names.enable));
        match (wanted, names) {
            (Some(true), None) => Err(Fault::Refused {
                field: "PtpEnable or GevIEEE1588".into(),
                asked: "true".into(),
                found: "no such feature".into(),
            }),
            (Some(wanted), Some(names)) => {
                features.boolean(names.enable, wanted)?;
                let within_ns = parameters.ptp_within_ns.unwrap_or(100_000);
                Ok(wanted.then_some(Self { names, within_ns }))
            }
            _ => Ok(None),
        }
    }

    /// How it stands: `Ok` in words, or `Err` why the clock cannot be trusted.
    pub(super) fn state(&self, camera: &Camera) -> Result<String, String> {
        // Where there is no latch, the values are read as they come.
        let _ = camera.execute_command(self.names.latch);
        let status = camera.string(self.names.status);
        let status = status.map_err(|e| format!("PTP: {}", e.message()))?;
        let offset = camera.integer(self.names.offset).ok();
        let words = match offset {
            Some(offset) => format!("PTP: {status}, {offset} ns from its master"),
            None => format!("PTP: {status}"),
        };
        let near = offset.is_none_or(|o| o.unsigned_abs() <= self.within_ns);
        match status.as_str() {
            "Master" => Ok(words),
            "Slave" if near => Ok(words),
            "Slave" => Err(format!(
                "PTP: the clock is {} ns from its master, expected at most {} ns",
                offset.unwrap_or_default(),
                self.within_ns
            )),
            _ => Err(format!("{words}, expected Slave or Master")),
        }
    }
}

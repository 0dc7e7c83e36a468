//! The configuration of the workers.

use super::FleetAddress;
use crate::range::{count, within};
use std::path::PathBuf;

/// How models are made of captures as they come. With which settings is what the other sections say.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// Models made at the same time, 0 to 16. 0 makes none: `scand --replay` does so later. Default 1.
    #[serde(deserialize_with = "count::<_, _, 0, 16>")]
    pub count: u32,
    /// Models are written to FOLDER/RECORDING/CAPTURE. Default `models` beside the folder of recordings.
    pub folder: PathBuf,
    /// Memory that one may take, in megabytes, 64 to 1000000; also the largest file that it may write. Default 4000.
    #[serde(deserialize_with = "count::<_, _, 64, 1_000_000>")]
    pub memory_mb: u32,
    /// How long one may take, in seconds, 1 to 86400. Default 900.
    #[serde(deserialize_with = "count::<_, _, 1, 86_400>")]
    pub time_limit_s: u32,
    /// Nice value of the processes, 0 to 19: a higher one leaves more processor time to capturing. Default 19.
    #[serde(deserialize_with = "count::<_, _, 0, 19>")]
    pub nice: u32,
    /// Where the server of a fleet is, `nats://HOST` or `tls://HOST`, whose workers make the models; the process
    /// `scand fleet run` offers them. No default: models are made here.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fleet: Option<FleetAddress>,
    /// Whether a model is made here that no worker of the fleet has begun for `fleet_wait_s`. Default false.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub fleet_or_local: bool,
    /// How long a job waits for a worker of the fleet before it is made here, in seconds, 10 to 86400: a worker
    /// says every few seconds that it goes on. Default 60.
    #[serde(deserialize_with = "count::<_, _, 10, 86_400>")]
    #[serde(skip_serializing_if = "is_usual_wait")]
    pub fleet_wait_s: u32,
    /// The share of the fleet's models that are made here again and compared, 0 to 1. Default 0.02.
    #[serde(deserialize_with = "within::<_, _, 0, 1>")]
    #[serde(skip_serializing_if = "is_usual_share")]
    pub recheck: f64,
}

/// How long a job waits unless the configuration says otherwise.
const USUAL_WAIT: u32 = 60;
/// The share of models that is made again unless the configuration says otherwise.
const USUAL_SHARE: f64 = 0.02;

// What is not set is not written: a model's digest has the text of all settings in it.
fn is_usual_wait(seconds: &u32) -> bool {
    *seconds == USUAL_WAIT
}

fn is_usual_share(share: &f64) -> bool {
    *share == USUAL_SHARE
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            count: 1,
            folder: PathBuf::new(),
            memory_mb: 4000,
            time_limit_s: 900,
            nice: 19,
            fleet: None,
            fleet_or_local: false,
            fleet_wait_s: USUAL_WAIT,
            recheck: USUAL_SHARE,
        }
    }
}

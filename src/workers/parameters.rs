//! The configuration of the workers.

use crate::range::count;
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
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            count: 1,
            folder: PathBuf::new(),
            memory_mb: 4000,
            time_limit_s: 900,
            nice: 19,
        }
    }
}

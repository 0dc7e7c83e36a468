//! The arguments that name the rig's configuration, for all commands of a live rig.

use crate::clock::Clock;
use crate::commands::BadConfiguration;
use crate::setup::{ConfigSource, Error, Prepared};
use std::path::PathBuf;

/// The rig's configuration.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct ConfigArgs {
    /// The rig's configuration (TOML).
    #[arg(
        short,
        long,
        value_name = "FILE",
        default_value = "/etc/scand/rig.toml"
    )]
    pub config: PathBuf,
    /// Set one value of the configuration; may be given several times.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

impl ConfigArgs {
    /// Where the configuration is.
    pub(super) fn source(&self) -> ConfigSource {
        ConfigSource {
            config: self.config.clone(),
            set: self.set.clone(),
        }
    }

    /// Reads configuration and calibration and makes a driver for each camera; opens none.
    ///
    /// # Errors
    /// If one of them is bad.
    pub(super) fn prepare(&self, clock: Clock) -> anyhow::Result<Prepared> {
        self.source().prepare(clock).map_err(|error| match error {
            error @ Error::Read { .. } => error.into(),
            error => BadConfiguration(error.into()).into(),
        })
    }
}

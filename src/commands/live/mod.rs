//! Commands that concern a live rig: the daemon itself, and its clients.

#[cfg(feature = "live")]
pub mod check;
pub mod client;
#[cfg(feature = "live")]
mod config_args;
mod decision_word;
#[cfg(feature = "live")]
mod models;
#[cfg(feature = "pedal")]
pub mod pedal;
#[cfg(feature = "live")]
pub mod run;
mod status_table;

//! Commands that concern a live rig: the daemon itself, and those that ask it.

pub mod ask;
#[cfg(feature = "live")]
pub mod check;
#[cfg(feature = "live")]
mod models;
#[cfg(feature = "pedal")]
pub mod pedal;
#[cfg(feature = "live")]
mod prepare;
#[cfg(feature = "live")]
pub mod run;
mod table;

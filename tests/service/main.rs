//! The daemon as a separate program, without cameras: as a service of systemd, and as its operator sees it.

mod daemon;
mod operator;
#[path = "../support/mod.rs"]
mod support;

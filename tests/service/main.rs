//! The daemon as a program of its own, without cameras: as a service of systemd's, and as its operator sees it.

mod daemon;
mod operator;
#[path = "../support/mod.rs"]
mod support;

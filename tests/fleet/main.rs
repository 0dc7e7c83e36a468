//! Models made by other processes through a NATS server of the test's own: the same bytes as here, whatever is killed,
//! stopped or lost meanwhile; what each role is denied at the server; and that nothing secret is where it must not be.

#![allow(clippy::disallowed_methods, reason = "a test's channel ends with it")]

#[path = "../support/mod.rs"]
mod support;

mod archive;
mod clocks;
mod disk;
mod faults;
mod live;
mod lost;
mod operator;
mod roles;
mod simulation;
mod test_bench;
mod wire;

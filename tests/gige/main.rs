//! The GigE Vision driver against cameras that the library's own simulator plays over the real protocol. Each test
//! has its own network.

#![allow(clippy::disallowed_methods, reason = "a test's channel ends with it")]

mod action;
mod binned;
mod description;
mod faults;
mod features;
mod frames;
mod network;
mod stand;
mod stranger;
#[path = "../support/mod.rs"]
mod support;

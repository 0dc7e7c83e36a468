//! Bad input, through the whole command and through the library: each file ends in an error that names what is
//! wrong, nothing panics, memory stays bounded and nothing half-written gets a final name.
//!
//! `SCAND_KEEP_HOSTILE=DIR` keeps the files in a folder, to look at them or to time them by hand.

mod command;
mod contents;
mod damaged;
pub(crate) mod recording;
mod tiny;

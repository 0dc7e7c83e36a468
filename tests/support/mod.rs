//! Code that several test programs share. Only tests use it; code that one program needs stays in that program. The
//! library's own tests include the files that they need by path (`src/lib.rs`).
#![allow(dead_code, reason = "each test program needs some of it")]

pub mod dice;
pub mod program;
pub mod skipped;
pub mod torture;
pub mod wait;

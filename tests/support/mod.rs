//! What several test programs share. Only tests use it; a helper that one program needs stays there. The library's own
//! tests take the files that they need by their paths (`src/lib.rs`).
#![allow(dead_code, reason = "each test program needs some of it")]

pub mod dice;
pub mod program;
pub mod skipped;
pub mod torture;

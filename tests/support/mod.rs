//! What several test programs share. Only tests use it; a helper that one program needs stays there.

pub mod skipped;

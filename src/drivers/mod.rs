//! Where frames come from. A driver opens a source and hands out its frames and triggers; a recording that
//! is played back is one of them.

pub mod replay;

//! Live cameras, each SDK in its own folder, and what all of them share. `capture` replays recordings.

pub mod aravis;
pub mod link;
#[cfg(feature = "live")]
pub mod live;
pub mod openni2;
pub mod pixel_format;
pub mod v4l2;

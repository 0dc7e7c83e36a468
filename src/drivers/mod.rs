//! Where frames come from: recordings that are played back, and live cameras, each SDK in a folder of its own.

pub mod aravis;
#[cfg(feature = "live")]
pub mod live;
pub mod openni2;
pub mod pixel_format;
pub mod replay;
pub mod v4l2;

//! Where frames come from: live cameras, each SDK in a folder of its own. A recording is played back in `job`.

pub mod aravis;
pub mod link;
#[cfg(feature = "live")]
pub mod live;
pub mod openni2;
pub mod pixel_format;
pub mod v4l2;

//! Colour cameras of the kernel's video drivers (V4L2): USB webcams, capture cards, sensors on embedded boards. What
//! can be configured is compiled without the feature, so that every configuration can be checked. No other SDK is named
//! here.

#[cfg(feature = "v4l2")]
mod camera;
#[cfg(feature = "v4l2")]
mod device;
#[cfg(any(feature = "v4l2", test))]
mod frame;
#[cfg(any(feature = "v4l2", test))]
mod jpeg;
mod parameters;
#[cfg(feature = "v4l2")]
mod settings;

#[cfg(feature = "v4l2")]
pub use camera::V4l2Driver;
pub use parameters::{Parameters, TriggerMode, fourcc};

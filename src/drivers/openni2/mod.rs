//! Depth cameras through OpenNI2 (Xtion, Carmine; the Kinect with its driver) and OpenNI's own recordings. Debian's
//! library is called through a small safe layer of our own, which nothing outside this folder uses.

mod parameters;

#[cfg(feature = "openni2")]
mod camera;
#[cfg(feature = "openni2")]
mod clock;
#[cfg(feature = "openni2")]
mod device;
#[cfg(feature = "openni2")]
mod driver;
#[cfg(feature = "openni2")]
mod ffi;
#[cfg(feature = "openni2")]
mod frame_check;
#[cfg(feature = "openni2")]
mod library;
#[cfg(feature = "openni2")]
mod recorder;
#[cfg(feature = "openni2")]
mod settings;
#[cfg(feature = "openni2")]
mod shoot;
#[cfg(feature = "openni2")]
mod stream;

#[cfg(feature = "openni2")]
pub use camera::Camera;
#[cfg(feature = "openni2")]
pub use driver::OpenNi2;
pub use parameters::{Parameters, Unit};
#[cfg(feature = "openni2")]
pub use recorder::Recorder;

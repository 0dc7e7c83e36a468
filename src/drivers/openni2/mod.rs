//! Depth cameras through OpenNI2 (Xtion, Carmine; the Kinect with its driver) and OpenNI's own recordings. Debian's
//! library is called through a small safe layer of our own, which nothing outside this folder uses.

mod parameters;

pub use parameters::{Parameters, Unit};

cfg_if::cfg_if! {
    if #[cfg(feature = "openni2")] {
        mod camera;
        mod clock;
        mod device;
        mod driver;
        mod ffi;
        mod frame_check;
        mod library;
        mod property;
        mod recorder;
        mod settings;
        mod shoot;
        mod stream;

        pub use camera::Camera;
        pub use driver::OpenNi2;
        pub use recorder::Recorder;
    }
}

//! GigE Vision cameras, through Aravis: finds, configures and triggers them, and takes their frames. What can be
//! configured is compiled without the library, so that every configuration can be checked. No other SDK is named here.

mod parameters;

pub use parameters::{
    Activation, ExposureMark, FeatureValue, Parameters, Region, TriggerMode, code, format_of,
};

cfg_if::cfg_if! {
    if #[cfg(feature = "live")] {
        mod action;
        mod gvcp;

        pub use action::{ActionCommand, ActionGroup, attempt_patience, send_action};
        pub use gvcp::{Acknowledgement, Identity, Message, identify};
    }
}

cfg_if::cfg_if! {
    if #[cfg(feature = "aravis")] {
        mod binning;
        mod camera;
        mod clock;
        mod features;
        mod find;
        mod look;
        mod precision_time;
        mod settings;
        mod shoot;
        mod stream;

        pub use camera::GigeDriver;
    }
}

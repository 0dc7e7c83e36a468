//! GigE Vision cameras, through Aravis: finds, configures and triggers them, and takes their frames. What can be
//! configured is compiled without the library, so that every configuration can be checked. No other SDK is named here.

#[cfg(feature = "live")]
mod action;
#[cfg(feature = "aravis")]
mod camera;
#[cfg(feature = "aravis")]
mod clock;
#[cfg(feature = "aravis")]
mod features;
#[cfg(feature = "aravis")]
mod find;
#[cfg(feature = "live")]
mod gvcp;
mod parameters;
#[cfg(feature = "aravis")]
mod precision_time;
#[cfg(feature = "aravis")]
mod settings;
#[cfg(feature = "aravis")]
mod shoot;
#[cfg(feature = "aravis")]
mod stream;

#[cfg(feature = "live")]
pub use action::{ActionCommand, ActionGroup, send_action};
#[cfg(feature = "aravis")]
pub use camera::GigeDriver;
#[cfg(feature = "live")]
pub use gvcp::{Answer, Identity, Message, identify};
pub use parameters::{
    Activation, ExposureMark, FeatureValue, Parameters, Region, TriggerMode, code, format_of,
};

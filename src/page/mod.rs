//! The operator's page: a process of its own that serves a web page, on loopback or with TLS, and is a client of the
//! daemon's socket. It lists and sends the files of models, and stores sessions. It parses no recording and decodes no
//! picture (a confined process does), opens no camera, and writes nothing but its own state and its cache.
//! design/page.md has the reasons.

mod assets;
mod control;
mod daemon;
#[cfg(test)]
mod hostile_tests;
mod http;
mod kept;
mod look;
#[cfg(test)]
mod look_tests;
mod metrics;
mod models;
mod now;
mod objects;
mod origin;
mod parameters;
mod recordings;
mod secrets;
mod serve;
mod sessions;
mod summary;
#[cfg(test)]
mod testing;
mod tls;
#[cfg(test)]
mod tls_tests;
mod views;
mod watch;

pub use assets::embedded;
pub use control::{Answer, ControlRequest, ask};
pub use parameters::{DEFAULT_CONFIGURATION, Error as ParametersError, Parameters};
pub use serve::{Error, run};
pub use sessions::Role;
pub use tls::TlsParameters;

/// What `scand make-view` is asked for.
pub mod make_view {
    pub use super::views::{
        CAMERA, CAPTURE, COMMAND, DIFFERENCE, FORM, LARGEST_SOURCE, PARENT, PHOTOGRAPHS, RECORDING,
        View,
    };
}

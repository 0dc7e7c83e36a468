//! The library and the program without cameras: recordings in, models out. Needs no feature and no system library. One
//! program, for each one links all of scand.

mod calibrate;
mod calibrated_rig;
mod disasters;
mod evaluate;
mod fuzzing;
mod gltf_validator;
mod golden;
mod hostile;
mod reconstruction;
mod recordings;
mod replay;
mod shared_recordings;
mod socket_page;
#[path = "../support/mod.rs"]
mod support;
mod usage;

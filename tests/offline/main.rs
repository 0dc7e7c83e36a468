//! The library and the program without cameras, from recordings to models. It needs no feature and no system
//! library. It is one program, because each program links all of scand.

mod archive;
mod board_shape;
mod calibrate;
mod calibrated_rig;
mod calibration_trial;
mod client;
mod desk;
mod disasters;
mod evaluate;
mod export;
mod free_space;
mod fusion_trial;
mod fuzzing;
mod gltf_validator;
mod golden;
mod hostile;
mod metadata;
mod notes;
mod pasted;
mod picture_files;
mod publish;
mod reconstruction;
mod recordings;
mod replay;
mod shared_recordings;
mod socket_page;
#[path = "../support/mod.rs"]
mod support;
mod transcripts;
mod usage;

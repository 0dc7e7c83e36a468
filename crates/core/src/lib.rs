//! scand without its cameras: recordings, and the models made from them. It opens a recording, assembles its captures,
//! fits and reads calibrations, reconstructs an object by the method of Jang, Park and Lee, "Hybrid optical system for
//! three-dimensional shape acquisition", Applied Optics 52(16), 2013, decides the model's verdict, writes the model,
//! and compares it with a truth.
//!
//! No camera, no command line, no system library, no `unsafe`. ARCHITECTURE.md has the table of the rooms that each
//! room may use.

#![forbid(unsafe_code)]
#![cfg_attr(not(test), warn(unreachable_pub))]
#![cfg_attr(not(test), warn(clippy::unwrap_used))]
#![cfg_attr(
    test,
    allow(clippy::disallowed_methods, reason = "a test's channel ends with it")
)]

pub mod array;
pub mod bag;
pub mod calibrate;
pub mod calibration;
pub mod capture;
pub mod dataset;
pub mod description;
pub mod evaluate;
pub mod export;
pub mod frame;
pub mod gltf_file;
pub mod image;
pub mod level;
pub mod look;
pub mod make_model;
pub mod markup;
pub mod mesh;
pub mod notes;
pub mod output;
pub mod publish;
pub mod queue;
pub mod range;
pub mod reconstruct;
pub mod recording;
pub mod register;
pub mod report;
pub mod statistics;
pub mod storage;
pub mod sync;
pub mod words;

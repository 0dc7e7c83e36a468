//! A rig that is played to the live drivers: their own libraries see cameras, and the cameras show a recording.

mod depth;

pub use depth::{SensorFile, SensorFrames, write_sensor_frames};

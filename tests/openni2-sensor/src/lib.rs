//! A simulated depth camera: a driver that Debian's libOpenNI2 loads as it loads that of a Kinect, and which plays
//! depth and colour from files. `SCAND_OPENNI2_FRAMES` names the files, a sensor each, with `:` between them
//! (`frames.rs` has their format); `SCAND_OPENNI2_CONTROL` names a text file that is read at every frame and can put
//! faults in (`control.rs`). The exported functions stand in `driver.rs`, what they are given and give in `abi.rs`.

mod abi;
mod control;
mod driver;
mod frames;
mod properties;
mod sensor;

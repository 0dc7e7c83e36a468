//! The simulated rig: objects whose form is known, rendered into the pictures and depth readings that real
//! cameras would give of them, with their noise and their faults, so that accuracy is a number.

mod random;
mod shape;

pub use shape::Shape;

//! Calibration sessions in front of the simulated rig: a known board at known placements, seen by cameras whose
//! lenses and poses are known. The rig, its sensors and its recordings are those of the objects.

mod options;
mod paint;
mod placements;
mod plate;
mod record;
mod session;

pub use options::{BoardFaults, BoardOptions, PlacementFault};
pub use placements::Placement;
pub use record::write_board_session;
pub use session::BoardSession;

#[cfg(test)]
mod tests;

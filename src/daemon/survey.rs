//! The rig's cameras, opened once to see how they are, where no daemon holds them.

use super::rig::{Rig, State, Station};
use super::status::{self, CameraStatus};
use crate::clock::Clock;
use crate::drivers::live::Backoff;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Opens all cameras, waits until each has answered that it is ready, at most for so long, and closes them. The cameras
/// by their ids, and how each is.
///
/// # Errors
/// If the system has no thread left.
pub fn survey(
    stations: Vec<Station>,
    clock: Clock,
    patience: Duration,
) -> std::io::Result<BTreeMap<String, CameraStatus>> {
    let mut rig = Rig::start(stations, clock, 64, Backoff::default())?;
    let deadline = Instant::now() + patience;
    while rig
        .states()
        .any(|(.., state)| !matches!(state, State::Ready(_)))
    {
        let message = rig.events().recv_deadline(deadline);
        let Ok(message) = message else { break };
        rig.note(message);
    }
    let cameras = status::cameras(&rig, &BTreeMap::new());
    rig.stop(Instant::now() + Duration::from_secs(5));
    Ok(cameras)
}

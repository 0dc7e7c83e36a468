//! Opens the rig's cameras once and reports their state, for a check while no daemon holds them.

use super::rig::{Rig, RigCamera, State};
use super::status::{self, CameraStatus};
use crate::clock::Clock;
use crate::drivers::live::Backoff;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Opens all cameras, waits at most `patience` until every one is ready, and closes them. Returns each camera's state
/// by its id.
///
/// # Errors
/// If the system cannot start a thread.
pub fn probe(
    rig_cameras: Vec<RigCamera>,
    clock: Clock,
    patience: Duration,
) -> std::io::Result<BTreeMap<String, CameraStatus>> {
    let mut rig = Rig::start(rig_cameras, clock, 64, Backoff::default())?;
    let deadline = clock.now() + patience;
    while rig
        .states()
        .any(|(.., state)| !matches!(state, State::Ready(_)))
    {
        let message = clock.recv_timeout(rig.events(), clock.until(deadline));
        let Ok(message) = message else { break };
        rig.note(message);
    }
    let cameras = status::cameras(&rig, &BTreeMap::new());
    rig.stop(Instant::now() + Duration::from_secs(5));
    Ok(cameras)
}

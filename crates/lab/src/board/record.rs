//! Writes a simulated calibration session as a recording.

use super::super::Error;
use super::BoardSession;
use scand_core::recording::{Compression, Writer};
use std::collections::BTreeMap;
use std::path::Path;

/// Writes the session to a new recording: the board's name, triggers and frames, and in its metadata the options that
/// make it again. It holds no calibration: that is what is to be found.
///
/// # Errors
/// If there is something at `path` already, or it cannot be written.
pub fn write_board_session(
    session: &BoardSession,
    path: &Path,
    compression: Compression,
) -> Result<(), Error> {
    let program = concat!("scand ", env!("CARGO_PKG_VERSION"));
    let mut writer = Writer::create(path, program, compression)?;
    let pairs = [
        ("simulation", serde_json::to_string(session.options())),
        ("boards", serde_json::to_string(session.board_options())),
    ];
    let pairs = pairs.map(|(key, json)| (key.to_owned(), json.unwrap_or_default()));
    writer.metadata("session", &BTreeMap::from(pairs))?;
    writer.board(session.declared_board())?;
    for index in 0..session.placements().len() {
        let capture = session.capture(index)?;
        writer.trigger(&capture.trigger)?;
        for frame in &capture.frames {
            writer.frame(frame)?;
        }
        writer.sync()?;
    }
    Ok(writer.finish()?)
}

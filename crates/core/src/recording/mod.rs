//! The recording format: one MCAP file with a session of captures and everything that a replay needs. This is the
//! only room that names MCAP and the Foxglove messages; others see frames, calibrations and topics.

mod chunk;
mod container;
mod copied;
mod error;
mod extract;
mod index;
pub mod interrupted;
mod json;
mod notes;
mod packing;
mod proto;
mod reader;
mod records;
mod recovery;
mod repair;
mod rewriting;
mod scan;
mod schemas;
mod session;
mod source;
mod summary;
mod topic;
mod typed;
mod writer;

pub use container::Compression;
pub use copied::recover_copy;
pub use error::{Damage, Error, MessageError};
pub use index::{Attachment, MessageRef};
pub use json::{CameraInCapture, CaptureOutcome, CaptureRecord, Lost, LostParts, Note};
pub use notes::{Notes, WrittenNote, beside, note_beside, noted_recording, notes_to_copy};
pub use packing::{Packed, pack};
pub use proto::Pose;
pub use reader::{ChannelInfo, Recording};
pub use recovery::{Recovered, finished_name, recover, tails, unfinished, unfinished_name};
pub use rewriting::may_be_being_written;
pub use session::{FinishedCapture, RecordingSession, SessionHeader};
pub use topic::{ColorPart, DepthPart, Topic};
pub use writer::Writer;

#[cfg(test)]
mod damage_tests;
#[cfg(test)]
mod packing_tests;
#[cfg(test)]
mod recovery_tests;
#[cfg(test)]
mod schema_tests;
#[cfg(test)]
mod session_tests;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;

//! Collects what a model's files say about the object, from the recording and the program.

use crate::capture::{self, CaptureFacts};
use crate::description::{Description, clean};
use crate::reconstruct::Scene;
use crate::recording::Recording;

/// What is known of a capture that is loaded. The session's pairs `title`, `operator`, `project`, `rights`, `rig` and
/// `subject` are those that files carry; others stay in the recording alone. The trigger's subject comes first.
pub(super) fn describe(recording: &Recording, scene: &Scene, facts: &CaptureFacts) -> Description {
    let pair = |key: &str| recording.session_pair(key).and_then(clean);
    Description {
        capture: facts.id.to_string(),
        subject: facts
            .subject
            .as_deref()
            .and_then(clean)
            .or_else(|| pair("subject")),
        title: pair("title"),
        operator: pair("operator"),
        project: pair("project"),
        rights: pair("rights"),
        session: pair("name"),
        rig: pair("rig"),
        time: facts.time_ns.iso_8601(),
        input_sha256: capture::input_digest(scene),
        calibration_sha256: capture::calibration_digest(scene),
        program: format!("scand {}", env!("CARGO_PKG_VERSION")),
    }
}

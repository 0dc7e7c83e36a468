//! Collects what a model's files say about the object, from the recording and the program.

use crate::capture::{self, CaptureFacts};
use crate::description::{Description, clean};
use crate::reconstruct::Scene;
use crate::recording::Recording;

/// Ids that are listed where not all have room; an id has at most 64 letters.
const MOST_LISTED: usize = 5;

/// What is known of a capture that is loaded. The session's pairs `title`, `operator`, `project`, `rights` and
/// `rig` are those that files carry, and `subject` where the trigger has none; others stay in the recording alone.
pub(super) fn describe(recording: &Recording, scene: &Scene, facts: &CaptureFacts) -> Description {
    let pair = |key: &str| recording.session_pair(key).and_then(clean);
    Description {
        capture: facts.id.to_string(),
        captures: None,
        subject: facts.subject.as_deref().and_then(clean),
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

/// What the digest of a model has of these data. The names are written here, and not taken from the type: renaming one
/// would make every model stale.
pub(super) fn digest_text(about: &Description) -> String {
    let Description {
        capture,
        captures,
        subject,
        title,
        operator,
        project,
        rights,
        session,
        rig,
        time,
        input_sha256,
        calibration_sha256,
        program,
    } = about;
    format!(
        "Description {{ capture: {capture:?}, captures: {captures:?}, subject: {subject:?}, title: {title:?}, \
         operator: {operator:?}, project: {project:?}, rights: {rights:?}, session: {session:?}, rig: {rig:?}, \
         time: {time:?}, input_sha256: {input_sha256:?}, calibration_sha256: {calibration_sha256:?}, \
         program: {program:?} }}"
    )
}

/// The same of a model of several captures: what it says of its input is about all of them, in this order.
pub(super) fn of_several(about: Description, captures: &[(&Scene, &CaptureFacts)]) -> Description {
    if captures.len() < 2 {
        return about;
    }
    let ids = captures.iter().map(|(_, facts)| facts.id.as_str());
    let all = |digest: fn(&Scene) -> String| -> Vec<String> {
        captures.iter().map(|(scene, _)| digest(scene)).collect()
    };
    let inputs = all(capture::input_digest);
    let mut calibrations = all(capture::calibration_digest);
    calibrations.dedup();
    Description {
        captures: Some(listed(&ids.collect::<Vec<_>>())),
        input_sha256: capture::joint_digest(&inputs),
        calibration_sha256: match &calibrations[..] {
            [only] => only.clone(),
            several => capture::joint_digest(several),
        },
        ..about
    }
}

/// The ids in a line; of so many that a text of a model's file has no room for them, the first ones.
fn listed(ids: &[&str]) -> String {
    let whole = ids.join(", ");
    if clean(&whole).as_ref() == Some(&whole) {
        return whole;
    }
    let shown = &ids[..MOST_LISTED.min(ids.len())];
    format!("{} and {} more", shown.join(", "), ids.len() - shown.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Another text makes every model of this version stale.
    #[test]
    fn a_digest_has_the_data_under_fixed_names() {
        let about = Description {
            capture: "a-0001".into(),
            subject: Some("1884.3".into()),
            title: Some("a \"krater\"".into()),
            time: "1970-01-01T00:00:00.000Z".into(),
            input_sha256: "ab".into(),
            calibration_sha256: "cd".into(),
            program: "scand 0.1.0".into(),
            ..Description::default()
        };
        let text = r#"Description { capture: "a-0001", captures: None, subject: Some("1884.3"), title: Some("a \"krater\""), operator: None, project: None, rights: None, session: None, rig: None, time: "1970-01-01T00:00:00.000Z", input_sha256: "ab", calibration_sha256: "cd", program: "scand 0.1.0" }"#;
        assert_eq!(digest_text(&about), text);
    }
}

//! Marks an existing model with the notes on its capture, in its report and on its preview. The model's own files stay
//! as they are, because a note may be taken back.

use super::{Error, report_file};
use crate::notes::{CaptureNote, CaptureNotes};
use crate::output;
use crate::report;
use crate::storage::write_atomically;
use serde::de::{Deserialize, Deserializer, MapAccess, Visitor};
use serde_json::value::RawValue;
use std::fmt;
use std::path::Path;

/// The preview's file in a model's folder.
pub(super) const PREVIEW: &str = "preview.png";
/// The report's member that holds the notes.
const MEMBER: &str = "notes";
/// Pixels of the largest preview.
const MOST_PIXELS: u64 = 40_000_000;

/// Replaces the notes in the report and on the preview in `folder` by these.
///
/// # Errors
/// If there is no report, or a file cannot be read or written.
pub fn mark(folder: &Path, notes: &CaptureNotes) -> Result<(), Error> {
    mark_with(folder, |_| notes.clone())
}

/// Adds notes to those that the report and the preview in `folder` say already.
///
/// # Errors
/// As for [`mark`].
pub fn mark_also(folder: &Path, said: &[CaptureNote]) -> Result<(), Error> {
    mark_with(folder, |before| {
        CaptureNotes::new(before.said.iter().chain(said).cloned().collect())
    })
}

/// The report in `folder` as [`mark`] would leave it, for a copy; `None` if it says already what these notes say.
///
/// # Errors
/// If there is no report, or it cannot be read.
pub fn marked_report(folder: &Path, notes: &CaptureNotes) -> Result<Option<String>, Error> {
    let marked = marked_with(folder, |_| notes.clone())?;
    Ok(marked.map(|(report, _)| report))
}

/// The picture of a preview as [`mark`] would leave it, for a copy.
///
/// # Errors
/// If these bytes are no PNG, or that of too large a picture.
pub fn marked_preview(bytes: &[u8], notes: &CaptureNotes) -> Result<Vec<u8>, Error> {
    let mut sheet = output::decode_png(bytes, MOST_PIXELS)?;
    report::stamp(&mut sheet, notes);
    Ok(output::encode_png(&sheet)?)
}

fn mark_with(
    folder: &Path,
    change: impl FnOnce(&CaptureNotes) -> CaptureNotes,
) -> Result<(), Error> {
    let Some((report, notes)) = marked_with(folder, change)? else {
        return Ok(());
    };
    // A person may keep reports without their pictures.
    if let Ok(bytes) = std::fs::read(folder.join(PREVIEW)) {
        let preview = marked_preview(&bytes, &notes)?;
        write_atomically(&folder.join(PREVIEW), &preview)?;
    }
    // The report last: it tells later calls that there is nothing left to mark.
    write_atomically(&folder.join(report_file::NAME), report.as_bytes())?;
    Ok(())
}

/// The text of the report with changed notes, and these; `None` if nothing changes.
fn marked_with(
    folder: &Path,
    change: impl FnOnce(&CaptureNotes) -> CaptureNotes,
) -> Result<Option<(String, CaptureNotes)>, Error> {
    let text = report_file::text(folder).map_err(Error::Unmarked)?;
    let mut members: Members = serde_json::from_str(&text)?;
    let before: CaptureNotes = members
        .get(MEMBER)
        .map_or(Ok(CaptureNotes::default()), |raw| {
            serde_json::from_str(raw.get())
        })?;
    let after = change(&before);
    if after == before {
        return Ok(None);
    }
    members.put(MEMBER, serde_json::to_string_pretty(&after)?)?;
    Ok(Some((members.text()?, after)))
}

/// The members of a JSON object in their order, each as the text that it was.
struct Members(Vec<(String, Box<RawValue>)>);

impl Members {
    fn get(&self, name: &str) -> Option<&RawValue> {
        let mut members = self.0.iter();
        members
            .find(|(key, _)| key == name)
            .map(|(_, value)| &**value)
    }

    /// Puts a member in the place of the old one, or at the end. Its text is that of a member at the top.
    fn put(&mut self, name: &str, text: String) -> serde_json::Result<()> {
        let indented = text.replace('\n', "\n  ");
        let value = RawValue::from_string(indented)?;
        match self.0.iter_mut().find(|(key, _)| key == name) {
            Some((_, old)) => *old = value,
            None => self.0.push((name.into(), value)),
        }
        Ok(())
    }

    fn text(&self) -> serde_json::Result<String> {
        let member = |(key, value): &(String, Box<RawValue>)| {
            Ok(format!(
                "  {}: {}",
                serde_json::to_string(key)?,
                value.get()
            ))
        };
        let members: serde_json::Result<Vec<String>> = self.0.iter().map(member).collect();
        Ok(format!("{{\n{}\n}}\n", members?.join(",\n")))
    }
}

impl<'de> Deserialize<'de> for Members {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Each;
        impl<'de> Visitor<'de> for Each {
            type Value = Members;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a report")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Members, A::Error> {
                let mut members = Vec::new();
                while let Some(member) = map.next_entry()? {
                    members.push(member);
                }
                Ok(Members(members))
            }
        }
        from.deserialize_map(Each)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Timestamp;
    use crate::image::RgbImage;
    use crate::notes::{Decision, NoteKind};

    fn said(kind: NoteKind, time: u64) -> CaptureNote {
        CaptureNote {
            time_ns: Timestamp(time),
            kind,
            text: "a hand".into(),
            author: None,
        }
    }

    #[test]
    fn a_mark_changes_the_notes_and_nothing_else_and_can_be_taken_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let report = "{\n  \"version\": 1,\n  \"notes\": {\n    \"decision\": null,\n    \"said\": []\n  },\n  \"z\": \
                      {\n    \"b\": 1.0,\n    \"a\": []\n  }\n}\n";
        std::fs::write(path(report_file::NAME), report).unwrap();
        let sheet = RgbImage::filled(1920, 400, [9, 9, 9]);
        std::fs::write(path(PREVIEW), output::encode_png(&sheet).unwrap()).unwrap();
        mark_also(folder.path(), &[said(NoteKind::Reject, 5)]).unwrap();
        mark_also(
            folder.path(),
            &[said(NoteKind::Text, 7), said(NoteKind::Reject, 5)],
        )
        .unwrap();
        let marked = std::fs::read_to_string(path(report_file::NAME)).unwrap();
        let value: serde_json::Value = serde_json::from_str(&marked).unwrap();
        assert_eq!(value["notes"]["decision"], "rejected");
        assert_eq!(value["notes"]["said"].as_array().unwrap().len(), 2);
        assert!(
            marked.ends_with("  \"z\": {\n    \"b\": 1.0,\n    \"a\": []\n  }\n}\n"),
            "{marked}"
        );
        let rejected = std::fs::read(path(PREVIEW)).unwrap();
        let picture = output::decode_png(&rejected, MOST_PIXELS).unwrap();
        assert!(
            picture.pixels().contains(&[222, 50, 60]),
            "the strip is red"
        );
        mark(folder.path(), &CaptureNotes::default()).unwrap();
        assert_eq!(
            std::fs::read_to_string(path(report_file::NAME)).unwrap(),
            report
        );
        let accepted = CaptureNotes::new(vec![said(NoteKind::Accept, 9)]);
        assert_eq!(accepted.decision, Some(Decision::Accepted));
        mark(folder.path(), &accepted).unwrap();
        let picture = std::fs::read(path(PREVIEW)).unwrap();
        let picture = output::decode_png(&picture, MOST_PIXELS).unwrap();
        assert!(
            !picture.pixels().contains(&[222, 50, 60]),
            "what stood there is gone"
        );
        assert!(mark(&path("none"), &accepted).is_err());
    }
}

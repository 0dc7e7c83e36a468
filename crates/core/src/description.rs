//! What a model's files say about the object and about how the model was made. It depends only on the recording and the
//! program. So it does not state when or on which machine the model was made, has no path, and has no note or verdict,
//! which may change. The names follow Dublin Core where that has one; `design/metadata.md` has the mapping. Data only.

use std::collections::BTreeMap;

/// Letters of a text that are kept.
pub(crate) const LONGEST: usize = 400;

/// What is known of a model.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Description {
    /// The capture's id; of a model of several captures, that of the capture whose rig is its frame.
    pub capture: String,
    /// The ids of all captures of a model of several, in the order of their triggers, separated by commas.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub captures: Option<String>,
    /// The object's number.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub subject: Option<String>,
    /// The object's title.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub title: Option<String>,
    /// Who ran the rig.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub operator: Option<String>,
    /// What the captures were taken for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub project: Option<String>,
    /// Who holds which rights, or the licence.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rights: Option<String>,
    /// The session's name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub session: Option<String>,
    /// The rig's name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rig: Option<String>,
    /// When the capture was triggered, in ISO 8601 (UTC).
    pub time: String,
    /// SHA-256 of what the model is made of: pictures, cameras and volume. The same at the rig and in a later replay.
    /// Of a model of several captures, the SHA-256 of their digests in hexadecimal digits, a line each.
    pub input_sha256: String,
    /// SHA-256 of the calibration that was used, of which `input_sha256` is a function too. Of several captures with
    /// different calibrations, the SHA-256 of their digests, as above.
    pub calibration_sha256: String,
    /// Name and version of the program.
    pub program: String,
}

impl Description {
    /// Everything that is known, by name, in a fixed order.
    pub fn pairs(&self) -> Vec<(&'static str, &str)> {
        let known = [
            ("captures", &self.captures),
            ("subject", &self.subject),
            ("title", &self.title),
            ("operator", &self.operator),
            ("project", &self.project),
            ("rights", &self.rights),
            ("session", &self.session),
            ("rig", &self.rig),
        ];
        let known = known
            .into_iter()
            .filter_map(|(name, text)| Some((name, text.as_deref()?)));
        std::iter::once(("capture", self.capture.as_str()))
            .chain(known)
            .chain([
                ("time", self.time.as_str()),
                ("input_sha256", self.input_sha256.as_str()),
                ("calibration_sha256", self.calibration_sha256.as_str()),
                ("program", self.program.as_str()),
            ])
            .collect()
    }

    /// What was written as [`Self::pairs`]. Other names are left out; what is not there stays empty.
    pub fn from_pairs(pairs: &BTreeMap<String, String>) -> Self {
        let known = |name: &str| pairs.get(name).cloned();
        let always = |name: &str| known(name).unwrap_or_default();
        Self {
            capture: always("capture"),
            captures: known("captures"),
            subject: known("subject"),
            title: known("title"),
            operator: known("operator"),
            project: known("project"),
            rights: known("rights"),
            session: known("session"),
            rig: known("rig"),
            time: always("time"),
            input_sha256: always("input_sha256"),
            calibration_sha256: always("calibration_sha256"),
            program: always("program"),
        }
    }

    /// The object in a line: its number and title, or the capture's id if neither is known.
    pub fn heading(&self) -> String {
        let known: Vec<&str> = [&self.subject, &self.title]
            .into_iter()
            .filter_map(|t| t.as_deref())
            .collect();
        match known[..] {
            [] => self.capture.clone(),
            _ => format!("{} ({})", known.join(", "), self.capture),
        }
    }
}

/// Where a vertex of a model comes from: the names by the numbers that files have, each with the words that people are
/// shown. Previews, viewers and published pages share these words; docs/results.md explains them.
pub const PROVENANCES: [(&str, &str); 6] = [
    ("hull", "silhouettes"),
    ("carved", "carved by depth"),
    ("restored", "measured by depth"),
    ("bridged", "interpolated"),
    ("unseen", "a guess"),
    ("table", "on the table"),
];

/// The words for a provenance of this name; `None` of one that is not known.
pub fn provenance_words(name: &str) -> Option<&'static str> {
    let mut known = PROVENANCES.into_iter();
    known.find_map(|(own, words)| (own == name).then_some(words))
}

/// A text of a recording as files for people may carry it: one line, not endless; `None` if nothing is left.
pub fn clean(text: &str) -> Option<String> {
    let letter = |c: char| if c.is_control() { ' ' } else { c };
    let kept: String = text.chars().take(LONGEST).map(letter).collect();
    let kept = kept.trim();
    (!kept.is_empty()).then(|| kept.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_becomes_one_line_that_ends() {
        assert_eq!(
            clean(" krater\nend_header\r\u{1b}[2J "),
            Some("krater end_header  [2J".into())
        );
        assert_eq!(clean("\n \t"), None);
        assert_eq!(
            clean(&"x".repeat(9999)).map(|text| text.len()),
            Some(LONGEST)
        );
    }

    #[test]
    fn the_documentation_has_the_words_for_each_provenance() {
        let page = include_str!("../../../docs/results.md");
        for (number, (name, words)) in PROVENANCES.into_iter().enumerate() {
            let row = format!("\n| {number} | `{name}` | {words} | ");
            assert!(page.contains(&row), "{row}");
            assert_eq!(provenance_words(name), Some(words));
        }
        assert_eq!(provenance_words("of_another_version"), None);
    }

    #[test]
    fn only_what_is_known_is_said() {
        let known = Description {
            capture: "a-0001".into(),
            subject: Some("1884.3".into()),
            time: "1970-01-01T00:00:00.000Z".into(),
            ..Description::default()
        };
        let names: Vec<&str> = known.pairs().into_iter().map(|(name, _)| name).collect();
        assert_eq!(
            names,
            [
                "capture",
                "subject",
                "time",
                "input_sha256",
                "calibration_sha256",
                "program"
            ]
        );
        assert_eq!(known.heading(), "1884.3 (a-0001)");
        let owned = |(name, text): (&str, &str)| (name.to_owned(), text.to_owned());
        let pairs = known.pairs().into_iter().map(owned).collect();
        assert_eq!(Description::from_pairs(&pairs), known);
    }
}

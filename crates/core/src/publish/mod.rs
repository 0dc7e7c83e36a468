//! What a published folder says: pages, IIIF manifests and Voyager scenes, made from the description of a model and
//! from its report. What goes public is decided here. No I/O; the command line reads models and writes the folder.

mod facts;
mod manifest;
mod page;
mod scene;

#[cfg(test)]
mod testing;

pub use facts::{Facts, Reason, Share};
pub use manifest::{Address, collection, manifest};
pub use page::{PageOptions, STYLE, gallery, object_page};
pub use scene::scene;

use crate::description::Description;
use std::collections::BTreeSet;

/// What is published only if it is named.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Extra {
    /// Who ran the rig.
    Operator,
    /// The session's name and the capture's id, which begins with it.
    Session,
    /// What the captures were taken for.
    Project,
    /// The rig's name.
    Rig,
    /// People's notes on the capture, with their authors.
    Notes,
    /// The verdict's reasons in words, which name cameras.
    Reasons,
}

impl Extra {
    /// All of them, in the order in which help names them.
    pub const ALL: [Self; 6] = [
        Self::Operator,
        Self::Session,
        Self::Project,
        Self::Rig,
        Self::Notes,
        Self::Reasons,
    ];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Operator => "operator",
            Self::Session => "session",
            Self::Project => "project",
            Self::Rig => "rig",
            Self::Notes => "notes",
            Self::Reasons => "reasons",
        }
    }
}

/// A file of the model at one level of detail.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LevelFile {
    /// Its name beside the page.
    pub name: String,
    /// Voyager's word for its quality: `High`, `Medium`, `Low` or `Thumb`.
    pub quality: &'static str,
    /// Number of triangles.
    pub triangles: usize,
    /// Size of the file in bytes.
    pub bytes: usize,
}

/// A picture beside the page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Its name beside the page.
    pub name: String,
    /// Width and height in pixels.
    pub size: (usize, usize),
    /// Size of the file in bytes.
    pub bytes: usize,
}

/// A published model: everything that its page, its manifest and its scene say.
#[derive(Clone, Debug)]
pub struct PublishedObject {
    /// The name of its folder, of `a-z`, `0-9` and `-`.
    pub id: String,
    /// What is known of it and may be public ([`public`]).
    pub about: Description,
    /// Figures and verdict.
    pub facts: Facts,
    /// The box around the model in the rig's frame (z up), in metres: lowest and highest corner.
    pub bounds: [[f32; 3]; 2],
    /// The model, most detailed first. Never empty.
    pub levels: Vec<LevelFile>,
    /// A picture of the model.
    pub picture: Picture,
    /// The same, small.
    pub thumbnail: Picture,
}

impl PublishedObject {
    /// The object in words: title and number, or that it has none.
    pub fn heading(&self) -> String {
        let known = [&self.about.title, &self.about.subject];
        let known: Vec<&str> = known.into_iter().filter_map(|t| t.as_deref()).collect();
        match known[..] {
            [] => format!("Object without a number ({})", self.id),
            _ => known.join(", "),
        }
    }

    /// Size of the box around the model in millimetres: width, depth and height.
    pub fn size_mm(&self) -> [f32; 3] {
        let [low, high] = self.bounds;
        [0, 1, 2].map(|axis| (high[axis] - low[axis]) * 1e3)
    }
}

/// The name of a model's folder: its number, as far as an address can hold it, and what tells its capture from
/// others. It depends on the recording alone, so an address stays valid when the folder is made again.
pub fn object_id(about: &Description) -> String {
    let letter = |c: char| match c.to_ascii_lowercase() {
        c if c.is_ascii_alphanumeric() => c,
        _ => '-',
    };
    let number = about.subject.as_deref().unwrap_or("object");
    let number: String = number.chars().take(40).map(letter).collect();
    let words: Vec<&str> = number.split('-').filter(|word| !word.is_empty()).collect();
    let number = match words[..] {
        [] => "object".to_owned(),
        _ => words.join("-"),
    };
    let is_hexadecimal = |c: &char| matches!(c, '0'..='9' | 'a'..='f');
    let digest: String = about
        .input_sha256
        .chars()
        .filter(is_hexadecimal)
        .take(8)
        .collect();
    format!("{number}-{digest}")
}

/// What of a description may be public: what is in `with`, and what names neither a person nor a device. A capture that
/// is not named gets `id` instead.
pub fn public(about: &Description, id: &str, with: &BTreeSet<Extra>) -> Description {
    let named =
        |extra: Extra, text: &Option<String>| text.clone().filter(|_| with.contains(&extra));
    Description {
        capture: match with.contains(&Extra::Session) {
            true => about.capture.clone(),
            false => id.to_owned(),
        },
        captures: named(Extra::Session, &about.captures),
        operator: named(Extra::Operator, &about.operator),
        project: named(Extra::Project, &about.project),
        session: named(Extra::Session, &about.session),
        rig: named(Extra::Rig, &about.rig),
        ..about.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::testing::{HOSTILE, described, object};
    use super::*;

    #[test]
    fn an_address_holds_no_letter_that_leads_elsewhere_and_is_the_same_each_time() {
        for (number, id) in [
            (Some("1884.3"), "1884-3-0123abcd"),
            (Some("../../etc"), "etc-0123abcd"),
            (Some(HOSTILE), "script-alert-1-script-x-0123abcd"),
            (Some("…"), "object-0123abcd"),
            (None, "object-0123abcd"),
        ] {
            let about = Description {
                subject: number.map(str::to_owned),
                ..described()
            };
            assert_eq!(object_id(&about), id);
        }
    }

    #[test]
    fn people_devices_and_sessions_stay_out_unless_they_are_named() {
        let about = described();
        let hidden = ["Ann", "annes-session", "secret project", "rig 4711"];
        let nothing = public(&about, "id", &BTreeSet::new());
        let text = serde_json::to_string(&nothing).unwrap();
        for word in hidden {
            assert!(!text.contains(word), "{word}: {text}");
        }
        assert!(text.contains("1884.3") && text.contains("A cup"), "{text}");
        let all = public(&about, "id", &Extra::ALL.into());
        assert_eq!(all, about);
        for (extra, word) in [
            (Extra::Operator, "Ann"),
            (Extra::Session, "annes-session"),
            (Extra::Project, "secret project"),
            (Extra::Rig, "rig 4711"),
        ] {
            let one = serde_json::to_string(&public(&about, "id", &[extra].into())).unwrap();
            let shown: Vec<&str> = hidden.into_iter().filter(|w| one.contains(w)).collect();
            assert_eq!(shown, [word]);
        }
    }

    #[test]
    fn a_heading_says_what_is_known() {
        let mut object = object();
        assert_eq!(object.heading(), "A cup, 1884.3");
        object.about.title = None;
        object.about.subject = None;
        assert!(object.heading().contains("without a number"));
        let [width, depth, height] = object.size_mm();
        assert!((width - 80.0).abs() < 0.01 && (depth - 60.0).abs() < 0.01);
        assert!((height - 100.0).abs() < 0.01);
    }
}

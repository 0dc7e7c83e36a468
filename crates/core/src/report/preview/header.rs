//! What stands above the panels: the verdict and the object, what people said of the capture, what is known of it, and
//! the verdict's reasons. Its height follows from its words. What people said has its place before all that may take
//! several lines, so that [`stamp`] finds it on a sheet that lies on the disk.

use super::canvas::{EMPTY, INK, PALE, PAPER, fill, letters_in, wrap, write};
use super::{GAP, LINE, MARGIN, Verdict, WIDTH, level_color};
use crate::description::Description;
use crate::image::{RgbImage, text_size};
use crate::level::Level;
use crate::notes::{CaptureNotes, Decision};

/// Reasons that are written out; the report has all.
const REASONS: usize = 8;
/// Lines of a reason.
const REASON_LINES: usize = 3;
/// Height of the badge and the title.
const TITLE: usize = 56;
/// Height of the strip for what people said, below the title.
const STRIP: usize = LINE + 6;
/// Width of a line.
const ROOM: usize = WIDTH - 2 * MARGIN;
/// How far reasons and notes are indented, for the square of their colour.
const INDENT: usize = 24;
/// Room for the model's size, right of the title.
const SIZE_ROOM: usize = 500;

/// The words above the panels, broken into lines.
pub(super) struct Header {
    level: Level,
    title: String,
    size: String,
    about: Vec<String>,
    /// A line's level where it begins a reason.
    reasons: Vec<(Option<Level>, String)>,
}

impl Header {
    pub(super) fn new(verdict: &Verdict, about: &Description, size: String) -> Self {
        let title = about.heading();
        let mut known = about_words(about);
        // A title that is too long for its line, in large letters, stands below it as a whole.
        if title.chars().count() > letters_in(title_room(verdict.level), 3) {
            known = format!("{title}, {known}");
        }
        Self {
            level: verdict.level,
            title,
            size,
            about: wrap(&known, letters_in(ROOM, 2)),
            reasons: reason_lines(verdict),
        }
    }

    /// Height in pixels, with the edge above and the gap below.
    pub(super) fn height(&self) -> usize {
        MARGIN + TITLE + STRIP + (self.about.len() + self.reasons.len()) * LINE + 3 * GAP
    }

    /// Draws it, and tells where the panels begin.
    pub(super) fn draw(&self, sheet: &mut RgbImage) -> usize {
        self.draw_title(sheet);
        let mut top = MARGIN + TITLE + STRIP;
        for line in &self.about {
            write(sheet, (MARGIN, top), 2, PALE, (ROOM, line));
            top += LINE;
        }
        top += GAP;
        for (level, line) in &self.reasons {
            if let Some(level) = level {
                fill(sheet, (MARGIN, top + 1), (12, 12), level_color(*level));
            }
            write(sheet, (MARGIN + INDENT, top), 2, INK, (ROOM - INDENT, line));
            top += LINE;
        }
        top + 2 * GAP
    }

    fn draw_title(&self, sheet: &mut RgbImage) {
        let word = self.level.name().to_uppercase();
        let (wide, high) = text_size(&word, 4);
        fill(
            sheet,
            (MARGIN, MARGIN),
            (wide + 32, 46),
            level_color(self.level),
        );
        let at = (MARGIN + 16, MARGIN + 25 - high / 2);
        write(sheet, at, 4, [255; 3], (wide + 32, &word));
        let room = title_room(self.level);
        let left = WIDTH - MARGIN - SIZE_ROOM - room;
        write(sheet, (left, MARGIN + 12), 3, INK, (room, &self.title));
        let (wide, _) = text_size(&self.size, 2);
        let right = WIDTH - MARGIN - wide.min(WIDTH / 2);
        let words = (WIDTH / 2, self.size.as_str());
        write(sheet, (right, MARGIN + 16), 2, PALE, words);
    }
}

/// Width in pixels that the title has beside the badge of a level.
fn title_room(level: Level) -> usize {
    let (badge, _) = text_size(level.name(), 4);
    WIDTH - 2 * MARGIN - badge - 52 - SIZE_ROOM
}

/// The reasons, broken into lines.
fn reason_lines(verdict: &Verdict) -> Vec<(Option<Level>, String)> {
    let letters = letters_in(ROOM - INDENT, 2);
    let mut lines = Vec::new();
    for reason in verdict.reasons.iter().take(REASONS) {
        let words = wrap(&reason.words, letters).into_iter().take(REASON_LINES);
        for (index, line) in words.enumerate() {
            lines.push(((index == 0).then_some(reason.level), line));
        }
    }
    if verdict.reasons.is_empty() {
        lines.push((Some(Level::Green), "no problem was found".to_owned()));
    }
    if verdict.reasons.len() > REASONS {
        let rest = verdict.reasons.len() - REASONS;
        lines.push((None, format!("and {rest} more: see report.json")));
    }
    lines
}

/// Writes the notes on a capture on its sheet, over earlier ones: the last decision and the last text. A picture that
/// is not a sheet stays as it is.
pub fn stamp(sheet: &mut RgbImage, notes: &CaptureNotes) {
    let top = MARGIN + TITLE;
    if sheet.width() != WIDTH || sheet.height() < top + STRIP {
        return;
    }
    fill(sheet, (MARGIN, top), (ROOM, STRIP), PAPER);
    let color = match notes.decision {
        Some(Decision::Accepted) => level_color(Level::Green),
        Some(Decision::Rejected) => level_color(Level::Red),
        None => EMPTY,
    };
    let lines = notes.lines();
    let newest = usize::from(notes.decision.is_some());
    let decision = lines.first().filter(|_| notes.decision.is_some());
    let text = lines.get(newest..).and_then(<[String]>::last);
    let words: Vec<&str> = [decision, text]
        .into_iter()
        .flatten()
        .map(String::as_str)
        .collect();
    if words.is_empty() {
        return;
    }
    fill(sheet, (MARGIN, top), (12, LINE - 2), color);
    let words = words.join("; ");
    let at = (MARGIN + INDENT, top);
    write(sheet, at, 2, INK, (ROOM - INDENT, &words));
}

/// When, where and by whom the capture was taken, and what the model was made with.
fn about_words(about: &Description) -> String {
    let known = [
        ("captures", &about.captures),
        ("session", &about.session),
        ("project", &about.project),
        ("rig", &about.rig),
        ("operator", &about.operator),
        ("rights", &about.rights),
    ];
    let known = known
        .into_iter()
        .filter_map(|(name, text)| Some(format!("{name} {}", text.as_ref()?)));
    // Their first digits: enough to tell two models apart.
    let digests = [
        ("input", &about.input_sha256),
        ("calibration", &about.calibration_sha256),
    ];
    let digests = digests.map(|(name, digest)| {
        let first = digest.get(..12).unwrap_or(digest);
        format!("{name} {first}")
    });
    let words = std::iter::once(about.time.clone()).chain(known);
    let words = words.chain(digests).chain([about.program.clone()]);
    words.collect::<Vec<String>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Timestamp;
    use crate::notes::{CaptureNote, NoteKind};

    fn green() -> Verdict {
        Verdict {
            level: Level::Green,
            reasons: Vec::new(),
        }
    }

    /// A text of `letters` letters that begins with a name.
    fn long(name: &str, letters: usize) -> String {
        let more = (0..).flat_map(|number| format!(" {name}{number}").chars().collect::<Vec<_>>());
        name.chars().chain(more).take(letters).collect()
    }

    /// Everything that can be known, each text as long as one can be.
    fn everything() -> Description {
        let text = |name: &str| Some(long(name, 400));
        Description {
            capture: "krater-0001".into(),
            captures: text("krater"),
            subject: Some("1884.3".into()),
            title: text("title"),
            operator: text("operator"),
            project: text("project"),
            rights: Some("r".repeat(400)),
            session: text("session"),
            rig: text("rig"),
            time: "2026-01-31T23:59:59.123Z".into(),
            input_sha256: "0123456789abcdef".repeat(4),
            calibration_sha256: "fedcba9876543210".repeat(4),
            program: "scand 0.1.0".into(),
        }
    }

    #[test]
    fn nothing_that_is_known_is_lost() {
        let about = everything();
        let header = Header::new(&green(), &about, "1 x 2 x 3 mm".into());
        assert!(header.about.len() > 10, "{:#?}", header.about);
        let letters = letters_in(ROOM, 2);
        assert!(header.about.iter().all(|l| l.chars().count() <= letters));
        // Where a line ends is no matter.
        let letters_of = |text: &str| text.replace(char::is_whitespace, "");
        let written = letters_of(&header.about.concat());
        for (name, text) in about.pairs() {
            let text = match name {
                "input_sha256" | "calibration_sha256" => &text[..12],
                _ => text,
            };
            assert!(written.contains(&letters_of(text)), "{name}: {text}");
        }
    }

    #[test]
    fn the_header_is_as_high_as_its_lines() {
        let short = Description {
            capture: "krater-0001".into(),
            ..Description::default()
        };
        let heights = [short, everything()].map(|about| {
            let header = Header::new(&green(), &about, String::new());
            let mut sheet = RgbImage::filled(WIDTH, 1200, PAPER);
            let top = header.draw(&mut sheet);
            assert_eq!(top, header.height());
            // The last line of the words is the reason, and below it nothing is written.
            let has_words = |y: usize| sheet.row(y).contains(&INK);
            let last = (0..1200).rev().find(|&y| has_words(y)).unwrap();
            assert!(last < top && last + 2 * GAP + LINE > top, "{last} {top}");
            // Every line of what is known is there.
            for index in 0..header.about.len() {
                let top = MARGIN + TITLE + STRIP + index * LINE;
                assert!((top..top + LINE).any(|y| sheet.row(y).contains(&PALE)));
            }
            top
        });
        assert!(heights[1] > heights[0] + 9 * LINE, "{heights:?}");
    }

    #[test]
    fn a_note_takes_the_place_of_earlier_ones_and_of_nothing_else() {
        let header = Header::new(&green(), &everything(), String::new());
        let mut sheet = RgbImage::filled(WIDTH, header.height(), PAPER);
        header.draw(&mut sheet);
        let before = sheet.clone();
        let said = CaptureNote {
            time_ns: Timestamp(1),
            kind: NoteKind::Reject,
            text: "a hand\nand another".into(),
            author: None,
        };
        stamp(&mut sheet, &CaptureNotes::new(vec![said]));
        let changed: Vec<usize> = (0..sheet.height())
            .filter(|&y| sheet.row(y) != before.row(y))
            .collect();
        let strip = MARGIN + TITLE..MARGIN + TITLE + STRIP;
        assert!(!changed.is_empty() && changed.iter().all(|y| strip.contains(y)));
        stamp(&mut sheet, &CaptureNotes::default());
        assert!(sheet == before, "a note that is gone leaves nothing");
    }
}

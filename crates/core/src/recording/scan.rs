//! Scans the records of a file from front to back, for everything that reads, repairs or packs it. Each record, and
//! each damaged part, is an event with its position; contents are not read here. After damage the scan continues at the
//! next chunk, if the file has a summary that locates it.

use super::records::{self, Malformed, RECORD_HEADER};
use super::source::{Source, Window};
use super::{Damage, Error};
use mcap::MAGIC;
use mcap::records::op;

/// Largest record that is read: a chunk may hold a whole capture of 100 MB.
pub(super) const LARGEST_RECORD: u64 = 256 << 20;
/// Bytes of a footer record and the magic bytes behind it.
const TAIL: u64 = (RECORD_HEADER + 20 + MAGIC.len()) as u64;

/// What is next in a file.
#[derive(Debug)]
pub(super) enum ScanEvent {
    /// A whole record.
    Record(Span),
    /// Bytes that are no record, or an end that is missing.
    Damage(Damage),
}

/// One record of a file: what it is and where its body is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Span {
    pub opcode: u8,
    pub body: u64,
    pub length: u64,
}

impl Span {
    /// Where the record begins.
    pub(super) fn offset(&self) -> u64 {
        self.body - RECORD_HEADER as u64
    }

    /// Where the next one begins.
    pub(super) fn end(&self) -> u64 {
        self.body + self.length
    }
}

/// A file, read up to some record.
pub(super) struct Scan<'a> {
    source: &'a Source,
    window: Window<'a>,
    position: u64,
    stage: Stage,
    is_damaged: bool,
}

#[derive(Clone, Copy, PartialEq)]
enum Stage {
    /// Among the records.
    Records,
    /// Behind the footer.
    Footer,
    /// At the end: whether the file is whole from its first magic bytes to its last.
    Ended(bool),
}

/// Why there is no record at a place, in words.
enum Broken {
    /// The file ends before it does.
    CutOff(String),
    /// Whatever follows.
    Senseless(String),
}

impl<'a> Scan<'a> {
    /// Begins behind the magic bytes.
    pub(super) fn begin(source: &'a Source) -> Result<Self, Error> {
        let mut window = Window::new(source);
        check_magic(source, window.read(0, MAGIC.len())?)?;
        Ok(Self {
            source,
            window,
            position: MAGIC.len() as u64,
            stage: Stage::Records,
            is_damaged: false,
        })
    }

    /// The next event; `None` at the end of the file.
    pub(super) fn next(&mut self) -> Result<Option<ScanEvent>, Error> {
        match self.stage {
            Stage::Ended(_) => Ok(None),
            Stage::Footer => self.behind_footer(),
            Stage::Records if self.position >= self.source.length => Ok(self.without_footer()),
            Stage::Records => match span(self.source, &mut self.window, self.position)? {
                Ok(span) => {
                    self.position = span.end();
                    if span.opcode == op::FOOTER {
                        self.stage = Stage::Footer;
                    }
                    Ok(Some(ScanEvent::Record(span)))
                }
                Err(Broken::CutOff(_)) if self.source.being_written => {
                    self.stage = Stage::Ended(false);
                    Ok(None)
                }
                Err(Broken::CutOff(what) | Broken::Senseless(what)) => {
                    let next = next_chunk(self.source, self.position)?;
                    Ok(Some(self.damage(next.unwrap_or(self.source.length), what)))
                }
            },
        }
    }

    /// Whether the file is whole from its first magic bytes to its last; known at its end.
    pub(super) fn is_complete(&self) -> bool {
        self.stage == Stage::Ended(true)
    }

    /// The first bytes of a record's body: `most` of them, or all.
    pub(super) fn head(&mut self, span: &Span, most: u64) -> Result<&[u8], Error> {
        self.window.read(span.body, most.min(span.length) as usize)
    }

    /// Goes on with the record at `position`.
    pub(super) fn skip_to(&mut self, position: u64) {
        self.position = position;
    }

    fn behind_footer(&mut self) -> Result<Option<ScanEvent>, Error> {
        let is_complete = self.window.read(self.position, MAGIC.len())? == MAGIC;
        self.stage = Stage::Ended(is_complete);
        if !is_complete {
            let what = "the footer is not followed by the magic bytes";
            return Ok(Some(self.damage(self.source.length, what.into())));
        }
        self.position += MAGIC.len() as u64;
        let what = "the recording ends here, and what follows belongs to another file";
        let has_more = self.position < self.source.length;
        Ok(has_more.then(|| self.damage(self.source.length, what.into())))
    }

    fn without_footer(&mut self) -> Option<ScanEvent> {
        self.stage = Stage::Ended(false);
        let is_told = self.is_damaged || self.source.being_written;
        let what = "the file ends without its footer: it was cut off or never finished";
        (!is_told).then(|| self.damage(self.source.length, what.into()))
    }

    /// What is wrong from here to `next`.
    fn damage(&mut self, next: u64, what: String) -> ScanEvent {
        let offset = std::mem::replace(&mut self.position, next);
        self.is_damaged = true;
        ScanEvent::Damage(Damage {
            offset,
            length: next - offset,
            what,
        })
    }
}

fn check_magic(source: &Source, start: &[u8]) -> Result<(), Error> {
    let found = match start {
        start if start == MAGIC => return Ok(()),
        [] => "it is empty".into(),
        start => match kind(start) {
            Some(kind) => format!("it is {kind}"),
            None => format!("it begins with {start:02x?}"),
        },
    };
    Err(Error::NotMcap {
        path: source.path.clone(),
        found,
    })
}

/// What a file is that begins so, as far as that is known.
fn kind(start: &[u8]) -> Option<&'static str> {
    let kinds: [(&[u8], &str); 8] = [
        (b"\x89PNG", "a PNG picture"),
        (b"\xff\xd8\xff", "a JPEG picture"),
        (b"PK\x03\x04", "a ZIP archive"),
        (b"\x1f\x8b", "a gzip archive"),
        (b"\x28\xb5\x2f\xfd", "a Zstandard archive"),
        (b"ply\n", "a PLY model"),
        (b"glTF", "a glTF model"),
        (b"#ROSBAG", "a ROS bag"),
    ];
    let mut kinds = kinds.into_iter();
    kinds
        .find(|(magic, _)| start.starts_with(magic))
        .map(|(_, kind)| kind)
}

/// The record at `position`, or why there is none.
fn span(
    source: &Source,
    window: &mut Window<'_>,
    position: u64,
) -> Result<Result<Span, Broken>, Error> {
    let Ok((opcode, length)) = records::record_header(window.read(position, RECORD_HEADER)?) else {
        let what = "the file is cut off within a record's header";
        return Ok(Err(Broken::CutOff(what.into())));
    };
    let body = position + RECORD_HEADER as u64;
    let left = source.length - body;
    Ok(match () {
        () if opcode == 0 => Err(Broken::Senseless("there is no record of opcode 0".into())),
        () if length > left => Err(Broken::CutOff(format!(
            "the record of opcode {opcode:#04x} says it has {length} bytes, but the file has only \
            {left} left"
        ))),
        () if length > LARGEST_RECORD && opcode != op::ATTACHMENT => {
            Err(Broken::Senseless(format!(
                "the record of opcode {opcode:#04x} has {length} bytes, expected at most \
                {LARGEST_RECORD}"
            )))
        }
        () => Ok(Span {
            opcode,
            body,
            length,
        }),
    })
}

/// Where the next chunk after `position` begins, or else the summary, by the file's own summary; `None` when
/// the file has none that can be read.
fn next_chunk(source: &Source, position: u64) -> Result<Option<u64>, Error> {
    let Some(tail) = source.length.checked_sub(TAIL) else {
        return Ok(None);
    };
    let mut window = Window::new(source);
    let footer = match records::record_header(window.read(tail, RECORD_HEADER)?) {
        Ok((op::FOOTER, 20)) => {
            records::summary_start(window.read(tail + RECORD_HEADER as u64, 20)?)
        }
        _ => Err(Malformed),
    };
    let Some(start) = footer
        .ok()
        .filter(|&start| start > position && start < tail)
    else {
        return Ok(None);
    };
    let mut next = start;
    let mut at = start;
    while at < tail {
        let Ok(found) = span(source, &mut window, at)? else {
            return Ok(None);
        };
        if found.opcode == op::CHUNK_INDEX {
            let body = window.read(found.body, found.length.min(24) as usize)?;
            if let Ok(chunk) = records::chunk_offset(body)
                && chunk > position
            {
                next = next.min(chunk);
            }
        }
        at = found.end();
    }
    Ok(Some(next))
}

//! Walks over the records of a file, reading their heads and skipping the chunks' contents, to learn what is
//! in it and how far it is whole. After a broken record it goes on where the summary, if there is one, says
//! that the next chunk begins.

use super::index::{Attachment, Index, MessageRef};
use super::records::{self, CHUNK_HEADER_AT_MOST, MESSAGE_HEADER, Malformed, RECORD_HEADER};
use super::source::{Source, Window};
use super::{Error, error::shortened};
use mcap::MAGIC;
use mcap::records::op;

/// Largest record that is read: a chunk may hold a whole capture of 100 MB.
pub(super) const LARGEST_RECORD: u64 = 256 << 20;
/// Bytes of a footer record and the magic bytes behind it.
const TAIL: u64 = (RECORD_HEADER + 20 + MAGIC.len()) as u64;

/// One record of the file: what it is and where its body is.
struct Span {
    opcode: u8,
    body: u64,
    length: u64,
}

/// Why there is no record at a place, in words.
enum Broken {
    /// The file ends before it does.
    CutOff(String),
    /// Whatever follows.
    Senseless(String),
}

/// Finds everything that is in the file.
pub(super) fn walk(source: &Source) -> Result<Index, Error> {
    let mut window = Window::new(source);
    check_magic(source, window.read(0, MAGIC.len())?)?;
    let mut index = Index::new(source.length);
    let mut position = MAGIC.len() as u64;
    while position < source.length {
        match span(source, &mut window, position)? {
            Ok(found) => {
                take(&mut index, &mut window, &found)?;
                position = found.body + found.length;
                if found.opcode == op::FOOTER {
                    finish(source, &mut index, &mut window, position)?;
                    return Ok(index);
                }
            }
            Err(Broken::CutOff(_)) if source.being_written => return Ok(index),
            Err(Broken::CutOff(what) | Broken::Senseless(what)) => {
                let next = next_chunk(source, position)?.unwrap_or(source.length);
                index.add_damage(position, next - position, what);
                position = next;
            }
        }
    }
    if index.damage.is_empty() && !source.being_written {
        let what = "the file ends without its footer: it was cut off or never finished";
        index.add_damage(source.length, 0, what);
    }
    Ok(index)
}

fn check_magic(source: &Source, start: &[u8]) -> Result<(), Error> {
    let found = match start {
        start if start == MAGIC => return Ok(()),
        [] => "it is empty".into(),
        start => format!("it begins with {start:02x?}"),
    };
    Err(Error::NotMcap {
        path: source.path.clone(),
        found,
    })
}

/// The record at `position`, or why there is none.
fn span(
    source: &Source,
    window: &mut Window<'_>,
    position: u64,
) -> Result<Result<Span, Broken>, Error> {
    let Ok((opcode, length)) = records::record_header(window.read(position, RECORD_HEADER)?) else {
        let what = "the file is cut off within a record's head";
        return Ok(Err(Broken::CutOff(what.into())));
    };
    let body = position + RECORD_HEADER as u64;
    let left = source.length - body;
    Ok(match () {
        () if opcode == 0 => Err(Broken::Senseless("there is no record of opcode 0".into())),
        () if length > left => Err(Broken::CutOff(format!(
            "the record of opcode {opcode:#04x} says it has {length} bytes, the file has {left} left"
        ))),
        () if length > LARGEST_RECORD && opcode != op::ATTACHMENT => {
            Err(Broken::Senseless(format!(
                "the record of opcode {opcode:#04x} has {length} bytes, at most {LARGEST_RECORD} are read"
            )))
        }
        () => Ok(Span {
            opcode,
            body,
            length,
        }),
    })
}

/// Enters one record into the index.
fn take(index: &mut Index, window: &mut Window<'_>, span: &Span) -> Result<(), Error> {
    let head = match span.opcode {
        op::CHUNK => CHUNK_HEADER_AT_MOST as u64,
        op::MESSAGE => MESSAGE_HEADER as u64,
        op::ATTACHMENT => 64 << 10,
        op::HEADER
        | op::SCHEMA
        | op::CHANNEL
        | op::MESSAGE_INDEX
        | op::METADATA
        | op::STATISTICS => LARGEST_RECORD,
        _ => 0,
    };
    let body = window.read(span.body, head.min(span.length) as usize)?;
    if take_body(index, span, body).is_err() {
        let opcode = span.opcode;
        let what = format!("the record of opcode {opcode:#04x} does not hold what it should");
        index.add_damage(
            span.body - RECORD_HEADER as u64,
            RECORD_HEADER as u64 + span.length,
            what,
        );
    }
    Ok(())
}

fn take_body(index: &mut Index, span: &Span, body: &[u8]) -> Result<(), Malformed> {
    match span.opcode {
        op::HEADER => (index.profile, index.library) = records::header(body)?,
        op::SCHEMA => index.add_schema(records::schema(body)?, span.body),
        op::CHANNEL => index.add_channel(records::channel(body)?, span.body),
        op::CHUNK => index
            .chunks
            .push(records::chunk_header(body, span.body, span.length)?),
        op::MESSAGE => {
            let (channel, log_time) = records::message_header(body)?;
            index.add_message(MessageRef {
                log_time,
                chunk: MessageRef::LOOSE,
                channel,
                offset: span.body - RECORD_HEADER as u64,
            });
        }
        op::MESSAGE_INDEX => take_message_index(index, body)?,
        op::METADATA => index.metadata.push(records::metadata(body)?),
        op::ATTACHMENT => index.attachments.push(attachment(span, body)?),
        op::STATISTICS => index.message_count = Some(records::statistics(body)?),
        _ => {}
    }
    Ok(())
}

/// Enters the messages of the chunk before.
fn take_message_index(index: &mut Index, body: &[u8]) -> Result<(), Malformed> {
    let (channel, entries) = records::message_index(body)?;
    let chunk = index.chunks.last().ok_or(Malformed)?;
    let number = index.chunks.len() as u32 - 1;
    let smallest = (RECORD_HEADER + MESSAGE_HEADER) as u64;
    let fits = |offset: u64| offset.saturating_add(smallest) <= chunk.uncompressed_size;
    if !entries.iter().all(|&(_, offset)| fits(offset)) {
        return Err(Malformed);
    }
    let message = |&(log_time, offset): &(u64, u64)| MessageRef {
        log_time,
        chunk: number,
        channel,
        offset,
    };
    entries
        .iter()
        .map(message)
        .for_each(|m| index.add_message(m));
    Ok(())
}

fn attachment(span: &Span, head: &[u8]) -> Result<Attachment, Malformed> {
    let mut cursor = records::Cursor(head);
    cursor.bytes(16)?;
    Ok(Attachment {
        name: shortened(&cursor.string()?),
        media_type: shortened(&cursor.string()?),
        offset: span.body,
        length: span.length,
    })
}

/// Looks at what follows the footer.
fn finish(
    source: &Source,
    index: &mut Index,
    window: &mut Window<'_>,
    position: u64,
) -> Result<(), Error> {
    index.complete = window.read(position, MAGIC.len())? == MAGIC;
    if !index.complete {
        let left = source.length - position;
        index.add_damage(
            position,
            left,
            "the footer is not followed by the magic bytes",
        );
    }
    Ok(())
}

/// Where the next chunk after `position` begins, or else the summary, by the file's own summary; `None` when
/// the file has none that can be read.
fn next_chunk(source: &Source, position: u64) -> Result<Option<u64>, Error> {
    let Some(tail) = source.length.checked_sub(TAIL) else {
        return Ok(None);
    };
    let mut window = Window::new(source);
    let footer = match records::record_header(window.read(tail, RECORD_HEADER)?) {
        Ok((op::FOOTER, 20)) => records::footer(window.read(tail + RECORD_HEADER as u64, 20)?),
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
            if let Ok(chunk) = records::chunk_index(body)
                && chunk > position
            {
                next = next.min(chunk);
            }
        }
        at = found.body + found.length;
    }
    Ok(Some(next))
}

//! The file that a sensor plays. All numbers are little endian.
//!
//! | bytes | what |
//! | --- | --- |
//! | 8 | `SCANDDP1` |
//! | 32 | serial number, filled up with zeros |
//! | 4 each | width, height, frames in a second, OpenNI's number of the depth format (100: 1 mm, 101: 100 µm), captures
//! |
//! | 4 each, for each capture | depth frames, colour frames |
//! | for each capture | its depth frames (2 bytes a pixel), then its colour frames (3 bytes a pixel, R G B) |
//!
//! A capture is played over and over. Where it has fewer colour frames than depth frames, each is shown for longer.

use std::fs::File;
use std::io::{Error, ErrorKind, Read, Result};
use std::os::unix::fs::FileExt;
use std::path::Path;

/// A file of frames, open.
#[derive(Debug)]
pub struct Frames {
    file: File,
    pub serial: String,
    pub width: u32,
    pub height: u32,
    pub rate: u32,
    pub depth_format: u32,
    captures: Vec<Capture>,
}

#[derive(Debug, Clone, Copy)]
struct Capture {
    offset: u64,
    depth: u32,
    color: u32,
}

impl Frames {
    pub fn open(path: &Path) -> Result<Self> {
        let mut file = File::open(path)?;
        let bad = |what: &str| Error::new(ErrorKind::InvalidData, what.to_owned());
        let mut head = [0; 40];
        file.read_exact(&mut head)?;
        if head[..8] != *b"SCANDDP1" {
            return Err(bad("it does not begin with SCANDDP1"));
        }
        let serial = String::from_utf8_lossy(&head[8..]);
        let serial = serial.trim_end_matches('\0').to_owned();
        let [width, height, rate, depth_format, count] = numbers(&mut file)?;
        if width == 0 || height == 0 || width > 8192 || height > 8192 || rate == 0 {
            return Err(bad("its size or rate makes no sense"));
        }
        if count == 0 || count > 100_000 {
            return Err(bad("it has no captures, or too many"));
        }
        let pixels = u64::from(width) * u64::from(height);
        let mut offset = 60 + 8 * u64::from(count);
        let mut captures = Vec::new();
        for _ in 0..count {
            let [depth, color] = numbers(&mut file)?;
            if depth == 0 {
                return Err(bad("a capture has no depth"));
            }
            captures.push(Capture {
                offset,
                depth,
                color,
            });
            offset += pixels * (2 * u64::from(depth) + 3 * u64::from(color));
        }
        if file.metadata()?.len() < offset {
            return Err(bad("it is cut off"));
        }
        Ok(Self {
            file,
            serial,
            width,
            height,
            rate,
            depth_format,
            captures,
        })
    }

    pub fn has_color(&self) -> bool {
        self.captures.iter().all(|c| c.color > 0)
    }

    /// Fills in the frame that is shown at a step of a capture.
    pub fn read(&self, capture: usize, step: u64, color: bool, into: &mut [u8]) -> Result<()> {
        let capture = self.captures[capture % self.captures.len()];
        let pixels = u64::from(self.width) * u64::from(self.height);
        let depth = u64::from(capture.depth);
        let shown = step % depth;
        let offset = if color {
            let number = shown * u64::from(capture.color) / depth;
            capture.offset + pixels * (2 * depth + 3 * number)
        } else {
            capture.offset + pixels * 2 * shown
        };
        self.file.read_exact_at(into, offset)
    }
}

fn numbers<const N: usize>(file: &mut File) -> Result<[u32; N]> {
    let mut found = [0; N];
    for number in &mut found {
        let mut bytes = [0; 4];
        file.read_exact(&mut bytes)?;
        *number = u32::from_le_bytes(bytes);
    }
    Ok(found)
}

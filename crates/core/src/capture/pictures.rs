//! Reads and decodes a capture's pictures on all cores, chunk by chunk, so that each chunk is unpacked once
//! and little more than the decoded pictures is in memory.

use super::error::Error;
use crate::frame::Picture;
use crate::image::{
    DecodeError, Grid, Mask, RgbImage, encode_linear_as_srgb, grey_from_file, grey_from_raw,
    readings_from_raw, rgb_from_file, rgb_from_raw,
};
use crate::recording::{MessageRef, Recording, Topic};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Decoded backgrounds, by message and by whether they were linear.
pub(super) type Backgrounds = BTreeMap<(MessageRef, bool), Arc<RgbImage>>;

/// What a picture is to become.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Colours, from light that is sRGB-encoded or linear.
    Color { linear: bool },
    /// A silhouette.
    Mask,
    /// Depth readings.
    Readings,
}

impl Kind {
    /// Bytes of a decoded pixel.
    pub(super) fn bytes(self) -> u64 {
        match self {
            Self::Color { .. } => 3,
            Self::Mask => 1,
            Self::Readings => 2,
        }
    }
}

/// A picture to be read.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PictureRequest {
    pub topic: Topic,
    pub message: MessageRef,
    pub kind: Kind,
    /// Width and height it should have.
    pub size: (usize, usize),
}

/// A picture that was read.
pub(super) enum Decoded {
    Color(Arc<RgbImage>),
    Mask(Mask),
    Readings(Grid<u16>),
}

/// Reads all of `wanted`; the results are in its order.
pub(super) fn read_all(
    recording: &Recording,
    wanted: &[PictureRequest],
) -> Result<Vec<Decoded>, Error> {
    let mut order: Vec<usize> = (0..wanted.len()).collect();
    order.sort_by_key(|&i| wanted[i].message.chunk());
    let chunks: Vec<&[usize]> = order
        .chunk_by(|&a, &b| wanted[a].message.chunk() == wanted[b].message.chunk())
        .collect();
    let mut done: Vec<(usize, Result<Decoded, Error>)> = chunks
        .into_par_iter()
        .flat_map(|of_chunk| {
            // The first picture brings its chunk into the recording's cache, where the others find it.
            let fetched = of_chunk.iter().map(|&i| (i, fetch(recording, &wanted[i])));
            let fetched: Vec<_> = fetched.collect();
            fetched.into_par_iter().map(|(i, picture)| {
                let decoded = picture.and_then(|picture| decode(recording, &picture, &wanted[i]));
                (i, decoded)
            })
        })
        .collect();
    done.sort_by_key(|(i, _)| *i);
    done.into_iter().map(|(_, decoded)| decoded).collect()
}

/// The picture, still encoded; it shares its chunk's memory.
fn fetch(recording: &Recording, wanted: &PictureRequest) -> Result<Picture, Error> {
    Ok(recording.picture(&wanted.topic, &wanted.message)?)
}

fn decode(
    recording: &Recording,
    picture: &Picture,
    wanted: &PictureRequest,
) -> Result<Decoded, Error> {
    decoded(picture, wanted).map_err(|problem| Error::Picture {
        path: recording.path().into(),
        topic: wanted.topic.to_string(),
        timestamp: wanted.message.log_time(),
        problem,
    })
}

fn decoded(picture: &Picture, wanted: &PictureRequest) -> Result<Decoded, DecodeError> {
    let size = wanted.size;
    Ok(match wanted.kind {
        Kind::Color { linear } => {
            let mut colors = match picture {
                Picture::Raw { .. } => rgb_from_raw(&picture.into(), size)?,
                Picture::Compressed { format, data } => rgb_from_file(format, data, size)?,
            };
            if linear {
                encode_linear_as_srgb(&mut colors);
            }
            Decoded::Color(Arc::new(colors))
        }
        Kind::Mask => Decoded::Mask(match picture {
            Picture::Raw { .. } => grey_from_raw(&picture.into(), size)?,
            Picture::Compressed { format, data } => grey_from_file(format, data, size)?,
        }),
        Kind::Readings => Decoded::Readings(readings_from_raw(&picture.into(), size)?),
    })
}

//! Lists what a capture needs from its recording, so that all of it can be read at once.

use super::error::Error;
use super::facts::{ColorFacts, DepthFacts, Silhouette};
use super::pictures::{Backgrounds, Decoded, Kind, PictureRequest, read_all};
use super::rig::RigAt;
use crate::calibration::{Camera, DepthCamera};
use crate::frame::{CameraId, Timestamp, Transfer};
use crate::image::{Grid, Mask, RgbImage};
use crate::reconstruct::{ColorView, DepthFrame, DepthView, SilhouetteSource};
use crate::recording::{ColorPart, DepthPart, MessageRef, Recording, Topic};
use crate::sync::{DepthWithColor, TimedFrame};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// The images that a capture needs, each read once; an index stands for each.
#[derive(Default)]
pub(super) struct ImageBatch {
    wanted: Vec<PictureRequest>,
    decoded: Vec<Option<Decoded>>,
    places: BTreeMap<(MessageRef, bool), usize>,
}

impl ImageBatch {
    /// Asks for a picture; one that was asked for before has its place already.
    fn want(&mut self, wanted: PictureRequest) -> usize {
        let key = key(&wanted);
        *self.places.entry(key).or_insert_with(|| {
            self.wanted.push(wanted);
            self.wanted.len() - 1
        })
    }

    /// Holds the pictures against their file: a few bytes can claim a picture of any size.
    pub(super) fn check_size(
        &self,
        recording: &Recording,
        trigger: Timestamp,
    ) -> Result<(), Error> {
        const LITTLE: u64 = 512 << 20;
        let pixels = |w: &PictureRequest| w.size.0 as u64 * w.size.1 as u64;
        let bytes = self.wanted.iter().map(|w| pixels(w) * w.kind.bytes()).sum();
        let most = LITTLE.saturating_add(recording.file_length().saturating_mul(100));
        match self.wanted.iter().max_by_key(|w| pixels(w)) {
            Some(largest) if bytes > most => Err(Error::TooLarge {
                path: recording.path().into(),
                trigger,
                pictures: self.wanted.len(),
                largest: (largest.topic.to_string(), largest.size),
                bytes,
                most,
            }),
            _ => Ok(()),
        }
    }

    /// Reads what is wanted and not among the pictures that are `kept`.
    pub(super) fn fill(&mut self, recording: &Recording, kept: &Backgrounds) -> Result<(), Error> {
        let of_kept = |w: &PictureRequest| kept.get(&key(w)).cloned().map(Decoded::Color);
        self.decoded = self.wanted.iter().map(of_kept).collect();
        let missing: Vec<usize> = (0..self.wanted.len())
            .filter(|&i| self.decoded[i].is_none())
            .collect();
        let wanted: Vec<PictureRequest> = missing.iter().map(|&i| self.wanted[i].clone()).collect();
        for (i, decoded) in missing.into_iter().zip(read_all(recording, &wanted)?) {
            self.decoded[i] = Some(decoded);
        }
        Ok(())
    }

    /// The backgrounds in the batch.
    pub(super) fn backgrounds(&self) -> Backgrounds {
        let both = self.wanted.iter().zip(&self.decoded);
        both.filter_map(|(wanted, decoded)| match (&wanted.topic, decoded) {
            (Topic::Color(_, ColorPart::Background), Some(Decoded::Color(picture))) => {
                Some((key(wanted), picture.clone()))
            }
            _ => None,
        })
        .collect()
    }

    fn color(&self, place: usize) -> Arc<RgbImage> {
        match self.decoded.get(place) {
            Some(Some(Decoded::Color(picture))) => picture.clone(),
            _ => Arc::default(),
        }
    }

    fn take_color(&mut self, place: usize) -> RgbImage {
        match self.decoded.get_mut(place).and_then(Option::take) {
            Some(Decoded::Color(picture)) => Arc::unwrap_or_clone(picture),
            _ => Grid::default(),
        }
    }

    fn take_mask(&mut self, place: usize) -> Mask {
        match self.decoded.get_mut(place).and_then(Option::take) {
            Some(Decoded::Mask(mask)) => mask,
            _ => Grid::default(),
        }
    }

    fn take_readings(&mut self, place: usize) -> Grid<u16> {
        match self.decoded.get_mut(place).and_then(Option::take) {
            Some(Decoded::Readings(readings)) => readings,
            _ => Grid::default(),
        }
    }
}

fn key(wanted: &PictureRequest) -> (MessageRef, bool) {
    (wanted.message, wanted.kind == Kind::Color { linear: true })
}

/// Plans one capture.
pub(super) struct Plan<'a> {
    pub recording: &'a Recording,
    pub rig: &'a RigAt<'a>,
    pub trigger: Timestamp,
    pub batch: &'a mut ImageBatch,
}

/// A colour camera's part.
pub(super) struct ColorPlan {
    camera: Camera,
    image: usize,
    silhouette: usize,
    ignored: Option<usize>,
    facts: ColorFacts,
}

/// A depth camera's part.
pub(super) struct DepthPlan {
    camera: DepthCamera,
    /// Places of the readings and of their colours.
    frames: Vec<(usize, Option<usize>)>,
    facts: DepthFacts,
}

impl Plan<'_> {
    pub(super) fn color(
        &mut self,
        id: &CameraId,
        frame: &TimedFrame<MessageRef>,
    ) -> Result<ColorPlan, Error> {
        let camera = self.rig.color(id)?;
        let size = (camera.intrinsics.width, camera.intrinsics.height);
        let linear = self.rig.settings(id)?.transfer == Transfer::Linear;
        let topic = |part| Topic::Color(id.clone(), part);
        let mut want = |part, message, kind| {
            self.batch.want(PictureRequest {
                topic: topic(part),
                message,
                kind,
                size,
            })
        };
        let image = want(ColorPart::Image, frame.handle, Kind::Color { linear });
        let masks = self
            .recording
            .messages_at(&topic(ColorPart::Mask), frame.timestamp);
        let background = self.rig.newest(&topic(ColorPart::Background));
        let (silhouette, from) = match (masks.last(), background) {
            (Some(mask), _) => {
                let place = want(ColorPart::Mask, *mask, Kind::Mask);
                (place, Silhouette::Mask)
            }
            (None, Some(plate)) => {
                let age_ns = self.trigger.0 - plate.log_time().0;
                let place = want(ColorPart::Background, plate, Kind::Color { linear });
                (place, Silhouette::Background { age_ns })
            }
            (None, None) => {
                return Err(Error::NoSilhouette {
                    path: self.recording.path().into(),
                    camera: id.clone(),
                    timestamp: frame.timestamp,
                });
            }
        };
        let ignored = self
            .recording
            .messages_at(&topic(ColorPart::Ignore), frame.timestamp);
        let ignored = ignored.last().copied();
        let delay = frame.timestamp.nanoseconds_since(self.trigger);
        Ok(ColorPlan {
            ignored: ignored.map(|mask| want(ColorPart::Ignore, mask, Kind::Mask)),
            camera,
            image,
            silhouette,
            facts: ColorFacts {
                camera: id.clone(),
                delay_ns: i64::try_from(delay).unwrap_or(i64::MAX),
                silhouette: from,
            },
        })
    }

    pub(super) fn depth(
        &mut self,
        id: &CameraId,
        takes: &[DepthWithColor<MessageRef>],
    ) -> Result<DepthPlan, Error> {
        let camera = self.rig.depth(id)?;
        let lens = &camera.camera.intrinsics;
        let size = (lens.width, lens.height);
        let mut want = |part, message, kind| {
            self.batch.want(PictureRequest {
                topic: Topic::Depth(id.clone(), part),
                message,
                kind,
                size,
            })
        };
        let linear = Kind::Color { linear: false };
        let frames: Vec<(usize, Option<usize>)> = takes
            .iter()
            .map(|take| {
                let readings = want(DepthPart::Image, take.depth.handle, Kind::Readings);
                let color = take.color.as_ref();
                let color = color.map(|c| want(DepthPart::Color, c.handle, linear));
                (readings, color)
            })
            .collect();
        let colors: BTreeSet<usize> = frames.iter().filter_map(|(_, color)| *color).collect();
        let lag = |take: &DepthWithColor<MessageRef>| {
            let color = take.color.as_ref()?.timestamp;
            Some(take.depth.timestamp.0.abs_diff(color.0))
        };
        Ok(DepthPlan {
            camera,
            facts: DepthFacts {
                camera: id.clone(),
                frames: frames.len(),
                color_frames: colors.len(),
                largest_color_lag_ns: takes.iter().filter_map(lag).max().unwrap_or(0),
            },
            frames,
        })
    }
}

impl ColorPlan {
    pub(super) fn facts(&self) -> ColorFacts {
        self.facts.clone()
    }

    pub(super) fn view(self, batch: &mut ImageBatch) -> ColorView {
        ColorView {
            camera: self.camera,
            image: batch.take_color(self.image),
            silhouette: match self.facts.silhouette {
                Silhouette::Mask => SilhouetteSource::Mask(batch.take_mask(self.silhouette)),
                Silhouette::Background { .. } => {
                    SilhouetteSource::Background(batch.color(self.silhouette))
                }
            },
            ignored: self.ignored.map(|place| batch.take_mask(place)),
        }
    }
}

impl DepthPlan {
    pub(super) fn facts(&self) -> DepthFacts {
        self.facts.clone()
    }

    pub(super) fn view(self, batch: &mut ImageBatch) -> DepthView {
        let frame = |(readings, color): (usize, Option<usize>)| DepthFrame {
            readings: batch.take_readings(readings),
            color: color.map(|place| batch.color(place)),
        };
        DepthView {
            frames: self.frames.into_iter().map(frame).collect(),
            camera: self.camera,
        }
    }
}

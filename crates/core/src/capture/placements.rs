//! A calibration session, from a recording or from picture files: placements of a board, each with the pictures of the
//! cameras that have one. It needs no calibration, background or volume.

use super::error::Error;
use super::load::{assemble, check_counts, misnamed};
use super::picture_files::{self, PictureFiles};
use super::replay;
use crate::calibration::Intrinsics;
use crate::frame::{CameraId, Picture, Timestamp};
use crate::image::{AS_STORED, DecodeError, Grid, grey_from_raw, grey_from_rgb, grey_of_used_bits};
use crate::image::{orientation_of_file, readings_from_raw, rgb_from_raw, size_of_file};
use crate::recording::{ColorPart, Damage, DepthPart, MessageRef, Recording, Topic};
use crate::sync::{self, Capture};
use std::path::{Path, PathBuf};

/// An open calibration session.
#[derive(Debug)]
pub struct Placements {
    source: Source,
    warnings: Vec<String>,
}

/// Where its pictures come from.
#[derive(Debug)]
enum Source {
    Recording(Box<Recording>, Vec<Capture<MessageRef>>),
    Files(PictureFiles),
}

/// A picture in which a camera may have seen the board.
#[derive(Clone, Debug, PartialEq)]
pub struct Shot {
    /// The placement's name.
    pub placement: String,
    /// The camera; of a depth camera, its colour picture.
    pub camera: CameraId,
    /// Whether it is a depth camera.
    pub measures_depth: bool,
    place: Place,
}

/// Where a picture is.
#[derive(Clone, Debug, PartialEq)]
enum Place {
    Message(Topic, MessageRef),
    File(PathBuf),
}

/// A depth camera's readings of a placement.
#[derive(Clone, Debug, PartialEq)]
pub struct Readings {
    /// The placement's name.
    pub placement: String,
    /// The depth camera.
    pub camera: CameraId,
    topic: Topic,
    messages: Vec<MessageRef>,
}

impl Shot {
    /// The picture's file; `None` if it is in a recording.
    pub fn file(&self) -> Option<&Path> {
        match &self.place {
            Place::Message(..) => None,
            Place::File(path) => Some(path),
        }
    }

    /// The EXIF orientation that the picture's file states, from 1 (as it is stored) to 8. It is 1 if the picture is in
    /// a recording, or if the file states none or cannot be read.
    pub fn orientation(&self) -> u8 {
        match self.file().map(picture_files::read) {
            Some(Ok(Picture::Compressed { format, data })) => orientation_of_file(&format, &data),
            _ => AS_STORED,
        }
    }
}

impl Placements {
    /// Opens a recording and assembles its placements.
    ///
    /// # Errors
    /// If it cannot be read, or has no trigger, or more cameras and triggers than any rig.
    pub fn open(path: &Path, parameters: &sync::Parameters) -> Result<Self, Error> {
        let recording = Recording::open(path)?;
        let cameras = cameras(&recording);
        check_counts(&recording, &cameras)?;
        let played = replay::events(&recording)?;
        let mut warnings = misnamed(&recording);
        warnings.extend(played.problems);
        let parameters = sync::Parameters {
            min_depth_frames: 1,
            go_on_without_missing: true,
            ..parameters.clone()
        };
        let planned = assemble(played.events, cameras, &parameters, &mut warnings);
        if planned.is_empty() {
            let damage = recording.damage().iter().map(ToString::to_string);
            let reasons = warnings.into_iter().chain(damage);
            return Err(Error::NoTrigger {
                path: path.into(),
                details: reasons.take(10).map(|r| format!("; {r}")).collect(),
            });
        }
        let mut captures: Vec<_> = planned.into_iter().map(|p| p.capture).collect();
        // A capture may become complete after a later one.
        captures.sort_by_key(|capture| capture.trigger.time);
        Ok(Self {
            source: Source::Recording(Box::new(recording), captures),
            warnings,
        })
    }

    /// The placements of picture files. Nothing is read yet.
    pub fn of_files(files: PictureFiles) -> Self {
        Self {
            warnings: files.warnings().to_vec(),
            source: Source::Files(files),
        }
    }

    /// The recording; none of picture files.
    pub fn recording(&self) -> Option<&Recording> {
        match &self.source {
            Source::Recording(recording, _) => Some(recording),
            Source::Files(_) => None,
        }
    }

    /// What it is called: the recording's path.
    pub fn path(&self) -> &Path {
        self.recording()
            .map_or(Path::new("pictures"), Recording::path)
    }

    /// When the first placement was recorded; unknown for picture files.
    pub fn first_time(&self) -> Option<Timestamp> {
        self.captures().first().map(|capture| capture.trigger.time)
    }

    fn captures(&self) -> &[Capture<MessageRef>] {
        match &self.source {
            Source::Recording(_, captures) => captures,
            Source::Files(_) => &[],
        }
    }

    /// What a person should know of the recording as a whole.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// The parts of the file that are known to be unreadable.
    pub fn damage(&self) -> &[Damage] {
        self.recording().map_or(&[], Recording::damage)
    }

    /// The placements' names in the order of their triggers.
    pub fn names(&self) -> Vec<String> {
        match &self.source {
            Source::Recording(_, captures) => {
                captures.iter().map(|c| c.trigger.id.to_string()).collect()
            }
            Source::Files(files) => files.placements().to_vec(),
        }
    }

    /// Cameras that have colour pictures, and whether they measure depth: in the order of their ids, colour cameras
    /// first.
    pub fn cameras(&self) -> Vec<(CameraId, bool)> {
        let cameras = match &self.source {
            Source::Recording(recording, _) => cameras(recording),
            Source::Files(files) => return files.cameras().map(|id| (id.clone(), false)).collect(),
        };
        let colors = cameras.colors.into_iter().map(|id| (id, false));
        let depths = cameras
            .depths
            .into_iter()
            .filter(|(_, has_color)| *has_color);
        colors.chain(depths.map(|(id, _)| (id, true))).collect()
    }

    /// Depth cameras that have no colour pictures, in which a board could be found.
    pub fn depth_cameras_without_color(&self) -> Vec<CameraId> {
        let Some(recording) = self.recording() else {
            return Vec::new();
        };
        let depths = cameras(recording).depths.into_iter();
        let without = depths.filter(|(_, has_color)| !has_color);
        without.map(|(id, _)| id).collect()
    }

    /// The pictures of all placements, one a camera.
    pub fn shots(&self) -> Vec<Shot> {
        if let Source::Files(files) = &self.source {
            let shot = |(placement, camera, file): (&str, &CameraId, &Path)| Shot {
                placement: placement.to_owned(),
                camera: camera.clone(),
                measures_depth: false,
                place: Place::File(file.into()),
            };
            return files.files().map(shot).collect();
        }
        let of = |capture: &Capture<MessageRef>| {
            let placement = capture.trigger.id.to_string();
            let color = |(id, frame): (&CameraId, &sync::TimedFrame<MessageRef>)| Shot {
                placement: placement.clone(),
                camera: id.clone(),
                measures_depth: false,
                place: Place::Message(Topic::Color(id.clone(), ColorPart::Image), frame.handle),
            };
            let depth = |(id, takes): (&CameraId, &Vec<sync::DepthWithColor<MessageRef>>)| {
                let color = takes.iter().find_map(|take| take.color.as_ref())?;
                Some(Shot {
                    placement: placement.clone(),
                    camera: id.clone(),
                    measures_depth: true,
                    place: Place::Message(Topic::Depth(id.clone(), DepthPart::Color), color.handle),
                })
            };
            let mut shots: Vec<Shot> = capture.colors.iter().map(color).collect();
            shots.extend(capture.depths.iter().filter_map(depth));
            shots
        };
        self.captures().iter().flat_map(of).collect()
    }

    /// The readings of all placements, one set a depth camera.
    pub fn readings(&self) -> Vec<Readings> {
        let of = |capture: &Capture<MessageRef>| {
            let placement = capture.trigger.id.to_string();
            let readings =
                move |(id, takes): (&CameraId, &Vec<sync::DepthWithColor<MessageRef>>)| Readings {
                    placement: placement.clone(),
                    camera: id.clone(),
                    topic: Topic::Depth(id.clone(), DepthPart::Image),
                    messages: takes.iter().map(|take| take.depth.handle).collect(),
                };
            capture.depths.iter().map(readings).collect::<Vec<_>>()
        };
        self.captures().iter().flat_map(of).collect()
    }

    /// Reads and decodes a picture as grey values; its size is its own.
    ///
    /// # Errors
    /// If it cannot be read, is damaged, or larger than any camera's.
    pub fn grey(&self, shot: &Shot) -> Result<Grid<u8>, Error> {
        match (&shot.place, self.recording()) {
            (Place::Message(topic, message), Some(recording)) => {
                let picture = recording.picture(topic, message)?;
                grey(&picture).map_err(|problem| undecodable(recording, topic, message, problem))
            }
            (Place::File(path), _) => {
                let failed = |problem| Error::BadPictureFile {
                    path: path.clone(),
                    problem,
                };
                grey(&picture_files::read(path)?).map_err(failed)
            }
            (Place::Message(topic, _), None) => Err(Error::NoTrigger {
                path: self.path().into(),
                details: format!("; {topic} is of a recording"),
            }),
        }
    }

    /// Reads and decodes a depth camera's frames.
    ///
    /// # Errors
    /// If one cannot be read, is damaged, or larger than any camera's.
    pub fn depth(&self, readings: &Readings) -> Result<Vec<Grid<u16>>, Error> {
        let Some(recording) = self.recording() else {
            return Ok(Vec::new());
        };
        let decode = |message: &MessageRef| {
            let picture = recording.picture(&readings.topic, message)?;
            let decoded =
                size(&picture).and_then(|size| readings_from_raw(&(&picture).into(), size));
            decoded.map_err(|problem| undecodable(recording, &readings.topic, message, problem))
        };
        readings.messages.iter().map(decode).collect()
    }
}

fn undecodable(
    recording: &Recording,
    topic: &Topic,
    message: &MessageRef,
    problem: DecodeError,
) -> Error {
    let timestamp: Timestamp = message.log_time();
    Error::Picture {
        path: recording.path().into(),
        topic: topic.to_string(),
        timestamp,
        problem,
    }
}

/// The picture's own width and height, within what any camera has.
fn size(picture: &Picture) -> Result<(usize, usize), DecodeError> {
    let size = match picture {
        Picture::Raw { width, height, .. } => (*width as usize, *height as usize),
        Picture::Compressed { format, data } => size_of_file(format, data)?,
    };
    let most = Intrinsics::LARGEST_SIDE;
    if size.0 == 0 || size.1 == 0 || size.0 > most || size.1 > most {
        return Err(DecodeError::Size {
            found: size,
            expected: (most, most),
        });
    }
    Ok(size)
}

fn grey(picture: &Picture) -> Result<Grid<u8>, DecodeError> {
    let size = size(picture)?;
    match picture {
        Picture::Raw { encoding, .. } if encoding == "mono8" => {
            grey_from_raw(&picture.into(), size)
        }
        Picture::Raw { .. } => Ok(grey_from_rgb(&rgb_from_raw(&picture.into(), size)?)),
        Picture::Compressed { format, data } => grey_of_used_bits(format, data, size),
    }
}

/// All cameras that have pictures.
fn cameras(recording: &Recording) -> sync::Cameras {
    let mut cameras = sync::Cameras::default();
    for topic in recording
        .topics()
        .filter(|t| !recording.messages(t).is_empty())
    {
        match topic {
            Topic::Color(id, ColorPart::Image) => drop(cameras.colors.insert(id.clone())),
            Topic::Depth(id, DepthPart::Image) => {
                let color = Topic::Depth(id.clone(), DepthPart::Color);
                cameras
                    .depths
                    .insert(id.clone(), !recording.messages(&color).is_empty());
            }
            _ => {}
        }
    }
    cameras
}

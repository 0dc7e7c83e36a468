//! Writes a session's captures one after the other into files of a bounded size, each of which can be read alone.
//! Callers hand in finished captures; this file makes them durable. The order is that of [`Writer`]: `.part`, chunks,
//! flush, fdatasync, and only then is a capture reported as durable.

use super::{CaptureRecord, Compression, Error, Note, Writer, recover, unfinished_name};
use crate::calibration::{CalibrationRecord, Camera, DepthCamera, Volume};
use crate::frame::{CameraId, CameraSettings, Frame, Picture, Timestamp, Trigger};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What every file of a session begins with, so that it stands alone.
#[derive(Clone, Debug, Default)]
pub struct SessionHeader {
    /// Colour cameras.
    pub colors: Vec<Camera>,
    /// Depth cameras.
    pub depths: Vec<DepthCamera>,
    /// The box that is reconstructed.
    pub volume: Option<Volume>,
    /// What the calibration of these cameras is worth, where that is known.
    pub calibration: Option<CalibrationRecord>,
    /// How each colour camera is set.
    pub settings: BTreeMap<CameraId, CameraSettings>,
    /// Each colour camera's view of the rig with no object in it, and when it was taken.
    pub backgrounds: BTreeMap<CameraId, (Timestamp, Picture)>,
    /// The text of the configuration that the rig runs with.
    pub configuration: String,
    /// Pairs about the session: subject, operator, note.
    pub about: BTreeMap<String, String>,
}

/// A capture, ready to be kept.
#[derive(Clone, Debug)]
pub struct FinishedCapture {
    /// What asked for it.
    pub trigger: Trigger,
    /// Its frames; of a failed one those that came.
    pub frames: Vec<Frame>,
    /// What became of it.
    pub record: CaptureRecord,
    /// When that was known.
    pub time: Timestamp,
}

impl FinishedCapture {
    /// Bytes of its pictures.
    pub fn bytes(&self) -> u64 {
        let bytes = self.frames.iter().map(|f| f.picture.bytes() as u64);
        bytes.sum()
    }
}

/// A session that is being recorded.
pub struct RecordingSession {
    folder: PathBuf,
    name: String,
    program: String,
    begin: Timestamp,
    /// Bytes after which a file is completed and the next one begun.
    largest_file: u64,
    header: SessionHeader,
    files: usize,
    open: Option<Open>,
    /// The file of each capture that was recorded.
    recorded: BTreeMap<String, PathBuf>,
    /// Files that could not be completed: only their `.part` exists.
    left: Vec<PathBuf>,
    unfinished: Option<Error>,
}

/// The file that is being written.
struct Open {
    path: PathBuf,
    writer: Writer,
    bytes: u64,
}

impl RecordingSession {
    /// Begins a session whose files will be `folder/NAME.mcap`, `folder/NAME-002.mcap` and so on. The first one is made
    /// with the first capture. `begin` is before every capture.
    ///
    /// # Errors
    /// If there is a session of this name already.
    pub fn begin(
        folder: &Path,
        name: &str,
        program: &str,
        begin: Timestamp,
        largest_file: u64,
        header: SessionHeader,
    ) -> Result<Self, Error> {
        let session = Self {
            folder: folder.into(),
            name: name.into(),
            program: program.into(),
            begin,
            largest_file,
            header,
            files: 0,
            open: None,
            recorded: BTreeMap::new(),
            left: Vec::new(),
            unfinished: None,
        };
        let path = session.path(0);
        if is_taken(&path)? {
            return Err(Error::Io {
                path,
                cause: std::io::ErrorKind::AlreadyExists.into(),
            });
        }
        Ok(session)
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Writes a capture and brings it to the disk: when this returns, it survives a power cut. The path is the one that
    /// the file has when it is complete. A full file that cannot be completed is left as `.part`
    /// ([`Self::take_unfinished`]); the capture goes into the next one.
    ///
    /// # Errors
    /// If it cannot be written. What was kept before stays: the file that broke is left as `.part`, which
    /// [`Self::close`] or a recovery completes, and the next capture begins another one.
    pub fn append(&mut self, capture: &FinishedCapture) -> Result<PathBuf, Error> {
        let kept = self.try_append(capture);
        if kept.is_err() {
            self.leave_file();
        }
        kept
    }

    fn try_append(&mut self, capture: &FinishedCapture) -> Result<PathBuf, Error> {
        let bytes = capture.bytes();
        let full = |open: &Open| open.bytes > 0 && open.bytes + bytes > self.largest_file;
        if self.open.as_ref().is_some_and(full) {
            self.unfinished = self.finish_file().err();
        }
        let open = self.open_file(capture.trigger.time)?;
        open.bytes += bytes;
        let path = open.path.clone();
        let writer = &mut open.writer;
        writer.trigger(&capture.trigger)?;
        for frame in &capture.frames {
            writer.frame(frame)?;
        }
        writer.capture(&capture.record, capture.time)?;
        writer.sync()?;
        self.recorded
            .insert(capture.record.id.clone(), path.clone());
        Ok(path)
    }

    /// The file of a capture, complete or not, if it is not the one that is being written: a note on it belongs beside
    /// that file, for a file's notes are about its own captures.
    pub fn earlier_file_of(&self, capture: &str) -> Option<PathBuf> {
        let path = self.recorded.get(capture)?;
        let is_open = self.open.as_ref().is_some_and(|open| open.path == *path);
        let part = unfinished_name(path);
        match part.exists() {
            _ if is_open => None,
            true => Some(part),
            false => Some(path.clone()),
        }
    }

    /// Writes what a person noted about a capture, and brings it to the disk. [`Self::earlier_file_of`] must not have
    /// the capture.
    ///
    /// # Errors
    /// As for [`Self::append`].
    pub fn note(&mut self, note: &Note, time: Timestamp) -> Result<(), Error> {
        let mut noted = || {
            let writer = &mut self.open_file(time)?.writer;
            writer.note(note, time)?;
            writer.sync()
        };
        let done = noted();
        if done.is_err() {
            self.leave_file();
        }
        done
    }

    /// Changes what is repeated in each file, from `time` on: new backgrounds, or a camera that came back with other
    /// settings. If something changed that only the beginning of a file has (calibration, configuration), the file is
    /// completed, and the next capture begins another one.
    ///
    /// # Errors
    /// As for [`Self::append`]; the next file begins with what is new all the same.
    pub fn change(&mut self, mut header: SessionHeader, time: Timestamp) -> Result<(), Error> {
        // The client's facts about the session stay as they were given; the rig's own facts are the present ones.
        for (key, value) in &self.header.about {
            let about = header.about.entry(key.clone());
            about.or_insert_with(|| value.clone());
        }
        let before = std::mem::replace(&mut self.header, header);
        if begins_otherwise(&before, &self.header) {
            return self.finish_file();
        }
        let Some(open) = &mut self.open else {
            return Ok(());
        };
        let written = changed(&mut open.writer, &before, &self.header, time);
        if written.is_err() {
            self.leave_file();
        }
        written
    }

    /// Why the last full file could not be completed, reported once.
    pub fn take_unfinished(&mut self) -> Option<Error> {
        self.unfinished.take()
    }

    /// Bytes after which a file is completed, from the next capture on.
    pub fn limit_files(&mut self, largest_file: u64) {
        self.largest_file = largest_file;
    }

    /// Completes the last file, and those that could not be completed before.
    ///
    /// # Errors
    /// If one cannot be: it is left as `.part`. Closing again, when there is space, tries once more.
    pub fn close(&mut self) -> Result<(), Error> {
        // Not tried twice: what just failed would have to be read from front to back.
        self.finish_file()?;
        let mut closed = Ok(());
        self.left.retain(|part| {
            let completed = complete(part);
            let is_left = completed.is_err();
            if closed.is_ok() {
                closed = completed;
            }
            is_left
        });
        closed
    }

    fn finish_file(&mut self) -> Result<(), Error> {
        let Some(Open { path, writer, .. }) = self.open.take() else {
            return Ok(());
        };
        let finished = writer.finish();
        if finished.is_err() {
            self.left.push(unfinished_name(&path));
        }
        finished
    }

    /// Lets go of a file that cannot be written any more.
    fn leave_file(&mut self) {
        let left = self.open.take().map(|open| unfinished_name(&open.path));
        self.left.extend(left);
    }

    fn path(&self, file: usize) -> PathBuf {
        let name = match file {
            0 => format!("{}.mcap", self.name),
            more => format!("{}-{:03}.mcap", self.name, more + 1),
        };
        self.folder.join(name)
    }

    /// The next file's name: one that nothing has, such as a recording of a session `NAME-002`.
    fn next_path(&mut self) -> Result<PathBuf, Error> {
        loop {
            let path = self.path(self.files);
            // Also of a file that cannot be begun: its name is not tried again.
            self.files += 1;
            if !is_taken(&path)? {
                return Ok(path);
            }
        }
    }

    /// The file that is written to, begun if there is none, for what is of `time`.
    fn open_file(&mut self, time: Timestamp) -> Result<&mut Open, Error> {
        let open = match self.open.take() {
            Some(open) => open,
            None => {
                let path = self.next_path()?;
                Open {
                    writer: self.begin_file(&path, time)?,
                    path,
                    bytes: 0,
                }
            }
        };
        Ok(self.open.insert(open))
    }

    /// A file with what every file begins with. One that cannot be begun has no capture, and goes.
    fn begin_file(&self, path: &Path, time: Timestamp) -> Result<Writer, Error> {
        let mut writer = Writer::create(path, &self.program, Compression::None)?;
        let begun = begin_file(&mut writer, &self.header, &self.name, self.begin)
            .and_then(|()| backgrounds(&mut writer, &SessionHeader::default(), &self.header, time));
        match begun {
            Ok(()) => Ok(writer),
            Err(error) => {
                let _ = std::fs::remove_file(unfinished_name(path));
                Err(error)
            }
        }
    }

    /// Makes the next write into the open file fail, as a full disk does.
    #[cfg(test)]
    pub(super) fn break_file(&mut self) {
        let open = self.open.as_mut().expect("a file is open");
        open.writer.break_container();
    }
}

/// Completes a file that was left; one that is gone was completed by somebody else.
fn complete(part: &Path) -> Result<(), Error> {
    let is_there = part.try_exists().map_err(|cause| Error::Io {
        path: part.into(),
        cause,
    })?;
    match is_there {
        true => recover(part).map(drop),
        false => Ok(()),
    }
}

/// Whether there is a recording of this name, complete or not.
fn is_taken(path: &Path) -> Result<bool, Error> {
    let exists = |path: &Path| {
        path.try_exists().map_err(|cause| Error::Io {
            path: path.into(),
            cause,
        })
    };
    Ok(exists(path)? || exists(&super::rewriting::with_ending(path, "part"))?)
}

/// Writes what every file begins with.
fn begin_file(
    writer: &mut Writer,
    header: &SessionHeader,
    name: &str,
    time: Timestamp,
) -> Result<(), Error> {
    let mut about = header.about.clone();
    about.insert("name".into(), name.into());
    writer.metadata("session", &about)?;
    if let Some(calibration) = &header.calibration {
        writer.calibration_record(calibration)?;
    }
    let text = header.configuration.as_bytes();
    writer.attach("rig.toml", "application/toml", time, text)?;
    for camera in &header.colors {
        writer.color_camera(camera, time)?;
    }
    for camera in &header.depths {
        writer.depth_camera(camera, time)?;
    }
    if let Some(volume) = &header.volume {
        writer.volume(volume, time)?;
    }
    settings(writer, &SessionHeader::default(), header, time)
}

/// Whether a file would begin with something that cannot follow later in it.
fn begins_otherwise(before: &SessionHeader, now: &SessionHeader) -> bool {
    before.colors != now.colors
        || before.depths != now.depths
        || before.volume != now.volume
        || before.calibration != now.calibration
        || before.configuration != now.configuration
        || before.about != now.about
}

/// Writes settings and backgrounds that are not what they were.
fn changed(
    writer: &mut Writer,
    before: &SessionHeader,
    now: &SessionHeader,
    time: Timestamp,
) -> Result<(), Error> {
    settings(writer, before, now, time)?;
    backgrounds(writer, before, now, time)
}

fn settings(
    writer: &mut Writer,
    before: &SessionHeader,
    now: &SessionHeader,
    time: Timestamp,
) -> Result<(), Error> {
    for (id, settings) in &now.settings {
        if before.settings.get(id) != Some(settings) {
            writer.settings(id, settings, time)?;
        }
    }
    Ok(())
}

/// A background keeps the time at which it was taken, so that its age can be told. One that was taken while the clock
/// was ahead counts from `time` on.
fn backgrounds(
    writer: &mut Writer,
    before: &SessionHeader,
    now: &SessionHeader,
    time: Timestamp,
) -> Result<(), Error> {
    for (id, (taken, picture)) in &now.backgrounds {
        let same = |(earlier, _): &(Timestamp, Picture)| earlier == taken;
        if !before.backgrounds.get(id).is_some_and(same) {
            writer.background(id, picture, time.min(*taken))?;
        }
    }
    Ok(())
}

//! The thread that has a look's pictures made: it passes a frame to a confined process (`scand make-look`) and shows
//! what comes back. It has the lowest priority, takes one frame at a time, and decodes nothing itself.

use super::measured::{Measured, brightness};
use super::protocol::{COMMAND, Head, LARGEST_OUTPUT, PARENT, Pixels, SegmentationSettings};
use super::{CameraLook, Looks};
use crate::frame::{Frame, Picture, Stream};
use crate::log;
use crate::process::{Cancel, Child, ChildExit, last_line, lower_thread_priority};
use crate::trigger::LookFigures;
use crossbeam_channel::{Receiver, Sender, bounded};
use rustix::fs::{MemfdFlags, memfd_create};
use std::fs::File;
use std::io::{self, BufWriter, Read, Seek, Write};
use std::path::PathBuf;
use std::process::Command;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

/// How long the making of a picture may take.
const PATIENCE: Duration = Duration::from_secs(10);

/// What it takes to make pictures of frames.
#[derive(Clone, Debug)]
pub struct LookPlan {
    /// The program that has the command `make-look`.
    pub program: PathBuf,
    /// What objects are cut out with; `None` for a rig that is not calibrated.
    pub cutting: Option<Arc<SegmentationSettings>>,
}

/// A frame of which a picture is to be made.
pub(in crate::daemon) struct LookTask {
    /// The frame.
    pub(in crate::daemon) frame: Frame,
    /// The camera's view of the empty rig.
    pub(in crate::daemon) background: Option<Picture>,
    /// What the object is cut out with.
    pub(in crate::daemon) cutting: Option<Arc<SegmentationSettings>>,
    /// Whether the camera joined 2x2 pixels for it.
    pub(in crate::daemon) is_binned: bool,
    /// Why the camera does not join pixels although it was to.
    pub(in crate::daemon) why_whole: Option<String>,
}

/// The thread, from outside.
pub(in crate::daemon) struct LookMaker {
    tasks: Sender<LookTask>,
    done: Receiver<()>,
    /// Kept, so that the channel never ends while somebody waits at it.
    _tell: Sender<()>,
    cancel: Cancel,
    is_busy: bool,
    thread: JoinHandle<()>,
}

impl LookMaker {
    /// Starts the thread.
    ///
    /// # Errors
    /// If the system has no thread or no file left.
    pub(in crate::daemon) fn start(plan: LookPlan, looks: Looks) -> io::Result<Self> {
        let (tasks, queue) = bounded(1);
        let (tell, done) = bounded(1);
        let cancel = Cancel::new()?;
        let mut maker = Maker {
            plan,
            looks,
            cancel: cancel.clone(),
            measured: Measured::default(),
        };
        let thread = std::thread::Builder::new().name("look".into());
        let to_tell = tell.clone();
        let thread = thread.spawn(move || maker.run(&queue, &to_tell))?;
        Ok(Self {
            tasks,
            done,
            _tell: tell,
            cancel,
            is_busy: false,
            thread,
        })
    }

    /// Whether a picture is being made.
    pub(in crate::daemon) fn is_busy(&self) -> bool {
        self.is_busy
    }

    /// Tells when a picture is made; to be followed by [`Self::finished`].
    pub(in crate::daemon) fn done(&self) -> &Receiver<()> {
        &self.done
    }

    /// The picture was made: there is room for another one.
    pub(in crate::daemon) fn finished(&mut self) {
        self.is_busy = false;
    }

    /// Has a picture made, unless one is being made.
    pub(in crate::daemon) fn make(&mut self, task: LookTask) {
        self.is_busy |= self.tasks.try_send(task).is_ok();
    }

    /// Stops the thread.
    pub(in crate::daemon) fn stop(self) {
        self.cancel.cancel();
        drop(self.tasks);
        let _ = self.thread.join();
    }
}

struct Maker {
    plan: LookPlan,
    looks: Looks,
    cancel: Cancel,
    measured: Measured,
}

impl Maker {
    fn run(&mut self, queue: &Receiver<LookTask>, tell: &Sender<()>) {
        for missing in lower_thread_priority(19) {
            log::warning!("the thread that makes pictures for looks cannot set {missing}");
        }
        while let Ok(task) = queue.recv() {
            let (camera, time) = (task.frame.camera.to_string(), task.frame.timestamp);
            let (bright, why_whole) = (brightness(&task.frame.picture), task.why_whole.clone());
            let made = self.input(task).and_then(|input| self.make(input));
            let outcome = made.map(|(picture, mut seen)| {
                self.measured.complete(&camera, time, bright, &mut seen);
                seen.why_whole = why_whole;
                (picture, seen)
            });
            let outcome =
                outcome.map_err(|why| format!("no picture could be made of its frame: {why}"));
            self.looks.show(&camera, CameraLook { time, outcome });
            if tell.send(()).is_err() {
                return;
            }
        }
    }

    /// A file in memory with everything about a frame, whose own memory is free again then.
    fn input(&self, task: LookTask) -> Result<File, String> {
        let LookTask {
            frame,
            background,
            cutting,
            is_binned,
            ..
        } = task;
        let head = Head {
            camera: frame.camera.to_string(),
            depth: frame.stream == Stream::Depth,
            joined: if is_binned { 2 } else { 1 },
            frame: pixels(&frame.picture),
            background: background.as_ref().map(pixels),
            cutting: cutting.map(Arc::unwrap_or_clone),
        };
        let write = || -> io::Result<File> {
            let mut input = BufWriter::new(in_memory("scand look input")?);
            serde_json::to_writer(&mut input, &head)?;
            input.write_all(b"\n")?;
            for picture in [Some(&frame.picture), background.as_ref()]
                .into_iter()
                .flatten()
            {
                let (Picture::Raw { data, .. } | Picture::Compressed { data, .. }) = picture;
                input.write_all(data)?;
            }
            let mut input = input.into_inner().map_err(io::IntoInnerError::into_error)?;
            input.rewind()?;
            Ok(input)
        };
        write().map_err(|error| error.to_string())
    }

    fn make(&self, input: File) -> Result<(Vec<u8>, LookFigures), String> {
        let said = |error: io::Error| error.to_string();
        let mut output = in_memory("scand look output").map_err(said)?;
        let mut command = Command::new(&self.plan.program);
        command.arg(COMMAND).arg(format!("--{PARENT}"));
        command.arg(std::process::id().to_string());
        // One processor is enough for a small picture; a press may want the others.
        command.env("RAYON_NUM_THREADS", "1");
        let written = output.try_clone().map_err(said)?;
        let child = Child::start_between(&mut command, input, written).map_err(said)?;
        let ended = child.wait(PATIENCE, self.looks.clock(), &self.cancel);
        match ended.map_err(said)? {
            (ChildExit::Ended(status), _) if status.success() => {}
            (ChildExit::Ended(status), words) => {
                return Err(format!("{status}: {}", last_line(&words)));
            }
            (ChildExit::TimedOut, _) => return Err("it took too long".into()),
            (ChildExit::Cancelled, _) => return Err("the daemon is ending".into()),
        }
        output.rewind().map_err(said)?;
        let mut made = Vec::new();
        let read = output.take(LARGEST_OUTPUT + 1).read_to_end(&mut made);
        read.map_err(said)?;
        parsed(&made)
    }
}

/// The picture, and what is seen in it.
fn parsed(made: &[u8]) -> Result<(Vec<u8>, LookFigures), String> {
    let end = made.iter().position(|&byte| byte == b'\n');
    let (line, picture) = made.split_at(end.ok_or("it wrote no line")?);
    if made.len() as u64 > LARGEST_OUTPUT || picture.len() < 2 {
        return Err(format!("it wrote {} bytes", made.len()));
    }
    let seen = serde_json::from_slice(line).map_err(|error| error.to_string())?;
    Ok((picture[1..].to_vec(), seen))
}

fn in_memory(name: &str) -> io::Result<File> {
    Ok(File::from(memfd_create(name, MemfdFlags::CLOEXEC)?))
}

fn pixels(picture: &Picture) -> Pixels {
    let bytes = picture.bytes() as u64;
    match picture {
        Picture::Raw {
            width,
            height,
            encoding,
            step,
            ..
        } => Pixels {
            width: *width,
            height: *height,
            encoding: encoding.clone(),
            step: *step,
            bytes,
        },
        Picture::Compressed { format, .. } => Pixels {
            width: 0,
            height: 0,
            encoding: format.clone(),
            step: 0,
            bytes,
        },
    }
}

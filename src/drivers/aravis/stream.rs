//! A camera's frames as they arrive from the network: keeps memory ready, checks each frame, and copies it once.
//! `shoot` decides which frames are used.
#![allow(unsafe_code)] // A frame is read where the library put it; the wrapper has that as a pointer only.

use super::parameters::{self, Parameters};
use crate::drivers::live::{Fault, Pool, ShotStats};
use crate::drivers::pixel_format::PixelFormat;
use crate::frame::Picture;
use aravis::glib::prelude::Cast;
use aravis::prelude::*;
use aravis::{Buffer, BufferPayloadType, BufferStatus, Camera, GvStream, GvStreamPacketResend};
use std::time::{Duration, Instant};

/// What every whole frame of a camera is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Layout {
    /// Of its pixels.
    pub format: PixelFormat,
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Bytes as the camera counts them, with whatever it adds.
    pub payload: usize,
}

/// A frame that came off the network.
pub(super) enum Arrival {
    /// Whole.
    Whole(Buffer),
    /// Damaged: why, and its stamp if that came through.
    Damaged(String, Option<u64>),
    /// No frame: memory that was handed back when a stream began or ended.
    Nothing,
}

/// A camera's stream.
pub(super) struct Frames {
    stream: GvStream,
    layout: Layout,
    /// Width and height of the small pictures of looks, once one was asked for. What is left of one is nobody's loss.
    small: Option<[u32; 2]>,
    counted: Counts,
    buffers: u32,
    opened: Instant,
}

/// What the library has counted.
#[derive(Debug, Clone, Copy, Default)]
struct Counts {
    resent: u64,
    missing: u64,
    underruns: u64,
}

/// How long packets of others may be taken for a new stream's.
const UNFILTERED: Duration = Duration::from_millis(50);
/// How long a packet may be late before it is asked for again, and a frame before it is given up.
const PACKET_TIMEOUT: Duration = Duration::from_millis(20);
const FRAME_RETENTION: Duration = Duration::from_millis(200);

impl Frames {
    /// Opens the stream, which gets no frames yet.
    ///
    /// # Errors
    /// If the library cannot.
    pub(super) fn open(
        camera: &Camera,
        parameters: &Parameters,
        layout: Layout,
    ) -> Result<Self, Fault> {
        let away = |why: String| Fault::Away(format!("its stream cannot be created: {why}"));
        let stream = camera
            .create_stream()
            .map_err(|e| away(e.message().into()))?;
        let stream = stream.downcast::<GvStream>();
        let stream = stream.map_err(|_| away("it is not a GigE Vision camera".into()))?;
        stream.set_packet_resend(match parameters.packet_resend {
            Some(false) => GvStreamPacketResend::Never,
            _ => GvStreamPacketResend::Always,
        });
        stream.set_packet_timeout(PACKET_TIMEOUT.as_micros() as u32);
        stream.set_frame_retention(FRAME_RETENTION.as_micros() as u32);
        Ok(Self {
            stream,
            layout,
            small: None,
            counted: Counts::default(),
            buffers: parameters.buffer_count(),
            opened: Instant::now(),
        })
    }

    /// Gives the stream its memory. From now on frames can come.
    ///
    /// With raw sockets the library listens before it sets its filter, and takes what other cameras send meanwhile for
    /// packets of this one (seen with 0.8.26). As long as there is no memory, nothing can become of them.
    pub(super) fn begin(&mut self) {
        std::thread::sleep(UNFILTERED.saturating_sub(self.opened.elapsed()));
        for _ in 0..self.buffers {
            self.give_back(Buffer::new_allocate(self.layout.payload));
        }
        self.count(&mut ShotStats::default());
    }

    /// Expects frames of another size from now on; the memory of whole ones is enough for smaller ones. What comes of
    /// the smaller size later is dropped in silence.
    pub(super) fn expect(&mut self, size: [u32; 2]) {
        if size < self.layout.size {
            self.small = Some(size);
        }
        self.layout.size = size;
    }

    /// What has come already; `None` if nothing has.
    pub(super) fn next(&self) -> Option<Arrival> {
        self.stream
            .try_pop_buffer()
            .map(|buffer| self.judge(buffer))
    }

    /// What comes within `patience`.
    pub(super) fn wait(&self, patience: Duration) -> Option<Arrival> {
        let patience = patience.as_micros().max(1) as u64;
        let popped = self.stream.timeout_pop_buffer(patience);
        popped.map(|buffer| self.judge(buffer))
    }

    /// Hands a frame's memory back, to be filled again.
    pub(super) fn give_back(&self, buffer: Buffer) {
        self.stream.push_buffer(buffer);
    }

    /// Adds to `stats` what was lost since the last call.
    pub(super) fn count(&mut self, stats: &mut ShotStats) {
        let (resent, missing) = self.stream.statistics();
        let (_, _, underruns) = StreamExt::statistics(&self.stream);
        let now = Counts {
            resent,
            missing,
            underruns,
        };
        let last = std::mem::replace(&mut self.counted, now);
        stats.resent_packets += now.resent.saturating_sub(last.resent);
        stats.missing_packets += now.missing.saturating_sub(last.missing);
        let dropped = now.underruns.saturating_sub(last.underruns);
        if dropped > 0 {
            stats.lost.push(format!(
                "{dropped} packets arrived while no memory was ready for their frame"
            ));
        }
    }

    fn judge(&self, buffer: Buffer) -> Arrival {
        let status = buffer.status();
        match status {
            BufferStatus::Success => {}
            BufferStatus::Cleared | BufferStatus::Aborted | BufferStatus::Unknown => {
                self.give_back(buffer);
                return Arrival::Nothing;
            }
            _ => {
                let stamp = Some(buffer.timestamp()).filter(|&ns| ns != 0);
                self.give_back(buffer);
                return Arrival::Damaged(damage(status), stamp);
            }
        }
        // A packet that came twice has made damaged frames look whole (Aravis, bug 311): believe the numbers.
        match self.contradiction(&buffer) {
            None => Arrival::Whole(buffer),
            Some(_) if self.is_late_small(&buffer) => {
                self.give_back(buffer);
                Arrival::Nothing
            }
            Some(why) => {
                let stamp = buffer.timestamp();
                self.give_back(buffer);
                Arrival::Damaged(why, Some(stamp))
            }
        }
    }

    /// Whether a frame is a small picture that came after its look.
    fn is_late_small(&self, buffer: &Buffer) -> bool {
        if buffer.payload_type() != BufferPayloadType::Image || self.small == Some(self.layout.size)
        {
            return false;
        }
        let size = [buffer.image_width() as u32, buffer.image_height() as u32];
        self.small == Some(size)
    }

    /// What is not as it was set, in a frame that claims to be whole.
    fn contradiction(&self, buffer: &Buffer) -> Option<String> {
        let kind = buffer.payload_type();
        if kind != BufferPayloadType::Image || buffer.n_parts() != 1 {
            return Some(format!("a frame is not a single picture but {kind:?}"));
        }
        let Layout { format, size, .. } = self.layout;
        let found = (buffer.image_width(), buffer.image_height());
        let code = buffer.image_pixel_format().raw();
        let same = (found.0 as u32, found.1 as u32) == (size[0], size[1]);
        if !same || parameters::format_of(code) != Some(format) {
            return Some(format!(
                "a frame is {}x{} of format 0x{code:08x}, expected {}x{} of {}",
                found.0,
                found.1,
                size[0],
                size[1],
                format.encoding()
            ));
        }
        let (bytes, expected) = (buffer.data().1, self.step(buffer) * size[1] as usize);
        (bytes != expected).then(|| format!("a frame has {bytes} bytes, expected {expected}"))
    }

    /// Bytes from row to row: some cameras pad their rows.
    fn step(&self, buffer: &Buffer) -> usize {
        let padding = usize::try_from(buffer.image_padding().0).unwrap_or(0);
        self.layout.size[0] as usize * self.layout.format.bytes_per_pixel().unwrap_or(0) + padding
    }

    /// Copies a whole frame out; `None` when the pool is used up.
    pub(super) fn copy(&self, buffer: &Buffer, pool: &Pool) -> Option<Picture> {
        let step = self.step(buffer);
        let (start, length) = buffer.data();
        let copied = pool.take(length).map(|mut memory| {
            // SAFETY: the library's contract (arv_buffer_get_data): `length` bytes at `start` are the frame, and live
            // as long as the buffer, which is ours alone until it is handed back.
            let bytes = unsafe { std::slice::from_raw_parts(start, length) };
            memory.write(bytes);
            memory.freeze()
        });
        Some(Picture::Raw {
            width: self.layout.size[0],
            height: self.layout.size[1],
            encoding: self.layout.format.encoding().into(),
            step: step as u32,
            data: copied?,
        })
    }
}

/// What happened to a frame.
fn damage(status: BufferStatus) -> String {
    match status {
        BufferStatus::Timeout => "a frame was not complete in time".into(),
        BufferStatus::MissingPackets => "a frame arrived with packets missing".into(),
        BufferStatus::WrongPacketId => "a frame arrived with a packet of another frame".into(),
        BufferStatus::SizeMismatch => "a frame was larger than its memory".into(),
        BufferStatus::PayloadNotSupported => {
            "a frame arrived in a form that is not supported".into()
        }
        other => format!("a frame arrived with status {other:?}"),
    }
}

//! Takes a shot with an open camera: by command, line or action, or from the frames of a free-running one; decides
//! which frames belong to the shot, and which are old, damaged or wrongly stamped. `camera` opens and closes the
//! camera.

use super::action::{ActionCommand, attempt_patience, send_action};
use super::camera::OpenCamera;
use super::features::no_answer;
use super::gvcp;
use super::parameters::ExposureMark;
use super::stream::Arrival;
use crate::drivers::live::{Fault, LINE_LEAD, NO_SIGNAL, Shot, ShotStats};
use crate::frame::{Frame, Stream, Timestamp};
use aravis::Buffer;
use aravis::prelude::*;
use std::net::SocketAddrV4;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Number of frames of a free-running camera that are kept.
const KEPT: usize = 3;
/// How long a frame may still come after a damaged one whose stamp was lost.
const AFTER_DAMAGE: Duration = Duration::from_millis(250);
/// How much older than its trigger a damaged frame is that belongs to another one.
const STALE_NS: i128 = 50_000_000;

impl OpenCamera {
    /// When the exposure of a frame began, on the host's timeline. `not_before` is what is known of that otherwise.
    fn begin_of(
        &mut self,
        stamp_ns: u64,
        not_before: Option<Timestamp>,
    ) -> Result<Timestamp, String> {
        let after_begin_ns = self.stamp_after_begin_ns();
        // The stamp's time is held against what is known of that moment: the exposure's end, where that is stamped.
        let not_before = not_before.map(|t| Timestamp(t.0.saturating_add(after_begin_ns)));
        let camera = (&self.camera, &self.device);
        let time = self.camera_clock.host_time(stamp_ns, not_before, camera)?;
        Ok(Timestamp(time.0.saturating_sub(after_begin_ns)))
    }

    /// How long after the beginning of an exposure the camera stamps its frame.
    fn stamp_after_begin_ns(&self) -> u64 {
        match self.parameters.exposure_mark.unwrap_or_default() {
            ExposureMark::Start => 0,
            ExposureMark::End => {
                let settings = self.info.settings.as_ref();
                let exposure = settings.and_then(|s| s.exposure).unwrap_or(0.0);
                (exposure * 1e9) as u64
            }
        }
    }

    /// Drops every frame that has come.
    pub(super) fn drain(&mut self, stats: &mut ShotStats) {
        while let Some(arrival) = self.frames.next() {
            if let Arrival::Whole(buffer) = arrival {
                self.frames.give_back(buffer);
                stats.unused += 1;
            }
        }
    }

    /// Keeps the newest of the frames that have come.
    pub(super) fn keep_newest(&mut self, stats: &mut ShotStats) {
        while let Some(arrival) = self.frames.next() {
            match arrival {
                Arrival::Whole(buffer) => self.keep(buffer, stats),
                // Nobody has asked for it.
                Arrival::Damaged(..) | Arrival::Nothing => {}
            }
        }
    }

    fn keep(&mut self, buffer: Buffer, stats: &mut ShotStats) {
        match self.begin_of(buffer.timestamp(), None) {
            Ok(time) => self.kept.push_back((time, buffer)),
            Err(why) => {
                self.frames.give_back(buffer);
                stats.lost.push(why);
            }
        }
        while self.kept.len() > KEPT {
            if let Some((_, oldest)) = self.kept.pop_front() {
                self.frames.give_back(oldest);
                stats.unused += 1;
            }
        }
    }

    /// Hands a frame over, and its memory back.
    fn deliver(
        &self,
        time: Timestamp,
        buffer: Buffer,
        stats: &mut ShotStats,
        take: &mut dyn FnMut(Frame),
    ) {
        self.hand_copy(time, &buffer, stats, take);
        self.frames.give_back(buffer);
    }

    /// Hands a copy of a frame over.
    fn hand_copy(
        &self,
        time: Timestamp,
        buffer: &Buffer,
        stats: &mut ShotStats,
        take: &mut dyn FnMut(Frame),
    ) {
        match self.frames.copy(buffer, &self.pool) {
            Some(picture) => take(Frame {
                camera: self.id.clone(),
                stream: Stream::Color,
                timestamp: time,
                picture,
            }),
            None => stats.lost.push(format!(
                "no memory for a frame: {} of {} bytes are in use (capture.memory_mb)",
                self.pool.allocated(),
                self.pool.limit()
            )),
        }
    }

    /// Waits for the first frame that was exposed at `earliest` or later, and hands it over; false if none came.
    /// `certain` is when it cannot have been exposed before, whatever its stamp says.
    fn await_triggered(
        &mut self,
        shot: &Shot,
        (earliest, certain): (Timestamp, Option<Timestamp>),
        stats: &mut ShotStats,
        take: &mut dyn FnMut(Frame),
    ) -> Result<bool, Fault> {
        let mut until = shot.deadline;
        // Stamped wrongly, or of a trigger before: which of both is seen when the right one comes.
        let mut doubtful = Vec::new();
        while let Some(arrival) = self.next_arrival(shot, until)? {
            match arrival {
                Arrival::Nothing => {}
                Arrival::Damaged(why, stamp) => {
                    let time = stamp.and_then(|ns| self.camera_clock.host_of(ns));
                    if time.is_some_and(|t| earliest.nanoseconds_since(t) > STALE_NS) {
                        // Of a trigger before.
                        continue;
                    }
                    stats.lost.push(why);
                    until = until.min(Instant::now() + AFTER_DAMAGE);
                }
                Arrival::Whole(buffer) => match self.begin_of(buffer.timestamp(), certain) {
                    Ok(time) if time >= earliest => {
                        self.deliver(time, buffer, stats, take);
                        stats.unused += doubtful.len() as u64;
                        return Ok(true);
                    }
                    Ok(_) => {
                        self.frames.give_back(buffer);
                        stats.unused += 1;
                    }
                    Err(why) => {
                        self.frames.give_back(buffer);
                        doubtful.push(why);
                    }
                },
            }
        }
        stats.lost.append(&mut doubtful);
        Ok(false)
    }

    /// Waits for the next frame; `None` when the time is over.
    fn next_arrival(&self, shot: &Shot, until: Instant) -> Result<Option<Arrival>, Fault> {
        const SLICE: Duration = Duration::from_millis(50);
        loop {
            let left = shot
                .remaining()
                .min(until.saturating_duration_since(Instant::now()));
            let arrival = match left.is_zero() {
                true => self.frames.next(),
                false => self.frames.wait(left.min(SLICE)),
            };
            if arrival.is_some() || left.is_zero() {
                return Ok(arrival);
            }
            self.in_control()?;
        }
    }

    pub(super) fn shoot_software(
        &mut self,
        shot: &Shot,
        stats: &mut ShotStats,
        take: &mut dyn FnMut(Frame),
    ) -> Result<(), Fault> {
        self.drain(stats);
        let triggered = self.clock.timestamp();
        if let Err(error) = self.camera.software_trigger() {
            if no_answer(&error) {
                self.is_silent = true;
                let (address, why) = (self.found.address, error.message());
                return Err(Fault::Away(format!(
                    "{address}: the camera did not answer the trigger: {why}"
                )));
            }
            stats.lost.push(format!(
                "the camera declined the trigger: {}",
                error.message()
            ));
            return Ok(());
        }
        let came = self.await_triggered(shot, (triggered, Some(triggered)), stats, take)?;
        self.miss(came, shot, stats)
    }

    pub(super) fn shoot_action(
        &mut self,
        shot: &Shot,
        stats: &mut ShotStats,
        take: &mut dyn FnMut(Frame),
    ) -> Result<(), Fault> {
        self.drain(stats);
        let (scheduled, doubt) = match self.schedule(shot) {
            Ok(scheduled) => scheduled,
            Err(why) => {
                stats.lost.push(why);
                return Ok(());
            }
        };
        let came = self.await_triggered(shot, (scheduled, Some(scheduled)), stats, take)?;
        if !came {
            stats.lost.extend(doubt);
        }
        self.miss(came, shot, stats)
    }

    /// Tells the camera when to expose; the host's time of that, and why the camera may not do so, if that is in doubt.
    fn schedule(&mut self, shot: &Shot) -> Result<(Timestamp, Option<String>), String> {
        if let Some(precision_time) = &self.precision_time {
            precision_time.state(&self.camera)?;
        }
        let lead_ns = (self.parameters.action_lead.unwrap_or(0.02) * 1e9) as u64;
        let proposed = Timestamp(self.clock.timestamp().0 + lead_ns);
        let proposed = self.camera_clock.device_time(proposed);
        let proposed =
            proposed.ok_or("its clock cannot be read, so that nothing can be scheduled")?;
        let at_ns = self.actions.agree(shot.number, proposed);
        let command = ActionCommand {
            device_key: self.parameters.action_device_key.unwrap_or(0),
            group_key: self.parameters.action_group_key.unwrap_or(1),
            group_mask: self.parameters.action_group_mask.unwrap_or(1),
            at_ns: Some(at_ns),
        };
        // 0 is no request.
        let request = (shot.number % 0xffff) as u16 + 1;
        let doubt = send_action(
            SocketAddrV4::new(self.found.address, gvcp::PORT),
            &command,
            request,
            attempt_patience(Duration::from_nanos(lead_ns)),
        )?;
        let host = self.camera_clock.host_of(at_ns);
        let host = host.ok_or("its clock was never read")?;
        Ok((host, doubt))
    }

    /// A line started the exposure, perhaps before the daemon heard of the trigger.
    pub(super) fn shoot_line(
        &mut self,
        shot: &Shot,
        stats: &mut ShotStats,
        take: &mut dyn FnMut(Frame),
    ) -> Result<(), Fault> {
        let earliest = Timestamp(shot.trigger.0.saturating_sub(LINE_LEAD.as_nanos() as u64));
        self.keep_newest(stats);
        let mut came = false;
        while let Some((time, buffer)) = self.kept.pop_front() {
            if time >= earliest && !came {
                self.deliver(time, buffer, stats, take);
                came = true;
            } else {
                self.frames.give_back(buffer);
                stats.unused += 1;
            }
        }
        let came = came || self.await_triggered(shot, (earliest, None), stats, take)?;
        self.miss(came, shot, stats)
    }

    /// Hands over a copy of the newest frame that a signal of the line started. It raises none, and the frame stays
    /// where the next shot finds it.
    pub(super) fn look_at_line(&mut self, stats: &mut ShotStats, take: &mut dyn FnMut(Frame)) {
        self.keep_newest(stats);
        match self.kept.back() {
            Some((time, buffer)) => self.hand_copy(*time, buffer, stats, take),
            None => stats.lost.push(NO_SIGNAL.into()),
        }
    }

    /// The last frame before the trigger and the first from then on.
    pub(super) fn shoot_free_run(
        &mut self,
        shot: &Shot,
        stats: &mut ShotStats,
        take: &mut dyn FnMut(Frame),
    ) -> Result<(), Fault> {
        self.keep_newest(stats);
        while self
            .kept
            .back()
            .is_none_or(|(time, _)| *time < shot.trigger)
        {
            match self.next_arrival(shot, shot.deadline)? {
                Some(Arrival::Whole(buffer)) => self.keep(buffer, stats),
                Some(Arrival::Damaged(why, _)) => stats.lost.push(why),
                Some(Arrival::Nothing) => {}
                None => break,
            }
        }
        let after = self.kept.iter().position(|(time, _)| *time >= shot.trigger);
        let before = after.map_or(self.kept.len().checked_sub(1), |i| i.checked_sub(1));
        let kept = std::mem::take(&mut self.kept);
        for (i, (time, buffer)) in kept.into_iter().enumerate() {
            if Some(i) == before || Some(i) == after {
                self.deliver(time, buffer, stats, take);
            } else {
                self.frames.give_back(buffer);
                stats.unused += 1;
            }
        }
        self.miss(after.is_some(), shot, stats)
    }

    /// Tells of a frame that did not come, and finds out whether the camera is still there.
    fn miss(&mut self, came: bool, shot: &Shot, stats: &mut ShotStats) -> Result<(), Fault> {
        if came || shot.abandoned.load(Ordering::Relaxed) {
            return Ok(());
        }
        if stats.lost.is_empty() {
            let waited = self.clock.timestamp().nanoseconds_since(shot.trigger) as f64 / 1e9;
            stats.lost.push(format!(
                "no frame arrived within {waited:.2} s of the trigger"
            ));
        }
        self.check()
    }
}

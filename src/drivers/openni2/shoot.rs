//! The shots of a depth camera: bursts of complete frames with their exposure times, and polling between shots.

use super::camera::Camera;
use super::clock::Anchor;
use super::frame_check::complete_rows;
use super::settings;
use super::stream;
use crate::drivers::live::{CameraInfo, Device, Fault, Shot, ShotStats};
use crate::frame::{Frame, Picture, Stream, Timestamp};
use crate::words::count;
use std::time::{Duration, Instant};

/// What a shot has so far.
struct Burst {
    stats: ShotStats,
    anchor: Option<Anchor>,
    /// Frames of depth and of colour that were handed over.
    taken: [u32; 2],
    /// Frames of each that a shot needs.
    wanted: [u32; 2],
    /// The number of the newest frame of each.
    numbers: [Option<i32>; 2],
}

impl Burst {
    fn has_enough(&self, which: usize) -> bool {
        self.taken[which] >= self.wanted[which]
    }

    fn is_complete(&self) -> bool {
        self.has_enough(0) && self.has_enough(1)
    }

    /// Counts the frames that did not come between the last one and this.
    fn follow(&mut self, which: usize, number: i32) {
        let missed = self.numbers[which]
            .replace(number)
            .map_or(0, |last| i64::from(number) - i64::from(last) - 1);
        // A file that begins again counts from one.
        if (1..1000).contains(&missed) {
            let of = NAMES[which];
            self.stats.lost.push(format!(
                "{} before number {number} did not arrive",
                count(missed as usize, &format!("{of} frame"))
            ));
        }
    }
}

/// Of depth and of colour.
const NAMES: [&str; 2] = ["depth", "color"];
const STREAMS: [Stream; 2] = [Stream::Depth, Stream::DepthColor];
const ENCODINGS: [&str; 2] = ["16UC1", "rgb8"];

impl Device for Camera {
    fn info(&self) -> &CameraInfo {
        &self.info
    }

    fn shoot(&mut self, shot: &Shot, take: &mut dyn FnMut(Frame)) -> Result<ShotStats, Fault> {
        if !self.runs {
            self.start()?;
        } else if !self.is_file() {
            self.drop_old_frames()?;
        }
        let outcome = self.burst(shot, self.parameters.burst(), take);
        if self.parameters.take_turns() {
            self.stop();
        }
        outcome
    }

    fn look(&mut self, shot: &Shot, take: &mut dyn FnMut(Frame)) -> Result<ShotStats, Fault> {
        // A stream that does not run would take longer to start than a press may wait.
        if !self.runs {
            return Ok(ShotStats::default());
        }
        if !self.is_file() {
            self.drop_old_frames()?;
        }
        self.burst(shot, 1, take)
    }

    fn idle(&mut self) -> Result<(), Fault> {
        let gone = self.device.gone();
        if let Some(why) = gone {
            return Err(Fault::Away(format!("{}: {why}", self.device.uri())));
        }
        if self.is_file() {
            let there = std::path::Path::new(self.device.uri()).exists();
            let missing = || Fault::Away(format!("{} is no longer there", self.device.uri()));
            return there.then_some(()).ok_or_else(missing);
        }
        if !self.runs {
            return Ok(());
        }
        self.drop_old_frames()?;
        self.see_each_stream()?;
        settings::still_registered(&self.parameters, &self.device)
    }
}

impl Camera {
    /// Takes what waits in the library: it was exposed before.
    fn drop_old_frames(&self) -> Result<(), Fault> {
        for stream in &self.streams {
            // One at most waits, or a newer one that took its place.
            for _ in 0..2 {
                if stream::wait(&[stream], Duration::ZERO)?.is_none() {
                    break;
                }
                stream.read()?;
            }
        }
        Ok(())
    }

    /// Each stream gives a frame, and the clock runs.
    fn see_each_stream(&mut self) -> Result<(), Fault> {
        let mut seen = vec![false; self.streams.len()];
        let limit = self.parameters.silence();
        let begin = Instant::now();
        while seen.contains(&false) {
            let left = limit.saturating_sub(begin.elapsed());
            if left.is_zero() {
                return Err(self.silent(limit));
            }
            let Some(which) = self.wait(left)? else {
                continue;
            };
            let arrival = self.host.timestamp();
            let device_us = self.streams[which].read()?.map(|f| f.facts().timestamp);
            if let Some(device_us) = device_us {
                let known = self.clock.see(which, device_us, arrival);
                known.map_err(|why| Fault::Away(format!("{}: {why}", self.device.uri())))?;
                seen[which] = true;
            }
        }
        Ok(())
    }

    fn burst(
        &mut self,
        shot: &Shot,
        each: u32,
        take: &mut dyn FnMut(Frame),
    ) -> Result<ShotStats, Fault> {
        let mut burst = Burst {
            stats: ShotStats::default(),
            anchor: None,
            taken: [0; 2],
            wanted: [each, if self.streams.len() == 2 { each } else { 0 }],
            numbers: [None; 2],
        };
        let silence = self.parameters.silence();
        let mut newest = Instant::now();
        while !burst.is_complete() {
            let left = shot.remaining();
            if left.is_zero() {
                break;
            }
            if newest.elapsed() > silence {
                return Err(self.silent(silence));
            }
            let Some(which) = self.wait(left)? else {
                continue;
            };
            newest = Instant::now();
            let arrival = self.host.timestamp();
            self.receive(which, arrival, shot, &mut burst, take)?;
        }
        Ok(burst.stats)
    }

    /// Takes one frame that has come.
    fn receive(
        &mut self,
        which: usize,
        arrival: Timestamp,
        shot: &Shot,
        burst: &mut Burst,
        take: &mut dyn FnMut(Frame),
    ) -> Result<(), Fault> {
        let Some(found) = self.streams[which].read()? else {
            return Ok(());
        };
        let facts = found.facts();
        let (number, device_us) = (facts.frame_index, facts.timestamp);
        burst.follow(which, number);
        let clock = self.clock.see(which, device_us, arrival);
        let rows = clock.and_then(|()| complete_rows(&self.expected[which], facts, found.bytes()));
        let timestamp = self.exposed(burst, device_us, arrival);
        let picture = match rows {
            Ok(_) if burst.has_enough(which) || timestamp < shot.trigger => {
                burst.stats.unused += 1;
                return Ok(());
            }
            Ok((step, rows)) => self.picture(which, step, rows),
            Err(why) => Err(why),
        };
        match picture {
            Ok(picture) => {
                burst.taken[which] += 1;
                take(Frame {
                    camera: self.id.clone(),
                    stream: STREAMS[which],
                    timestamp,
                    picture,
                });
            }
            Err(why) => {
                let lost = format!("{} frame {number}: {why}", NAMES[which]);
                burst.stats.lost.push(lost);
            }
        }
        Ok(())
    }

    /// The one copy of a frame: from the library's memory into the pool's.
    fn picture(&self, which: usize, step: u32, rows: &[u8]) -> Result<Picture, String> {
        let buffer = self.pool.take(rows.len());
        let mut buffer = buffer.ok_or("no memory for a frame: raise capture.memory_mb")?;
        buffer.write(rows);
        let [width, height] = self.expected[which].size;
        Ok(Picture::Raw {
            width,
            height,
            encoding: ENCODINGS[which].into(),
            step,
            data: buffer.freeze(),
        })
    }

    /// The start of a frame's exposure. A file's frames are exposed, in a manner of speaking, when they are read.
    fn exposed(&self, burst: &mut Burst, device_us: u64, arrival: Timestamp) -> Timestamp {
        if self.is_file() {
            return arrival;
        }
        let anchor = burst.anchor.or_else(|| self.clock.anchor(device_us));
        burst.anchor = anchor;
        let arrival = anchor.map_or(arrival, |a| a.arrival(device_us));
        Timestamp(arrival.0.saturating_sub(self.parameters.latency_ns()))
    }
}

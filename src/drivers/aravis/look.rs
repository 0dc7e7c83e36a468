//! Takes the pictures of a look with an open camera: whole ones as for a capture, or small ones where the camera joins
//! pixels and that keeps a press waiting no longer. After each small picture the camera is as it was, or lost.

use super::binning::BinnedLooks;
use super::camera::OpenCamera;
use super::parameters::TriggerMode;
use crate::drivers::live::{Fault, Shot, ShotStats};
use crate::frame::Frame;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How long a picture of the trial may take.
const TRIAL_PATIENCE: Duration = Duration::from_secs(2);

impl OpenCamera {
    /// Takes the frames of a capture. If small pictures make it miss its frame, no more are taken.
    pub(super) fn capture(
        &mut self,
        shot: &Shot,
        take: &mut dyn FnMut(Frame),
    ) -> Result<ShotStats, Fault> {
        let now = Instant::now();
        let was_small = self.binned.as_mut().is_some_and(|b| b.was_small(now));
        let stats = self.shoot(shot, take)?;
        if was_small && !stats.lost.is_empty() {
            self.give_up("a capture right after a small one lost its frame");
        }
        Ok(stats)
    }

    /// Takes a picture for a look.
    pub(super) fn look(
        &mut self,
        shot: &Shot,
        take: &mut dyn FnMut(Frame),
    ) -> Result<ShotStats, Fault> {
        if self.mode() == TriggerMode::Line {
            self.in_control()?;
            let mut stats = ShotStats::default();
            self.look_at_line(&mut stats, take);
            return Ok(stats);
        }
        let now = Instant::now();
        match self.binned.as_ref().is_some_and(|b| b.is_next(now)) {
            true => self.small_picture(shot, take),
            false => self.whole_picture(shot, take),
        }
    }

    /// Tries the way to small pictures and back when the camera is opened for the first time: with a picture before it,
    /// one between and one after.
    ///
    /// # Errors
    /// If the camera did not come back as it was, or is away.
    pub(super) fn try_binned_looks(&mut self) -> Result<(), Fault> {
        if self.binned.as_ref().is_some_and(BinnedLooks::needs_trial) {
            self.trial()?;
        }
        if let Some(binned) = &mut self.binned {
            binned.end_trial();
        }
        self.info.remarks.extend(self.why_whole());
        Ok(())
    }

    fn trial(&mut self) -> Result<(), Fault> {
        let mut came = 0;
        let begun = Instant::now();
        self.whole_picture(&self.trial_shot(), &mut |_| came += 1)?;
        let whole_took = begun.elapsed();
        let begun = Instant::now();
        self.small_picture(&self.trial_shot(), &mut |_| came += 1)?;
        // A camera that is back and not ready for a trigger yet would miss a press, or keep it waiting.
        self.whole_picture(&self.trial_shot(), &mut |_| came += 1)?;
        let took = begun.elapsed().saturating_sub(whole_took);
        if came < 3 {
            self.give_up(&format!("{came} of 3 pictures of a trial arrived"));
        }
        let binned = self.binned.as_ref();
        if let Some(why) = binned.and_then(|b| b.does_not_pay(Some(took))) {
            self.give_up(&why);
        }
        Ok(())
    }

    fn trial_shot(&self) -> Shot {
        Shot {
            number: 0,
            trigger: self.clock.timestamp(),
            deadline: self.clock.now() + TRIAL_PATIENCE,
            clock: self.clock,
            abandoned: Arc::default(),
        }
    }

    fn whole_picture(
        &mut self,
        shot: &Shot,
        take: &mut dyn FnMut(Frame),
    ) -> Result<ShotStats, Fault> {
        let begun = Instant::now();
        let mut has_come = false;
        let mut stats = self.shoot(shot, &mut |frame| {
            has_come = true;
            take(frame);
        })?;
        stats.why_whole = self.why_whole();
        if let Some(binned) = self.binned.as_mut().filter(|_| has_come) {
            binned.took_whole(begun.elapsed(), Instant::now());
        }
        Ok(stats)
    }

    /// Takes a small picture, and brings the camera back at once, whatever came of it.
    fn small_picture(
        &mut self,
        shot: &Shot,
        take: &mut dyn FnMut(Frame),
    ) -> Result<ShotStats, Fault> {
        let begun = Instant::now();
        match self.enter() {
            Ok(()) => {}
            Err(Fault::Refused {
                field,
                asked,
                found,
            }) => {
                self.come_back()?;
                self.give_up(&format!("{field} was asked for {asked} and is {found}"));
                return self.whole_picture(shot, take);
            }
            Err(away) => return Err(away),
        }
        let mut has_come = false;
        // A camera that is lost is opened anew, with all its settings.
        let mut stats = self.shoot(shot, &mut |frame| {
            has_come = true;
            take(frame);
        })?;
        self.come_back()?;
        stats.is_binned = true;
        if let Some(binned) = &mut self.binned {
            let took = has_come.then(|| begun.elapsed());
            binned.took_small(took, Instant::now());
        }
        Ok(stats)
    }

    fn enter(&mut self) -> Result<(), Fault> {
        let Some(binned) = &self.binned else {
            return Ok(());
        };
        binned.enter(&self.camera)?;
        self.frames.expect(binned.small_size());
        Ok(())
    }

    /// Brings the camera back. One that is not as a capture needs it is lost, and no more small pictures are taken.
    fn come_back(&mut self) -> Result<(), Fault> {
        let Some(binned) = &self.binned else {
            return Ok(());
        };
        // Whatever becomes of the camera, no small picture is taken for a whole one from here on.
        self.frames.expect(binned.whole_size());
        match binned.leave(&self.camera) {
            Err(fault @ Fault::Refused { .. }) => {
                let why = format!("it did not come back from a small one ({fault})");
                self.give_up(&why);
                Err(Fault::Away(format!(
                    "it did not come back from a small one ({fault}), and is opened anew"
                )))
            }
            came => came,
        }
    }

    fn give_up(&self, why: &str) {
        if let Some(binned) = &self.binned {
            binned.give_up(why);
        }
    }

    fn why_whole(&self) -> Option<String> {
        let binned = self.binned.as_ref()?;
        binned.why_whole().map(Into::into)
    }
}

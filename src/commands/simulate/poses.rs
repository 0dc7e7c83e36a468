//! `scand simulate --poses`: one object in several poses, a capture each, and what happens to it in between.

use crate::range::millimetres;
use scand_lab::{CaptureFault, Exchange, Options, Pose};
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Several poses")]
pub(super) struct PoseArgs {
    /// The object's poses, a capture each: upright, flip, side, side:DEGREES, turn:DEGREES, any. It rests on the table
    /// in each, and is put down up to 10 mm beside the middle in all but the first.
    #[arg(long, value_name = "LIST", value_delimiter = ',', conflicts_with_all = ["captures", "calibration_session"])]
    poses: Vec<Pose>,
    /// The object's number, which the triggers name.
    #[arg(long, value_name = "NUMBER", conflicts_with = "calibration_session")]
    subject: Option<String>,
    /// Write the object's pose in each capture into this file.
    #[arg(long, value_name = "FILE.json", conflicts_with = "calibration_session")]
    pub poses_truth: Option<PathBuf>,
    /// Break a ball of this radius out of the object's upper edge before a capture (counted from 0).
    #[arg(long, value_name = "CAPTURE=LENGTH", value_parser = parse_fault)]
    chip: Vec<CaptureFault>,
    /// Break a ball of this radius out of the middle of the top, or out of a hollow's floor, before a capture.
    #[arg(long, value_name = "CAPTURE=LENGTH", value_parser = parse_fault, conflicts_with = "chip")]
    pit: Vec<CaptureFault>,
    /// Show something else in a capture: a shape, bigger:PERCENT, taller:PERCENT, or handle-up:MM for a mug.
    #[arg(long, value_name = "CAPTURE=WHAT", value_parser = parse_exchange)]
    exchanged: Vec<Exchange>,
    /// Put a prop of this width, in the backdrop's cloth, beside the object in a capture.
    #[arg(long, value_name = "CAPTURE=LENGTH", value_parser = parse_fault)]
    prop: Vec<CaptureFault>,
    /// Write which pixels show a prop, as masks of what is to be ignored.
    #[arg(long)]
    props_ignored: bool,
    /// Remove a piece of this radius from the object's outline in the first colour camera's picture of a capture, as
    /// glare would.
    #[arg(long, value_name = "CAPTURE=LENGTH", value_parser = parse_fault)]
    lost_piece: Vec<CaptureFault>,
    /// Standard deviation of the error of the calibrated principal points.
    #[arg(long, value_name = "PX")]
    calibration_px: Option<f64>,
    /// Record a calibration that is too large by this.
    #[arg(long, value_name = "PERCENT", allow_negative_numbers = true)]
    calibration_scale_percent: Option<f64>,
}

impl PoseArgs {
    /// Takes what was given.
    pub(super) fn take_into(self, options: &mut Options) {
        if !self.poses.is_empty() {
            options.poses = self.poses;
        }
        options.subject = self.subject.or(options.subject.take());
        let faults = &mut options.faults;
        faults.chip_mm.extend(self.chip);
        faults.pit_mm.extend(self.pit);
        faults.exchanged.extend(self.exchanged);
        faults.prop_mm.extend(self.prop);
        faults.props_ignored |= self.props_ignored;
        faults.lost_piece_mm.extend(self.lost_piece);
        super::take(&mut faults.calibration_px, self.calibration_px);
        let scale = self.calibration_scale_percent;
        super::take(&mut faults.calibration_scale_percent, scale);
    }
}

/// A capture's number and what follows it.
fn split(text: &str) -> Option<(usize, &str)> {
    let (capture, rest) = text.split_once('=')?;
    Some((capture.parse().ok()?, rest))
}

fn parse_fault(text: &str) -> Result<CaptureFault, String> {
    let parsed = split(text).and_then(|(capture, amount)| {
        let amount = millimetres(amount).ok()?;
        Some(CaptureFault { capture, amount })
    });
    parsed.ok_or_else(|| format!("{text:?} is not CAPTURE=LENGTH, such as 1=6mm"))
}

fn parse_exchange(text: &str) -> Result<Exchange, String> {
    let expected = || format!("{text:?} is not CAPTURE=WHAT, such as 1=bigger:1");
    let (capture, with) = split(text).ok_or_else(expected)?;
    let with = with.parse()?;
    Ok(Exchange { capture, with })
}

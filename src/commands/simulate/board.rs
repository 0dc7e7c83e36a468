//! `scand simulate --calibration-session`: writes a recording to calibrate from, and its truth in separate files.

use crate::commands::{refuse_to_replace, wrong_usage};
use crate::range::millimetres;
use crate::recording::Compression;
use crate::storage::write_atomically;
use crate::words::count as counted;
use anyhow::Context;
use scand_lab::{BoardOptions, BoardSession, Options, PlacementFault, write_board_session};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Calibration sessions")]
pub(super) struct BoardArgs {
    /// Show a calibration board instead of an object, at one placement after the other. The rig is the same as for an
    /// object, except that its depth camera is 1.3 m away by default.
    #[arg(long, conflicts_with_all = [
        "preset", "captures", "masks", "textured", "rings", "no_background", "empty_table", "doubtful_calibration",
        "chip", "pit", "exchanged", "prop", "props_ignored", "lost_piece", "calibration_px", "calibration_scale_percent",
    ])]
    pub calibration_session: bool,
    /// The board, such as checkerboard:11x8:25mm or charuco:11x8:25mm:two-sided.
    #[arg(long, value_name = "BOARD", requires = "calibration_session")]
    board: Option<String>,
    /// The board that the recording describes, by default the same.
    #[arg(long, value_name = "BOARD", requires = "calibration_session")]
    declared_board: Option<String>,
    /// How often the board is shown; the first time it lies on the table.
    #[arg(long, value_name = "N", requires = "calibration_session")]
    placements: Option<usize>,
    /// By how much the print on the back is displaced; a plain number counts millimetres.
    #[arg(long, value_name = "LENGTH", value_parser = millimetres, requires = "calibration_session")]
    misprint_mm: Option<f64>,
    /// How far the edges of the board's squares lie off its middle: along the rows, and down the columns. Plain numbers
    /// count millimetres.
    #[arg(long, value_name = "LENGTH,LENGTH", value_parser = parse_bend, allow_hyphen_values = true,
        requires = "calibration_session")]
    board_bend_mm: Option<[f64; 2]>,
    /// By how many per cent the board's squares are longer along the rows than their mean, and shorter down the
    /// columns.
    #[arg(
        long,
        value_name = "PERCENT",
        allow_negative_numbers = true,
        requires = "calibration_session"
    )]
    board_stretch_percent: Option<f64>,
    /// Write where the board was at each placement into this file.
    #[arg(long, value_name = "FILE.json", requires = "calibration_session")]
    placements_truth: Option<PathBuf>,
    /// Move the board during a placement (counted from 0).
    #[arg(long, value_name = "PLACEMENT=MM", value_parser = parse_move, requires = "calibration_session")]
    moved_placement: Vec<PlacementFault>,
    /// Blur a placement, as if out of focus or shaken.
    #[arg(long, value_name = "PLACEMENT=PX", value_parser = parse_fault, requires = "calibration_session")]
    blurred_placement: Vec<PlacementFault>,
    /// Leave the board where it was, at a placement.
    #[arg(long, value_name = "PLACEMENT", requires = "calibration_session")]
    duplicate_placement: Vec<usize>,
    /// Turn the board by 180 degrees in its plane, at a placement.
    #[arg(long, value_name = "PLACEMENT", requires = "calibration_session")]
    turned_over_placement: Vec<usize>,
    /// Hide the board from a camera.
    #[arg(long, value_name = "ID", requires = "calibration_session")]
    blind: Vec<String>,
}

fn parse_fault(text: &str) -> Result<PlacementFault, String> {
    let parsed = placement_fault(text, |amount| amount.parse().ok());
    parsed.ok_or_else(|| format!("{text:?} is not PLACEMENT=AMOUNT, such as 3=1.5"))
}

fn parse_move(text: &str) -> Result<PlacementFault, String> {
    let parsed = placement_fault(text, |amount| millimetres(amount).ok());
    parsed.ok_or_else(|| format!("{text:?} is not PLACEMENT=LENGTH, such as 3=1.5mm"))
}

fn placement_fault(text: &str, amount: impl Fn(&str) -> Option<f64>) -> Option<PlacementFault> {
    let (placement, of) = text.split_once('=')?;
    Some(PlacementFault {
        placement: placement.parse().ok()?,
        amount: amount(of)?,
    })
}

fn parse_bend(text: &str) -> Result<[f64; 2], String> {
    let expected = || format!("{text:?} is not LENGTH,LENGTH, such as 0.5mm,0mm");
    let (along_rows, down_columns) = text.split_once(',').ok_or_else(expected)?;
    let number = |part: &str| millimetres(part).map_err(|_| expected());
    Ok([number(along_rows)?, number(down_columns)?])
}

impl BoardArgs {
    /// Refuses to replace the file of the placements.
    pub(super) fn refuse_to_replace(&self, force: bool) -> anyhow::Result<()> {
        refuse_to_replace(
            "--placements-truth",
            self.placements_truth.as_deref(),
            force,
        )
    }

    fn options(self) -> BoardOptions {
        let mut options = BoardOptions::default();
        super::take(&mut options.board, self.board);
        super::take(&mut options.placements, self.placements);
        super::take(&mut options.misprint_mm, self.misprint_mm);
        super::take(&mut options.bend_mm, self.board_bend_mm);
        super::take(&mut options.stretch_percent, self.board_stretch_percent);
        options.declared = self.declared_board;
        let faults = &mut options.faults;
        faults.moved_mm = self.moved_placement;
        faults.blurred_px = self.blurred_placement;
        faults.duplicate = self.duplicate_placement;
        faults.turned_over = self.turned_over_placement;
        faults.blind = self.blind;
        options
    }
}

/// Simulates and writes.
pub(super) fn run(
    options: Options,
    args: BoardArgs,
    out: &Path,
    truth: Option<&Path>,
    compression: Compression,
) -> anyhow::Result<ExitCode> {
    let placements_truth = args.placements_truth.clone();
    let session = BoardSession::new(options, args.options()).map_err(wrong_usage)?;
    write_board_session(&session, out, compression)
        .with_context(|| format!("cannot write {}", out.display()))?;
    let (count, board) = (session.placements().len(), session.board());
    outln!(
        "{}: {} of {board}",
        out.display(),
        counted(count, "placement")
    );
    if let Some(path) = truth {
        write_atomically(path, session.truth().to_toml().as_bytes())?;
        outln!(
            "{}: {}",
            path.display(),
            counted(session.truth().cameras.len(), "camera")
        );
    }
    if let Some(path) = placements_truth {
        write_atomically(&path, &placements_json(&session)?)?;
        outln!("{}: {count} poses", path.display());
    }
    Ok(ExitCode::SUCCESS)
}

/// Poses as translation in metres and quaternion x, y, z, w.
fn placements_json(session: &BoardSession) -> anyhow::Result<Vec<u8>> {
    let pose = |pose: &nalgebra::Isometry3<f64>| {
        serde_json::json!({
            "translation": pose.translation.vector.as_slice(),
            "rotation": pose.rotation.coords.as_slice(),
        })
    };
    let placements = session.placements().iter();
    let document = serde_json::json!({
        "board": session.board().to_string(),
        "rig_from_board": placements.map(|p| pose(&p.rig_from_board)).collect::<Vec<_>>(),
        "front_from_back": pose(&session.front_from_back()),
    });
    Ok(serde_json::to_vec_pretty(&document)?)
}

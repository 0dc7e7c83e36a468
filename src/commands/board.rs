//! `scand board`: a calibration board to print.

use super::{refuse_to_replace, wrong_usage};
use crate::calibration::{Board, BoardKind};
use crate::output::{Paper, board_sheet};
use crate::storage::write_atomically;
use std::path::PathBuf;
use std::process::ExitCode;

/// Print a calibration board: a PDF file, true to scale, with rulers on it.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// What its white squares hold.
    #[arg(long, value_enum)]
    kind: Kind,
    /// Inner corners: one less than squares in each direction.
    #[arg(long, value_name = "COLUMNSxROWS", default_value = "11x8")]
    size: String,
    /// Side of a square, with its unit.
    #[arg(long, value_name = "LENGTH", default_value = "25mm")]
    square: String,
    /// Two pages, one for each side of a plate, with ids of their own.
    #[arg(long)]
    two_sided: bool,
    /// Thickness of the plate, with its unit; it need not be exact.
    #[arg(long, value_name = "LENGTH", requires = "two_sided")]
    thickness: Option<String>,
    /// Side of a marker, with its unit, if not three quarters of a square.
    #[arg(long, value_name = "LENGTH")]
    marker: Option<String>,
    /// Dictionary of the markers, if not the smallest of DICT_4X4 that does.
    #[arg(long, value_name = "NAME")]
    dictionary: Option<String>,
    /// Paper: auto, custom (a page of the board's size), a4, letter, a3, a2, a1, a0 or 2a0.
    #[arg(long, default_value = "auto")]
    paper: Paper,
    /// The file to write.
    #[arg(long, value_name = "FILE.pdf")]
    out: PathBuf,
    /// Replace the file that is there
    #[arg(long)]
    force: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Kind {
    /// Nothing: the paper's board.
    Checkerboard,
    /// Markers: a board that is cut off is recognised too, and each side of a two-sided one.
    Charuco,
}

/// Writes the file and says what `scand calibrate` is to be told.
///
/// # Errors
/// If there is no such board, it does not fit on the paper, or the file is there already or cannot be written.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    refuse_to_replace("--out", Some(&args.out), args.force)?;
    let board: Board = text(&args).parse().map_err(wrong_usage)?;
    let (file, paper) = board_sheet(&board, args.paper).map_err(wrong_usage)?;
    write_atomically(&args.out, &file)?;
    let pages = board.faces().len();
    let markers = match board.kind {
        BoardKind::Checkerboard => String::new(),
        BoardKind::Charuco(markers) => format!(", markers of {}", markers.dictionary),
    };
    outln!(
        "{}: {pages} page{} on {paper}{markers}; print at 100 % and measure the rulers. The board is --board {board}",
        args.out.display(),
        if pages == 1 { "" } else { "s" }
    );
    if board.is_symmetric() {
        outln!(
            "it looks the same turned by 180 degrees: one corner more or less a row would be better"
        );
    }
    Ok(ExitCode::SUCCESS)
}

/// The board's compact text.
fn text(args: &Args) -> String {
    let kind = match args.kind {
        Kind::Checkerboard => "checkerboard",
        Kind::Charuco => "charuco",
    };
    let mut text = format!("{kind}:{}:{}", args.size, args.square);
    if args.two_sided {
        text += ":two-sided";
    }
    let options = [
        ("thickness", &args.thickness),
        ("marker", &args.marker),
        ("dictionary", &args.dictionary),
    ];
    for (name, value) in options {
        if let Some(value) = value {
            text += &format!(":{name}={value}");
        }
    }
    text
}

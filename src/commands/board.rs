//! `scand board`: writes a calibration board to print.

use super::{refuse_to_replace, wrong_usage};
use crate::calibration::{Board, BoardKind};
use crate::output::{Paper, board_sheet, largest_square_mm};
use crate::storage::write_atomically;
use std::path::PathBuf;
use std::process::ExitCode;

/// Write a calibration board as a PDF to print true to scale, with rulers to check the scale.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  scand board --kind charuco --out board.pdf
  scand board --kind charuco --square 25mm --paper a3 -o board.pdf
  scand board --kind charuco --two-sided --thickness 5mm -o board.pdf")]
pub struct Args {
    /// Whether the white squares have markers.
    #[arg(long, value_enum)]
    kind: Kind,
    /// Number of inner corners, one fewer than squares in each direction.
    #[arg(long, value_name = "COLUMNSxROWS", default_value = "11x8")]
    size: String,
    /// Side of a square, with its unit, such as 25mm; by default the largest with which the board fits the paper.
    #[arg(long, value_name = "LENGTH")]
    square: Option<String>,
    /// Make two pages with different markers, one for each side of a plate.
    #[arg(long)]
    two_sided: bool,
    /// Thickness of the plate, with its unit; it need not be exact.
    #[arg(long, value_name = "LENGTH", requires = "two_sided")]
    thickness: Option<String>,
    /// Side of a marker, with its unit; by default three quarters of a square.
    #[arg(long, value_name = "LENGTH")]
    marker: Option<String>,
    /// Dictionary of the markers; by default the smallest DICT_4X4 that has enough.
    #[arg(long, value_name = "NAME")]
    dictionary: Option<String>,
    /// Paper: auto (A4, or with --square the smallest sheet of the A series that has room), custom (a page of the
    /// board's size), a4, letter, a3, a2, a1, a0 or 2a0.
    #[arg(long, default_value = "auto")]
    paper: Paper,
    /// The file to write.
    #[arg(short, long, value_name = "FILE.pdf")]
    out: PathBuf,
    /// Replace an existing file
    #[arg(short, long)]
    force: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Kind {
    /// No markers, as on the board of the paper.
    Checkerboard,
    /// Markers, so that a board that is cut off is recognised too, and each side of a two-sided board.
    Charuco,
}

/// Writes the file and prints the options for `scand calibrate`.
///
/// # Errors
/// If there is no such board, it does not fit on the paper, or the file already exists or cannot be written.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    refuse_to_replace("--out", Some(&args.out), args.force)?;
    let board = board(&args)?;
    let (file, paper) = board_sheet(&board, args.paper).map_err(wrong_usage)?;
    write_atomically(&args.out, &file)?;
    let pages = board.faces().len();
    let markers = match board.kind {
        BoardKind::Checkerboard => String::new(),
        BoardKind::Charuco(markers) => format!(", markers of {}", markers.dictionary),
    };
    outln!(
        "{}: {pages} page{} on {paper}{markers}; print at 100 % on paper of this size and measure the rulers. The board \
         is --board {board}",
        args.out.display(),
        if pages == 1 { "" } else { "s" }
    );
    if let Some(mm) = larger_than_a4(&args, &board, &paper) {
        outln!("it does not fit on A4: without --square, it would have squares of {mm} mm and fit");
    }
    if board.is_symmetric() {
        outln!(
            "the board looks the same when turned by 180 degrees: use one corner more or fewer in \
            each row"
        );
    }
    Ok(ExitCode::SUCCESS)
}

/// The board that is asked for; where no length of its squares is given, with the largest that fit the paper.
fn board(args: &Args) -> anyhow::Result<Board> {
    if let Some(square) = &args.square {
        return text(args, square).parse().map_err(wrong_usage);
    }
    let any: Board = text(args, "25mm").parse().map_err(wrong_usage)?;
    let square = match (args.paper, largest_square_mm(&any, args.paper)) {
        (_, Some(mm)) => format!("{mm}mm"),
        (Paper::Custom, None) => {
            return Err(wrong_usage(
                "--paper custom needs --square, which sets the size of the sheet",
            ));
        }
        (_, None) => return Err(wrong_usage("no squares of 1 mm or more fit the paper")),
    };
    text(args, &square).parse().map_err(wrong_usage)
}

/// Of a board that was given no paper and does not fit on A4: the squares with which it would.
fn larger_than_a4(args: &Args, board: &Board, paper: &str) -> Option<f64> {
    let is_larger = args.paper == Paper::Smallest && paper != "A4";
    is_larger.then(|| largest_square_mm(board, Paper::Smallest))?
}

/// The board's compact text, with squares of this length.
fn text(args: &Args, square: &str) -> String {
    let kind = match args.kind {
        Kind::Checkerboard => "checkerboard",
        Kind::Charuco => "charuco",
    };
    let mut text = format!("{kind}:{}:{square}", args.size);
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

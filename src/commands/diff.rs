//! `scand diff A B`: whether two models of one object are the same, and if not, where they differ.

use super::evaluate::parse_samples;
use super::refuse_to_replace;
use crate::evaluate::load::load;
use crate::evaluate::picture::{self, Row};
use crate::evaluate::{Difference, DifferenceParameters, Side, difference, table};
use crate::mesh::Mesh;
use crate::output::encode_png;
use crate::storage::write_atomically;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Exit code where the comparison itself failed: as with `diff`, 1 is an answer.
const EXIT_TROUBLE: u8 = 2;

/// Compare two models of one object, neither of which is the truth. Ends with 0 where they are the same
/// within the tolerance, 1 where they differ, 2 where they cannot be compared.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The first model: .ply, .glb or .obj.
    a: PathBuf,
    /// The second model.
    b: PathBuf,
    /// Answer with JSON.
    #[arg(long)]
    json: bool,
    /// Draw the distances, from five sides, into this PNG file.
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Replace the file that is there
    #[arg(long, requires = "picture")]
    force: bool,
    /// Surfaces nowhere farther apart than this are the same, 0 to 1000; round-off is never a difference.
    #[arg(long, value_name = "MM", default_value_t = DifferenceParameters::default().tolerance_mm,
        value_parser = parse_tolerance, allow_negative_numbers = true)]
    tolerance_mm: f64,
    /// Points on each surface.
    #[arg(long, default_value_t = DifferenceParameters::default().samples, value_parser = parse_samples)]
    samples: usize,
}

/// A tolerance within reason, in millimetres.
fn parse_tolerance(text: &str) -> Result<f64, String> {
    const MOST_MM: f64 = 1000.0;
    let tolerance: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    // Not a number is in no range.
    if (0.0..=MOST_MM).contains(&tolerance) {
        Ok(tolerance)
    } else {
        Err(format!("not in 0 to {MOST_MM}"))
    }
}

/// Compares, prints, and draws if asked to.
///
/// # Errors
/// None: what goes wrong is told here, for its exit code is not that of other commands.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    match compare(&args) {
        Ok(found) => Ok(ExitCode::from(u8::from(!found.same))),
        Err(error) => {
            eprintln!("scand: {error:#}");
            Ok(ExitCode::from(EXIT_TROUBLE))
        }
    }
}

fn compare(args: &Args) -> anyhow::Result<Difference> {
    refuse_to_replace("--picture", args.picture.as_deref(), args.force)?;
    let parameters = DifferenceParameters {
        samples: args.samples,
        tolerance_mm: args.tolerance_mm,
        ..DifferenceParameters::default()
    };
    let (a, b) = (load(&args.a)?, load(&args.b)?);
    let found = difference(&a, &b, &parameters)?;
    if let Some(path) = &args.picture {
        draw(path, &found, &a.mesh, &b.mesh)?;
    }
    if args.json {
        outln!("{}", serde_json::to_string_pretty(&found)?);
    } else {
        outln!("{}", words(&found));
    }
    Ok(found)
}

fn draw(path: &Path, found: &Difference, a: &Mesh, b: &Mesh) -> anyhow::Result<()> {
    let (of_a, of_b) = (
        picture::vertex_distances(a, b),
        picture::vertex_distances(b, a),
    );
    let row = |title, mesh, signed_mm| Row {
        title,
        mesh,
        signed_mm,
    };
    let headline = format!(
        "a to b {:.3} mm, b to a {:.3} mm (means), at most {:.2} mm",
        found.a_to_b.mean_mm,
        found.b_to_a.mean_mm,
        found.a_to_b.max_mm.max(found.b_to_a.max_mm)
    );
    let picture = picture::draw(&headline, &[row("a", a, &of_a), row("b", b, &of_b)]);
    write_atomically(path, &encode_png(&picture)?)?;
    Ok(())
}

fn words(found: &Difference) -> String {
    let mut out = String::new();
    table::solid(&mut out, "a", &found.a);
    table::solid(&mut out, "b", &found.b);
    out += &format!("volume {:+.3} %\n", found.volume_change_percent);
    table::summary_head(&mut out);
    table::summary(&mut out, "a to b", Some(found.a_to_b));
    table::summary(&mut out, "b to a", Some(found.b_to_a));
    out += &format!("\nb is larger by {:+.4} mm in the mean\n", found.growth_mm);
    if !found.places.is_empty() {
        out += "farthest apart, in mm of the rig's frame:\n";
    }
    for place in &found.places {
        let [x, y, z] = place.position_mm;
        let on = match place.on {
            Side::A => "a",
            Side::B => "b",
        };
        out += &format!(
            "  {:8.3} at ({x:.1}, {y:.1}, {z:.1}) on {on}\n",
            place.distance_mm
        );
    }
    if let Some(changes) = &found.provenance {
        out += &format!(
            "provenance changed on {:.2} % of a\n",
            100.0 * changes.changed_share
        );
        for change in &changes.changes {
            let (from, to) = (change.from, change.to);
            out += &format!("  {from:?} to {to:?}: {:.2} %\n", 100.0 * change.share);
        }
    }
    out += if found.same { "same\n" } else { "different\n" };
    out
}

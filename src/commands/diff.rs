//! `scand diff A B`: tells whether two models of one object are the same, and if not, where they differ.

use super::all_is_printed;
use super::comparison::{ComparisonArgs, model_file};
use crate::evaluate::load::load;
use crate::evaluate::picture::{self, Row};
use crate::evaluate::{Difference, DifferenceParameters, Side, difference, table};
use crate::image::RgbImage;
use crate::mesh::Mesh;
use crate::range;
use std::path::PathBuf;
use std::process::ExitCode;

/// Exit code where the comparison itself failed: as with `diff`, 1 is an answer.
const EXIT_TROUBLE: u8 = 2;

/// Compare two models of one object if neither is the truth. The exit code is 0 if they are the same within the
/// tolerance, 1 if they differ, and 2 if they cannot be compared or the result cannot be printed.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  scand diff before/cup/cup-000 after/cup/cup-000
  scand diff a.glb b.glb --tolerance-mm 0.1mm")]
pub struct Args {
    /// The first model: .ply or .glb.
    a: PathBuf,
    /// The second model.
    b: PathBuf,
    #[command(flatten)]
    comparison: ComparisonArgs,
    /// The models are the same if their surfaces are nowhere farther apart than this, 0mm to 1000mm; a plain number
    /// counts millimetres. Rounding is never taken for a difference.
    #[arg(long, value_name = "LENGTH", default_value_t = DifferenceParameters::default().tolerance_mm,
        value_parser = parse_tolerance, allow_negative_numbers = true)]
    tolerance_mm: f64,
}

/// A tolerance in millimetres.
fn parse_tolerance(text: &str) -> anyhow::Result<f64> {
    Ok(range::check(
        range::millimetres(text).map_err(anyhow::Error::msg)?,
        [0.0, 1000.0],
        "",
    )?)
}

/// Compares, prints, and draws if asked to.
///
/// # Errors
/// None: errors are printed here, because their exit code is not that of other commands.
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
    args.comparison.check()?;
    let parameters = DifferenceParameters {
        samples: args.comparison.samples,
        tolerance_mm: args.tolerance_mm,
        ..DifferenceParameters::default()
    };
    let (a, b) = (load(&model_file(&args.a)?)?, load(&model_file(&args.b)?)?);
    let found = difference(&a, &b, &parameters)?;
    let draw = || draw(&found, &a.mesh, &b.mesh);
    args.comparison.print(&found, || words(&found), draw)?;
    all_is_printed()?;
    Ok(found)
}

fn draw(found: &Difference, a: &Mesh, b: &Mesh) -> RgbImage {
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
    picture::draw(&headline, &[row("a", a, &of_a), row("b", b, &of_b)])
}

fn words(found: &Difference) -> String {
    let mut out = String::new();
    table::solid(&mut out, "a", &found.a);
    table::solid(&mut out, "b", &found.b);
    out += &format!("volume {:+.3} %\n", found.volume_change_percent);
    table::summary_head(&mut out);
    table::summary(&mut out, "a to b", Some(found.a_to_b));
    table::summary(&mut out, "b to a", Some(found.b_to_a));
    let size = if found.growth_mm < 0.0 {
        "smaller"
    } else {
        "larger"
    };
    out += &format!(
        "\non average, b is {size} by {:.4} mm\n",
        found.growth_mm.abs()
    );
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
            let (from, to) = (change.from.name(), change.to.name());
            out += &format!("  {from} to {to}: {:.2} %\n", 100.0 * change.share);
        }
    }
    out += if found.same { "same\n" } else { "different\n" };
    out
}

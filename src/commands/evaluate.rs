//! `scand evaluate MODEL TRUTH`: measures how far a model is from the truth.

use super::comparison::{ComparisonArgs, model_file};
use crate::evaluate::load::load;
use crate::evaluate::picture::{self, Row};
use crate::evaluate::{Evaluation, Parameters, evaluate, table};
use crate::image::RgbImage;
use crate::mesh::Mesh;
use crate::range::millimetres;
use std::path::PathBuf;
use std::process::ExitCode;

/// Measure how far a model is from the truth. Both must be in the rig's frame, z up (a .glb is y up and is turned
/// first).
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  scand evaluate out/cup/cup-000 cup.truth.ply
  scand evaluate out/cup/cup-000 cup.truth.ply --floor-mm 1mm --picture distances.png")]
pub struct Args {
    /// The model: .ply or .glb, or the folder of a model.
    model: PathBuf,
    /// The truth: .ply or .glb, or the folder of a model.
    truth: PathBuf,
    #[command(flatten)]
    comparison: ComparisonArgs,
    /// Ignore everything at or below this height (of z), such as 1mm; a plain number counts millimetres.
    #[arg(long, value_name = "LENGTH", default_value_t = Parameters::default().floor_mm, allow_negative_numbers = true,
        value_parser = millimetres)]
    floor_mm: f64,
}

/// Measures, prints, and draws if asked to.
///
/// # Errors
/// Where a file cannot be read or written, the picture already exists, or there is nothing to measure.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    args.comparison.check()?;
    let parameters = Parameters {
        samples: args.comparison.samples,
        floor_mm: args.floor_mm,
        ..Parameters::default()
    };
    let model = load(&model_file(&args.model)?)?;
    let truth = load(&model_file(&args.truth)?)?;
    // Only models that scand made say where their surface comes from.
    if model.provenance.is_none() && truth.provenance.is_some() {
        let [model, truth] = [&args.model, &args.truth].map(|path| path.display());
        eprintln!(
            "scand: {truth}, given as the truth, is a model that scand made, and {model}, given as the model, is not: the \
             model comes first"
        );
    }
    let found = evaluate(&model, &truth.mesh, &parameters)?;
    let words = || table::table(&found);
    let draw = || draw(&found, &model.mesh, &truth.mesh);
    args.comparison.print(&found, words, draw)?;
    Ok(ExitCode::SUCCESS)
}

fn draw(found: &Evaluation, model: &Mesh, truth: &Mesh) -> RgbImage {
    let of_model = picture::vertex_distances(model, truth);
    let of_truth = picture::vertex_distances(truth, model);
    let rows = [
        Row {
            title: "model",
            mesh: model,
            signed_mm: &of_model,
        },
        Row {
            title: "truth",
            mesh: truth,
            signed_mm: &of_truth,
        },
    ];
    let accuracy = found.whole.accuracy.map_or(0.0, |s| s.mean_mm);
    let completeness = found.whole.completeness.map_or(0.0, |s| s.mean_mm);
    let score = found.whole.f_score_at(1.0).unwrap_or(0.0);
    let headline = format!(
        "F-score at 1 mm {score:.3}, accuracy {accuracy:.2} mm, completeness {completeness:.2} mm (means)"
    );
    picture::draw(&headline, &rows)
}

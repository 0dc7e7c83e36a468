//! `scand evaluate MODEL TRUTH`: how far a model is from the truth.

use super::refuse_to_replace;
use crate::evaluate::load::load;
use crate::evaluate::picture::{self, Row};
use crate::evaluate::{Evaluation, Parameters, evaluate, table};
use crate::mesh::Mesh;
use crate::output::encode_png;
use crate::storage::write_atomically;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Measure a model against the truth: both in the rig's frame, z up (a .glb is y up and turned first).
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The model: .ply, .glb or .obj.
    model: PathBuf,
    /// The truth: .ply, .glb or .obj.
    truth: PathBuf,
    /// Answer with JSON.
    #[arg(long)]
    json: bool,
    /// Draw the distances, from five sides, into this PNG file.
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Replace the file that is there
    #[arg(long, requires = "picture")]
    force: bool,
    /// Points on each surface.
    #[arg(long, default_value_t = Parameters::default().samples, value_parser = parse_samples)]
    samples: usize,
    /// What is at or below this height (of z, in millimetres) is left out.
    #[arg(long, value_name = "MM", default_value_t = Parameters::default().floor_mm, allow_negative_numbers = true)]
    floor_mm: f64,
}

/// More than this many samples cost memory and tell nothing.
const MAX_SAMPLES: usize = 20_000_000;

/// A number of samples within reason.
pub(super) fn parse_samples(text: &str) -> Result<usize, String> {
    let samples: usize = text.parse().map_err(|_| "not a whole number".to_owned())?;
    if (1..=MAX_SAMPLES).contains(&samples) {
        Ok(samples)
    } else {
        Err(format!("not in 1 to {MAX_SAMPLES}"))
    }
}

/// Measures, prints, and draws if asked to.
///
/// # Errors
/// Where a file cannot be read or written, the picture is there already, or there is nothing to measure.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    refuse_to_replace("--picture", args.picture.as_deref(), args.force)?;
    let parameters = Parameters {
        samples: args.samples,
        floor_mm: args.floor_mm,
        ..Parameters::default()
    };
    let model = load(&args.model)?;
    let truth = load(&args.truth)?;
    let found = evaluate(&model, &truth.mesh, &parameters)?;
    if let Some(path) = &args.picture {
        draw(path, &found, &model.mesh, &truth.mesh)?;
    }
    if args.json {
        outln!("{}", serde_json::to_string_pretty(&found)?);
    } else {
        outln!("{}", table::table(&found));
    }
    Ok(ExitCode::SUCCESS)
}

fn draw(path: &Path, found: &Evaluation, model: &Mesh, truth: &Mesh) -> anyhow::Result<()> {
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
    let picture = picture::draw(&headline, &rows);
    write_atomically(path, &encode_png(&picture)?)?;
    Ok(())
}

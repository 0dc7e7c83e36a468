//! `scand export`: models in the formats of other programs (`model`), and captures as datasets (`dataset`). This file
//! has the arguments and what they mean.

mod dataset;
mod model;
mod words;

pub(super) use model::find as find_models;

use super::wrong_usage;
use crate::dataset::Kind;
use crate::export::{Compression, Format};
use crate::storage::check_writable;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Highest level of detail: it leaves less than two in 100,000 vertices.
const HIGHEST_LEVEL: i64 = 8;

/// Write models in the formats of other programs, or captures as datasets for other programs that reconstruct
#[derive(Debug, clap::Args)]
#[command(after_help = "Formats:
  obj   metres, y up; with MTL and PNG       3mf   millimetres, z up; with texture
  stl   millimetres, z up; no colours        usdz  metres, y up; with texture
  glb   metres, y up; as scand replay writes it, or another level of detail, or compressed

Datasets (undistorted pictures, masks, poses; metres, z up):
  colmap, nerfstudio, openmvs

Examples:
  scand export out/cup/CAPTURE --format 3mf
  scand export out --format glb --lod 2 --compress -o web
  scand export cup.mcap --dataset colmap --model out -o datasets")]
pub struct Args {
    /// Models (a model.glb, the folder of a capture, or a folder of such folders); with --dataset, recordings
    #[arg(required = true, value_name = "MODEL|RECORDING")]
    what: Vec<PathBuf>,
    /// The format: obj, stl, 3mf, usdz or glb
    #[arg(long, value_parser = words::format, required_unless_present = "dataset", conflicts_with = "dataset")]
    format: Option<Format>,
    /// The program to make a dataset for: colmap, nerfstudio or openmvs
    #[arg(long, value_name = "PROGRAM", value_parser = words::kind)]
    dataset: Option<Kind>,
    /// Level of detail: each one has a quarter of the vertices of the one before, and half the texture's resolution
    #[arg(long, value_name = "N", default_value_t = 0, conflicts_with = "dataset",
        value_parser = clap::value_parser!(u32).range(0..=HIGHEST_LEVEL))]
    lod: u32,
    /// Make a glb smaller: with whole numbers instead of floats (quantization, the extension KHR_mesh_quantization)
    #[arg(long, value_name = "FORM", num_args = 0..=1, require_equals = true, default_missing_value = "quantization",
        conflicts_with = "dataset", value_parser = words::compression)]
    compress: Option<Compression>,
    /// Make the dataset of this capture alone; may be given several times
    #[arg(long, value_name = "ID", requires = "dataset")]
    capture: Vec<String>,
    /// Put points of this model (or of the capture's model in this folder) into the dataset
    #[arg(long, requires = "dataset")]
    model: Option<PathBuf>,
    /// Look in the recordings of this folder for notes that are newer than the models' reports
    #[arg(
        long,
        value_name = "DIR",
        default_value = ".",
        conflicts_with = "dataset"
    )]
    recordings: PathBuf,
    /// With --dataset: use this calibration (TOML) instead of the recorded one
    #[arg(long, value_name = "FILE", conflicts_with = "format")]
    calibration: Option<PathBuf>,
    /// With --dataset: read this configuration (TOML), of which `sync` and `silhouette` matter
    #[arg(short, long, value_name = "FILE", conflicts_with = "format")]
    config: Option<PathBuf>,
    /// With --dataset: set one value of the configuration; may be given several times
    #[arg(long, value_name = "KEY=VALUE", conflicts_with = "format")]
    set: Vec<String>,
    /// Write into this folder
    #[arg(short, long, value_name = "DIR", default_value = "export")]
    out: PathBuf,
    /// Replace existing files, or datasets
    #[arg(short, long)]
    force: bool,
}

/// Exports what was named. The exit code is 3 if some models could not be exported.
///
/// # Errors
/// If none could: a file is not what it should be, something exists that is not to be replaced, or cannot be written.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    match (args.format, args.dataset) {
        (Some(format), _) => {
            if args.compress.is_some() && format != Format::Glb {
                return Err(wrong_usage(words::no_compression(format)));
            }
            let models = model::find(&args.what)?;
            check_writable(&args.out)?;
            Ok(model::export(&models, format, &args))
        }
        (None, Some(kind)) => {
            dataset::export(kind, &args)?;
            Ok(ExitCode::SUCCESS)
        }
        (None, None) => Err(wrong_usage("give --format or --dataset")),
    }
}

/// The error for an existing file that must not be replaced.
fn exists(path: &Path) -> anyhow::Error {
    anyhow::anyhow!(
        "{} already exists: give --force to replace it, or another --out",
        path.display()
    )
}

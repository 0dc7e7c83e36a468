//! What the commands that compare two models share: their arguments, and how they print their results.

use super::{check_folder_of, refuse_to_replace};
use crate::image::RgbImage;
use crate::output::encode_png;
use crate::range;
use crate::storage::write_atomically;
use std::path::{Path, PathBuf};

/// Points on each surface, unless others are asked for.
const SAMPLES: usize = 200_000;

#[derive(Debug, clap::Args)]
pub(super) struct ComparisonArgs {
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
    /// Draw the distances, seen from five sides, into this PNG file.
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Replace an existing file
    #[arg(short, long, requires = "picture")]
    force: bool,
    /// Number of points on each surface.
    #[arg(long, default_value_t = SAMPLES, value_parser = parse_samples)]
    pub(super) samples: usize,
}

/// The file of a model that is named by its file, or by the folder that a replay made.
pub(super) fn model_file(path: &Path) -> PathBuf {
    let inside = path.join("model.ply");
    if inside.is_file() {
        inside
    } else {
        path.to_owned()
    }
}

/// A number of samples: more than 20 million cost memory and tell nothing.
fn parse_samples(text: &str) -> anyhow::Result<usize> {
    let samples: usize = text.parse()?;
    Ok(range::check(samples as f64, [1.0, 2e7], "").map(|_| samples)?)
}

impl ComparisonArgs {
    /// Refuses a picture that already exists or cannot be written, before anything is computed.
    ///
    /// # Errors
    /// If it is, and is not to be replaced.
    pub(super) fn check(&self) -> anyhow::Result<()> {
        refuse_to_replace("--picture", self.picture.as_deref(), self.force)?;
        self.picture.as_deref().map_or(Ok(()), check_folder_of)?;
        Ok(())
    }

    /// Draws what was found, if asked to, and prints it.
    ///
    /// # Errors
    /// If the picture cannot be written.
    pub(super) fn print(
        &self,
        found: &impl serde::Serialize,
        words: impl FnOnce() -> String,
        draw: impl FnOnce() -> RgbImage,
    ) -> anyhow::Result<()> {
        if let Some(path) = &self.picture {
            write_atomically(path, &encode_png(&draw())?)?;
        }
        match self.json {
            true => outln!("{}", serde_json::to_string_pretty(found)?),
            false => outln!("{}", words()),
        }
        Ok(())
    }
}

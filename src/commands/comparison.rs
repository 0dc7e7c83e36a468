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

/// Folders that are listed where none has the name that was given.
const MOST_LISTED: usize = 5;

/// The file of a model that is named by its file, or by the folder that a replay made.
///
/// # Errors
/// If nothing has that name, or it is a folder without a model; the message lists the folders that may be meant.
pub(super) fn model_file(path: &Path) -> anyhow::Result<PathBuf> {
    let files = ["model.ply", "model.glb"].map(|name| path.join(name));
    if let Some(inside) = files.into_iter().find(|file| file.is_file()) {
        return Ok(inside);
    }
    let found = path.display();
    let advice = "name a model's file or its folder";
    if let Err(error) = path.symlink_metadata() {
        let above = path.ancestors().skip(1).find(|folder| folder.is_dir());
        let listed = above.map_or_else(String::new, folders_in);
        anyhow::bail!("{found}: {error}: {advice}{listed}");
    }
    anyhow::ensure!(
        !path.is_dir(),
        "{found}: the folder has no model: {advice}{}",
        folders_in(path)
    );
    Ok(path.to_owned())
}

/// The folders in a folder, in words.
fn folders_in(folder: &Path) -> String {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let folders = entries.map(|entry| entry.path()).filter(|p| p.is_dir());
    let mut names: Vec<String> = folders
        .filter_map(|path| Some(path.file_name()?.to_string_lossy().into_owned()))
        .collect();
    names.sort();
    if names.is_empty() {
        return String::new();
    }
    let more = match names.len() > MOST_LISTED {
        true => " and others",
        false => "",
    };
    names.truncate(MOST_LISTED);
    let names = names.join(", ");
    format!("; {} has {names}{more}", folder.display())
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

//! Exports models: finds the files that are named, and writes those of each in the format that was asked for.

use super::{Args, exists, write};
use crate::export::{self, Format, ReadModel, compress, level_of_detail};
use crate::frame::CaptureId;
use crate::level::Level;
use crate::make_model::object_folder_name;
use crate::words::count;
use anyhow::Context;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The name that a model has in its capture's folder.
const MODEL: &str = "model.glb";
/// Folders of captures lie this deep in a replay's folder: recording, capture.
const DEPTH: usize = 2;

/// The models that are named: files, folders of captures, and folders of these, in the order of their names.
///
/// # Errors
/// If something is named that is neither a model nor a folder with one.
pub(in crate::commands) fn find(what: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let mut models = Vec::new();
    for path in what {
        let before = models.len();
        if path.is_dir() {
            find_below(path, DEPTH, &mut models)
                .with_context(|| format!("cannot read {}", path.display()))?;
            anyhow::ensure!(
                models.len() > before,
                "{}: the folder has no {MODEL}: scand replay RECORDING makes one",
                path.display()
            );
        } else {
            refuse_other(path)?;
            models.push(path.clone());
        }
    }
    Ok(models)
}

/// Whether a folder has a model that was made again with other settings. It lies beside the first, of the same capture,
/// and is exported only if it is named.
fn is_remake(name: &str) -> bool {
    let number = name
        .rsplit_once(".remake-")
        .map_or("", |(_, number)| number);
    !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit())
}

fn find_below(folder: &Path, depth: usize, models: &mut Vec<PathBuf>) -> std::io::Result<()> {
    let model = folder.join(MODEL);
    if model.is_file() {
        models.push(model);
        return Ok(());
    }
    if depth == 0 {
        return Ok(());
    }
    let mut folders = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if !name.starts_with('.') && !is_remake(&name) && entry.file_type()?.is_dir() {
            folders.push(entry.path());
        }
    }
    folders.sort();
    folders
        .iter()
        .try_for_each(|folder| find_below(folder, depth - 1, models))
}

/// Says of a file that is no .glb what to give instead.
fn refuse_other(path: &Path) -> anyhow::Result<()> {
    let name = path.display();
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    match ending.as_deref() {
        Some("mcap" | "part") => anyhow::bail!(
            "{name} is a recording: make its models with scand replay {name}, then export these (or give --dataset instead of --format)"
        ),
        Some("ply") => anyhow::bail!("{name}: a .ply has no texture: give the {MODEL} beside it"),
        _ => Ok(()),
    }
}

/// Writes each model.
///
/// # Errors
/// At the first that cannot be read or written; those before it are complete.
pub(super) fn export(models: &[PathBuf], format: Format, args: &Args) -> anyhow::Result<()> {
    let mut names = BTreeSet::new();
    for path in models {
        let read = export::read(path)?;
        let stem = stem(&read, path, args.lod)?;
        anyhow::ensure!(
            names.insert(stem.clone()),
            "{}: a model of the same name, {stem}, was exported in this run: export it with another --out",
            path.display()
        );
        one(&read, &stem, format, args).with_context(|| path.display().to_string())?;
        if let Some(remark) = remark(path) {
            eprintln!("scand: {}: {remark}", path.display());
        }
    }
    Ok(())
}

/// The name of a model's files, without their endings: its capture's or, of a model of several captures, its object's.
fn stem(read: &ReadModel, path: &Path, level: u32) -> anyhow::Result<String> {
    let capture = read.about.capture.as_str();
    let capture = CaptureId::new(capture).map_err(|_| {
        let found: String = capture.chars().take(60).collect();
        anyhow::anyhow!(
            "{}: its capture is called {found:?}, which is not a file name",
            path.display()
        )
    })?;
    let name = match &read.about.captures {
        None => capture.to_string(),
        Some(_) => object_folder_name(read.about.subject.as_deref().unwrap_or(capture.as_str())),
    };
    Ok(match level {
        0 => name,
        level => format!("{name}-lod{level}"),
    })
}

fn one(read: &ReadModel, stem: &str, format: Format, args: &Args) -> anyhow::Result<()> {
    // Known before the work; a file that takes the name in the meantime keeps it.
    let main = args.out.join(format!("{stem}.{}", format.name()));
    if !args.force && main.symlink_metadata().is_ok() {
        return Err(exists(&main));
    }
    let model = level_of_detail(&read.model, args.lod)?;
    let mut files = match (format, args.lod) {
        // Nothing changes: the texture is not encoded once more.
        (Format::Glb, 0) => vec![export::File {
            name: format!("{stem}.glb"),
            bytes: read.bytes.clone(),
        }],
        _ => export::encode(&model, &read.about, format, stem)?,
    };
    if let Some(compression) = args.compress {
        for file in &mut files {
            file.bytes = compress(&file.bytes, compression).map_err(anyhow::Error::msg)?;
        }
    }
    for file in &files {
        write(&args.out.join(&file.name), &file.bytes, args.force)?;
    }
    outln!(
        "{}: {}, {}",
        main.display(),
        format.conventions(),
        count(model.mesh.triangles.len(), "triangle")
    );
    Ok(())
}

/// What the report beside a model says that a person who hands the model on should know.
fn remark(path: &Path) -> Option<&'static str> {
    let bytes = std::fs::read(path.with_file_name("report.json")).ok()?;
    let report: serde_json::Value = serde_json::from_slice(&bytes).ok()?;
    match (&report["notes"]["decision"], &report["verdict"]["level"]) {
        (decision, _) if decision == "rejected" => {
            Some("the capture was rejected; its model is exported, as it was asked for")
        }
        (_, level) if level == Level::Red.name() => {
            Some("the verdict is red: do not use the model before you know why (report.json)")
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_gives_its_first_models_and_a_name_any() {
        let root = tempfile::tempdir().unwrap();
        let folders = [
            "a/a-0001",
            "a/a-0001.remake-1",
            "a/b.remake-x",
            ".remake/a/a-0002",
        ];
        for folder in folders.map(|folder| root.path().join(folder)) {
            std::fs::create_dir_all(&folder).unwrap();
            std::fs::write(folder.join(MODEL), "").unwrap();
        }
        let of = |folder: &str| root.path().join(folder).join(MODEL);
        let found = find(&[root.path().to_owned()]).unwrap();
        assert_eq!(found, ["a/a-0001", "a/b.remake-x"].map(of));
        let named = find(&[root.path().join("a/a-0001.remake-1")]).unwrap();
        assert_eq!(named, [of("a/a-0001.remake-1")]);
    }
}

//! Exports models: finds the files that are named, and writes those of each in the format that was asked for.

use super::{Args, exists};
use crate::commands::EXIT_INCOMPLETE;
use crate::commands::model_notes::{self, Unread};
use crate::export::{self, Format, ReadModel, compress, level_of_detail};
use crate::frame::CaptureId;
use crate::level::Level;
use crate::make_model::object_folder_name;
use crate::storage::{self, StagedFolder, check_writable};
use crate::words::count;
use anyhow::Context;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

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

/// Writes each model. The exit code is 3 if some could not be read or written, and 1 if none could.
pub(super) fn export(models: &[PathBuf], format: Format, args: &Args) -> ExitCode {
    let mut names = BTreeSet::new();
    let mut unread = Unread::new();
    let mut failed = 0;
    let places = places(models);
    for (path, folder) in &places {
        let told = export_one(path, &args.out.join(folder), &mut names, format, args);
        match told {
            Ok(capture) => {
                let (remark, also_unread) = remark(path, &capture, &args.recordings);
                unread.extend(also_unread);
                if let Some(remark) = remark {
                    eprintln!("scand: {}: {remark}", path.display());
                }
            }
            // The others are exported.
            Err(error) => {
                failed += 1;
                eprintln!("scand: {error:#}");
            }
        }
    }
    model_notes::tell_unread(&unread);
    match failed {
        0 => ExitCode::SUCCESS,
        _ if failed == places.len() => ExitCode::FAILURE,
        _ => ExitCode::from(EXIT_INCOMPLETE),
    }
}

/// Each model once, with the folder below `--out` that its files go into: one of its recording's name where captures
/// of several recordings have one name.
fn places(models: &[PathBuf]) -> Vec<(&Path, PathBuf)> {
    let name = |path: &Path| path.file_name().unwrap_or_default().to_owned();
    let of = |path: &Path| {
        let folder = path.parent().filter(|_| path.ends_with(MODEL))?;
        Some((name(folder), name(folder.parent()?)))
    };
    let mut recordings: BTreeMap<_, BTreeSet<_>> = BTreeMap::new();
    for (capture, recording) in models.iter().filter_map(|path| of(path)) {
        recordings.entry(capture).or_default().insert(recording);
    }
    let mut seen = BTreeSet::new();
    let first = |path: &&PathBuf| {
        let same = path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
        seen.insert(same)
    };
    let place = |path: &PathBuf| {
        let (capture, recording) = of(path)?;
        (recordings[&capture].len() > 1).then(|| PathBuf::from(recording))
    };
    let first: Vec<&PathBuf> = models.iter().filter(first).collect();
    first
        .into_iter()
        .map(|path| (path.as_path(), place(path).unwrap_or_default()))
        .collect()
}

/// Exports a model; returns the capture that it is of.
fn export_one(
    path: &Path,
    folder: &Path,
    names: &mut BTreeSet<PathBuf>,
    format: Format,
    args: &Args,
) -> anyhow::Result<String> {
    let read = export::read(path)?;
    let stem = stem(&read, path, args.lod)?;
    anyhow::ensure!(
        names.insert(folder.join(&stem)),
        "{}: a model of the same name, {stem}, was exported in this run: export it with another --out",
        path.display()
    );
    check_writable(folder)?;
    one(&read, folder, &stem, format, args).with_context(|| path.display().to_string())?;
    Ok(read.about.capture)
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

fn one(
    read: &ReadModel,
    folder: &Path,
    stem: &str,
    format: Format,
    args: &Args,
) -> anyhow::Result<()> {
    // Known before the work; a file that takes the name in the meantime keeps it.
    let main = folder.join(format!("{stem}.{}", format.name()));
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
        _ => export::encode(&model, &read.about, format, stem, &read.glb)?,
    };
    if let Some(compression) = args.compress {
        for file in &mut files {
            file.bytes = compress(&file.bytes, compression).map_err(anyhow::Error::msg)?;
        }
    }
    write_all(folder, &main, &files, args.force)?;
    outln!(
        "{}: {}, {}",
        main.display(),
        format.conventions(),
        count(model.mesh.triangles.len(), "triangle")
    );
    Ok(())
}

/// Writes a model's files, all of them or none: after a full disk, nothing is in the way of the next run.
fn write_all(
    folder: &Path,
    main: &Path,
    files: &[export::File],
    force: bool,
) -> anyhow::Result<()> {
    // All that needs space is done before the first file gets its name.
    let staged = StagedFolder::create(main)?;
    for file in files {
        staged.write(&file.name, &file.bytes)?;
    }
    let mut placed = Vec::new();
    for file in files {
        let (from, to) = (staged.path().join(&file.name), folder.join(&file.name));
        if let Err(cause) = place(&from, &to, force) {
            // What was replaced has no old file to put back.
            if !force {
                placed
                    .iter()
                    .for_each(|path| drop(std::fs::remove_file(path)));
            }
            return Err(match cause.kind() {
                ErrorKind::AlreadyExists => exists(&to),
                _ => anyhow::anyhow!("cannot write {}", storage::with_advice(&to, &cause)),
            });
        }
        placed.push(to);
    }
    storage::sync_folder(folder).with_context(|| format!("cannot write {}", folder.display()))
}

fn place(from: &Path, to: &Path, force: bool) -> std::io::Result<()> {
    match force {
        true => std::fs::rename(from, to),
        false => storage::rename_noreplace(from, to),
    }
}

/// What a person who hands the model on should know of it, from the report beside it and the notes, which may be newer;
/// and the recordings whose notes were not read.
fn remark(path: &Path, capture: &str, recordings: &Path) -> (Option<&'static str>, Unread) {
    let report = std::fs::read(path.with_file_name("report.json")).ok();
    let report = report.and_then(|bytes| serde_json::from_slice::<Value>(&bytes).ok());
    let Some(report) = report else {
        return (None, Unread::new());
    };
    let found = model_notes::find(&report, capture, recordings);
    let remark = if found.is_rejected {
        Some("the capture was rejected; its model is exported, as it was asked for")
    } else if report["verdict"]["level"] == Level::Red.name() {
        Some("the verdict is red: do not use the model before you know why (report.json)")
    } else {
        None
    };
    (remark, found.unread)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_a_set_of_files_all_are_written_or_none() {
        let folder = tempfile::tempdir().unwrap();
        let main = folder.path().join("cup.obj");
        let files = ["cup.mtl", "cup.png", "cup.obj"].map(|name| export::File {
            name: name.into(),
            bytes: b"new".into(),
        });
        let names = || {
            let entries = std::fs::read_dir(folder.path()).unwrap();
            let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
            names.collect::<BTreeSet<_>>()
        };
        let write = |force| write_all(folder.path(), &main, &files, force);
        std::fs::write(folder.path().join("cup.png"), "old").unwrap();
        let error = write(false).unwrap_err().to_string();
        assert!(error.contains("cup.png already exists"), "{error}");
        assert_eq!(names(), BTreeSet::from(["cup.png".to_owned()]));
        // A file that cannot be written is found before any has its name.
        let longest = [
            files[0].clone(),
            export::File {
                name: "c".repeat(300),
                bytes: Vec::new(),
            },
        ];
        write_all(folder.path(), &main, &longest, true).unwrap_err();
        assert_eq!(names(), BTreeSet::from(["cup.png".to_owned()]));
        write(true).unwrap();
        assert_eq!(names().len(), 3);
        assert_eq!(
            std::fs::read(folder.path().join("cup.png")).unwrap(),
            b"new"
        );
    }

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

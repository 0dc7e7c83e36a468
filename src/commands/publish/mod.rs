//! `scand publish`: a static folder for a web server, made of models: a gallery, a page for each object with a viewer,
//! levels of detail, and the files that other programs read. This file has the arguments and writes the folder.

mod published_object;
mod viewer;

use super::export::find_models;
use super::{EXIT_INCOMPLETE, check_folder_of, model_notes, wrong_usage};
use crate::publish::{
    Address, Extra, PageOptions, PublishedObject, STYLE, collection, gallery, manifest,
    object_page, scene,
};
use crate::storage::StagedFolder;
use crate::words::{closest, count, shell_word};
use anyhow::Context;
use published_object::{Made, make};
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::process::ExitCode;

/// Make a static folder for a web server: a gallery, and a page for each object with a viewer and its files
#[derive(Debug, clap::Args)]
#[command(after_help = "What --with can name; all of it stays out otherwise:
  operator  who ran the rig                    rig      the rig's name
  session   the session, and the capture's id  notes    notes on the capture, with their authors
  project   what it was taken for              reasons  the verdict's reasons, which name cameras
The object's number, title and rights, and the time of the capture, are published always.

Examples:
  scand publish out -o site
  scand publish out/cup/cup-000 -o site --title Cups --address https://museum.example/cups
  scand publish out -o site --with operator,project --force")]
pub struct Args {
    /// Models: a model.glb, the folder of a capture, or a folder of such folders
    #[arg(required = true, value_name = "MODEL")]
    what: Vec<PathBuf>,
    /// Make this folder
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Publish this too: operator, session, project, rig, notes or reasons
    #[arg(long, value_name = "WHAT", value_delimiter = ',', value_parser = extra)]
    with: Vec<Extra>,
    /// Where the web server will have the folder; needed for the manifests of IIIF
    #[arg(short, long, value_name = "URL", value_parser = Address::parse)]
    address: Option<Address>,
    /// The gallery's title
    #[arg(short, long, default_value = "Objects")]
    title: String,
    /// Look in the recordings of this folder for notes that are newer than the reports
    #[arg(long, value_name = "DIR", default_value = ".")]
    recordings: PathBuf,
    /// Publish rejected captures too
    #[arg(long)]
    rejected: bool,
    /// Replace an existing folder that scand published
    #[arg(short, long)]
    force: bool,
}

/// Lies in each published folder, so that nothing else is ever replaced.
const MARK: &str = "style.css";

/// Makes the folder. The exit code is 3 if a model was left out because it cannot be read.
///
/// # Errors
/// If nothing is left to publish, or the folder cannot be written.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    refuse_to_replace(&args)?;
    let models = find_models(&args.what)?;
    check_folder_of(&args.out)?;
    let with: BTreeSet<Extra> = args.with.iter().copied().collect();
    let folder = StagedFolder::create(&args.out)?;
    let options = PageOptions {
        title: &args.title,
        has_viewer: viewer::script().is_some(),
        has_manifests: args.address.is_some(),
    };
    let mut objects = Vec::new();
    let mut unread = model_notes::Unread::new();
    let mut ids = BTreeSet::new();
    let mut failed = 0;
    for path in &models {
        let made = make(path, &args.recordings, &with, args.rejected)
            .with_context(|| path.display().to_string());
        let made = match made {
            Ok(made) => made,
            // The others are published.
            Err(error) => {
                failed += 1;
                eprintln!("scand: left out, because it cannot be published: {error:#}");
                continue;
            }
        };
        let Some(made) = made else {
            eprintln!(
                "scand: {}: left out, because the capture was rejected (--rejected takes it)",
                path.display()
            );
            continue;
        };
        let Made { object, files, .. } = made;
        unread.extend(made.unread);
        if !ids.insert(object.id.clone()) {
            return Err(wrong_usage(format!(
                "{}: the model of this capture was named before: name one of them",
                path.display()
            )));
        }
        let place = format!("objects/{}", object.id);
        for (name, bytes) in &files {
            folder.write(&format!("{place}/{name}"), bytes)?;
        }
        write_pages_of(&folder, &place, &object, &args, options)?;
        outln!("{}: {place}", path.display());
        objects.push(object);
    }
    anyhow::ensure!(!objects.is_empty(), "nothing is left to publish");
    write_gallery(&folder, &objects, &args, options)?;
    folder.commit(args.force)?;
    model_notes::tell_unread(&unread);
    print_result(&args, objects.len());
    Ok(match failed {
        0 => ExitCode::SUCCESS,
        _ => ExitCode::from(EXIT_INCOMPLETE),
    })
}

/// Writes what is made of an object besides its own files: its page, its scene, and its manifest where there is an
/// address.
fn write_pages_of(
    folder: &StagedFolder,
    place: &str,
    object: &PublishedObject,
    args: &Args,
    options: PageOptions,
) -> anyhow::Result<()> {
    folder.write(&format!("{place}/scene.svx.json"), &json(&scene(object))?)?;
    if let Some(at) = &args.address {
        folder.write(
            &format!("{place}/manifest.json"),
            &json(&manifest(object, at))?,
        )?;
    }
    let page = object_page(object, options);
    Ok(folder.write(&format!("{place}/index.html"), page.as_bytes())?)
}

/// Writes what all objects share: the gallery, the collection where there is an address, the style and the viewer.
fn write_gallery(
    folder: &StagedFolder,
    objects: &[PublishedObject],
    args: &Args,
    options: PageOptions,
) -> anyhow::Result<()> {
    folder.write(MARK, STYLE.as_bytes())?;
    folder.write("index.html", gallery(objects, options).as_bytes())?;
    if let Some(at) = &args.address {
        folder.write(
            "collection.json",
            &json(&collection(objects, &args.title, at))?,
        )?;
    }
    for (name, bytes) in [
        ("viewer.js", viewer::script()),
        ("viewer-licences.txt", viewer::licences()),
    ] {
        if let Some(bytes) = bytes {
            folder.write(name, bytes)?;
        }
    }
    Ok(())
}

/// An existing folder is replaced only if that was asked for and scand made it.
fn refuse_to_replace(args: &Args) -> anyhow::Result<()> {
    if args.out.symlink_metadata().is_err() {
        return Ok(());
    }
    anyhow::ensure!(
        args.force,
        "{} already exists: give --force to replace it, or another --out",
        args.out.display()
    );
    let is_ours = args.out.join("objects").is_dir() && args.out.join(MARK).is_file();
    anyhow::ensure!(
        is_ours,
        "{} was not published by scand, so it is not replaced: give another --out",
        args.out.display()
    );
    Ok(())
}

fn print_result(args: &Args, published: usize) {
    outln!(
        "{}: {}; for a web server, or to look at with: python3 -m http.server --directory {}",
        args.out.display(),
        count(published, "object"),
        shell_word(&args.out)
    );
    if viewer::script().is_none() {
        eprintln!("scand: {}", viewer::MISSING);
    }
    if args.address.is_none() {
        eprintln!(
            "scand: no IIIF manifests were written, because they contain the folder's web address: give it with --address"
        );
    }
}

fn json(value: &serde_json::Value) -> anyhow::Result<Vec<u8>> {
    Ok((serde_json::to_string_pretty(value)? + "\n").into_bytes())
}

/// What can be published, by its name.
fn extra(text: &str) -> Result<Extra, String> {
    let known = Extra::ALL.map(Extra::name);
    if let Some(extra) = Extra::ALL.into_iter().find(|extra| extra.name() == text) {
        return Ok(extra);
    }
    let tip = closest(text, known).map(|close| format!("; did you mean {close}?"));
    Err(format!(
        "expected one of {}{}",
        known.join(", "),
        tip.unwrap_or_default()
    ))
}

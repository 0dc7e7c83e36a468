//! Makes a published object of a model: what may be public of it, its levels of detail and its pictures.

use crate::commands::model_notes;
use crate::description::Description;
use crate::export::{
    self, Compression, Format, ReadModel, compress, describe, encode, level_of_detail,
};
use crate::level::Level;
use crate::mesh::bounding_box;
use crate::output::encode_jpeg;
use crate::publish::{Extra, Facts, LevelFile, Picture, PublishedObject, object_id, public};
use crate::reconstruct::Model;
use crate::report::picture_of;
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;

/// Levels of detail after the full one: the name of the file and Voyager's word for its quality.
const LEVELS: [(&str, &str); 3] = [("medium", "Medium"), ("low", "Low"), ("thumb", "Thumb")];
/// A level with fewer vertices shows nothing of an object.
const FEWEST_VERTICES: usize = 500;
const PICTURE: (usize, usize) = (1200, 900);
const THUMBNAIL: (usize, usize) = (400, 300);
const QUALITY: u8 = 88;

/// Files that lie beside an object's page: names and contents.
type Files = Vec<(String, Vec<u8>)>;

/// A published object with its files.
pub(super) struct Made {
    pub(super) object: PublishedObject,
    pub(super) files: Files,
    /// Recordings whose notes were not read.
    pub(super) unread: model_notes::Unread,
}

/// Makes the published object of the model in `path`; `None` if the capture was rejected, unless `include_rejected` is
/// given.
///
/// # Errors
/// If the model cannot be read or one of its files cannot be made.
pub(super) fn make(
    path: &Path,
    recordings: &Path,
    with: &BTreeSet<Extra>,
    include_rejected: bool,
) -> anyhow::Result<Option<Made>> {
    let read = export::read(path)?;
    let report = report_beside(path);
    let found = model_notes::find(&report, &read.about.capture, recordings);
    if found.is_rejected && !include_rejected {
        return Ok(None);
    }
    let facts = Facts::of(&report, &found.notes, with);
    tell_doubts(path, facts.level);
    let id = object_id(&read.about);
    let about = public(&read.about, &id, with);
    let mut files = Files::default();
    let levels = add_levels(&mut files, &read, &about)?;
    let picture = add_picture(&mut files, "picture", &read.model, PICTURE)?;
    let thumbnail = add_picture(&mut files, "thumbnail", &read.model, THUMBNAIL)?;
    let corners = bounding_box(&read.model.mesh.vertices).unwrap_or_default();
    let bounds = corners.map(|corner| [corner.x, corner.y, corner.z]);
    let object = PublishedObject {
        id,
        about,
        facts,
        bounds,
        levels,
        picture,
        thumbnail,
    };
    Ok(Some(Made {
        object,
        files,
        unread: found.unread,
    }))
}

/// Says that a verdict is red or not known.
fn tell_doubts(path: &Path, level: Option<Level>) {
    match level {
        None => eprintln!(
            "scand: {}: no report.json with a verdict is beside it; the page says that it is unknown",
            path.display()
        ),
        Some(Level::Red) => eprintln!(
            "scand: {}: the verdict is red; the page says so",
            path.display()
        ),
        _ => {}
    }
}

/// Adds the full model and its levels of detail.
fn add_levels(
    files: &mut Files,
    read: &ReadModel,
    about: &Description,
) -> anyhow::Result<Vec<LevelFile>> {
    let bytes = describe(&read.bytes, about).map_err(anyhow::Error::msg)?;
    let mut levels = vec![level_file("high", "High", &read.model, &bytes)];
    files.push((levels[0].name.clone(), bytes));
    for (number, (name, quality)) in (1..).zip(LEVELS) {
        if read.model.mesh.vertices.len() >> (2 * number) < FEWEST_VERTICES {
            break;
        }
        let model = level_of_detail(&read.model, number)?;
        let encoded = encode(&model, about, Format::Glb, name, &read.glb)?;
        for file in encoded {
            let bytes =
                compress(&file.bytes, Compression::Quantization).map_err(anyhow::Error::msg)?;
            levels.push(level_file(name, quality, &model, &bytes));
            files.push((format!("{name}.glb"), bytes));
        }
    }
    Ok(levels)
}

/// Draws a model and adds the picture.
fn add_picture(
    files: &mut Files,
    name: &str,
    model: &Model,
    size: (usize, usize),
) -> anyhow::Result<Picture> {
    let bytes = encode_jpeg(&picture_of(model, size), QUALITY)?;
    let picture = Picture {
        name: format!("{name}.jpg"),
        size,
        bytes: bytes.len(),
    };
    files.push((picture.name.clone(), bytes));
    Ok(picture)
}

fn level_file(name: &str, quality: &'static str, model: &Model, bytes: &[u8]) -> LevelFile {
    LevelFile {
        name: format!("{name}.glb"),
        quality,
        triangles: model.mesh.triangles.len(),
        bytes: bytes.len(),
    }
}

/// The report beside a model; null if there is none.
fn report_beside(path: &Path) -> Value {
    let bytes = std::fs::read(path.with_file_name("report.json"));
    let report = bytes
        .ok()
        .and_then(|bytes| serde_json::from_slice(&bytes).ok());
    report.unwrap_or_default()
}

//! Reads the two files of a model, and compares what they state of themselves with the model's report. Nothing is
//! written here, and no link is followed.

use crate::evaluate::load::load_ply_with_comments;
use crate::export;
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::Path;

pub(super) const GLB: &str = "model.glb";
pub(super) const PLY: &str = "model.ply";
pub(super) const REPORT: &str = "report.json";
/// Why a file of a model is left out.
pub(super) const IS_LINK: &str = "it is a link, which may lead to anything";

/// What both files state as text, by the names that these have in the report's description.
const TEXTS: [&str; 3] = ["capture", "input_sha256", "calibration_sha256"];

/// What a file of a model states of itself.
struct Stated {
    texts: BTreeMap<String, String>,
    /// Unknown for a file that has a vertex more than once.
    vertices: Option<usize>,
    triangles: usize,
}

/// What is wrong with a model's files: the file, what was found, and what the report let expect. `None` if both can be
/// read and contradict nothing. A PLY file that is a link is not looked at: it is left out by itself.
pub(super) fn problem(folder: &Path, report: &Value) -> Option<String> {
    let (glb, ply) = (folder.join(GLB), folder.join(PLY));
    problem_of_file(&glb, of_glb, report).or_else(|| {
        let is_link = ply.is_symlink();
        problem_of_file(&ply, of_ply, report).filter(|_| !is_link)
    })
}

fn problem_of_file(
    path: &Path,
    read: fn(&Path) -> Result<Stated, String>,
    report: &Value,
) -> Option<String> {
    let named = |problem: &str| Some(format!("{}: {problem}", path.display()));
    if let Some(problem) = no_file(path) {
        return named(&problem);
    }
    match read(path) {
        Ok(stated) => named(&contradiction(&stated, report)?),
        // The readers name the file.
        Err(problem) => Some(problem),
    }
}

/// Why there is no file at a path to read; `None` if there is one.
pub(super) fn no_file(path: &Path) -> Option<String> {
    match path.symlink_metadata() {
        Err(error) if error.kind() == ErrorKind::NotFound => Some("the file is missing".into()),
        Err(error) => Some(error.to_string()),
        Ok(about) if about.is_symlink() => Some(IS_LINK.into()),
        Ok(about) if about.is_file() => None,
        Ok(_) => Some("it is not a regular file".into()),
    }
}

fn of_glb(path: &Path) -> Result<Stated, String> {
    let read = export::read(path).map_err(|error| error.to_string())?;
    let pairs = read.about.pairs().into_iter();
    Ok(Stated {
        texts: pairs
            .map(|(name, text)| (name.to_owned(), text.to_owned()))
            .collect(),
        vertices: None,
        triangles: read.model.mesh.triangles.len(),
    })
}

fn of_ply(path: &Path) -> Result<Stated, String> {
    let (read, texts) = load_ply_with_comments(path).map_err(|error| error.to_string())?;
    Ok(Stated {
        texts,
        vertices: Some(read.mesh.vertices.len()),
        triangles: read.mesh.triangles.len(),
    })
}

/// The first thing that a file and the report both state, and not in the same way.
fn contradiction(stated: &Stated, report: &Value) -> Option<String> {
    let text = |name: &&str| {
        let found = stated.texts.get(*name).filter(|text| !text.is_empty())?;
        let expected = report["description"][*name].as_str()?;
        (found != expected)
            .then(|| format!("its {name} is {found:?}, expected {expected:?} as in {REPORT}"))
    };
    let count = |(name, found): (&str, Option<usize>)| {
        let (found, expected) = (found? as u64, report["model"]["mesh"][name].as_u64()?);
        (found != expected)
            .then(|| format!("it has {found} {name}, expected {expected} as in {REPORT}"))
    };
    let counts = [
        ("triangles", Some(stated.triangles)),
        ("vertices", stated.vertices),
    ];
    let texts = TEXTS.iter().find_map(text);
    texts.or_else(|| counts.into_iter().find_map(count))
}

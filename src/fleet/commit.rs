//! Checks a result that came from outside, and puts it into place. Runs in a confined child: whatever the files do to a
//! parser happens there.

use super::bundle::{Bundle, REPORT, contents_sha256, read_bundle};
use crate::evaluate::load::load_unwelded;
use crate::mesh::{self, Mesh};
use crate::storage::{self, StagedFolder};
use serde_json::Value;
use std::path::Path;

/// The schema of reports, as it is published.
const SCHEMA: &str = include_str!("../../docs/report.schema.json");
/// What the folder of a model holds, in the order of a bundle.
const OF_A_MODEL: [&str; 4] = ["model.glb", "model.ply", "preview.png", REPORT];
/// Pixels of the largest preview.
const MAX_PIXELS: usize = 40_000_000;

/// What became of a result.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CommitResult {
    /// It is in place.
    Placed,
    /// The same was there.
    Equal,
    /// Another one is there, of the same inputs, settings and program: something is broken.
    Differs,
    /// It is not what a worker may return; nothing was written.
    Refused(String),
}

/// Checks the result at `path` and puts it into the folder `target`. It has to be of the capture `capture` of the
/// recording named `recording`, and to have the digest of contents that its worker named. An existing model is replaced
/// only if `replace`.
///
/// # Errors
/// If the folder cannot be written.
pub fn commit(
    path: &Path,
    target: &Path,
    (recording, capture): (&str, &str),
    contents: &str,
    replace: bool,
) -> Result<CommitResult, String> {
    let (bundle, found) = match read_bundle(path) {
        Ok(read) => read,
        Err(error) => return Ok(CommitResult::Refused(error.to_string())),
    };
    if found != contents {
        let why = "the SHA-256 of its contents is not the one that its worker reported";
        return Ok(CommitResult::Refused(why.into()));
    }
    if let Some(problem) = problem(&bundle, (recording, capture)) {
        return Ok(CommitResult::Refused(problem));
    }
    if !replace && let Some(there) = compared(target, contents) {
        return Ok(there);
    }
    // Only what was compared, or is to be replaced, gives way to it.
    let replace = replace || target.exists();
    let placed = StagedFolder::create(target).and_then(|staged| {
        let mut files = bundle.files.iter();
        files.try_for_each(|(name, bytes)| staged.write(name, bytes))?;
        staged.commit(replace)
    });
    match placed {
        Ok(()) => Ok(CommitResult::Placed),
        Err(error @ storage::Error::Exists { .. }) => {
            compared(target, contents).ok_or_else(|| error.to_string())
        }
        Err(error) => Err(error.to_string()),
    }
}

/// How a result compares with what is in its place; `None` if that may give way to it: there is nothing, or the report
/// of a failure.
fn compared(target: &Path, contents: &str) -> Option<CommitResult> {
    if !target.exists() {
        None
    } else if contents_sha256(target).is_ok_and(|there| there == contents) {
        Some(CommitResult::Equal)
    } else {
        // That two runs of one job differ is a defect.
        (!is_failure(target)).then_some(CommitResult::Differs)
    }
}

/// What is wrong with the files of a result.
fn problem(bundle: &Bundle, (recording, capture): (&str, &str)) -> Option<String> {
    let Some(report) = bundle.file(REPORT) else {
        return Some("it has no report".into());
    };
    let report: Value = match serde_json::from_slice(report) {
        Ok(report) => report,
        Err(error) => return Some(format!("{REPORT}: {error}")),
    };
    if let Some(problem) = against_schema(&report).or_else(|| of_words(&report)) {
        return Some(format!("{REPORT}: {problem}"));
    }
    if report["capture"]["id"] != capture || report["recording"] != recording {
        return Some(format!(
            "{REPORT} is about another capture, not {capture} of {recording}"
        ));
    }
    let names: Vec<&str> = bundle.files.iter().map(|(name, _)| *name).collect();
    if report["outcome"] == "failed" {
        let alone = names == [REPORT];
        return (!alone).then(|| "the report of a failure comes with a model".into());
    }
    if names != OF_A_MODEL {
        return Some(format!(
            "it has the files {names:?}, expected {OF_A_MODEL:?}"
        ));
    }
    let says_open = report["verdict"]["reasons"]
        .as_array()
        .is_some_and(|reasons| reasons.iter().any(|r| r["code"] == "not_watertight"));
    let problem = of_model(bundle, says_open).err();
    problem.or_else(|| of_picture(bundle.file("preview.png").unwrap_or_default()))
}

/// Checks both files of a model: one surface, closed unless the report says otherwise.
fn of_model(bundle: &Bundle, says_open: bool) -> Result<(), String> {
    let load = |name| -> Result<Mesh, String> {
        let bytes = bundle.file(name).unwrap_or_default();
        let loaded = load_unwelded(bytes, Path::new(name)).map_err(|e| e.to_string())?;
        Ok(loaded.mesh)
    };
    let (plain, textured) = (load("model.ply")?, load("model.glb")?);
    if let Some(problem) = of_mesh(&plain, says_open) {
        return Err(format!("model.ply: {problem}"));
    }
    if is_same_surface(&plain, &textured) {
        Ok(())
    } else {
        Err("model.glb: its triangles are not those of model.ply".into())
    }
}

/// Whether two meshes have the same triangles in the same order, wherever their corners stand in the lists of vertices.
/// Each index has to be one of a vertex.
fn is_same_surface(a: &Mesh, b: &Mesh) -> bool {
    let corners = |mesh: &Mesh, triangle: &[u32; 3]| triangle.map(|v| mesh.vertices[v as usize]);
    let mut pairs = a.triangles.iter().zip(&b.triangles);
    a.triangles.len() == b.triangles.len() && pairs.all(|(t, u)| corners(a, t) == corners(b, u))
}

fn against_schema(report: &Value) -> Option<String> {
    let schema: Value = match serde_json::from_str(SCHEMA) {
        Ok(schema) => schema,
        Err(error) => return Some(format!("the schema of reports: {error}")),
    };
    match jsonschema::validator_for(&schema) {
        Ok(validator) if validator.is_valid(report) => None,
        Ok(_) => Some("it does not have the members that a report has (report.schema.json)".into()),
        Err(error) => Some(format!("the schema of reports: {error}")),
    }
}

/// What is wrong with the words that terminals and logs show: each is of a length that a person reads, and has no
/// character that a terminal obeys.
fn of_words(report: &Value) -> Option<String> {
    const LONGEST: usize = 20_000;
    let reasons = report["verdict"]["reasons"].as_array();
    let words = reasons.into_iter().flatten().map(|reason| &reason["words"]);
    let mut words = words.chain([&report["reason"]]).filter_map(Value::as_str);
    words.find_map(|text| {
        let obeyed = |c: &char| c.is_control() && *c != '\n' && *c != '\t';
        match text.chars().find(obeyed) {
            _ if text.len() > LONGEST => Some(format!(
                "a reason has {} bytes, expected at most {LONGEST}",
                text.len()
            )),
            Some(found) => Some(format!("a reason has the control character {found:?}")),
            None => None,
        }
    })
}

fn of_mesh(mesh: &Mesh, says_open: bool) -> Option<String> {
    if mesh.triangles.is_empty() {
        return Some("it has no triangles".into());
    }
    let closed = mesh::is_watertight(mesh);
    (!closed && !says_open).then(|| "it is not closed, and its report does not say so".into())
}

fn of_picture(bytes: &[u8]) -> Option<String> {
    match crate::image::size_of_file("png", bytes) {
        Ok((width, height)) if width.saturating_mul(height) <= MAX_PIXELS => {
            let decoded = crate::image::rgb_from_file("png", bytes, (width, height));
            decoded.err().map(|e| format!("preview.png: {e}"))
        }
        Ok((width, height)) => Some(format!("preview.png: {width} x {height} pixels")),
        Err(error) => Some(format!("preview.png: {error}")),
    }
}

/// Whether a folder holds the report of a failure.
fn is_failure(folder: &Path) -> bool {
    let report = std::fs::read(folder.join(REPORT)).unwrap_or_default();
    let report: Option<Value> = serde_json::from_slice(&report).ok();
    report.is_some_and(|report| report["outcome"] == "failed")
}

#[cfg(test)]
mod tests {
    use super::super::bundle::write_bundle;
    use super::*;
    use crate::frame::{CaptureId, Timestamp};
    use crate::make_model::{FailedJob, report_failure};
    use crate::reconstruct::Method;
    use crate::report::FailedCapture;

    struct Place {
        home: tempfile::TempDir,
    }

    impl Place {
        fn new() -> Self {
            let home = tempfile::tempdir().unwrap();
            Self { home }
        }

        fn failure(&self, reason: &str) -> Bundle {
            let folder = self.home.path().join("made");
            let job = FailedJob {
                recording: Path::new("cup.mcap"),
                method: Method::default(),
                capture: FailedCapture {
                    id: &CaptureId::new("a1").unwrap(),
                    time_ns: Timestamp(1),
                    source: "test",
                },
            };
            report_failure(&folder, job, reason, None, true).unwrap();
            Bundle::of_folder(&folder).unwrap()
        }

        fn commit(&self, bundle: &Bundle, of: (&str, &str), contents: &str) -> CommitResult {
            let path = self.home.path().join("bundle");
            write_bundle(bundle, &path).unwrap();
            let target = self.home.path().join("out/cup/a1");
            let parts = commit(&path, &target, of, contents, false).unwrap();
            // Nothing but what is in place is left behind.
            let left = std::fs::read_dir(self.home.path().join("out/cup"));
            assert!(left.into_iter().flatten().count() <= 1);
            parts
        }
    }

    const OF: (&str, &str) = ("cup.mcap", "a1");

    fn refused(committed: &CommitResult, words: &str) {
        match committed {
            CommitResult::Refused(why) => assert!(why.contains(words), "{why}"),
            other => panic!("{other:?}, expected: {words}"),
        }
    }

    #[test]
    fn a_report_is_placed_once_and_newer_reasons_replace_it() {
        let place = Place::new();
        let first = place.failure("no light");
        let contents = first.contents_sha256().unwrap();
        assert_eq!(place.commit(&first, OF, &contents), CommitResult::Placed);
        assert_eq!(place.commit(&first, OF, &contents), CommitResult::Equal);
        let second = place.failure("no camera");
        let contents = second.contents_sha256().unwrap();
        assert_eq!(place.commit(&second, OF, &contents), CommitResult::Placed);
    }

    #[test]
    fn a_result_of_another_capture_or_with_other_files_is_refused() {
        let place = Place::new();
        let bundle = place.failure("no light");
        let contents = bundle.contents_sha256().unwrap();
        refused(
            &place.commit(&bundle, ("cup.mcap", "a2"), &contents),
            "another capture",
        );
        refused(
            &place.commit(&bundle, ("b.mcap", "a1"), &contents),
            "another capture",
        );
        refused(
            &place.commit(&bundle, OF, &"0".repeat(64)),
            "its worker reported",
        );
        let with = |files: Vec<(&'static str, Vec<u8>)>| {
            let bundle = Bundle { files };
            let contents = bundle.contents_sha256().unwrap();
            place.commit(&bundle, OF, &contents)
        };
        refused(&with(vec![]), "no report");
        let report = bundle.files[0].1.clone();
        let model = ("model.ply", b"ply".to_vec());
        refused(&with(vec![model, (REPORT, report)]), "comes with a model");
        let poor = br#"{"outcome":"done","capture":{"id":"a1"},"recording":"cup.mcap"}"#;
        refused(&with(vec![(REPORT, poor.to_vec())]), "report.schema.json");
    }

    #[test]
    fn reports_of_each_version_are_taken() {
        let bundle = Place::new().failure("no light");
        let mut report: Value = serde_json::from_slice(bundle.file(REPORT).unwrap()).unwrap();
        assert_eq!(report["version"], crate::report::VERSION);
        for version in 1..=crate::report::VERSION {
            report["version"] = version.into();
            assert_eq!(against_schema(&report), None, "{version}");
        }
        report["version"] = 0.into();
        assert!(against_schema(&report).is_some());
    }

    #[test]
    fn an_open_mesh_is_one_only_where_its_report_says_so() {
        let mut mesh = mesh::cuboid([-1.0; 3], [1.0; 3]);
        assert_eq!(of_mesh(&mesh, false), None);
        mesh.triangles.pop();
        assert!(of_mesh(&mesh, false).unwrap().contains("not closed"));
        assert_eq!(of_mesh(&mesh, true), None);
        mesh.triangles.clear();
        assert!(of_mesh(&mesh, true).is_some());
    }

    #[test]
    fn a_surface_is_the_same_however_its_corners_are_listed() {
        let mesh = mesh::cuboid([-1.0; 3], [1.0; 3]);
        let corners = mesh.triangles.iter().flatten();
        let soup = Mesh {
            vertices: corners.map(|&v| mesh.vertices[v as usize]).collect(),
            triangles: (0..12).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
        };
        assert!(is_same_surface(&mesh, &soup));
        let mut other = soup.clone();
        other.vertices[7].x += 1e-6;
        assert!(!is_same_surface(&mesh, &other));
        let mut fewer = soup;
        fewer.triangles.pop();
        assert!(!is_same_surface(&mesh, &fewer));
    }
}

//! `scand evaluate` and `scand diff` as a user calls them: files, the output as text or JSON, and the exit code.

use assert_cmd::Command;
use scand::description::Description;
use scand::evaluate::load::load;
use scand::image::RgbImage;
use scand::mesh::{Mesh, vertex_normals};
use scand::output::{glb, ply};
use scand::reconstruct::{Model, Provenance, Texture};
use std::path::{Path, PathBuf};

/// A box, as a PLY file.
fn write_box(folder: &Path, name: &str, size: [f32; 3]) -> PathBuf {
    let mut text = "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\n\
        property float z\nproperty uchar provenance\nproperty float expected_error\nelement face 6\n\
        property list uchar int vertex_indices\nend_header\n"
        .to_owned();
    for i in 0..8 {
        let at = |bit: usize| if i >> bit & 1 == 1 { size[bit] } else { 0.0 };
        text += &format!("{} {} {} {} 0.001\n", at(0), at(1), at(2), i % 2);
    }
    for face in [
        "0 2 3 1", "4 5 7 6", "0 1 5 4", "2 6 7 3", "0 4 6 2", "1 3 7 5",
    ] {
        text += &format!("4 {face}\n");
    }
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path
}

fn scand() -> Command {
    let mut command = Command::cargo_bin("scand").unwrap();
    command.timeout(std::time::Duration::from_secs(120));
    command
}

#[test]
fn evaluate_answers_in_json_and_draws() {
    let folder = tempfile::tempdir().unwrap();
    let truth = write_box(folder.path(), "truth.ply", [0.06, 0.06, 0.06]);
    let model = write_box(folder.path(), "model.ply", [0.06, 0.06, 0.061]);
    let picture = folder.path().join("distances.png");
    let output = scand()
        .arg("evaluate")
        .args([&model, &truth])
        .args(["--json", "--samples", "20000", "--picture"])
        .arg(&picture)
        .assert()
        .success();
    let found: serde_json::Value = serde_json::from_slice(&output.get_output().stdout).unwrap();
    let number = |path: &str| found.pointer(path).and_then(|v| v.as_f64()).unwrap();
    assert!((number("/volume_error_percent") - 100.0 / 60.0).abs() < 1e-3);
    assert!((number("/whole/accuracy/max_mm") - 1.0).abs() < 1e-3);
    assert!(number("/whole/f_scores/2/f_score") > 0.999);
    assert_eq!(found["model"]["watertight"], true);
    assert_eq!(found["by_provenance"][1]["provenance"], "carved");
    assert_eq!(found["by_expected_error"][0]["from_mm"], 1.0);
    // It expects 1 mm everywhere, and is off by 1 mm at its lid alone.
    let stated = "/by_provenance/0/expected";
    assert!(number(&format!("{stated}/actual_over_expected")) < 0.7);
    assert!(number(&format!("{stated}/within_twice_share")) > 0.999);
    assert_eq!(number(&format!("{stated}/beyond_thrice_share")), 0.0);
    assert_eq!(
        found.pointer(&format!("{stated}/rank_correlation")),
        Some(&serde_json::Value::Null)
    );
    assert!(image::open(&picture).unwrap().width() > 1000);
    for command in ["evaluate", "diff"] {
        let mut again = scand();
        again
            .args([command, "--picture"])
            .args([&picture, &model, &truth]);
        let refused = again.output().unwrap();
        let words = String::from_utf8_lossy(&refused.stderr);
        assert!(words.contains("distances.png already exists"), "{words}");
        let replaced = again.arg("--force").output().unwrap();
        assert!(replaced.stderr.is_empty(), "{replaced:?}");
    }
    let words = scand()
        .arg("evaluate")
        .args([&model, &truth])
        .assert()
        .success();
    let words = String::from_utf8_lossy(&words.get_output().stdout).into_owned();
    for wanted in [
        "F-score at 1 mm",
        "rims",
        "sharp edges",
        "normals of the outside",
        "dented",
        "carved",
        "watertight",
        "signed bias",
        "beyond 3x",
        "p90/p10",
    ] {
        assert!(words.contains(wanted), "{wanted} in {words}");
    }
}

#[test]
fn evaluate_tells_a_model_that_stands_in_the_truths_place() {
    let folder = tempfile::tempdir().unwrap();
    let model = write_box(folder.path(), "model.ply", [0.06; 3]);
    let truth = folder.path().join("truth.ply");
    let text = std::fs::read_to_string(&model).unwrap();
    std::fs::write(&truth, text.replace("uchar provenance", "uchar other")).unwrap();
    let told = |files: [&PathBuf; 2]| {
        let ended = scand().arg("evaluate").args(files).assert().success();
        String::from_utf8_lossy(&ended.get_output().stderr).into_owned()
    };
    assert_eq!(told([&model, &truth]), "");
    assert!(told([&truth, &model]).contains("the model comes first"));
}

#[test]
fn evaluate_names_what_it_cannot_read() {
    let folder = tempfile::tempdir().unwrap();
    let truth = write_box(folder.path(), "truth.ply", [0.06; 3]);
    let broken = folder.path().join("broken.glb");
    std::fs::write(&broken, b"glTF\x02\0\0\0").unwrap();
    let failed = scand()
        .arg("evaluate")
        .args([&broken, &truth])
        .assert()
        .code(1);
    assert!(String::from_utf8_lossy(&failed.get_output().stderr).contains("broken.glb"));
    scand()
        .arg("evaluate")
        .args([&truth, &truth])
        .args(["--samples", "0"])
        .assert()
        .code(2);
}

#[test]
fn diff_ends_with_what_it_found() {
    let folder = tempfile::tempdir().unwrap();
    let a = write_box(folder.path(), "a.ply", [0.06; 3]);
    let b = write_box(folder.path(), "b.ply", [0.06, 0.06, 0.063]);
    let diff = |files: [&PathBuf; 2], more: &[&str]| {
        let mut command = scand();
        command
            .arg("diff")
            .args(files)
            .args(["--samples", "5000"])
            .args(more);
        command
    };
    diff([&a, &a], &[]).assert().code(0);
    // Points between the corners are found again with round-off alone.
    let slanted = write_box(folder.path(), "slanted.ply", [0.0617, 0.0331, 0.0473]);
    diff([&slanted, &slanted], &["--tolerance-mm", "0"])
        .assert()
        .code(0);
    for (wrong, reason) in [
        ("-1", "expected 0 to 1000"),
        ("nan", "expected a length"),
        ("1e4", "expected 0 to 1000"),
    ] {
        let refused = diff([&a, &a], &["--tolerance-mm", wrong]).assert().code(2);
        let words = String::from_utf8_lossy(&refused.get_output().stderr).into_owned();
        assert!(words.contains(reason), "{words}");
    }
    diff([&a, &b], &["--tolerance-mm", "4"]).assert().code(0);
    let output = diff([&a, &b], &["--json"]).assert().code(1);
    let found: serde_json::Value = serde_json::from_slice(&output.get_output().stdout).unwrap();
    assert_eq!(found["same"], false);
    // The tops are 3 mm apart, seen from either.
    let place = &found["places"][0];
    let top = if place["on"] == "a" { 60.0 } else { 63.0 };
    assert!((place["distance_mm"].as_f64().unwrap() - 3.0).abs() < 1e-3);
    assert!((place["position_mm"][2].as_f64().unwrap() - top).abs() < 1e-3);
    diff([&a, &folder.path().join("none.ply")], &[])
        .assert()
        .code(2);
    diff([&a, &b], &["--unknown"]).assert().code(2);
}

#[test]
fn diff_that_cannot_print_its_result_does_not_say_that_models_differ() {
    let folder = tempfile::tempdir().unwrap();
    let model = write_box(folder.path(), "a.ply", [0.06; 3]);
    let full = std::fs::File::options().write(true).open("/dev/full");
    let ended = crate::support::program::scand()
        .arg("diff")
        .args([&model, &model])
        .args(["--samples", "5000"])
        .stdout(full.unwrap())
        .output()
        .unwrap();
    let words = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(2), "{words}");
    let told = words.matches("cannot write to standard output").count();
    assert_eq!(told, 1, "{words}");
}

#[test]
fn a_change_of_provenance_is_told_by_the_names_that_models_have() {
    let folder = tempfile::tempdir().unwrap();
    let a = write_box(folder.path(), "a.ply", [0.06; 3]);
    let b = folder.path().join("b.ply");
    let text = std::fs::read_to_string(&a).unwrap();
    std::fs::write(&b, text.replace(" 1 0.001\n", " 2 0.001\n")).unwrap();
    let told = scand().arg("diff").args([&a, &b]).assert().code(0);
    let words = String::from_utf8_lossy(&told.get_output().stdout).into_owned();
    assert!(words.contains("  carved to restored: "), "{words}");
}

/// A model whose texture has a seam at every edge, so that a .glb holds each vertex many times.
fn textured(mesh: Mesh) -> Model {
    let count = mesh.vertices.len();
    let triangles = mesh.triangles.len();
    let uv = |i: usize| {
        let at = i as f32 / (3 * triangles) as f32;
        [at, 1.0 - at]
    };
    Model {
        normals: vertex_normals(&mesh),
        provenance: (0..count).map(|v| Provenance::ALL[v % 6]).collect(),
        expected_error: (0..count).map(|v| v as f32 * 1e-4).collect(),
        captures: Vec::new(),
        texture: Some(Texture {
            atlas: RgbImage::filled(16, 16, [90, 120, 150]),
            corner_uv: (0..triangles)
                .map(|t| [0, 1, 2].map(|i| uv(3 * t + i)))
                .collect(),
            vertex_colors: vec![[90, 120, 150]; count],
            seen: vec![true; triangles],
        }),
        mesh,
    }
}

#[test]
fn what_is_written_is_read_back_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = load(&write_box(folder.path(), "box.ply", [0.06, 0.05, 0.04]))
        .unwrap()
        .mesh;
    let model = textured(mesh);
    let paths = ["model.ply", "model.glb"].map(|name| folder.path().join(name));
    std::fs::write(
        &paths[0],
        ply::encode(&model, &Description::default()).unwrap(),
    )
    .unwrap();
    std::fs::write(
        &paths[1],
        glb::encode(&model, &Description::default(), &glb::Parameters::default()).unwrap(),
    )
    .unwrap();
    for path in paths {
        let read = load(&path).unwrap();
        assert_eq!(read.mesh.vertices.len(), 8, "{}", path.display());
        let (provenance, errors) = (read.provenance.unwrap(), read.expected_error.unwrap());
        for (v, p) in read.mesh.vertices.iter().enumerate() {
            let near = |q: &&nalgebra::Point3<f32>| (*q - p).norm() < 1e-7;
            let old = model.mesh.vertices.iter().position(|q| near(&q)).unwrap();
            assert_eq!(provenance[v], model.provenance[old]);
            assert_eq!(errors[v], model.expected_error[old]);
        }
        assert!(scand::mesh::check(&read.mesh).is_watertight());
    }
}

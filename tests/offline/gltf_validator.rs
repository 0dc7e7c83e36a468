//! Runs the Khronos validator over the files that scand writes. It needs node and the npm package `gltf-validator`
//! (`npm install` in `tests/gltf`), which `tests/deps.sh` installs if npm is installed.

use crate::support::skipped::{Needed, skip};
use nalgebra::{Point3, Vector3};
use scand::description::Description;
use scand::export::{Compression, compress};
use scand::image::RgbImage;
use scand::mesh::Mesh;
use scand::output::glb;
use scand::reconstruct::{Model, Provenance, Texture};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Validates files; `None` where the validator is not installed, else whether all are clean, and the reports.
fn validate(files: &[PathBuf]) -> Option<(bool, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/gltf");
    let modules = std::env::var_os("SCAND_GLTF_VALIDATOR")
        .map_or_else(|| folder.join("node_modules"), PathBuf::from);
    if !modules.join("gltf-validator").exists() {
        return None;
    }
    let output = Command::new("node")
        .env("NODE_PATH", modules)
        .arg(folder.join("validate.js"))
        .args(files)
        .output()
        .ok()?;
    let text = [output.stdout, output.stderr].concat();
    let text = String::from_utf8_lossy(&text).into_owned();
    Some((output.status.success(), text))
}

fn tetrahedron() -> Model {
    let corners = [
        [0.0f32; 3],
        [0.1, 0.0, 0.0],
        [0.0, 0.1, 0.0],
        [0.0, 0.0, 0.1],
    ];
    let mesh = Mesh {
        vertices: corners.map(Point3::from).to_vec(),
        triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
    };
    Model {
        normals: scand::mesh::vertex_normals(&mesh),
        provenance: Provenance::ALL[..4].to_vec(),
        expected_error: vec![0.0001, 0.0003, 0.1, 0.0],
        captures: Vec::new(),
        texture: None,
        mesh,
    }
}

fn painted() -> Model {
    let flat = |i: usize| {
        let left = i as f32 * 0.25;
        [[left, 0.0], [left + 0.2, 0.0], [left, 1.0]]
    };
    Model {
        texture: Some(Texture {
            atlas: RgbImage::from_fn(37, 23, |x, y| [x as u8 * 6, y as u8 * 9, 128]),
            corner_uv: (0..4).map(flat).collect(),
            vertex_colors: vec![[128; 3]; 4],
            seen: vec![true, true, true, false],
        }),
        ..tetrahedron()
    }
}

#[test]
fn the_khronos_validator_finds_nothing() {
    let mut broken_normals = tetrahedron();
    broken_normals.normals[0] = Vector3::zeros();
    let empty_atlas = Model {
        texture: painted().texture.map(|t| Texture {
            atlas: RgbImage::default(),
            ..t
        }),
        ..tetrahedron()
    };
    let of_several = Model {
        captures: vec![1, 2, 3, 0xff_ffff],
        ..painted()
    };
    let models = [
        ("painted", painted()),
        ("of-several", of_several),
        ("unlit", painted()),
        ("plain", tetrahedron()),
        ("broken-normals", broken_normals),
        ("empty-atlas", empty_atlas),
        ("empty", Model::default()),
    ];
    // All that a model can say of its object.
    let about = |name: &str| Description {
        capture: name.into(),
        captures: Some(format!("{name}, other")),
        subject: Some("1884.3".into()),
        title: Some("Krater \"with\" handles".into()),
        operator: Some("Ann".into()),
        project: Some("day".into()),
        rights: Some("CC0".into()),
        session: Some("amphora".into()),
        rig: Some("north".into()),
        time: "2026-01-31T23:59:59.123Z".into(),
        input_sha256: "ab".repeat(32),
        calibration_sha256: "cd".repeat(32),
        program: "scand 0.1.0".into(),
    };
    let home = tempfile::tempdir().unwrap();
    let files = models.map(|(name, model)| {
        let path = home.path().join(name).with_extension("glb");
        let parameters = glb::Parameters {
            unlit: name == "unlit",
            ..glb::Parameters::default()
        };
        let bytes = glb::encode(&model, &about(name), &parameters).unwrap();
        std::fs::write(&path, bytes).unwrap();
        path
    });
    let small = home.path().join("painted-compressed.glb");
    let whole = std::fs::read(&files[0]).unwrap();
    let compressed = compress(&whole, Compression::Quantization).unwrap();
    std::fs::write(&small, compressed).unwrap();
    let files: Vec<PathBuf> = files.into_iter().chain([small]).collect();
    match validate(&files) {
        None => skip(Needed::GltfValidator, "no validator of glTF files"),
        Some((clean, report)) => {
            println!("{report}");
            assert!(clean, "{report}");
        }
    }
}

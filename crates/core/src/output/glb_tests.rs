//! Tests of the .glb writer: what it writes is parsed back by the letter of the specification.

use super::*;
use crate::image::rgb_from_file;
use crate::mesh;
use nalgebra::{Point3, Vector3};
use serde_json::Value;

/// A square of two triangles with a seam along its diagonal; the second triangle was not seen.
pub(crate) fn textured_square() -> Model {
    let vertices = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    let mesh = mesh::Mesh {
        vertices: vertices
            .iter()
            .map(|&[x, y]| Point3::new(x, y, 0.25))
            .collect(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    };
    Model {
        normals: vec![Vector3::z(); 4],
        provenance: vec![
            Provenance::Hull,
            Provenance::Table,
            Provenance::Carved,
            Provenance::Restored,
        ],
        expected_error: vec![0.0001, 0.0002, 0.0003, 0.0004],
        captures: Vec::new(),
        texture: Some(Texture {
            atlas: RgbImage::filled(16, 8, [200, 100, 50]),
            corner_uv: vec![
                [[0.0, 0.0], [0.5, 0.0], [0.5, 1.0]],
                [[0.5, 0.0], [1.0, 1.0], [0.5, 1.0]],
            ],
            vertex_colors: vec![[200, 100, 50], [1, 2, 3], [4, 5, 6], [7, 8, 9]],
            seen: vec![true, false],
        }),
        mesh,
    }
}

/// What is known of a model.
pub(crate) fn described(capture: &str) -> Description {
    let known = |text: &str| Some(text.to_owned());
    Description {
        capture: capture.into(),
        subject: known("1884.3"),
        title: known("Krater"),
        operator: known("Ann"),
        rights: known("CC0"),
        session: known("day"),
        time: "2026-01-31T23:59:59.123Z".into(),
        input_sha256: "ab".into(),
        calibration_sha256: "cd".into(),
        program: "scand test".into(),
        ..Description::default()
    }
}

#[test]
fn what_is_known_of_the_object_is_in_the_file() {
    let bytes = encode(
        &textured_square(),
        &described("cup-1"),
        &Parameters::default(),
    )
    .unwrap();
    let (json, _) = parse(&bytes);
    let extras = &json["asset"]["extras"];
    assert_eq!(
        [&extras["subject"], &extras["capture"], &extras["units"]],
        ["1884.3", "cup-1", "metres"]
    );
    assert_eq!(extras["project"], Value::Null);
    assert_eq!(
        json["extensionsUsed"],
        serde_json::json!(["KHR_xmp_json_ld"])
    );
    assert_eq!(json["asset"]["extensions"]["KHR_xmp_json_ld"]["packet"], 0);
    let packet = &json["extensions"]["KHR_xmp_json_ld"]["packets"][0];
    assert_eq!(packet["dc:identifier"], "1884.3");
    assert_eq!(packet["dc:title"]["rdf:_1"]["@value"], "Krater");
    assert_eq!(packet["dc:creator"]["@list"][0], "Ann");
    let process = &packet["crmdig:L11i_was_output_of"];
    assert_eq!(
        process["crmdig:L23_used_software_or_firmware"],
        "scand test"
    );
    // Every prefix that the packet uses is one that its context declares.
    let text = packet.to_string();
    let prefixes = text
        .split('"')
        .filter_map(|word| word.split_once(':'))
        .map(|(prefix, _)| prefix);
    for prefix in prefixes.filter(|p| ["dc", "dcterms", "rdf", "crmdig"].contains(p)) {
        assert!(packet["@context"][prefix].is_string(), "{prefix}");
    }
}

#[test]
fn an_unlit_material_says_so_and_is_lit_otherwise() {
    let json = |unlit| {
        let parameters = Parameters {
            unlit,
            ..Parameters::default()
        };
        let bytes = encode(&textured_square(), &described("cup-1"), &parameters).unwrap();
        parse(&bytes).0
    };
    let extension = "KHR_materials_unlit";
    let unlit = json(true);
    assert!(unlit["materials"][0]["extensions"][extension].is_object());
    assert_eq!(unlit["extensionsUsed"][1], extension);
    assert_eq!(json(false)["materials"][0]["extensions"], Value::Null);
}

/// The JSON and the binary chunk of a .glb, its framing checked.
fn parse(bytes: &[u8]) -> (Value, &[u8]) {
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!(&bytes[..4], b"glTF");
    assert_eq!(word(4), 2);
    assert_eq!(word(8), bytes.len());
    let json_size = word(12);
    assert_eq!(&bytes[16..20], b"JSON");
    assert_eq!(json_size % 4, 0);
    let json = serde_json::from_slice(&bytes[20..20 + json_size]).unwrap();
    let rest = &bytes[20 + json_size..];
    if rest.is_empty() {
        return (json, rest);
    }
    assert_eq!(&rest[4..8], b"BIN\0");
    assert_eq!(rest.len() % 4, 0);
    (json, &rest[8..])
}

/// The numbers of an accessor, row by row, and its limits checked.
fn read(json: &Value, binary: &[u8], accessor: &Value) -> Vec<Vec<f64>> {
    let accessor = &json["accessors"][accessor.as_u64().unwrap() as usize];
    let view = &json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
    let number = |v: &Value| v.as_u64().map(|n| n as usize);
    let offset = number(&view["byteOffset"]).unwrap();
    assert_eq!(offset % 4, 0);
    let width = match accessor["type"].as_str().unwrap() {
        "SCALAR" => 1,
        "VEC2" => 2,
        _ => 3,
    };
    let kind = accessor["componentType"].as_u64().unwrap() as u32;
    let component = |at: usize| match kind {
        UNSIGNED_INT => f64::from(u32::from_le_bytes(binary[at..at + 4].try_into().unwrap())),
        _ => f64::from(f32::from_le_bytes(binary[at..at + 4].try_into().unwrap())),
    };
    let rows: Vec<Vec<f64>> = (0..number(&accessor["count"]).unwrap())
        .map(|row| {
            let start = offset + row * width * 4;
            (0..width).map(|c| component(start + c * 4)).collect()
        })
        .collect();
    for c in 0..width {
        let column = || rows.iter().map(|r| r[c]);
        let low = column().fold(f64::INFINITY, f64::min);
        let high = column().fold(f64::NEG_INFINITY, f64::max);
        assert_eq!(accessor["min"][c].as_f64(), Some(low));
        assert_eq!(accessor["max"][c].as_f64(), Some(high));
    }
    rows
}

#[test]
fn what_is_written_is_read_back() {
    let model = textured_square();
    let bytes = encode(&model, &described("cup-1"), &Parameters::default()).unwrap();
    let (json, binary) = parse(&bytes);
    assert_eq!(json["asset"]["extras"]["capture"], "cup-1");
    let primitive = &json["meshes"][0]["primitives"][0];
    let attribute = |name: &str| read(&json, binary, &primitive["attributes"][name]);
    let positions = attribute("POSITION");
    assert_eq!(positions.len(), 6, "the diagonal is a seam");
    let indices = read(&json, binary, &primitive["indices"]);
    assert_eq!(indices.len(), 6);
    for (corner, index) in indices.iter().enumerate() {
        let (triangle, corner) = (corner / 3, corner % 3);
        let vertex = model.mesh.triangles[triangle][corner] as usize;
        let index = index[0] as usize;
        let expected = y_up(model.mesh.vertices[vertex].into()).map(f64::from);
        assert_eq!(positions[index], expected);
        assert_eq!(attribute("NORMAL")[index], [0.0, 1.0, 0.0]);
        let provenance = f64::from(model.provenance[vertex] as u8);
        assert_eq!(attribute("_PROVENANCE")[index], [provenance]);
        let error = f64::from(model.expected_error[vertex]);
        assert_eq!(attribute("_ERROR")[index], [error]);
        let texture = model.texture.as_ref().unwrap();
        let uv = texture.corner_uv[triangle][corner].map(f64::from);
        assert_eq!(attribute("TEXCOORD_0")[index], uv);
        let seen = f64::from(u8::from(texture.seen[triangle]));
        assert_eq!(attribute("_SEEN")[index], [seen]);
    }
}

#[test]
fn the_embedded_picture_is_the_atlas() {
    let bytes = encode(
        &textured_square(),
        &described("cup"),
        &Parameters::default(),
    )
    .unwrap();
    let (json, binary) = parse(&bytes);
    let view = json["images"][0]["bufferView"].as_u64().unwrap() as usize;
    let view = &json["bufferViews"][view];
    let offset = view["byteOffset"].as_u64().unwrap() as usize;
    let length = view["byteLength"].as_u64().unwrap() as usize;
    let picture = rgb_from_file("jpeg", &binary[offset..offset + length], (16, 8)).unwrap();
    for (found, expected) in picture[(7, 3)].iter().zip([200, 100, 50]) {
        assert!(found.abs_diff(expected) <= 3, "{found} {expected}");
    }
}

#[test]
fn a_model_without_texture_or_triangles_is_written() {
    let plain = Model {
        texture: None,
        ..textured_square()
    };
    let bytes = encode(&plain, &described("x"), &Parameters::default()).unwrap();
    let (json, _) = parse(&bytes);
    assert_eq!(json["accessors"][0]["count"], 4);
    assert!(json["textures"].is_null());
    let bytes = encode(&Model::default(), &described("x"), &Parameters::default()).unwrap();
    let (json, binary) = parse(&bytes);
    assert!(json["meshes"].is_null() && binary.is_empty());
}

#[test]
fn a_model_that_does_not_hold_together_is_refused() {
    let refused = |spoil: fn(&mut Model), word: &str| {
        let mut model = textured_square();
        spoil(&mut model);
        let error = encode(&model, &described("x"), &Parameters::default()).unwrap_err();
        assert!(error.to_string().contains(word), "{error}");
        assert!(crate::output::ply::encode(&model, &described("x")).is_err());
    };
    refused(|m| m.mesh.vertices[1].x = f32::NAN, "position");
    refused(|m| m.mesh.triangles[0][0] = 9, "vertex index");
    refused(|m| m.expected_error[0] = f32::INFINITY, "expected error");
    refused(|m| m.normals.truncate(1), "normals");
    refused(|m| m.provenance.clear(), "provenance");
    refused(
        |m| m.texture.as_mut().unwrap().corner_uv.clear(),
        "corner uv",
    );
}

#[test]
fn which_captures_made_a_vertex_is_written_of_several_captures_alone() {
    let mut model = textured_square();
    let captures = |model: &Model| {
        let bytes = encode(model, &described("x"), &Parameters::default()).unwrap();
        let (json, binary) = parse(&bytes);
        let mesh = &json["meshes"][0];
        assert_eq!(
            mesh["extras"]["_CAPTURES"].is_string(),
            !model.captures.is_empty()
        );
        let attributes = &mesh["primitives"][0]["attributes"];
        let accessor = attributes.get("_CAPTURES")?;
        let positions = read(&json, binary, &attributes["POSITION"]);
        Some((positions, read(&json, binary, accessor)))
    };
    assert!(captures(&model).is_none());
    model.captures = vec![1, 2, 3, 1 << 23];
    let (positions, found) = captures(&model).unwrap();
    for (position, found) in positions.iter().zip(&found) {
        let is_at = |v: &&Point3<f32>| y_up((**v).into()).map(f64::from) == position[..];
        let vertex = model.mesh.vertices.iter().position(|v| is_at(&v)).unwrap();
        assert_eq!(found[..], [f64::from(model.captures[vertex])]);
    }
    model.captures.pop();
    assert!(encode(&model, &described("x"), &Parameters::default()).is_err());
}

#[test]
fn normals_are_of_unit_length_whatever_comes() {
    let mut model = textured_square();
    model.normals[0] = Vector3::zeros();
    model.normals[1] = Vector3::new(f32::NAN, 0.0, 0.0);
    model.normals[2] = Vector3::new(0.0, 3.0, 0.0);
    let bytes = encode(&model, &described("x"), &Parameters::default()).unwrap();
    let (json, binary) = parse(&bytes);
    let primitive = &json["meshes"][0]["primitives"][0];
    for normal in read(&json, binary, &primitive["attributes"]["NORMAL"]) {
        let length = normal.iter().map(|n| n * n).sum::<f64>().sqrt();
        assert!((length - 1.0).abs() < 1e-6, "{normal:?}");
    }
}

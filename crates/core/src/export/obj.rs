//! Wavefront OBJ with its material (MTL) and texture (PNG): metres, y up.

use super::{Error, File, known, unique_uv};
use crate::description::Description;
use crate::output::{encode_png, unit, y_up};
use crate::reconstruct::Model;
use std::fmt::Write;

/// The files of a model: `STEM.png` and `STEM.mtl`, if it has a texture, and `STEM.obj`.
///
/// # Errors
/// If the texture cannot be encoded.
pub(super) fn encode(model: &Model, about: &Description, stem: &str) -> Result<Vec<File>, Error> {
    let mut files = Vec::new();
    let mut put = |ending: &str, bytes: Vec<u8>| {
        files.push(File {
            name: format!("{stem}.{ending}"),
            bytes,
        });
    };
    if let Some(texture) = &model.texture {
        put("png", encode_png(&texture.atlas)?);
    }
    put("mtl", material(model, stem).into_bytes());
    put("obj", surface(model, about, stem).into_bytes());
    Ok(files)
}

fn material(model: &Model, stem: &str) -> String {
    let color = match model.texture {
        Some(_) => format!("Kd 1 1 1\nmap_Kd {stem}.png\n"),
        None => "Kd 0.6 0.6 0.6\n".into(),
    };
    format!("newmtl surface\n{color}Ka 0 0 0\nKs 0 0 0\nd 1\nillum 1\n")
}

fn surface(model: &Model, about: &Description, stem: &str) -> String {
    let mut text = String::from("# scand; metres, y up\n");
    for line in known(about) {
        let _ = writeln!(text, "# {line}");
    }
    let _ = writeln!(text, "mtllib {stem}.mtl\no {stem}");
    for vertex in &model.mesh.vertices {
        let [x, y, z] = y_up((*vertex).into());
        let _ = writeln!(text, "v {x} {y} {z}");
    }
    let (places, corners) = model.texture.as_ref().map(unique_uv).unwrap_or_default();
    for [u, v] in places {
        // Up from the bottom edge.
        let _ = writeln!(text, "vt {u} {}", 1.0 - v);
    }
    for normal in &model.normals {
        let [x, y, z] = y_up(unit(*normal).into());
        let _ = writeln!(text, "vn {x} {y} {z}");
    }
    text.push_str("usemtl surface\n");
    for (t, triangle) in model.mesh.triangles.iter().enumerate() {
        text.push('f');
        for (i, vertex) in triangle.iter().enumerate() {
            let vertex = vertex + 1;
            let _ = match corners.get(t) {
                Some(uv) => write!(text, " {vertex}/{}/{vertex}", uv[i] + 1),
                None => write!(text, " {vertex}//{vertex}"),
            };
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::testing::{described, textured_square};
    use super::*;

    #[test]
    fn a_reader_finds_metres_y_up_and_the_texture() {
        let mut about = described("a");
        about.title = Some("Krater\nv 9 9 9".into());
        let files = encode(&textured_square(), &about, "cup-1").unwrap();
        let names: Vec<&str> = files.iter().map(|f| f.name.as_str()).collect();
        assert_eq!(names, ["cup-1.png", "cup-1.mtl", "cup-1.obj"]);
        let [mtl, obj] = [1, 2].map(|i| String::from_utf8(files[i].bytes.clone()).unwrap());
        assert!(mtl.contains("map_Kd cup-1.png"), "{mtl}");
        let lines = |kind: &str| -> Vec<&str> {
            let prefix = format!("{kind} ");
            obj.lines().filter(|l| l.starts_with(&prefix)).collect()
        };
        assert_eq!(
            lines("v"),
            ["v 0 0.25 0", "v 1 0.25 0", "v 1 0.25 -1", "v 0 0.25 -1"]
        );
        assert_eq!(lines("vt").first(), Some(&"vt 0 1"));
        assert_eq!(lines("vn").first(), Some(&"vn 0 1 0"));
        assert_eq!(lines("f"), ["f 1/1/1 2/2/2 3/3/3", "f 1/2/1 3/4/3 4/3/4"]);
    }

    #[test]
    fn a_model_without_texture_is_grey() {
        let mut model = textured_square();
        model.texture = None;
        let files = encode(&model, &described("a"), "a").unwrap();
        assert_eq!(files.len(), 2);
        assert!(
            String::from_utf8(files[1].bytes.clone())
                .unwrap()
                .contains("f 1//1 2//2 3//3")
        );
    }
}

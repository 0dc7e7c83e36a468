//! A model as binary PLY, without the vertices that texture seams double, in the rig's frame, with colour,
//! provenance and expected error of each vertex.

use super::Error;
use super::attributes::{CAPTURES, check, unit};
use crate::description::{Description, clean};
use crate::reconstruct::{Model, Provenance};
use std::fmt::Write;

/// Bytes of one vertex: position, normal, colour, provenance, expected error. That of a model of several captures has
/// four more.
const VERTEX_BYTES: usize = 12 + 12 + 3 + 1 + 4;
/// Bytes of one face: the count and three indices.
const FACE_BYTES: usize = 1 + 12;
/// Colour of a model that has none.
const GREY: [u8; 3] = [200; 3];

/// A model as the bytes of a binary little-endian .ply. Data about the model are in comments.
///
/// # Errors
/// If the model's parts do not fit each other or hold a number that is not finite.
pub fn encode(model: &Model, about: &Description) -> Result<Vec<u8>, Error> {
    check(model)?;
    let vertices = model.mesh.vertices.len();
    let triangles = model.mesh.triangles.len();
    let mut bytes = header(model, about).into_bytes();
    let captures_bytes = 4 * model.captures.len();
    bytes.reserve_exact(vertices * VERTEX_BYTES + captures_bytes + triangles * FACE_BYTES);
    for vertex in 0..vertices {
        push_vertex(&mut bytes, model, vertex);
    }
    for triangle in &model.mesh.triangles {
        bytes.push(3);
        for index in triangle {
            bytes.extend_from_slice(&(*index as i32).to_le_bytes());
        }
    }
    Ok(bytes)
}

fn push_vertex(bytes: &mut Vec<u8>, model: &Model, vertex: usize) {
    let position = model.mesh.vertices[vertex];
    let normal = unit(model.normals[vertex]);
    for value in position.coords.iter().chain(normal.iter()) {
        bytes.extend_from_slice(&value.to_le_bytes());
    }
    let color = model
        .texture
        .as_ref()
        .map_or(GREY, |t| t.vertex_colors[vertex]);
    bytes.extend_from_slice(&color);
    bytes.push(model.provenance[vertex] as u8);
    bytes.extend_from_slice(&model.expected_error[vertex].to_le_bytes());
    if let Some(captures) = model.captures.get(vertex) {
        bytes.extend_from_slice(&captures.to_le_bytes());
    }
}

fn header(model: &Model, about: &Description) -> String {
    let is_of_several = !model.captures.is_empty();
    let mut text = String::from("ply\nformat binary_little_endian 1.0\n");
    let named =
        Provenance::ALL.map(|provenance| format!("{}={}", provenance as u8, provenance.name()));
    let captures = is_of_several.then(|| format!("captures {CAPTURES}"));
    let comments = [
        "frame rig, right-handed, z up; x y z in metres".to_owned(),
        "red green blue are sRGB-encoded".to_owned(),
        "expected_error is the expected distance to the true surface in metres".to_owned(),
        format!("provenance {}", named.join(", ")),
    ];
    // A line break in a comment would end it.
    let known = about.pairs().into_iter();
    let known = known.filter_map(|(name, text)| Some(format!("{name} {}", ascii(&clean(text)?))));
    for comment in known.chain(comments).chain(captures) {
        let _ = writeln!(text, "comment {comment}");
    }
    let _ = writeln!(text, "element vertex {}", model.mesh.vertices.len());
    for name in ["x", "y", "z", "nx", "ny", "nz"] {
        let _ = writeln!(text, "property float {name}");
    }
    for name in ["red", "green", "blue", "provenance"] {
        let _ = writeln!(text, "property uchar {name}");
    }
    text.push_str("property float expected_error\n");
    if is_of_several {
        text.push_str("property uint captures\n");
    }
    let _ = writeln!(text, "element face {}", model.mesh.triangles.len());
    text.push_str("property list uchar int vertex_indices\nend_header\n");
    text
}

/// A text in ASCII, which is all that many readers of headers take: other letters as in JSON (`\u00e4`), and a
/// backslash twice.
fn ascii(text: &str) -> String {
    let mut plain = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '\\' => plain.push_str("\\\\"),
            ' '..='~' => plain.push(letter),
            _ => {
                for unit in letter.encode_utf16(&mut [0; 2]) {
                    let _ = write!(plain, "\\u{unit:04x}");
                }
            }
        }
    }
    plain
}

#[cfg(test)]
mod tests {
    use super::super::glb::tests::{described, textured_square};
    use super::*;

    /// The header's lines and the bytes after it.
    fn parts(bytes: &[u8]) -> (Vec<&str>, &[u8]) {
        let end = b"end_header\n";
        let at = bytes.windows(end.len()).position(|w| w == end).unwrap();
        let header = std::str::from_utf8(&bytes[..at]).unwrap();
        (header.lines().collect(), &bytes[at + end.len()..])
    }

    #[test]
    fn a_header_is_ascii_whatever_the_title_is() {
        let about = Description {
            title: Some(r#"Krater «Η Νίκη» \ "𓀀" 100 %"#.into()),
            ..Description::default()
        };
        let bytes = encode(&textured_square(), &about).unwrap();
        let (lines, _) = parts(&bytes);
        let escaped = r#"comment title Krater \u00ab\u0397 \u039d\u03af\u03ba\u03b7\u00bb \\ "\ud80c\udc00" 100 %"#;
        assert!(lines.contains(&escaped), "{lines:?}");
        assert!(lines.iter().all(|line| line.is_ascii()));
    }

    fn float(bytes: &[u8], at: usize) -> f32 {
        f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
    }

    #[test]
    fn what_is_written_is_read_back() {
        let model = textured_square();
        let bytes = encode(&model, &described("cup")).unwrap();
        let (header, body) = parts(&bytes);
        assert_eq!(header[0], "ply");
        assert!(header.contains(&"comment capture cup"));
        assert!(header.contains(&"element vertex 4"));
        assert_eq!(body.len(), 4 * VERTEX_BYTES + 2 * FACE_BYTES);
        for (vertex, position) in model.mesh.vertices.iter().enumerate() {
            let record = &body[vertex * VERTEX_BYTES..];
            for i in 0..3 {
                assert_eq!(float(record, 4 * i), position[i]);
                assert_eq!(float(record, 12 + 4 * i), model.normals[vertex][i]);
            }
            let colors = &model.texture.as_ref().unwrap().vertex_colors;
            assert_eq!(record[24..27], colors[vertex]);
            assert_eq!(record[27], model.provenance[vertex] as u8);
            assert_eq!(float(record, 28), model.expected_error[vertex]);
        }
        let faces = &body[4 * VERTEX_BYTES..];
        assert_eq!(faces[0], 3);
        assert_eq!(faces[1..5], 0i32.to_le_bytes());
    }

    #[test]
    fn vertices_of_several_captures_say_which_made_them() {
        let mut model = textured_square();
        let alone = encode(&model, &described("cup")).unwrap();
        model.captures = vec![1, 2, 3, 4];
        let bytes = encode(&model, &described("cup")).unwrap();
        let (header, body) = parts(&bytes);
        let at = |line: &str| header.iter().position(|l| *l == line).unwrap();
        assert_eq!(
            at("property uint captures"),
            at("property float expected_error") + 1
        );
        let alone = parts(&alone);
        assert_eq!(
            alone.0.len() + 2,
            header.len(),
            "a comment and a property more"
        );
        for vertex in 0..4 {
            let record = &body[vertex * (VERTEX_BYTES + 4)..][..VERTEX_BYTES + 4];
            assert_eq!(
                record[..VERTEX_BYTES],
                alone.1[vertex * VERTEX_BYTES..][..VERTEX_BYTES]
            );
            assert_eq!(record[VERTEX_BYTES..], model.captures[vertex].to_le_bytes());
        }
    }

    #[test]
    fn an_empty_model_is_a_valid_file() {
        let bytes = encode(&Model::default(), &described("a\nb")).unwrap();
        let (header, body) = parts(&bytes);
        assert!(header.contains(&"comment capture a b"));
        assert!(header.contains(&"element face 0"));
        assert!(body.is_empty());
    }
}

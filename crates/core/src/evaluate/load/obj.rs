//! Wavefront OBJ: positions and faces, nothing else.

use super::{LoadedModel, fan};
use crate::mesh::Mesh;
use nalgebra::Point3;

/// Reads `v` and `f` lines (indices from 1, or negative from the latest vertex); other lines are ignored.
pub fn parse(bytes: &[u8]) -> Result<LoadedModel, String> {
    let mut mesh = Mesh::default();
    let mut polygon = Vec::new();
    for (index, line) in bytes.split(|&b| b == b'\n').enumerate() {
        let line = String::from_utf8_lossy(line);
        let mut words = line.split_ascii_whitespace();
        let number = index + 1;
        match words.next() {
            Some("v") => mesh
                .vertices
                .push(position(words).ok_or_else(|| complain(number, &line))?),
            Some("f") => {
                polygon.clear();
                for word in words {
                    let corner = corner(word, mesh.vertices.len());
                    polygon.push(corner.ok_or_else(|| complain(number, &line))?);
                }
                if polygon.len() < 3 {
                    return Err(complain(number, &line));
                }
                mesh.triangles.extend(fan(&polygon));
            }
            _ => {}
        }
    }
    Ok(LoadedModel {
        mesh,
        ..LoadedModel::default()
    })
}

fn complain(number: usize, line: &str) -> String {
    let start: String = line.trim().chars().take(60).collect();
    format!("line {number} cannot be read: \"{start}\"")
}

fn position<'a>(mut words: impl Iterator<Item = &'a str>) -> Option<Point3<f32>> {
    let mut coordinate = || words.next()?.parse().ok();
    Some(Point3::new(coordinate()?, coordinate()?, coordinate()?))
}

/// The vertex of `7`, `7/1`, `7//2` or `-1`.
fn corner(word: &str, count: usize) -> Option<u32> {
    let index: i64 = word.split('/').next()?.parse().ok()?;
    let from_start = if index < 0 {
        count as i64 + index
    } else {
        index - 1
    };
    u32::try_from(from_start).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_of_every_spelling_are_read() {
        let text =
            "# a\nv 0 0 0 1\nv 1 0 0\r\nv 1 1 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1/1 3//1 4\nf -4 -3 -1\n";
        let mesh = parse(text.as_bytes()).unwrap().mesh;
        assert_eq!(mesh.vertices.len(), 4);
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 3]]);
    }

    #[test]
    fn bad_lines_are_named() {
        for (text, wanted) in [
            ("v 1 2\n", "line 1"),
            ("v 0 0 0\nf 1 1", "line 2"),
            ("f 0 1 2", "line 1"),
            ("f -1 -2 -3", "line 1"),
            ("f a b c", "a b c"),
            ("f 99999999999999999999 1 1", "line 1"),
        ] {
            let error = parse(text.as_bytes()).unwrap_err();
            assert!(error.contains(wanted), "{error}");
        }
        assert!(parse(&[0xff, 0, b'\n', 0xfe]).is_ok());
    }
}

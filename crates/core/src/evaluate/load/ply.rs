//! PLY: ascii and binary of either byte order, any element and property, polygons as fans.

use super::{LoadedModel, fan, provenance};
use nalgebra::{Point3, Vector3};
use std::collections::BTreeMap;

/// A longer header is refused.
const MAX_HEADER_BYTES: usize = 64 << 10;
/// A face of more corners is taken for damage.
const MAX_CORNERS: usize = 1024;

/// Reads vertices (`x y z`, and where they are `nx ny nz`, `red green blue`, `provenance`, `expected_error`)
/// and faces (`vertex_indices` or `vertex_index`). Other elements and properties are stepped over.
pub(super) fn parse(bytes: &[u8]) -> Result<LoadedModel, String> {
    let (header, body) = split_header(bytes)?;
    let (format, elements) = read_header(header)?;
    let of_vertices = elements.iter().filter(|e| e.name == "vertex").count();
    if of_vertices > 1 {
        return Err(format!(
            "the header has {of_vertices} elements vertex, expected one"
        ));
    }
    let mut source = Source { rest: body, format };
    let mut model = LoadedModel::default();
    for element in &elements {
        let least = element.least_bytes(format);
        let room = source.rest.len() / least.max(1);
        if element.count > room {
            let (name, count) = (&element.name, element.count);
            return Err(format!(
                "the header lists {count} of {name}, but the file has room for at most {room}"
            ));
        }
        match element.name.as_str() {
            "vertex" => read_vertices(&mut source, element, &mut model)?,
            "face" => read_faces(&mut source, element, &mut model)?,
            // Elements without properties take no bytes: nothing to step over.
            _ if least == 0 => {}
            _ => (0..element.count).try_for_each(|_| skip(&mut source, &element.properties))?,
        }
    }
    Ok(model)
}

/// The comments of the header: the first word of each, and what follows it. Of several with one word, the first counts.
pub(super) fn comments(bytes: &[u8]) -> Result<BTreeMap<String, String>, String> {
    let (header, _) = split_header(bytes)?;
    let comments = header
        .lines()
        .filter_map(|line| line.strip_prefix("comment "));
    let mut found = BTreeMap::new();
    for (word, rest) in comments.filter_map(|comment| comment.split_once(' ')) {
        found
            .entry(word.to_owned())
            .or_insert_with(|| rest.trim_end().to_owned());
    }
    Ok(found)
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Format {
    Ascii,
    Little,
    Big,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn parse(word: &str) -> Result<Self, String> {
        Ok(match word {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            other => return Err(format!("unknown property type \"{}\"", shorten(other))),
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

struct Property {
    name: String,
    /// The type of a list's length; `None` for a single value.
    length: Option<Scalar>,
    scalar: Scalar,
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

impl Element {
    /// The fewest bytes that one of it takes.
    fn least_bytes(&self, format: Format) -> usize {
        let of = |p: &Property| match format {
            Format::Ascii => 1,
            _ => p.length.unwrap_or(p.scalar).bytes(),
        };
        self.properties.iter().map(of).sum()
    }

    fn property(&self, name: &str) -> Option<usize> {
        self.properties
            .iter()
            .position(|p| p.name == name && p.length.is_none())
    }

    fn all<const N: usize>(&self, names: [&str; N]) -> Option<[usize; N]> {
        let found = names.map(|name| self.property(name));
        found
            .iter()
            .all(Option::is_some)
            .then(|| found.map(|f| f.unwrap_or(0)))
    }
}

fn shorten(text: &str) -> String {
    text.chars().take(40).collect()
}

fn split_header(bytes: &[u8]) -> Result<(&str, &[u8]), String> {
    let start = &bytes[..bytes.len().min(MAX_HEADER_BYTES)];
    if !start.starts_with(b"ply") {
        return Err("not a PLY file: it does not begin with \"ply\"".to_owned());
    }
    // A line of its own: a comment may have the word in it.
    let mark = b"\nend_header";
    let end = start.windows(mark.len()).position(|w| w == mark);
    let end = end.ok_or("the PLY header does not end")?;
    let header = std::str::from_utf8(&start[..end]).map_err(|_| "the PLY header is not text")?;
    let after = &bytes[end + mark.len()..];
    let line_end = after.iter().position(|&b| b == b'\n');
    let line_end = line_end.ok_or("the file ends with its PLY header")?;
    Ok((header, &after[line_end + 1..]))
}

fn read_header(header: &str) -> Result<(Format, Vec<Element>), String> {
    let mut format = None;
    let mut elements: Vec<Element> = Vec::new();
    for line in header.lines() {
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words.as_slice() {
            ["format", "ascii", _] => format = Some(Format::Ascii),
            ["format", "binary_little_endian", _] => format = Some(Format::Little),
            ["format", "binary_big_endian", _] => format = Some(Format::Big),
            ["element", name, count] => elements.push(Element {
                name: (*name).to_owned(),
                count: count
                    .parse()
                    .map_err(|_| format!("element {} has no count", shorten(name)))?,
                properties: Vec::new(),
            }),
            ["property", rest @ ..] => {
                let property = read_property(rest)?;
                let element = elements.last_mut().ok_or(
                    "a property comes before the first \
                    element",
                )?;
                element.properties.push(property);
            }
            [] | ["ply" | "comment" | "obj_info", ..] => {}
            _ => return Err(format!("unknown header line \"{}\"", shorten(line))),
        }
    }
    Ok((format.ok_or("the PLY header has no format")?, elements))
}

fn read_property(words: &[&str]) -> Result<Property, String> {
    let (name, length, scalar) = match words {
        ["list", length, scalar, name] => (name, Some(Scalar::parse(length)?), scalar),
        [scalar, name] => (name, None, scalar),
        _ => return Err(format!("unknown property {words:.3?}")),
    };
    Ok(Property {
        name: (*name).to_owned(),
        length,
        scalar: Scalar::parse(scalar)?,
    })
}

/// What is left of the file's body.
struct Source<'a> {
    rest: &'a [u8],
    format: Format,
}

impl Source<'_> {
    fn next(&mut self, scalar: Scalar) -> Result<f64, String> {
        if self.format == Format::Ascii {
            return self.next_word();
        }
        // `f64` holds each of them exactly.
        Ok(match scalar {
            Scalar::I8 => i8::from_le_bytes(self.bytes()?).into(),
            Scalar::U8 => u8::from_le_bytes(self.bytes()?).into(),
            Scalar::I16 => i16::from_le_bytes(self.bytes()?).into(),
            Scalar::U16 => u16::from_le_bytes(self.bytes()?).into(),
            Scalar::I32 => i32::from_le_bytes(self.bytes()?).into(),
            Scalar::U32 => u32::from_le_bytes(self.bytes()?).into(),
            Scalar::F32 => f32::from_le_bytes(self.bytes()?).into(),
            Scalar::F64 => f64::from_le_bytes(self.bytes()?),
        })
    }

    /// The next bytes of a binary file, the least significant first.
    fn bytes<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (&bytes, rest) = self.rest.split_first_chunk().ok_or("the file ends early")?;
        self.rest = rest;
        let mut bytes: [u8; N] = bytes;
        if self.format == Format::Big {
            bytes.reverse();
        }
        Ok(bytes)
    }

    fn next_word(&mut self) -> Result<f64, String> {
        let text = self.rest.trim_ascii_start();
        let end = text.iter().position(u8::is_ascii_whitespace);
        let (word, rest) = text.split_at(end.unwrap_or(text.len()));
        self.rest = rest;
        if word.is_empty() {
            return Err("the file ends early".to_owned());
        }
        let word = String::from_utf8_lossy(word);
        word.parse()
            .map_err(|_| format!("\"{}\" is not a number", shorten(&word)))
    }

    /// The length of a list whose items have type `scalar`, which the file must have room for.
    fn list_length(&mut self, length: Scalar, scalar: Scalar) -> Result<usize, String> {
        let count = self.next(length)?;
        let item = match self.format {
            Format::Ascii => 1,
            _ => scalar.bytes(),
        };
        let room = self.rest.len() / item;
        if count.fract() != 0.0 || !(0.0..=room as f64).contains(&count) {
            return Err(format!(
                "a list has {count} values, but the file has room for only {room}"
            ));
        }
        Ok(count as usize)
    }
}

fn skip(source: &mut Source, properties: &[Property]) -> Result<(), String> {
    for property in properties {
        let count = match property.length {
            Some(length) => source.list_length(length, property.scalar)?,
            None => 1,
        };
        for _ in 0..count {
            source.next(property.scalar)?;
        }
    }
    Ok(())
}

fn read_vertices(
    source: &mut Source,
    element: &Element,
    model: &mut LoadedModel,
) -> Result<(), String> {
    let position = element.all(["x", "y", "z"]);
    let position = position.ok_or("the vertices have no x, y and z")?;
    let normal = element.all(["nx", "ny", "nz"]);
    let color = element.all(["red", "green", "blue"]);
    let origin = element.property("provenance");
    let error = element.property("expected_error");
    let mut row = vec![0.0; element.properties.len()];
    let mut normals = normal.map(|_| Vec::new());
    let mut colors = color.map(|_| Vec::new());
    let mut origins = origin.map(|_| Vec::new());
    let mut errors = error.map(|_| Vec::new());
    for vertex in 0..element.count {
        for (value, property) in row.iter_mut().zip(&element.properties) {
            match property.length {
                Some(_) => skip(source, std::slice::from_ref(property))?,
                None => *value = source.next(property.scalar)?,
            }
        }
        let three = |at: [usize; 3]| at.map(|i| row[i] as f32);
        model.mesh.vertices.push(Point3::from(three(position)));
        if let (Some(list), Some(at)) = (&mut normals, normal) {
            list.push(Vector3::from(three(at)));
        }
        if let (Some(list), Some(at)) = (&mut colors, color) {
            list.push(at.map(|i| row[i] as u8));
        }
        if let (Some(list), Some(at)) = (&mut origins, origin) {
            list.push(provenance(row[at], vertex)?);
        }
        if let (Some(list), Some(at)) = (&mut errors, error) {
            list.push(row[at] as f32);
        }
    }
    model.normals = normals;
    model.colors = colors;
    model.provenance = origins;
    model.expected_error = errors;
    Ok(())
}

fn read_faces(
    source: &mut Source,
    element: &Element,
    model: &mut LoadedModel,
) -> Result<(), String> {
    let is_indices = |p: &Property| {
        p.length.is_some() && matches!(p.name.as_str(), "vertex_indices" | "vertex_index")
    };
    let Some(indices) = element.properties.iter().position(is_indices) else {
        return Err("the faces have no vertex_indices".to_owned());
    };
    let (before, after) = element.properties.split_at(indices);
    let mut polygon = Vec::new();
    for face in 0..element.count {
        skip(source, before)?;
        read_polygon(source, &after[0], &mut polygon).map_err(|e| format!("face {face}: {e}"))?;
        model.mesh.triangles.extend(fan(&polygon));
        skip(source, &after[1..])?;
    }
    Ok(())
}

fn read_polygon(
    source: &mut Source,
    property: &Property,
    polygon: &mut Vec<u32>,
) -> Result<(), String> {
    polygon.clear();
    let length = property.length.unwrap_or(property.scalar);
    let count = source.list_length(length, property.scalar)?;
    if count > MAX_CORNERS {
        return Err(format!(
            "it has {count} corners, expected at most {MAX_CORNERS}"
        ));
    }
    for _ in 0..count {
        let index = source.next(property.scalar)?;
        if index.fract() != 0.0 || !(0.0..=f64::from(u32::MAX)).contains(&index) {
            return Err(format!("{index} is not the index of a vertex"));
        }
        polygon.push(index as u32);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reconstruct::Provenance;
    use proptest::prelude::*;

    const VERTEX: &str = "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n";
    const FACE: &str = "element face 1\nproperty list uchar int vertex_indices\n";

    fn header(format: &str, extra: &str) -> String {
        format!(
            "ply\nformat {format} 1.0\ncomment c\n{VERTEX}{extra}element other 2\nproperty list uchar short a\n\
             property double b\n{FACE}end_header\n"
        )
    }

    fn binary(big: bool) -> Vec<u8> {
        let put = |out: &mut Vec<u8>, mut bytes: Vec<u8>| {
            if big {
                bytes.reverse();
            }
            out.extend(bytes);
        };
        let format = if big {
            "binary_big_endian"
        } else {
            "binary_little_endian"
        };
        let extra = "property uchar provenance\nproperty float expected_error\n";
        let mut out = header(format, extra).into_bytes();
        for v in 0..3_u8 {
            for c in [v == 1, v == 2, false] {
                put(&mut out, f32::from(u8::from(c)).to_le_bytes().to_vec());
            }
            out.push(v);
            put(&mut out, (0.5 * f32::from(v)).to_le_bytes().to_vec());
        }
        for other in [1_u8, 0] {
            out.push(other);
            (0..other).for_each(|_| put(&mut out, 7_i16.to_le_bytes().to_vec()));
            put(&mut out, 1.5_f64.to_le_bytes().to_vec());
        }
        out.push(3);
        (0..3_i32).for_each(|i| put(&mut out, i.to_le_bytes().to_vec()));
        out
    }

    #[test]
    fn both_byte_orders_and_ascii_say_the_same() {
        let little = parse(&binary(false)).unwrap();
        assert_eq!(little.mesh.triangles, [[0, 1, 2]]);
        assert_eq!(little.mesh.vertices[1], Point3::new(1.0, 0.0, 0.0));
        let carved = [Provenance::Hull, Provenance::Carved, Provenance::Restored];
        assert_eq!(little.provenance.as_deref(), Some(&carved[..]));
        assert_eq!(little.expected_error.as_deref(), Some(&[0.0, 0.5, 1.0][..]));
        assert_eq!(parse(&binary(true)).unwrap(), little);
        let extra = "property uchar provenance\nproperty float expected_error\n";
        let text =
            header("ascii", extra) + "0 0 0 0 0\n1 0 0 1 .5\n0 1 0 2 1\n1 7 1.5\n0 1.5\n3 0 1 2\n";
        assert_eq!(parse(text.as_bytes()).unwrap(), little);
    }

    #[test]
    fn a_comment_may_have_the_word_that_ends_a_header() {
        let text = header("ascii", "") + "0 0 0\n1 0 0\n0 1 0\n1 7 1.5\n0 1.5\n3 0 1 2\n";
        let named = text.replace("comment c", "comment subject end_header 3");
        assert_eq!(parse(named.as_bytes()), parse(text.as_bytes()));
        assert_eq!(parse(named.as_bytes()).unwrap().mesh.triangles.len(), 1);
    }

    #[test]
    fn normals_colours_and_polygons_are_read() {
        let text = "ply\r\nformat ascii 1.0\r\nelement vertex 4\r\nproperty float x\r\nproperty float y\r\n\
            property float z\r\nproperty float nx\r\nproperty float ny\r\nproperty float nz\r\n\
            property uchar red\r\nproperty uchar green\r\nproperty uchar blue\r\nproperty uchar alpha\r\n\
            element face 1\r\nproperty list uchar uint vertex_index\r\nend_header\r\n\
            0 0 0 0 0 1 1 2 3 255\r\n1 0 0 0 0 1 4 5 6 255\r\n1 1 0 0 0 1 7 8 9 255\r\n\
            0 1 0 0 0 1 10 11 12 255\r\n4 0 1 2 3\r\n";
        let model = parse(text.as_bytes()).unwrap();
        assert_eq!(model.mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(model.colors.unwrap()[2], [7, 8, 9]);
        assert_eq!(model.normals.unwrap()[3], Vector3::z());
        assert_eq!(model.provenance, None);
    }

    #[test]
    fn of_comments_with_one_word_the_first_counts() {
        let text = "ply\r\ncomment capture cup 1\r\ncomment\r\ncomment alone\r\ncomment capture other\r\nend_header\n";
        let found = comments(text.as_bytes()).unwrap();
        assert_eq!(
            found.into_iter().collect::<Vec<_>>(),
            [("capture".to_owned(), "cup 1".to_owned())]
        );
        assert!(comments(b"ply\ncomment capture cup").is_err());
    }

    #[test]
    fn hostile_files_are_refused_with_a_reason() {
        let with = |from: &str, to: &str| {
            let mut text = binary(false);
            let at = text
                .windows(from.len())
                .position(|w| w == from.as_bytes())
                .unwrap();
            text.splice(at..at + from.len(), to.bytes());
            parse(&text).unwrap_err()
        };
        assert!(
            with("vertex 3", "vertex 18446744073709551615")
                .contains("18446744073709551615 of vertex")
        );
        assert!(with("vertex 3", "vertex -3").contains("no count"));
        assert!(with("other 2", "other 99999999").contains("99999999 of other"));
        assert!(with("float x", "quad x").contains("quad"));
        assert!(with("float x", "float w").contains("no x, y and z"));
        assert!(with("vertex_indices", "corners").contains("vertex_indices"));
        assert!(with("little", "middle").contains("format"));
        assert!(with("end_header", "no_header!").contains("does not end"));
        assert!(with("ply", "pig").contains("not a PLY"));
        let mut provenance = binary(false);
        let body = provenance
            .windows(10)
            .position(|w| w == b"end_header")
            .unwrap()
            + 11;
        provenance[body + 12] = 77;
        assert!(parse(&provenance).unwrap_err().contains("provenance 77"));
        // The second one's values would stand for the vertices of both.
        assert!(with("other 2", "vertex 2").contains("2 elements vertex"));
    }

    proptest! {
        #[test]
        fn damage_anywhere_gives_an_answer_or_an_error(
            at in 0_usize..400, value: u8, cut in 0_usize..400, big: bool,
        ) {
            let mut bytes = binary(big);
            let length = bytes.len();
            bytes[at % length] = value;
            let _ = parse(&bytes);
            bytes.truncate(cut % length);
            let _ = parse(&bytes);
        }

        #[test]
        fn a_file_cut_off_is_an_error(cut in 0_usize..400) {
            let bytes = binary(false);
            prop_assert!(parse(&bytes[..cut % bytes.len()]).is_err());
        }
    }
}

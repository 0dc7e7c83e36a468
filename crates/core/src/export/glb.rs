//! Makes a smaller `model.glb`: positions, normals and texture coordinates as whole numbers (`KHR_mesh_quantization`),
//! and indices of two bytes if they fit. It takes a file that scand wrote, and changes nothing else in it.
//! `EXT_meshopt_compression` and `KHR_draco_mesh_compression` need libraries in C++, which the build does without.

use super::read;
use crate::description::Description;
use crate::gltf_file::{GltfFile, QUANTIZATION};
use crate::output;
use gltf::accessor::{DataType, Dimensions};
use gltf::json::Index;
use gltf::json::accessor::Accessor;
use serde_json::{Value, json};

/// How a glTF can be made smaller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Compression {
    /// Whole numbers instead of floats, by the extension `KHR_mesh_quantization`.
    Quantization,
}

const BYTE: u32 = 5120;
const UNSIGNED_SHORT: u32 = 5123;
/// Steps along the longest side of the box around the model.
const STEPS: f32 = 65_535.0;

/// A .glb of scand, quantised. A position is then off by at most the box's longest side over 131070.
///
/// # Errors
/// If the file is not one that scand wrote.
pub(super) fn quantize(bytes: &[u8]) -> Result<Vec<u8>, String> {
    let (file, ..) = read::parse(bytes)?;
    let json = serde_json::from_slice(file.json());
    let mut writer = Writer {
        json: json.map_err(|e| format!("the glTF JSON cannot be read: {e}"))?,
        file: &file,
        binary: Vec::new(),
        views: Vec::new(),
    };
    writer.rewrite()?;
    Ok(pack(&writer.json, &writer.binary))
}

/// A .glb of scand with another description.
///
/// # Errors
/// If the file is not one that scand wrote.
pub(super) fn describe(bytes: &[u8], about: &Description) -> Result<Vec<u8>, String> {
    let (file, ..) = read::parse(bytes)?;
    let json = serde_json::from_slice(file.json());
    let mut json = json.map_err(|e| format!("the glTF JSON cannot be read: {e}"))?;
    output::glb::describe(&mut json, about);
    Ok(pack(&json, file.binary()))
}

/// The container around JSON and binary.
fn pack(json: &Value, binary: &[u8]) -> Vec<u8> {
    let mut json = json.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    // It is about the size of the file before, whose size four bytes held.
    let total = 28 + json.len() + binary.len();
    let mut bytes = [b"glTF".as_slice(), &2_u32.to_le_bytes()].concat();
    bytes.extend((total as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", json.as_slice()), (b"BIN\0", binary)] {
        bytes.extend((chunk.len() as u32).to_le_bytes());
        bytes.extend(kind);
        bytes.extend_from_slice(chunk);
    }
    bytes
}

struct Writer<'a> {
    file: &'a GltfFile<'a>,
    json: Value,
    binary: Vec<u8>,
    views: Vec<Value>,
}

impl Writer<'_> {
    fn rewrite(&mut self) -> Result<(), String> {
        let primitive = self.json["meshes"][0]["primitives"][0].clone();
        let index = |value: &Value| value.as_u64().map(|index| index as u32);
        let attributes = primitive["attributes"].as_object();
        for (name, accessor) in attributes.into_iter().flatten() {
            let Some(accessor) = index(accessor) else {
                continue;
            };
            match name.as_str() {
                "POSITION" => self.positions(accessor)?,
                "NORMAL" => self.normals(accessor)?,
                "TEXCOORD_0" => self.places(accessor)?,
                _ => self.numbers(accessor)?,
            }
        }
        if let Some(indices) = index(&primitive["indices"]) {
            self.indices(indices)?;
        }
        self.image()?;
        self.json["bufferViews"] = Value::Array(std::mem::take(&mut self.views));
        self.json["buffers"] = json!([{ "byteLength": self.binary.len() }]);
        if let Some(used) = self.json["extensionsUsed"].as_array_mut() {
            used.push(QUANTIZATION.into());
        }
        self.json["extensionsRequired"] = json!([QUANTIZATION]);
        Ok(())
    }

    /// Positions as steps from the corner of the box around them; the node brings them back to metres.
    fn positions(&mut self, accessor: u32) -> Result<(), String> {
        let points = self.vectors::<3>(accessor)?;
        let extreme = |of: fn(f32, f32) -> f32, from: f32| {
            points
                .iter()
                .fold([from; 3], |a, b| [0, 1, 2].map(|i| of(a[i], b[i])))
        };
        let (low, high) = (
            extreme(f32::min, f32::INFINITY),
            extreme(f32::max, f32::NEG_INFINITY),
        );
        let longest = (0..3)
            .map(|i| high[i] - low[i])
            .fold(f32::MIN_POSITIVE, f32::max);
        let steps =
            |p: [f32; 3]| [0, 1, 2].map(|i| ((p[i] - low[i]) / longest * STEPS).round() as u16);
        let data = points.iter().flat_map(|p| {
            let [x, y, z] = steps(*p);
            [x, y, z, 0].map(u16::to_le_bytes).concat()
        });
        let data: Vec<u8> = data.collect();
        // Not every reader takes fractions here.
        self.attribute(accessor, &data, 8, (UNSIGNED_SHORT, false));
        self.json["accessors"][accessor as usize]["min"] = json!(steps(low));
        self.json["accessors"][accessor as usize]["max"] = json!(steps(high));
        let node = self.json["nodes"].get_mut(0).ok_or("it has no node")?;
        node["scale"] = json!([longest / STEPS, longest / STEPS, longest / STEPS]);
        node["translation"] = json!(low);
        Ok(())
    }

    fn normals(&mut self, accessor: u32) -> Result<(), String> {
        let normals = self.vectors::<3>(accessor)?;
        let byte = |c: f32| (c * 127.0).round() as i8 as u8;
        let data = normals
            .iter()
            .flat_map(|n| [byte(n[0]), byte(n[1]), byte(n[2]), 0]);
        let data: Vec<u8> = data.collect();
        self.attribute(accessor, &data, 4, (BYTE, true));
        self.forget_limits(accessor);
        Ok(())
    }

    fn places(&mut self, accessor: u32) -> Result<(), String> {
        let places = self.vectors::<2>(accessor)?;
        let step = |c: &f32| ((c * STEPS).round() as u16).to_le_bytes();
        let data: Vec<u8> = places.iter().flatten().flat_map(step).collect();
        self.attribute(accessor, &data, 4, (UNSIGNED_SHORT, true));
        self.forget_limits(accessor);
        Ok(())
    }

    /// Numbers of scand's own stay floats: importers differ in what they read there.
    fn numbers(&mut self, accessor: u32) -> Result<(), String> {
        let values = self.file.numbers(Index::new(accessor))?;
        let data: Vec<u8> = values
            .iter()
            .flat_map(|v| (*v as f32).to_le_bytes())
            .collect();
        let view = self.view(&data, json!({ "target": 34962 }));
        self.json["accessors"][accessor as usize]["bufferView"] = view;
        Ok(())
    }

    fn indices(&mut self, accessor: u32) -> Result<(), String> {
        let values = self.file.numbers(Index::new(accessor))?;
        // The largest number of two bytes is reserved.
        let fit = values.iter().all(|&v| v < f64::from(u16::MAX));
        let data: Vec<u8> = match fit {
            true => values
                .iter()
                .flat_map(|v| (*v as u16).to_le_bytes())
                .collect(),
            false => values
                .iter()
                .flat_map(|v| (*v as u32).to_le_bytes())
                .collect(),
        };
        let view = self.view(&data, json!({ "target": 34963 }));
        let accessor = &mut self.json["accessors"][accessor as usize];
        accessor["bufferView"] = view;
        if fit {
            accessor["componentType"] = UNSIGNED_SHORT.into();
        }
        Ok(())
    }

    fn image(&mut self) -> Result<(), String> {
        let Some(image) = self.file.root().images.first() else {
            return Ok(());
        };
        let bytes = image
            .buffer_view
            .and_then(|view| self.file.view_bytes(view));
        let bytes = bytes.ok_or("its texture lies outside the file")?.to_vec();
        self.json["images"][0]["bufferView"] = self.view(&bytes, json!({}));
        Ok(())
    }

    /// The vectors of an accessor of floats.
    fn vectors<const N: usize>(&self, accessor: u32) -> Result<Vec<[f32; N]>, String>
    where
        [f32; N]: gltf::accessor::util::Item,
    {
        let shape = if N == 3 {
            Dimensions::Vec3
        } else {
            Dimensions::Vec2
        };
        let index: Index<Accessor> = Index::new(accessor);
        Ok(self
            .file
            .items::<[f32; N]>(index, DataType::F32, shape)?
            .collect())
    }

    fn attribute(&mut self, accessor: u32, data: &[u8], stride: usize, kind: (u32, bool)) {
        let view = self.view(data, json!({ "target": 34962, "byteStride": stride }));
        let accessor = &mut self.json["accessors"][accessor as usize];
        accessor["bufferView"] = view;
        accessor["componentType"] = kind.0.into();
        accessor["normalized"] = kind.1.into();
    }

    /// Only positions must say their limits.
    fn forget_limits(&mut self, accessor: u32) {
        if let Some(accessor) = self.json["accessors"][accessor as usize].as_object_mut() {
            accessor.remove("min");
            accessor.remove("max");
        }
    }

    /// Appends a view, aligned to 4 bytes.
    fn view(&mut self, data: &[u8], mut with: Value) -> Value {
        with["buffer"] = 0.into();
        with["byteOffset"] = self.binary.len().into();
        with["byteLength"] = data.len().into();
        self.views.push(with);
        self.binary.extend_from_slice(data);
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        (self.views.len() - 1).into()
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{as_glb, described, painted_ball};
    use super::*;
    use crate::evaluate::load::load_unwelded;
    use std::path::Path;

    #[test]
    fn a_quantised_model_is_smaller_and_within_half_a_step() {
        let model = painted_ball();
        let before = as_glb(&model, &described("ball"));
        let after = quantize(&before).unwrap();
        assert!(after.len() < before.len());
        let text = String::from_utf8_lossy(&after);
        assert!(text.contains("\"extensionsRequired\":[\"KHR_mesh_quantization\"]"));
        let refused = read::parse(&after).map(|_| ()).unwrap_err();
        assert!(
            refused.contains("a compressed copy") && refused.contains("give the model.glb"),
            "{refused}"
        );
        let [before, after] =
            [before, after].map(|bytes| load_unwelded(&bytes, Path::new("ball.glb")).unwrap());
        assert_eq!(after.mesh.triangles, before.mesh.triangles);
        assert_eq!(after.provenance, before.provenance);
        let vertices = before.mesh.vertices.iter().zip(&after.mesh.vertices);
        let largest = vertices
            .map(|(a, b)| (a - b).amax())
            .fold(0.0_f32, f32::max);
        assert!(largest < 0.1 / STEPS * 0.55, "{largest}");
    }

    #[test]
    fn another_description_replaces_each_word_of_the_first_and_nothing_else() {
        let model = painted_ball();
        let mut first = described("annes-session-7");
        first.operator = Some("Ann".into());
        let before = as_glb(&model, &first);
        let mut second = described("ball");
        second.operator = None;
        let after = describe(&before, &second).unwrap();
        let text = String::from_utf8_lossy(&after);
        assert!(!text.contains("Ann") && !text.contains("annes-session"));
        let (_, read, about) = read::parse(&after).unwrap();
        assert_eq!(about, second);
        assert_eq!(read.mesh, read::parse(&before).unwrap().1.mesh);
        let binary = |bytes: &[u8]| GltfFile::parse(bytes).unwrap().binary().to_vec();
        assert_eq!(binary(&after), binary(&before));
        assert!(describe(&after, &first).unwrap().len() <= before.len() + 8);
    }

    #[test]
    fn other_files_are_refused() {
        assert!(quantize(b"glTF").is_err());
        assert!(describe(b"glTF", &described("a")).is_err());
        let glb = as_glb(&painted_ball(), &described("ball"));
        let file = GltfFile::parse(&glb).unwrap();
        let mut json: Value = serde_json::to_value(file.root()).unwrap();
        json["nodes"] = json!([]);
        json["scenes"] = json!([{ "nodes": [] }]);
        let without_node = pack(&json, file.binary());
        assert_eq!(quantize(&without_node).unwrap_err(), "it has no node");
    }
}

//! Binary glTF 2.0: the triangles of the scene, with nodes' transforms applied, turned from y up to z up.

use super::{LoadedModel, provenance};
use crate::reconstruct::Provenance;
use nalgebra::{Matrix4, Point3, Quaternion, UnitQuaternion, Vector3};
use serde::Deserialize;
use std::collections::BTreeMap;

/// Deeper trees of nodes are taken for a loop.
const MAX_DEPTH: usize = 64;
/// More nodes than this are not visited: a hostile file may name one node many times over.
const MAX_VISITS: usize = 10_000;
/// Vertices and triangles of all visited nodes together.
const MAX_ELEMENTS: usize = 20_000_000;

/// Reads the default scene. `_PROVENANCE` and `_ERROR` are kept where every primitive has them.
pub fn parse(bytes: &[u8]) -> Result<LoadedModel, String> {
    let (json, binary) = split_chunks(bytes)?;
    let document: Document =
        serde_json::from_slice(json).map_err(|e| format!("the glTF JSON cannot be read: {e}"))?;
    if let Some(name) = document.extensions_required.first() {
        let name: String = name.chars().take(60).collect();
        return Err(format!(
            "the glTF extension {name} is required and not known here"
        ));
    }
    let mut reader = Reader {
        document: &document,
        binary,
        model: LoadedModel::default(),
        provenance: Vec::new(),
        errors: Vec::new(),
        visits: 0,
    };
    for &node in document.roots()?.iter() {
        reader.visit(node, Matrix4::identity(), 0)?;
    }
    let count = reader.model.mesh.vertices.len();
    let whole = |n: usize| n == count && n > 0;
    let mut model = reader.model;
    model.provenance = whole(reader.provenance.len()).then_some(reader.provenance);
    model.expected_error = whole(reader.errors.len()).then_some(reader.errors);
    Ok(model)
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Document {
    #[serde(default)]
    scene: usize,
    #[serde(default)]
    scenes: Vec<Scene>,
    #[serde(default)]
    nodes: Vec<Node>,
    #[serde(default)]
    meshes: Vec<GltfMesh>,
    #[serde(default)]
    accessors: Vec<Accessor>,
    #[serde(default)]
    buffer_views: Vec<BufferView>,
    #[serde(default)]
    extensions_required: Vec<String>,
}

impl Document {
    fn roots(&self) -> Result<&[usize], String> {
        let scene = self.scenes.get(self.scene);
        Ok(&scene.ok_or("the file has no scene")?.nodes)
    }
}

#[derive(Deserialize)]
struct Scene {
    #[serde(default)]
    nodes: Vec<usize>,
}

#[derive(Deserialize)]
struct Node {
    mesh: Option<usize>,
    #[serde(default)]
    children: Vec<usize>,
    matrix: Option<[f32; 16]>,
    translation: Option<[f32; 3]>,
    rotation: Option<[f32; 4]>,
    scale: Option<[f32; 3]>,
}

impl Node {
    fn parent_from_node(&self) -> Matrix4<f32> {
        if let Some(columns) = self.matrix {
            return Matrix4::from_column_slice(&columns);
        }
        let translation = Vector3::from(self.translation.unwrap_or_default());
        let [x, y, z, w] = self.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]);
        let rotation = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
        let scale = Vector3::from(self.scale.unwrap_or([1.0; 3]));
        Matrix4::new_translation(&translation)
            * rotation.to_homogeneous()
            * Matrix4::new_nonuniform_scaling(&scale)
    }
}

#[derive(Deserialize)]
struct GltfMesh {
    primitives: Vec<Primitive>,
}

#[derive(Deserialize)]
struct Primitive {
    attributes: BTreeMap<String, usize>,
    indices: Option<usize>,
    #[serde(default = "triangles")]
    mode: u32,
}

fn triangles() -> u32 {
    4
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Accessor {
    buffer_view: Option<usize>,
    #[serde(default)]
    byte_offset: usize,
    component_type: u32,
    #[serde(default)]
    normalized: bool,
    count: usize,
    r#type: String,
    sparse: Option<serde_json::Value>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct BufferView {
    buffer: usize,
    #[serde(default)]
    byte_offset: usize,
    byte_length: usize,
    byte_stride: Option<usize>,
}

fn split_chunks(bytes: &[u8]) -> Result<(&[u8], &[u8]), String> {
    let word = |at: usize| -> Option<u32> {
        Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
    };
    if !bytes.starts_with(b"glTF") {
        return Err("not a GLB file: it does not begin with \"glTF\"".to_owned());
    }
    if word(4) != Some(2) {
        return Err("glTF is of a version other than 2".to_owned());
    }
    let mut chunks: [&[u8]; 2] = [&[], &[]];
    let mut at = 12;
    while let (Some(length), Some(kind)) = (word(at), word(at + 4)) {
        let end = at + 8 + length as usize;
        let chunk = bytes.get(at + 8..end).ok_or_else(|| {
            let left = bytes.len() - at - 8;
            format!("a chunk of {length} bytes, where the file has {left} left")
        })?;
        match &kind.to_le_bytes() {
            b"JSON" => chunks[0] = chunk,
            b"BIN\0" => chunks[1] = chunk,
            _ => {}
        }
        at = end;
    }
    if chunks[0].is_empty() {
        return Err("the GLB file has no JSON chunk".to_owned());
    }
    Ok(chunks.into())
}

struct Reader<'a> {
    document: &'a Document,
    binary: &'a [u8],
    model: LoadedModel,
    provenance: Vec<Provenance>,
    errors: Vec<f32>,
    visits: usize,
}

impl Reader<'_> {
    fn visit(
        &mut self,
        index: usize,
        world_from_parent: Matrix4<f32>,
        depth: usize,
    ) -> Result<(), String> {
        self.visits += 1;
        if depth > MAX_DEPTH || self.visits > MAX_VISITS {
            return Err("the tree of nodes is too deep or too large".to_owned());
        }
        let document = self.document;
        let node = document.nodes.get(index);
        let node = node.ok_or_else(|| format!("there is no node {index}"))?;
        let world_from_node = world_from_parent * node.parent_from_node();
        if let Some(mesh) = node.mesh {
            let mesh = document.meshes.get(mesh);
            let mesh =
                mesh.ok_or_else(|| format!("node {index} names a mesh that is not there"))?;
            for primitive in &mesh.primitives {
                self.add(primitive, &world_from_node)?;
            }
        }
        node.children
            .iter()
            .try_for_each(|&child| self.visit(child, world_from_node, depth + 1))
    }

    fn add(&mut self, primitive: &Primitive, world_from_node: &Matrix4<f32>) -> Result<(), String> {
        if primitive.mode != triangles() {
            let mode = primitive.mode;
            return Err(format!(
                "a primitive of mode {mode}, where 4 (triangles) is read"
            ));
        }
        let attribute = |name: &str| primitive.attributes.get(name).copied();
        let positions = attribute("POSITION").ok_or("a primitive without POSITION")?;
        let positions = self.values(positions, 3)?;
        let base = self.model.mesh.vertices.len();
        if base + positions.len() / 3 > MAX_ELEMENTS {
            return Err(format!("more than {MAX_ELEMENTS} vertices"));
        }
        let vertices = positions.chunks_exact(3).map(|p| {
            let local = Point3::new(p[0] as f32, p[1] as f32, p[2] as f32);
            let p = world_from_node.transform_point(&local);
            // y up to z up.
            Point3::new(p.x, -p.z, p.y)
        });
        self.model.mesh.vertices.extend(vertices);
        let count = positions.len() / 3;
        self.add_triangles(primitive, base, count, world_from_node.determinant() < 0.0)?;
        if let Some(accessor) = attribute("_PROVENANCE") {
            for (vertex, value) in self
                .values(accessor, 1)?
                .into_iter()
                .take(count)
                .enumerate()
            {
                self.provenance.push(provenance(value, vertex)?);
            }
        }
        if let Some(accessor) = attribute("_ERROR") {
            let values = self.values(accessor, 1)?;
            self.errors
                .extend(values.iter().take(count).map(|&v| v as f32));
        }
        Ok(())
    }

    /// Triangles of `count` vertices from `base` on; a mirroring transform turns them inside out, and back.
    fn add_triangles(
        &mut self,
        primitive: &Primitive,
        base: usize,
        count: usize,
        mirrored: bool,
    ) -> Result<(), String> {
        let indices = match primitive.indices {
            Some(accessor) => self.values(accessor, 1)?,
            None => (0..count).map(|i| i as f64).collect(),
        };
        if let Some(index) = indices.iter().find(|&&i| !(0.0..count as f64).contains(&i)) {
            return Err(format!("index {index} names none of {count} vertices"));
        }
        let mesh = &mut self.model.mesh;
        if mesh.triangles.len() + indices.len() / 3 > MAX_ELEMENTS {
            return Err(format!("more than {MAX_ELEMENTS} triangles"));
        }
        for corner in indices.chunks_exact(3) {
            let mut triangle = [corner[0], corner[1], corner[2]].map(|i| base as u32 + i as u32);
            if mirrored {
                triangle.swap(1, 2);
            }
            mesh.triangles.push(triangle);
        }
        Ok(())
    }

    /// All components of an accessor of vectors of `width`.
    fn values(&self, index: usize, width: usize) -> Result<Vec<f64>, String> {
        let accessor = self.document.accessors.get(index);
        let accessor = accessor.ok_or_else(|| format!("there is no accessor {index}"))?;
        let explain = |what: &str| format!("accessor {index} {what}");
        let found = match accessor.r#type.as_str() {
            "SCALAR" => 1,
            "VEC3" => 3,
            _ => 0,
        };
        if found != width {
            return Err(explain(&format!("does not hold vectors of {width}")));
        }
        if accessor.sparse.is_some() {
            return Err(explain("is sparse, which is not read"));
        }
        let size = component_bytes(accessor.component_type);
        let size = size.ok_or_else(|| explain("has an unknown component type"))?;
        let data = self
            .view(accessor)
            .ok_or_else(|| explain("lies outside the file"))?;
        let element = size * width;
        let stride = data.1.unwrap_or(element);
        if stride < element {
            return Err(explain(&format!(
                "has a stride of {stride} bytes for {element}"
            )));
        }
        // The last element may end where the view does.
        let room = (data.0.len() + stride).saturating_sub(element) / stride;
        if accessor.count > room {
            let count = accessor.count;
            return Err(explain(&format!(
                "promises {count} elements, where there is room for {room}"
            )));
        }
        let mut values = Vec::with_capacity(accessor.count * width);
        for at in (0..accessor.count).map(|i| i * stride) {
            for component in data.0[at..at + element].chunks_exact(size) {
                values.push(decode(
                    component,
                    accessor.component_type,
                    accessor.normalized,
                ));
            }
        }
        Ok(values)
    }

    /// An accessor's bytes, up to the end of its view, and the view's stride.
    fn view(&self, accessor: &Accessor) -> Option<(&[u8], Option<usize>)> {
        let view = self.document.buffer_views.get(accessor.buffer_view?)?;
        let end = view.byte_offset.checked_add(view.byte_length)?;
        let bytes = self.binary.get(view.byte_offset..end)?;
        (view.buffer == 0).then_some((bytes.get(accessor.byte_offset..)?, view.byte_stride))
    }
}

fn component_bytes(kind: u32) -> Option<usize> {
    match kind {
        5120 | 5121 => Some(1),
        5122 | 5123 => Some(2),
        5125 | 5126 => Some(4),
        _ => None,
    }
}

/// A component's value (glTF 2.0, section 3.6.2.2 and, for normalised ones, 3.11).
fn decode(bytes: &[u8], kind: u32, normalized: bool) -> f64 {
    let b = |i: usize| bytes.get(i).copied().unwrap_or(0);
    let whole = [b(0), b(1), b(2), b(3)];
    let half = [b(0), b(1)];
    let (value, most) = match kind {
        5120 => (f64::from(b(0) as i8), 127.0),
        5121 => (f64::from(b(0)), 255.0),
        5122 => (f64::from(i16::from_le_bytes(half)), 32767.0),
        5123 => (f64::from(u16::from_le_bytes(half)), 65535.0),
        5125 => (f64::from(u32::from_le_bytes(whole)), 1.0),
        _ => (f64::from(f32::from_le_bytes(whole)), 1.0),
    };
    if normalized {
        (value / most).max(-1.0)
    } else {
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{check, shapes};
    use proptest::prelude::*;
    use serde_json::{Value, json};

    fn glb(json: &Value, binary: &[u8]) -> Vec<u8> {
        let mut text = json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut out = b"glTF\x02\0\0\0".to_vec();
        out.extend((28 + text.len() as u32 + binary.len() as u32).to_le_bytes());
        for (kind, chunk) in [(b"JSON", text.as_slice()), (b"BIN\0", binary)] {
            out.extend((chunk.len() as u32).to_le_bytes());
            out.extend(kind);
            out.extend(chunk);
        }
        out
    }

    /// A tetrahedron, y up, with its provenance (u8, strided by 4) and expected errors.
    fn sample() -> (Value, Vec<u8>) {
        let mesh = shapes::tetrahedron(1.0);
        let mut binary = Vec::new();
        for p in &mesh.vertices {
            [p.x, p.z, -p.y]
                .iter()
                .for_each(|c| binary.extend(c.to_le_bytes()));
        }
        for t in &mesh.triangles {
            t.iter()
                .for_each(|&i| binary.extend((i as u16).to_le_bytes()));
        }
        (0..4_u8).for_each(|i| binary.extend([i, 0, 0, 0]));
        (0..4_u8).for_each(|i| binary.extend((f32::from(i) * 1e-3).to_le_bytes()));
        let json = json!({
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"mode": 4, "indices": 1,
                "attributes": {"POSITION": 0, "_PROVENANCE": 2, "_ERROR": 3}}]}],
            "accessors": [
                {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
                {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
                {"bufferView": 2, "componentType": 5121, "count": 4, "type": "SCALAR"},
                {"bufferView": 2, "byteOffset": 16, "componentType": 5126, "count": 4, "type": "SCALAR"},
            ],
            "bufferViews": [
                {"buffer": 0, "byteOffset": 0, "byteLength": 48},
                {"buffer": 0, "byteOffset": 48, "byteLength": 24},
                {"buffer": 0, "byteOffset": 72, "byteLength": 32, "byteStride": 4},
            ],
        });
        (json, binary)
    }

    #[test]
    fn the_scene_is_read_and_turned_to_z_up() {
        let (json, binary) = sample();
        let model = parse(&glb(&json, &binary)).unwrap();
        assert_eq!(model.mesh, shapes::tetrahedron(1.0));
        assert_eq!(model.provenance.unwrap(), Provenance::ALL[..4]);
        assert_eq!(model.expected_error.unwrap()[2], 0.002);
    }

    #[test]
    fn transforms_of_nodes_apply_and_mirrors_stay_oriented() {
        let (mut json, binary) = sample();
        json["nodes"] = json!([
            {"children": [1], "translation": [1.0, 2.0, 3.0], "scale": [-2.0, 2.0, 2.0]},
            {"mesh": 0, "rotation": [0.0, 0.70710677, 0.0, 0.70710677]},
        ]);
        let mesh = parse(&glb(&json, &binary)).unwrap().mesh;
        let report = check(&mesh);
        assert!(report.is_watertight());
        let whole = check(&shapes::tetrahedron(2.0)).volume;
        assert!((report.volume - whole).abs() < 1e-4 * whole);
        let centre = mesh
            .vertices
            .iter()
            .fold(Vector3::zeros(), |sum, v| sum + v.coords / 4.0);
        assert!((centre - Vector3::new(1.0, -3.0, 2.0)).norm() < 1e-5);
    }

    #[test]
    fn hostile_files_are_refused_with_a_reason() {
        let refuse = |path: &str, value: Value, wanted: &str| {
            let (mut json, binary) = sample();
            *json.pointer_mut(path).unwrap() = value;
            let error = parse(&glb(&json, &binary)).unwrap_err();
            assert!(error.contains(wanted), "{path}: {error}");
        };
        refuse(
            "/accessors/0/count",
            json!(u64::MAX),
            "18446744073709551615",
        );
        refuse("/accessors/0/count", json!(5), "room for 4");
        refuse("/accessors/0/type", json!("VEC4"), "vectors of 3");
        refuse("/accessors/0/componentType", json!(1), "component type");
        refuse("/accessors/1/count", json!(9999), "accessor 1");
        refuse("/bufferViews/0/byteLength", json!(u64::MAX), "outside");
        refuse("/bufferViews/0/byteOffset", json!(1_u64 << 40), "outside");
        refuse("/bufferViews/2/byteStride", json!(0), "accessor 2");
        refuse("/bufferViews/1/byteOffset", json!(0), "names none");
        refuse("/nodes/0/mesh", json!(7), "mesh");
        refuse("/nodes/0", json!({"children": [0]}), "too deep");
        refuse("/nodes/0", json!({"children": [3]}), "no node 3");
        refuse("/scene", json!(4), "no scene");
        refuse("/meshes/0/primitives/0/mode", json!(1), "mode");
        let (mut json, binary) = sample();
        json["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
        assert!(parse(&glb(&json, &binary)).unwrap_err().contains("draco"));
    }

    #[test]
    fn nodes_that_multiply_do_not_run_away() {
        let (mut json, binary) = sample();
        let doubling: Vec<Value> = (0..40)
            .map(|i| json!({"children": [i + 1, i + 1]}))
            .chain([json!({"mesh": 0})])
            .collect();
        json["nodes"] = Value::Array(doubling);
        assert!(
            parse(&glb(&json, &binary))
                .unwrap_err()
                .contains("too large")
        );
    }

    proptest! {
        #[test]
        fn damage_anywhere_gives_an_answer_or_an_error(at in 0_usize..2000, value: u8, cut in 0_usize..2000) {
            let (json, binary) = sample();
            let mut bytes = glb(&json, &binary);
            let length = bytes.len();
            bytes[at % length] = value;
            let _ = parse(&bytes);
            bytes.truncate(cut % length);
            let _ = parse(&bytes);
        }
    }
}

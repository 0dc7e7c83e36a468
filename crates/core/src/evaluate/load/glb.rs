//! Binary glTF 2.0: the triangles of the scene, with nodes' transforms applied, turned from y up to z up. `gltf_file`
//! reads the container and the accessors.

use super::{LoadedModel, provenance};
use crate::gltf_file::{GltfFile, QUANTIZATION};
use crate::reconstruct::Provenance;
use gltf::Semantic;
use gltf::json::accessor::Accessor;
use gltf::json::validation::Checked;
use gltf::json::{Index, Node, mesh};
use gltf::scene::Transform;
use nalgebra::{Matrix3, Matrix4, Point3, Vector3};

/// Deeper trees of nodes are taken for a loop.
const MAX_DEPTH: usize = 64;
/// More nodes than this are not visited: a hostile file may name one node many times over.
const MAX_VISITS: usize = 10_000;
/// Vertices and triangles of all visited nodes together.
const MAX_ELEMENTS: usize = 20_000_000;

/// Reads the default scene. `NORMAL`, `_PROVENANCE` and `_ERROR` are kept where every primitive has them.
pub(super) fn parse(bytes: &[u8]) -> Result<LoadedModel, String> {
    let file = GltfFile::parse_with(bytes, &[QUANTIZATION])?;
    let root = file.root();
    let scene = root.scenes.get(root.scene.map_or(0, |scene| scene.value()));
    let mut reader = Reader {
        file: &file,
        model: LoadedModel::default(),
        normals: Vec::new(),
        provenance: Vec::new(),
        errors: Vec::new(),
        visits: 0,
    };
    for &node in &scene.ok_or("the file has no scene")?.nodes {
        reader.visit(node, Matrix4::identity(), 0)?;
    }
    let count = reader.model.mesh.vertices.len();
    let whole = |n: usize| n == count && n > 0;
    let mut model = reader.model;
    model.normals = whole(reader.normals.len()).then_some(reader.normals);
    model.provenance = whole(reader.provenance.len()).then_some(reader.provenance);
    model.expected_error = whole(reader.errors.len()).then_some(reader.errors);
    Ok(model)
}

struct Reader<'a> {
    file: &'a GltfFile<'a>,
    model: LoadedModel,
    normals: Vec<Vector3<f32>>,
    provenance: Vec<Provenance>,
    errors: Vec<f32>,
    visits: usize,
}

impl Reader<'_> {
    fn visit(
        &mut self,
        index: Index<Node>,
        world_from_parent: Matrix4<f32>,
        depth: usize,
    ) -> Result<(), String> {
        self.visits += 1;
        if depth > MAX_DEPTH || self.visits > MAX_VISITS {
            return Err("the tree of nodes is too deep or too large".to_owned());
        }
        let (root, number) = (self.file.root(), index.value());
        let node = root.get(index);
        let node = node.ok_or_else(|| format!("there is no node {number}"))?;
        let world_from_node = world_from_parent * parent_from_node(node);
        if let Some(mesh) = node.mesh {
            let mesh = root.get(mesh);
            let mesh =
                mesh.ok_or_else(|| format!("node {number} refers to a mesh that does not exist"))?;
            for primitive in &mesh.primitives {
                self.add(primitive, &world_from_node)?;
            }
        }
        let mut children = node.children.iter().flatten();
        children.try_for_each(|&child| self.visit(child, world_from_node, depth + 1))
    }

    fn add(
        &mut self,
        primitive: &mesh::Primitive,
        world_from_node: &Matrix4<f32>,
    ) -> Result<(), String> {
        if primitive.mode != Checked::Valid(mesh::Mode::Triangles) {
            return Err("a primitive has a mode other than 4 (triangles)".to_owned());
        }
        let attributes = &primitive.attributes;
        let attribute = |name: Semantic| attributes.get(&Checked::Valid(name)).copied();
        let positions = attribute(Semantic::Positions).ok_or("a primitive has no POSITION")?;
        let positions = self.file.points(positions)?;
        let base = self.model.mesh.vertices.len();
        let vertices = positions.into_iter().map(|p| {
            let p = world_from_node.transform_point(&Point3::from(p));
            // y up to z up.
            Point3::new(p.x, -p.z, p.y)
        });
        self.model.mesh.vertices.extend(vertices);
        let count = self.model.mesh.vertices.len() - base;
        if base + count > MAX_ELEMENTS {
            return Err(format!("it has more than {MAX_ELEMENTS} vertices"));
        }
        self.add_triangles(primitive, base, count, world_from_node.determinant() < 0.0)?;
        if let Some(normals) = attribute(Semantic::Normals) {
            self.add_normals(normals, count, world_from_node);
        }
        let values = |name: &str| {
            let Some(accessor) = attribute(Semantic::Extras(name.to_owned())) else {
                return Ok(Vec::new());
            };
            // Before they are read: many nodes may share a small mesh with a large accessor.
            let stated = self.file.root().get(accessor).map(|a| a.count.0);
            match stated {
                Some(values) if values != count as u64 => {
                    Err(format!("_{name} has {values} values for {count} vertices"))
                }
                _ => self.file.numbers(accessor),
            }
        };
        let (provenances, errors) = (values("PROVENANCE")?, values("ERROR")?);
        for (vertex, &value) in provenances.iter().enumerate() {
            self.provenance.push(provenance(value, vertex)?);
        }
        let errors = errors.iter().map(|&v| v as f32);
        self.errors.extend(errors);
        Ok(())
    }

    /// Normals of `count` vertices. They are passed over where they cannot be read, as those of compressed copies.
    fn add_normals(
        &mut self,
        accessor: Index<Accessor>,
        count: usize,
        world_from_node: &Matrix4<f32>,
    ) {
        // Before they are read: many nodes may share a small mesh with a large accessor.
        let stated = self.file.root().get(accessor).map(|a| a.count.0);
        let linear: Matrix3<f32> = world_from_node.fixed_view::<3, 3>(0, 0).into_owned();
        let (Some(inverse), true) = (linear.try_inverse(), stated == Some(count as u64)) else {
            return;
        };
        let turn = inverse.transpose();
        let turned = self.file.points(accessor).into_iter().flatten().map(|n| {
            let n = turn * Vector3::from(n);
            // y up to z up.
            Vector3::new(n.x, -n.z, n.y)
        });
        self.normals.extend(turned);
    }

    /// Triangles of `count` vertices from `base` on; a mirroring transform turns them inside out, and back.
    fn add_triangles(
        &mut self,
        primitive: &mesh::Primitive,
        base: usize,
        count: usize,
        mirrored: bool,
    ) -> Result<(), String> {
        let indices = match primitive.indices {
            Some(accessor) => self.file.numbers(accessor)?,
            None => (0..count).map(|i| i as f64).collect(),
        };
        if let Some(index) = indices.iter().find(|&&i| !(0.0..count as f64).contains(&i)) {
            return Err(format!(
                "index {index} is out of range for {count} vertices"
            ));
        }
        let mesh = &mut self.model.mesh;
        if mesh.triangles.len() + indices.len() / 3 > MAX_ELEMENTS {
            return Err(format!("it has more than {MAX_ELEMENTS} triangles"));
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
}

fn parent_from_node(node: &Node) -> Matrix4<f32> {
    if let Some(columns) = node.matrix {
        return Matrix4::from_column_slice(&columns);
    }
    let transform = Transform::Decomposed {
        translation: node.translation.unwrap_or_default(),
        rotation: node.rotation.unwrap_or_default().0,
        scale: node.scale.unwrap_or([1.0; 3]),
    };
    Matrix4::from(transform.matrix())
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
    fn normals_are_turned_as_their_vertices_are_or_passed_over() {
        let (mut json, binary) = sample();
        json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = json!(0);
        json["nodes"][0]["rotation"] = json!([0.0, 0.70710677, 0.0, 0.70710677]);
        let model = parse(&glb(&json, &binary)).unwrap();
        let normals = model.normals.unwrap();
        assert_eq!(normals.len(), 4);
        for (p, normal) in model.mesh.vertices.iter().zip(normals) {
            assert!((p.coords - normal).norm() < 1e-5, "{p} {normal}");
        }
        json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = json!(2);
        assert_eq!(parse(&glb(&json, &binary)).unwrap().normals, None);
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
        refuse("/accessors/0/count", json!(5), "room for only 4");
        refuse("/accessors/0/type", json!("VEC4"), "vectors of 3");
        refuse("/accessors/0/componentType", json!(1), "component type");
        refuse("/accessors/1/count", json!(9999), "accessor 1");
        refuse("/bufferViews/0/byteLength", json!(u64::MAX), "outside");
        refuse("/bufferViews/0/byteOffset", json!(1_u64 << 40), "outside");
        refuse("/bufferViews/2/byteStride", json!(0), "accessor 2");
        refuse("/bufferViews/1/byteOffset", json!(0), "out of range");
        let fewer = "_PROVENANCE has 3 values for 4 vertices";
        refuse("/accessors/2/count", json!(3), fewer);
        refuse("/accessors/3/count", json!(2), "_ERROR has 2 values");
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

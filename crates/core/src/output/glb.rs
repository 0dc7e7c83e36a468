//! A model as glTF 2.0 in one binary file: metres, y up, one mesh with one primitive and one material, the
//! texture embedded, provenance and expected error as custom attributes.

use super::attributes::{CAPTURES, SplitVertices, check, split_at_seams, unit, y_up};
use super::gltf::{
    ARRAY_BUFFER, Accessor, Asset, Attributes, Buffer, BufferView, CLAMP_TO_EDGE,
    ELEMENT_ARRAY_BUFFER, FLOAT, Image, LINEAR, LINEAR_MIPMAP_LINEAR, Material, Mesh,
    MetallicRoughness, Node, Primitive, Root, Sampler, Scene, TextureInfo, TextureJson,
    UNSIGNED_INT,
};
use super::{Error, jpeg, xmp};
use crate::description::Description;
use crate::image::RgbImage;
use crate::reconstruct::{Model, Provenance, Texture};
use serde_json::{Value, json};

/// How a .glb is written.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// JPEG quality of the embedded texture, 1 to 100.
    /// Default 90, range 1 to 100.
    #[serde(deserialize_with = "crate::range::count::<_, u8, 1, 100>")]
    pub jpeg_quality: u8,
    /// Whether viewers show the colours as they are, without light and shade of their own (`KHR_materials_unlit`): the
    /// pictures' light is in the texture already. Without it the form shows better.
    /// Default false.
    pub unlit: bool,
}

/// The extension by which viewers add no light.
pub(crate) const UNLIT: &str = "KHR_materials_unlit";

impl Default for Parameters {
    fn default() -> Self {
        Self {
            jpeg_quality: 90,
            unlit: false,
        }
    }
}

/// A model as the bytes of a .glb. Data about the model are in the file's extras and, in the vocabularies of archives,
/// in its XMP packet. A model with no triangles becomes a valid file with an empty scene; one without texture a plain
/// grey one.
///
/// # Errors
/// If the model's parts do not fit each other, hold a number that is not finite or exceed glTF's 4 GiB.
pub fn encode(
    model: &Model,
    about: &Description,
    parameters: &Parameters,
) -> Result<Vec<u8>, Error> {
    check(model)?;
    let texture = model.texture.as_ref().filter(|t| has_pixels(&t.atlas));
    let mut body = Body::default();
    let mut root = Root::empty(about);
    if !model.mesh.triangles.is_empty() {
        let jpeg = texture
            .map(|t| jpeg::encode(&t.atlas, parameters.jpeg_quality))
            .transpose()?;
        root.add_mesh(&about.capture, model, texture, &mut body);
        root.add_material(jpeg, parameters.unlit, &mut body);
        root.buffers = vec![Buffer {
            byte_length: body.bytes.len(),
        }];
    }
    root.accessors = body.accessors;
    root.buffer_views = body.views;
    pack(&root, &body.bytes)
}

/// Puts another description into a .glb that [`encode`] made, given as its JSON: what is known, and the names of its
/// parts.
pub fn describe(json: &mut Value, about: &Description) {
    json["asset"]["extras"] = extras(about);
    json["extensions"][xmp::EXTENSION] = json!({ "packets": [xmp::packet(about)] });
    for part in ["scenes", "nodes", "meshes"] {
        for named in json[part].as_array_mut().into_iter().flatten() {
            named["name"] = about.capture.as_str().into();
        }
    }
}

/// What is known, by name, for programs that read no XMP.
fn extras(about: &Description) -> Value {
    let known = about.pairs().into_iter();
    let fixed = [("units", "metres"), ("up", "y")];
    let pairs = known
        .chain(fixed)
        .map(|(name, text)| (name.to_owned(), Value::from(text)));
    Value::Object(pairs.collect())
}

fn has_pixels(atlas: &RgbImage) -> bool {
    atlas.width() > 0 && atlas.height() > 0
}

impl Root {
    fn empty(about: &Description) -> Self {
        Self {
            asset: Asset {
                version: "2.0",
                generator: format!("scand {}", env!("CARGO_PKG_VERSION")),
                extras: extras(about),
                extensions: json!({ xmp::EXTENSION: { "packet": 0 } }),
            },
            extensions_used: vec![xmp::EXTENSION],
            extensions: json!({ xmp::EXTENSION: { "packets": [xmp::packet(about)] } }),
            scene: 0,
            scenes: vec![Scene {
                name: about.capture.clone(),
                nodes: Vec::new(),
            }],
            nodes: Vec::new(),
            meshes: Vec::new(),
            materials: Vec::new(),
            textures: Vec::new(),
            samplers: Vec::new(),
            images: Vec::new(),
            accessors: Vec::new(),
            buffer_views: Vec::new(),
            buffers: Vec::new(),
        }
    }

    fn add_mesh(
        &mut self,
        capture: &str,
        model: &Model,
        texture: Option<&Texture>,
        body: &mut Body,
    ) {
        let split = match texture {
            Some(texture) => split_at_seams(model, texture),
            None => SplitVertices::of_welded(model),
        };
        self.scenes[0].nodes = vec![0];
        self.nodes.push(Node {
            name: capture.to_owned(),
            mesh: 0,
        });
        self.meshes.push(Mesh {
            name: capture.to_owned(),
            primitives: vec![Primitive {
                attributes: add_attributes(model, &split, body),
                indices: body.indices(&split.triangles),
                material: 0,
            }],
            extras: attributes_in_words(model),
        });
    }

    fn add_material(&mut self, jpeg: Option<Vec<u8>>, unlit: bool, body: &mut Body) {
        if unlit {
            self.extensions_used.push(UNLIT);
        }
        let textured = jpeg.is_some();
        if let Some(jpeg) = jpeg {
            self.images.push(Image {
                name: "atlas".into(),
                buffer_view: body.view(&jpeg, None),
                mime_type: "image/jpeg",
            });
            self.samplers.push(Sampler {
                mag_filter: LINEAR,
                min_filter: LINEAR_MIPMAP_LINEAR,
                wrap_s: CLAMP_TO_EDGE,
                wrap_t: CLAMP_TO_EDGE,
            });
            self.textures.push(TextureJson {
                sampler: 0,
                source: 0,
            });
        }
        self.materials.push(Material {
            name: "surface".into(),
            pbr_metallic_roughness: MetallicRoughness {
                base_color_texture: textured.then_some(TextureInfo { index: 0 }),
                base_color_factor: (!textured).then_some([0.6, 0.6, 0.6, 1.0]),
                metallic_factor: 0.0,
                roughness_factor: 1.0,
            },
            extensions: unlit.then(|| json!({ UNLIT: {} })),
        });
    }
}

fn attributes_in_words(model: &Model) -> Value {
    let mut words = json!({
        "_PROVENANCE": Provenance::ALL,
        "_ERROR": "expected distance to the true surface in metres",
        "_SEEN": "1 where a camera saw the surface, 0 where none did: grey, or the colours around it",
    });
    if !model.captures.is_empty() {
        words["_CAPTURES"] = CAPTURES.into();
    }
    words
}

fn add_attributes(model: &Model, split: &SplitVertices, body: &mut Body) -> Attributes {
    let each = || split.welded.iter().map(|&v| v as usize);
    let positions = each().map(|v| y_up(model.mesh.vertices[v].into()));
    let normals = each().map(|v| y_up(unit(model.normals[v]).into()));
    let errors = each().map(|v| [model.expected_error[v]]);
    // As floats: Blender's importer (4.2) fails on integers, and a vertex's attribute takes 4 bytes anyway.
    let provenance = each().map(|v| [f32::from(model.provenance[v] as u8)]);
    let captures = (!model.captures.is_empty()).then(|| each().map(|v| [model.captures[v] as f32]));
    let seen = split.seen.iter().map(|&seen| [f32::from(seen)]);
    Attributes {
        position: body.floats(positions, "VEC3"),
        normal: body.floats(normals, "VEC3"),
        texcoord: (!split.uv.is_empty()).then(|| body.floats(split.uv.iter().copied(), "VEC2")),
        provenance: body.floats(provenance, "SCALAR"),
        error: body.floats(errors, "SCALAR"),
        captures: captures.map(|captures| body.floats(captures, "SCALAR")),
        seen: (!split.seen.is_empty()).then(|| body.floats(seen, "SCALAR")),
    }
}

/// The binary chunk in the making, and what points into it.
#[derive(Default)]
struct Body {
    bytes: Vec<u8>,
    views: Vec<BufferView>,
    accessors: Vec<Accessor>,
}

impl Body {
    /// Appends a view, aligned to 4 bytes.
    fn view(&mut self, data: &[u8], target: Option<u32>) -> u32 {
        let byte_offset = self.bytes.len();
        self.bytes.extend_from_slice(data);
        pad(&mut self.bytes, 0);
        self.views.push(BufferView {
            buffer: 0,
            byte_offset,
            byte_length: data.len(),
            target,
        });
        self.views.len() as u32 - 1
    }

    fn floats<const N: usize>(
        &mut self,
        values: impl Iterator<Item = [f32; N]>,
        kind: &'static str,
    ) -> u32 {
        let (mut low, mut high) = ([f32::INFINITY; N], [f32::NEG_INFINITY; N]);
        let mut data = Vec::with_capacity(values.size_hint().0 * N * 4);
        let mut count = 0;
        for value in values {
            for i in 0..N {
                low[i] = low[i].min(value[i]);
                high[i] = high[i].max(value[i]);
                data.extend_from_slice(&value[i].to_le_bytes());
            }
            count += 1;
        }
        let buffer_view = self.view(&data, Some(ARRAY_BUFFER));
        self.accessor(Accessor {
            buffer_view,
            component_type: FLOAT,
            count,
            kind,
            min: low.map(f64::from).to_vec(),
            max: high.map(f64::from).to_vec(),
        })
    }

    fn indices(&mut self, triangles: &[[u32; 3]]) -> u32 {
        let flat = || triangles.iter().flatten();
        let data: Vec<u8> = flat().flat_map(|i| i.to_le_bytes()).collect();
        let extreme = |index: Option<&u32>| vec![f64::from(index.copied().unwrap_or(0))];
        let buffer_view = self.view(&data, Some(ELEMENT_ARRAY_BUFFER));
        self.accessor(Accessor {
            buffer_view,
            component_type: UNSIGNED_INT,
            count: triangles.len() * 3,
            kind: "SCALAR",
            min: extreme(flat().min()),
            max: extreme(flat().max()),
        })
    }

    fn accessor(&mut self, accessor: Accessor) -> u32 {
        self.accessors.push(accessor);
        self.accessors.len() as u32 - 1
    }
}

/// Header, JSON chunk and binary chunk (glTF 2.0, section 4.4).
fn pack(root: &Root, binary: &[u8]) -> Result<Vec<u8>, Error> {
    let mut json = serde_json::to_vec(root).expect("plain structs are serialised");
    pad(&mut json, b' ');
    let binary_size = if binary.is_empty() {
        0
    } else {
        8 + binary.len()
    };
    let total = 12 + 8 + json.len() + binary_size;
    let size = u32::try_from(total).map_err(|_| Error::BadModel {
        what: "size as .glb",
        found: format!("{total} bytes"),
        expected: "below 4 GiB".into(),
    })?;
    let mut bytes = Vec::with_capacity(total);
    bytes.extend_from_slice(b"glTF");
    bytes.extend_from_slice(&2u32.to_le_bytes());
    bytes.extend_from_slice(&size.to_le_bytes());
    chunk(&mut bytes, b"JSON", &json);
    if !binary.is_empty() {
        chunk(&mut bytes, b"BIN\0", binary);
    }
    Ok(bytes)
}

fn chunk(bytes: &mut Vec<u8>, kind: &[u8; 4], data: &[u8]) {
    bytes.extend_from_slice(&(data.len() as u32).to_le_bytes());
    bytes.extend_from_slice(kind);
    bytes.extend_from_slice(data);
}

fn pad(bytes: &mut Vec<u8>, with: u8) {
    bytes.resize(bytes.len().next_multiple_of(4), with);
}

#[cfg(test)]
#[path = "glb_tests.rs"]
pub(crate) mod tests;

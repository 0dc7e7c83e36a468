//! Reads a `model.glb` of scand back into the model from which it was made: the welded surface, the decoded texture,
//! and the data about the object. Other programs' files are refused, because they lack what scand writes about a model.

use super::Error;
use crate::description::Description;
use crate::gltf_file::{GltfFile, QUANTIZATION};
use crate::image::{RgbImage, rgb_from_file, size_of_file};
use crate::mesh::Mesh;
use crate::output::{glb, jpeg_quality};
use crate::reconstruct::{Model, Provenance, Texture};
use gltf::Semantic;
use gltf::accessor::{DataType, Dimensions};
use gltf::json::validation::Checked;
use gltf::json::{Index, accessor::Accessor, mesh};
use nalgebra::{Point3, Vector3};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Larger files are refused.
const MAX_FILE_BYTES: u64 = 2 << 30;
/// Texels of an atlas, at most.
const MAX_TEXELS: usize = 16_384 * 16_384;

/// A model of scand, read back.
#[derive(Clone, Debug)]
pub struct ReadModel {
    /// The model in the rig's frame, welded.
    pub model: Model,
    /// What is known of it.
    pub about: Description,
    /// How the file was written, so that a level of detail is written the same way.
    pub glb: glb::Parameters,
    /// The file's bytes.
    pub bytes: Vec<u8>,
}

/// Reads the model in the file at `path`.
///
/// # Errors
/// If the file cannot be read, is damaged, or was not written by scand.
pub fn read(path: &Path) -> Result<ReadModel, Error> {
    let io = |cause| Error::Io {
        path: path.to_owned(),
        cause,
    };
    let what = |what: String| Error::NotAModel {
        path: path.to_owned(),
        what,
    };
    let found = std::fs::metadata(path).map_err(io)?;
    // A device has no end, and a pipe may have none.
    if !found.is_file() {
        return Err(what("it is not a regular file".into()));
    }
    let size = found.len();
    if size > MAX_FILE_BYTES {
        return Err(what(format!(
            "the file has {size} bytes; a model has at most {MAX_FILE_BYTES}"
        )));
    }
    let bytes = std::fs::read(path).map_err(io)?;
    let (file, model, about) = parse(&bytes).map_err(what)?;
    let glb = written_as(&file);
    Ok(ReadModel {
        model,
        about,
        glb,
        bytes,
    })
}

/// The parameters with which a file was written, as far as it tells.
fn written_as(file: &GltfFile<'_>) -> glb::Parameters {
    let texture = file.root().images.first();
    let texture = texture
        .and_then(|image| image.buffer_view)
        .and_then(|view| file.view_bytes(view));
    let quality = texture.and_then(jpeg_quality);
    let mut extensions = file.root().extensions_used.iter();
    glb::Parameters {
        jpeg_quality: quality.unwrap_or(glb::Parameters::default().jpeg_quality),
        unlit: extensions.any(|name| name == glb::UNLIT),
    }
}

/// The bytes of a file as glTF, the model in it, and what is known of it.
pub(super) fn parse(bytes: &[u8]) -> Result<(GltfFile<'_>, Model, Description), String> {
    if !bytes.starts_with(b"glTF") {
        return Err(
            "it is not a binary glTF file: scand export reads the model.glb of a capture".into(),
        );
    }
    let file = GltfFile::parse_with(bytes, &[QUANTIZATION])?;
    let about = about(&file)?;
    let mut required = file.root().extensions_required.iter();
    if required.any(|name| name == QUANTIZATION) {
        return Err(
            "it is a compressed copy of a model, which is less exact: give the model.glb that it was made from".into(),
        );
    }
    let [mesh] = &file.root().meshes[..] else {
        let count = file.root().meshes.len();
        return Err(format!("it has {count} meshes; a model of scand has one"));
    };
    let [primitive] = &mesh.primitives[..] else {
        return Err("its mesh has several parts; that of scand has one".into());
    };
    let split = Split::read(&file, primitive)?;
    let atlas = atlas(&file)?;
    Ok((file, split.weld(atlas), about))
}

/// What the file says of itself.
fn about(file: &GltfFile<'_>) -> Result<Description, String> {
    let asset = &file.root().asset;
    let generator: String = asset
        .generator
        .iter()
        .flat_map(|g| g.chars())
        .take(60)
        .collect();
    let extras = asset.extras.as_ref().map(|extras| extras.get());
    let pairs: Option<BTreeMap<String, String>> =
        extras.and_then(|text| serde_json::from_str(text).ok());
    match pairs {
        Some(pairs) if generator.starts_with("scand ") => Ok(Description::from_pairs(&pairs)),
        _ if generator.is_empty() => Err("it was not written by scand".into()),
        _ => Err(format!("it was written by {generator:?}, not by scand")),
    }
}

/// The picture of the texture, if there is one.
fn atlas(file: &GltfFile<'_>) -> Result<Option<RgbImage>, String> {
    let Some(image) = file.root().images.first() else {
        return Ok(None);
    };
    let bytes = image.buffer_view.and_then(|view| file.view_bytes(view));
    let bytes = bytes.ok_or("its texture lies outside the file")?;
    let explain = |error| format!("its texture cannot be decoded: {error}");
    let size = size_of_file("jpeg", bytes).map_err(explain)?;
    if size.0.saturating_mul(size.1) > MAX_TEXELS {
        return Err(format!("its texture has {}x{} texels", size.0, size.1));
    }
    rgb_from_file("jpeg", bytes, size)
        .map(Some)
        .map_err(explain)
}

/// The vertices as the file has them: split along the texture's seams, in the rig's frame.
struct Split {
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    uv: Vec<[f32; 2]>,
    provenance: Vec<Provenance>,
    errors: Vec<f32>,
    /// Empty where the model is that of one capture.
    captures: Vec<u32>,
    seen: Vec<bool>,
    triangles: Vec<[u32; 3]>,
}

impl Split {
    fn read(file: &GltfFile<'_>, primitive: &mesh::Primitive) -> Result<Self, String> {
        if primitive.mode != Checked::Valid(mesh::Mode::Triangles) {
            return Err("its mesh is not made of triangles".into());
        }
        let find = |name: Semantic| primitive.attributes.get(&Checked::Valid(name)).copied();
        let extra = |name: &str| find(Semantic::Extras(name.to_owned()));
        let needed = |index: Option<Index<Accessor>>, name: &str| {
            index.ok_or_else(|| format!("its vertices have no {name}: scand writes it"))
        };
        let vectors = |index| {
            let items = file.items::<[f32; 3]>(index, DataType::F32, Dimensions::Vec3)?;
            Ok::<Vec<[f32; 3]>, String>(items.map(z_up).collect())
        };
        let positions = vectors(needed(find(Semantic::Positions), "POSITION")?)?;
        let normals = vectors(needed(find(Semantic::Normals), "NORMAL")?)?;
        let errors = file.numbers(needed(extra("ERROR"), "_ERROR")?)?;
        let provenance = file.numbers(needed(extra("PROVENANCE"), "_PROVENANCE")?)?;
        let captures = extra("CAPTURES").map_or(Ok(Vec::new()), |index| file.numbers(index))?;
        let seen = extra("SEEN").map_or(Ok(Vec::new()), |index| file.numbers(index))?;
        let uv = match find(Semantic::TexCoords(0)) {
            Some(index) => file
                .items::<[f32; 2]>(index, DataType::F32, Dimensions::Vec2)?
                .collect(),
            None => Vec::new(),
        };
        let indices = file.numbers(primitive.indices.ok_or("its mesh has no indices")?)?;
        let split = Self {
            triangles: triangles(&indices, positions.len())?,
            provenance: provenance
                .into_iter()
                .map(known_provenance)
                .collect::<Result<_, _>>()?,
            errors: errors.into_iter().map(|e| e as f32).collect(),
            captures: captures.into_iter().map(|bits| bits as u32).collect(),
            seen: seen.into_iter().map(|s| s > 0.5).collect(),
            positions,
            normals,
            uv,
        };
        split.check()?;
        Ok(split)
    }

    fn check(&self) -> Result<(), String> {
        let count = self.positions.len();
        let of_each = [self.normals.len(), self.provenance.len(), self.errors.len()];
        let optional = [self.uv.len(), self.seen.len(), self.captures.len()];
        if of_each.iter().any(|&n| n != count) || optional.iter().any(|&n| n != 0 && n != count) {
            return Err(format!("its attributes do not have {count} values each"));
        }
        if self.triangles.is_empty() {
            return Err("it has no triangles".into());
        }
        let numbers = self.positions.iter().chain(&self.normals).flatten();
        let numbers = numbers.chain(self.uv.iter().flatten()).chain(&self.errors);
        match { numbers }.find(|value| !value.is_finite()) {
            Some(value) => Err(format!("it has the value {value}, which is not finite")),
            None => Ok(()),
        }
    }

    /// Joins what seams split: vertices of which everything but the place in the atlas is the same.
    fn weld(self, atlas: Option<RgbImage>) -> Model {
        let mut numbers = HashMap::new();
        let mut first = Vec::new();
        let welded: Vec<u32> = (0..self.positions.len())
            .map(|v| {
                let shape = [self.positions[v], self.normals[v]].map(|p| p.map(f32::to_bits));
                let captures = self.captures.get(v);
                let known = (self.provenance[v], self.errors[v].to_bits(), captures);
                *numbers.entry((shape, known)).or_insert_with(|| {
                    first.push(v);
                    first.len() as u32 - 1
                })
            })
            .collect();
        let each = || first.iter();
        let texture = atlas.filter(|_| !self.uv.is_empty());
        let texture = texture.map(|atlas| self.texture(atlas, &first));
        Model {
            mesh: Mesh {
                vertices: each().map(|&v| Point3::from(self.positions[v])).collect(),
                triangles: self
                    .triangles
                    .iter()
                    .map(|t| t.map(|v| welded[v as usize]))
                    .collect(),
            },
            normals: each().map(|&v| Vector3::from(self.normals[v])).collect(),
            provenance: each().map(|&v| self.provenance[v]).collect(),
            expected_error: each().map(|&v| self.errors[v]).collect(),
            captures: each()
                .filter_map(|&v| self.captures.get(v).copied())
                .collect(),
            texture,
        }
    }

    fn texture(&self, atlas: RgbImage, first: &[usize]) -> Texture {
        let was_seen = |t: &[u32; 3]| t.iter().all(|&v| self.seen.get(v as usize) != Some(&false));
        Texture {
            corner_uv: self
                .triangles
                .iter()
                .map(|t| t.map(|v| self.uv[v as usize]))
                .collect(),
            seen: self.triangles.iter().map(was_seen).collect(),
            vertex_colors: first.iter().map(|&v| texel(&atlas, self.uv[v])).collect(),
            atlas,
        }
    }
}

/// The texel at a place of the atlas.
fn texel(atlas: &RgbImage, uv: [f32; 2]) -> [u8; 3] {
    let at = |c: f32, length: usize| ((c * length as f32) as usize).min(length.saturating_sub(1));
    atlas.row(at(uv[1], atlas.height()))[at(uv[0], atlas.width())]
}

fn triangles(indices: &[f64], vertices: usize) -> Result<Vec<[u32; 3]>, String> {
    if let Some(index) = indices
        .iter()
        .find(|&&i| !(0.0..vertices as f64).contains(&i))
    {
        return Err(format!(
            "index {index} is out of range for {vertices} vertices"
        ));
    }
    let (whole, rest) = indices.as_chunks::<3>();
    if !rest.is_empty() {
        return Err(format!("{} indices make no whole triangles", indices.len()));
    }
    Ok(whole.iter().map(|t| t.map(|i| i as u32)).collect())
}

fn known_provenance(value: f64) -> Result<Provenance, String> {
    let known = Provenance::ALL
        .into_iter()
        .find(|&p| f64::from(p as u8) == value);
    known
        .ok_or_else(|| format!("a vertex has provenance {value}, which this version does not know"))
}

/// From glTF's frame (y up) to the rig's (z up).
fn z_up([x, y, z]: [f32; 3]) -> [f32; 3] {
    // Adding zero turns -0 into 0.
    [x, -z + 0.0, y]
}

#[cfg(test)]
mod tests {
    use super::super::testing::{as_glb, described, painted_ball, textured_square};
    use super::*;
    use crate::mesh::check;

    #[test]
    fn a_model_comes_back_as_it_was() {
        let (model, about) = (painted_ball(), described("ball-1"));
        let (_, read, read_about) = parse(&as_glb(&model, &about)).unwrap();
        assert_eq!(read_about, about);
        assert!(check(&read.mesh).is_watertight());
        assert_eq!(read.mesh.vertices.len(), model.mesh.vertices.len());
        assert_eq!(read.mesh.triangles.len(), model.mesh.triangles.len());
        // Vertices are numbered anew, triangles keep their order.
        for t in 0..model.mesh.triangles.len() {
            assert_eq!(read.mesh.corners(t), model.mesh.corners(t));
            for (a, b) in read.mesh.triangles[t].iter().zip(model.mesh.triangles[t]) {
                assert_eq!(
                    read.expected_error[*a as usize],
                    model.expected_error[b as usize]
                );
                let turned = read.normals[*a as usize] - model.normals[b as usize];
                assert!(turned.norm() < 1e-6);
            }
        }
        let (read, wrote) = (read.texture.unwrap(), model.texture.unwrap());
        assert_eq!(read.corner_uv, wrote.corner_uv);
        assert_eq!(read.seen, wrote.seen);
        assert!(read.atlas.same_size(&wrote.atlas));
    }

    #[test]
    fn files_of_others_and_damaged_ones_are_refused_with_a_reason() {
        let refused = |bytes: &[u8]| parse(bytes).map(|_| ()).unwrap_err();
        assert!(refused(b"solid ball").contains("not a binary glTF"));
        let good = as_glb(&textured_square(), &described("a"));
        let with = |from: &str, to: &str| {
            assert_eq!(from.len(), to.len(), "the file keeps its length");
            let at = good
                .windows(from.len())
                .position(|w| w == from.as_bytes())
                .unwrap();
            let mut bytes = good.clone();
            bytes[at..at + from.len()].copy_from_slice(to.as_bytes());
            parse(&bytes).map(|_| ())
        };
        assert!(
            with("\"generator\":\"scand", "\"generator\":\"trash")
                .unwrap_err()
                .contains("trash")
        );
        assert!(
            with("_ERROR\":", "_ERRAR\":")
                .unwrap_err()
                .contains("_ERROR")
        );
        assert!(with("_SEEN\":", "_SEES\":").is_ok());
        assert!(refused(&good[..good.len() / 2]).contains("cannot be read"));
        for at in 0..good.len() {
            let mut bytes = good.clone();
            bytes[at] ^= 0x55;
            let _ = parse(&bytes);
        }
    }
}

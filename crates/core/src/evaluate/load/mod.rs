//! Reads model files back: PLY and GLB into one mesh in the rig's frame (z up, metres) with what they know of each
//! vertex. Nothing in a file is trusted: counts are compared with the file's size before memory is allocated, indices
//! with the number of vertices, and coordinates and expected errors must be finite. GLB is read with the crate `gltf`
//! (`glb.rs` says how far). PLY has its own reader, because no crate compares a header's counts with the file's size.

mod glb;
mod ply;

use super::Error;
use crate::mesh::{Mesh, is_closed};
use crate::reconstruct::Provenance;
use nalgebra::{Point3, Vector3};
use std::collections::{BTreeMap, HashMap};
use std::hash::Hash;
use std::path::Path;

/// Larger files are refused.
pub const MAX_FILE_BYTES: u64 = 2 << 30;

/// A model from a file, in the rig's frame (z up, metres). The optional vectors are a value a vertex.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LoadedModel {
    /// The surface, welded.
    pub mesh: Mesh,
    /// Normals, as the file gives them.
    pub normals: Option<Vec<Vector3<f32>>>,
    /// Colours.
    pub colors: Option<Vec<[u8; 3]>>,
    /// Where each vertex comes from.
    pub provenance: Option<Vec<Provenance>>,
    /// Expected distance to the true surface, in metres.
    pub expected_error: Option<Vec<f32>>,
}

/// Reads the model at `path`; its ending tells the format.
///
/// # Errors
/// Where the file cannot be read or is not what its ending says; the error names the file and the place.
pub fn load(path: &Path) -> Result<LoadedModel, Error> {
    load_unwelded(&bytes_of(path)?, path).map(weld_if_open)
}

/// Reads the PLY file at `path` as it is, without welding, and the comments of its header: the first word of each, and
/// what follows it.
///
/// # Errors
/// As [`load`].
pub fn load_ply_with_comments(
    path: &Path,
) -> Result<(LoadedModel, BTreeMap<String, String>), Error> {
    let bytes = bytes_of(path)?;
    let model = parse_with(ply::parse, &bytes, path)?;
    let comments = ply::comments(&bytes).map_err(|what| Error::Format {
        path: path.to_owned(),
        what,
    })?;
    Ok((model, comments))
}

/// The bytes of a file that may be a model.
fn bytes_of(path: &Path) -> Result<Vec<u8>, Error> {
    let io = |cause| Error::Io {
        path: path.to_owned(),
        cause,
    };
    let size = std::fs::metadata(path).map_err(io)?.len();
    format_of(path)?;
    if size > MAX_FILE_BYTES {
        return Err(Error::Format {
            path: path.to_owned(),
            what: format!("it has {size} bytes, expected at most {MAX_FILE_BYTES}"),
        });
    }
    std::fs::read(path).map_err(io)
}

/// Reads the bytes of a GLB, which are called `name` in messages.
///
/// # Errors
/// As [`load`].
pub fn load_glb(bytes: &[u8], name: &Path) -> Result<LoadedModel, Error> {
    parse_with(glb::parse, bytes, name).map(weld_if_open)
}

/// Reads the bytes of the file that is called `name`, as they are: a vertex on a seam of the texture stands there more
/// than once.
///
/// # Errors
/// As [`load`].
pub fn load_unwelded(bytes: &[u8], name: &Path) -> Result<LoadedModel, Error> {
    parse_with(format_of(name)?, bytes, name)
}

type Parse = fn(&[u8]) -> Result<LoadedModel, String>;

/// What reads a file of this name.
fn format_of(name: &Path) -> Result<Parse, Error> {
    let extension = name
        .extension()
        .map(|e| e.to_string_lossy().to_ascii_lowercase());
    match extension.as_deref() {
        Some("ply") => Ok(ply::parse),
        Some("glb") => Ok(glb::parse),
        other => Err(Error::UnknownFormat {
            path: name.to_owned(),
            extension: other.unwrap_or("none").to_owned(),
        }),
    }
}

fn parse_with(parse: Parse, bytes: &[u8], name: &Path) -> Result<LoadedModel, Error> {
    let what = |what: String| Error::Format {
        path: name.to_owned(),
        what,
    };
    let model = parse(bytes).map_err(what)?;
    examine(&model).map_err(what)?;
    Ok(model)
}

/// What every reader owes: triangles, indices within range, finite coordinates, a value a vertex of what is known of
/// vertices, and errors that can be expected.
fn examine(model: &LoadedModel) -> Result<(), String> {
    examine_mesh(&model.mesh)?;
    let count = model.mesh.vertices.len();
    let lengths = [
        ("normals", model.normals.as_ref().map(Vec::len)),
        ("colours", model.colors.as_ref().map(Vec::len)),
        ("provenances", model.provenance.as_ref().map(Vec::len)),
        (
            "expected errors",
            model.expected_error.as_ref().map(Vec::len),
        ),
    ];
    for (what, length) in lengths {
        if let Some(length) = length.filter(|&length| length != count) {
            return Err(format!("it has {length} {what} for {count} vertices"));
        }
    }
    let possible = |error: &f32| error.is_finite() && *error >= 0.0;
    let mut errors = model.expected_error.iter().flatten();
    if let Some(v) = errors.position(|error| !possible(error)) {
        return Err(format!(
            "vertex {v} has an expected error that is no finite length of 0 m or more"
        ));
    }
    Ok(())
}

fn examine_mesh(mesh: &Mesh) -> Result<(), String> {
    if mesh.triangles.is_empty() {
        return Err("the file has no triangles".to_owned());
    }
    let finite = |p: &Point3<f32>| p.coords.iter().all(|c| c.is_finite());
    if let Some(v) = mesh.vertices.iter().position(|p| !finite(p)) {
        let p = mesh.vertices[v];
        return Err(format!(
            "vertex {v} is at ({}, {}, {}), expected finite coordinates",
            p.x, p.y, p.z
        ));
    }
    let count = mesh.vertices.len();
    let broken = |t: &&[u32; 3]| t.iter().any(|&v| v as usize >= count);
    if let Some(t) = mesh.triangles.iter().find(broken) {
        return Err(format!(
            "a face uses the vertices {t:?}, but there are only {count}"
        ));
    }
    Ok(())
}

/// Joins the vertices that seams of texture and normals split, but only where the mesh is open without that: a closed
/// one may hold two vertices in one place on purpose. Where a surface touches itself, two in one place differ in what
/// is known of them; so vertices of equal position are joined only where the mesh is open otherwise.
fn weld_if_open(model: LoadedModel) -> LoadedModel {
    if is_closed(&model.mesh) {
        return model;
    }
    let place = |v: usize| bits(model.mesh.vertices[v].into());
    let known = |v: usize| {
        let normals = model.normals.as_ref();
        let normal = normals.map(|each| bits(each[v].into()));
        let provenance = model.provenance.as_ref().map(|each| each[v]);
        let error = model.expected_error.as_ref().map(|each| each[v].to_bits());
        (normal, provenance, error)
    };
    let welded = weld(&model, |v| (place(v), known(v)));
    if is_closed(&welded.mesh) {
        return welded;
    }
    weld(&model, place)
}

/// The bits of three numbers. Adding zero turns −0 into 0.
fn bits(numbers: [f32; 3]) -> [u32; 3] {
    numbers.map(|c| (c + 0.0).to_bits())
}

/// Joins the vertices that have the same `key`, and drops the triangles that vanish.
fn weld<K: Eq + Hash>(model: &LoadedModel, key: impl Fn(usize) -> K) -> LoadedModel {
    let mut seen = HashMap::new();
    let mut kept = Vec::new();
    let renumbered: Vec<u32> = (0..model.mesh.vertices.len())
        .map(|v| {
            *seen.entry(key(v)).or_insert_with(|| {
                kept.push(v);
                kept.len() as u32 - 1
            })
        })
        .collect();
    let triangles = model.mesh.triangles.iter();
    let triangles = triangles
        .map(|t| t.map(|v| renumbered[v as usize]))
        .filter(|[a, b, c]| a != b && b != c && c != a)
        .collect();
    LoadedModel {
        mesh: Mesh {
            vertices: pick(&kept, &model.mesh.vertices),
            triangles,
        },
        normals: model.normals.as_ref().map(|v| pick(&kept, v)),
        colors: model.colors.as_ref().map(|v| pick(&kept, v)),
        provenance: model.provenance.as_ref().map(|v| pick(&kept, v)),
        expected_error: model.expected_error.as_ref().map(|v| pick(&kept, v)),
    }
}

fn pick<T: Copy>(kept: &[usize], values: &[T]) -> Vec<T> {
    kept.iter().map(|&v| values[v]).collect()
}

/// The provenance of number `value`.
fn provenance(value: f64, vertex: usize) -> Result<Provenance, String> {
    let known = Provenance::ALL
        .into_iter()
        .find(|&p| f64::from(p as u8) == value);
    known.ok_or_else(|| {
        let most = Provenance::ALL.len() - 1;
        format!("vertex {vertex} has provenance {value}, expected 0 to {most}")
    })
}

/// A polygon as a fan of triangles.
fn fan(polygon: &[u32]) -> impl Iterator<Item = [u32; 3]> + '_ {
    polygon
        .windows(2)
        .skip(1)
        .map(|pair| [polygon[0], pair[0], pair[1]])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{check, shapes, vertex_normals};

    /// A model whose triangles have no vertex in common, with the normals that its vertices had.
    fn torn(mesh: &Mesh) -> LoadedModel {
        let normals = vertex_normals(mesh);
        let corners = || mesh.triangles.iter().flatten().map(|&v| v as usize);
        LoadedModel {
            mesh: Mesh {
                vertices: corners().map(|v| mesh.vertices[v]).collect(),
                triangles: (0..mesh.triangles.len() as u32)
                    .map(|t| [3 * t, 3 * t + 1, 3 * t + 2])
                    .collect(),
            },
            normals: Some(corners().map(|v| normals[v]).collect()),
            ..LoadedModel::default()
        }
    }

    #[test]
    fn what_touches_itself_in_a_point_stays_a_solid() {
        let mut mesh = shapes::tetrahedron(1.0);
        let mut other = shapes::tetrahedron(1.0);
        let shift = mesh.vertices[0] - other.vertices[1];
        other.vertices.iter_mut().for_each(|p| *p += shift);
        shapes::append(&mut mesh, &other);
        let welded = weld_if_open(torn(&mesh)).mesh;
        assert_eq!(welded.vertices.len(), 8);
        assert!(check(&welded).is_watertight());
    }

    #[test]
    fn edges_that_normals_split_are_welded() {
        let mut torn = torn(&shapes::cube(1.0));
        for (v, normal) in torn.normals.iter_mut().flatten().enumerate() {
            // One for each triangle.
            *normal = Vector3::new(v as f32 / 3.0, 0.0, 1.0).map(f32::floor);
        }
        let welded = weld_if_open(torn).mesh;
        assert_eq!(welded.vertices.len(), 8);
        assert!(check(&welded).is_watertight());
    }

    #[test]
    fn seams_are_welded_and_what_is_known_of_vertices_kept() {
        let cube = shapes::cube(1.0);
        let soup = LoadedModel {
            mesh: Mesh {
                vertices: cube
                    .triangles
                    .iter()
                    .flatten()
                    .map(|&v| cube.vertices[v as usize])
                    .collect(),
                triangles: (0..12).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
            },
            expected_error: Some(cube.triangles.iter().flatten().map(|&v| v as f32).collect()),
            ..LoadedModel::default()
        };
        let welded = weld_if_open(soup);
        assert_eq!(welded.mesh.vertices.len(), 8);
        assert!(check(&welded.mesh).is_watertight());
        for (p, e) in welded
            .mesh
            .vertices
            .iter()
            .zip(welded.expected_error.unwrap())
        {
            assert_eq!(*p, cube.vertices[e as usize]);
        }
    }

    #[test]
    fn a_closed_mesh_keeps_vertices_that_share_a_place() {
        let mut mesh = shapes::tetrahedron(1.0);
        shapes::append(&mut mesh, &shapes::tetrahedron(1.0));
        let model = LoadedModel {
            mesh,
            ..LoadedModel::default()
        };
        assert_eq!(weld_if_open(model.clone()), model);
    }

    #[test]
    fn errors_name_the_file_and_what_is_wrong() {
        let folder = tempfile::tempdir().unwrap();
        let say = |name: &str, bytes: &[u8]| {
            let path = folder.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            let text = load(&path).unwrap_err().to_string();
            assert!(text.contains(name), "{text}");
            text
        };
        assert!(say("a.stl", b"solid").contains("stl"));
        assert!(say("a.obj", b"v 0 0 0\n").contains("obj"));
        assert!(say("a", b"").contains("none"));
        let ply = |vertices: &str, faces: &str| {
            let (v, f) = (vertices.lines().count(), faces.lines().count());
            format!(
                "ply\nformat ascii 1.0\nelement vertex {v}\nproperty float x\nproperty float y\nproperty float z\n\
                 element face {f}\nproperty list uchar int vertex_indices\nend_header\n{vertices}{faces}"
            )
        };
        let empty = ply("0 0 0\n", "");
        let placeless = ply("0 0 0\n1 0 nan\n0 1 0\n", "3 0 1 2\n");
        assert!(say("a.ply", empty.as_bytes()).contains("no triangles"));
        assert!(say("b.ply", placeless.as_bytes()).contains("vertex 1"));
        assert!(load(&folder.path().join("none.ply")).is_err());
        for error in ["-0.001", "inf", "nan", "1e300"] {
            let unexpected = ply(&format!("0 0 0 0\n1 0 0 {error}\n0 1 0 0\n"), "3 0 1 2\n")
                .replace("float z\n", "float z\nproperty float expected_error\n");
            let told = say("c.ply", unexpected.as_bytes());
            assert!(told.contains("vertex 1 has an expected error"), "{told}");
        }
    }

    #[test]
    fn what_is_known_of_vertices_has_a_value_for_each() {
        let mesh = shapes::tetrahedron(1.0);
        let with = |errors: usize| LoadedModel {
            mesh: mesh.clone(),
            expected_error: Some(vec![0.0; errors]),
            ..LoadedModel::default()
        };
        examine(&with(4)).unwrap();
        for errors in [3, 5] {
            let told = examine(&with(errors)).unwrap_err();
            assert!(told.contains("expected errors for 4 vertices"), "{told}");
        }
    }
}

//! Prepares a model for a viewer's file: splits vertices where the texture has a seam, turns y up, and checks the
//! result.

use super::Error;
use crate::reconstruct::{Model, Texture};
use nalgebra::Vector3;

/// The vertices of a textured model, one for each pair of a welded vertex and a place in the atlas.
#[derive(Debug, Default, PartialEq)]
pub(super) struct SplitVertices {
    /// Which welded vertex each one is.
    pub welded: Vec<u32>,
    /// Where each one lies in the atlas; empty without texture.
    pub uv: Vec<[f32; 2]>,
    /// Whether a camera saw its surface; empty without texture.
    pub seen: Vec<u8>,
    /// Triangles over the split vertices, in the order of the model's.
    pub triangles: Vec<[u32; 3]>,
}

/// Splits vertices along seams. The numbering depends on the order of triangles alone.
pub(super) fn split_at_seams(model: &Model, texture: &Texture) -> SplitVertices {
    let mut variants = Variants {
        first: vec![NONE; model.mesh.vertices.len()],
        next: Vec::with_capacity(model.mesh.vertices.len()),
        split: SplitVertices::default(),
    };
    let corners = model.mesh.triangles.iter().zip(&texture.corner_uv);
    for ((triangle, uvs), &seen) in corners.zip(&texture.seen) {
        let indices = [0, 1, 2].map(|i| variants.index(triangle[i], uvs[i], seen));
        variants.split.triangles.push(indices);
    }
    variants.split
}

/// End of a list of variants.
const NONE: u32 = u32::MAX;

/// The variants of each welded vertex as linked lists: nearly all have one or two.
struct Variants {
    /// For each welded vertex its newest variant.
    first: Vec<u32>,
    /// For each variant an older one of the same vertex.
    next: Vec<u32>,
    split: SplitVertices,
}

impl Variants {
    /// The split vertex at a welded one's place in the atlas, made if there is none yet.
    fn index(&mut self, vertex: u32, uv: [f32; 2], seen: bool) -> u32 {
        let head = self.first[vertex as usize];
        let mut at = head;
        while at != NONE {
            if self.split.is(at as usize, uv, seen) {
                return at;
            }
            at = self.next[at as usize];
        }
        let new = self.split.welded.len() as u32;
        self.next.push(head);
        self.first[vertex as usize] = new;
        self.split.welded.push(vertex);
        self.split.uv.push(uv);
        self.split.seen.push(u8::from(seen));
        new
    }
}

impl SplitVertices {
    fn is(&self, index: usize, uv: [f32; 2], seen: bool) -> bool {
        self.uv[index].map(f32::to_bits) == uv.map(f32::to_bits)
            && self.seen[index] == u8::from(seen)
    }

    /// A model without texture: nothing is split.
    pub(super) fn of_welded(model: &Model) -> Self {
        Self {
            welded: (0..model.mesh.vertices.len() as u32).collect(),
            triangles: model.mesh.triangles.clone(),
            ..Self::default()
        }
    }
}

/// From the rig's frame (z up) to glTF's (y up): a quarter turn about x.
pub fn y_up(v: [f32; 3]) -> [f32; 3] {
    // Adding zero turns -0 into 0.
    [v[0], v[2], -v[1] + 0.0]
}

/// A unit vector, +z where there is no direction to keep.
pub fn unit(normal: Vector3<f32>) -> Vector3<f32> {
    let direction = normal.try_normalize(1e-12);
    // A norm that is not a number passes nalgebra's own test.
    direction
        .filter(|n| n.iter().all(|c| c.is_finite()))
        .unwrap_or_else(Vector3::z)
}

/// What the bits of a vertex say that several captures made.
pub(super) const CAPTURES: &str =
    "bit i is 1 where the i-th capture, from 0, of fusion.captures in report.json made the surface";

/// Checks that a model's vectors have the lengths they must have, that its indices are within them, and
/// that its numbers are finite.
pub(super) fn check(model: &Model) -> Result<(), Error> {
    let vertices = model.mesh.vertices.len();
    let triangles = model.mesh.triangles.len();
    length("normals", model.normals.len(), vertices)?;
    length("provenance", model.provenance.len(), vertices)?;
    length("expected error", model.expected_error.len(), vertices)?;
    if !model.captures.is_empty() {
        length("captures", model.captures.len(), vertices)?;
    }
    if let Some(texture) = &model.texture {
        length("corner uv", texture.corner_uv.len(), triangles)?;
        length("seen flags", texture.seen.len(), triangles)?;
        length("vertex colours", texture.vertex_colors.len(), vertices)?;
    }
    let largest = model.mesh.triangles.iter().flatten().max();
    if let Some(&index) = largest.filter(|&&i| i as usize >= vertices) {
        return Err(bad("vertex index", index, format!("below {vertices}")));
    }
    let positions = model.mesh.vertices.iter().flat_map(|p| p.coords.iter());
    finite("position", positions)?;
    finite("expected error", model.expected_error.iter())?;
    let uv = model.texture.iter().flat_map(|t| &t.corner_uv);
    finite("texture coordinate", uv.flatten().flatten())
}

fn length(what: &'static str, found: usize, expected: usize) -> Result<(), Error> {
    if found == expected {
        return Ok(());
    }
    Err(bad(what, format!("{found} long"), expected.to_string()))
}

fn finite<'a>(what: &'static str, mut values: impl Iterator<Item = &'a f32>) -> Result<(), Error> {
    match values.find(|v| !v.is_finite()) {
        Some(value) => Err(bad(what, value, "a finite number".into())),
        None => Ok(()),
    }
}

fn bad(what: &'static str, found: impl ToString, expected: String) -> Error {
    Error::BadModel {
        what,
        found: found.to_string(),
        expected,
    }
}

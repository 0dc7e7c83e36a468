//! The result of a reconstruction: a mesh whose vertices know where they come from.

use crate::image::RgbImage;
use crate::mesh::Mesh;
use nalgebra::{Vector2, Vector3};

/// Where a vertex comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum Provenance {
    /// On the visual hull.
    #[default]
    Hull = 0,
    /// Where the depth carved the hull.
    Carved = 1,
    /// In a concave region restored from the depth.
    Restored = 2,
    /// In a concave region, over a hole in the depth.
    Bridged = 3,
    /// Never seen: in a concave region by no depth camera, where only the volume cuts the object off, or on a piece
    /// that no silhouette requires.
    Unseen = 4,
    /// Cut by the table's plane, the volume's floor.
    Table = 5,
}

impl Provenance {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 6] = [
        Self::Hull,
        Self::Carved,
        Self::Restored,
        Self::Bridged,
        Self::Unseen,
        Self::Table,
    ];

    /// Its name in models, reports and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Hull => "hull",
            Self::Carved => "carved",
            Self::Restored => "restored",
            Self::Bridged => "bridged",
            Self::Unseen => "unseen",
            Self::Table => "table",
        }
    }
}

/// A reconstructed object in the rig's frame (z up, metres). The vectors are a value a vertex.
#[derive(Clone, Debug, Default)]
pub struct Model {
    /// Closed, oriented, manifold and welded.
    pub mesh: Mesh,
    /// Unit outward normals.
    pub normals: Vec<Vector3<f32>>,
    /// Where each vertex comes from.
    pub provenance: Vec<Provenance>,
    /// Expected distance to the true surface, in metres.
    pub expected_error: Vec<f32>,
    /// For each vertex which captures made it: bit i stands for capture i of those that the model is fused of. Empty
    /// where the model is that of one capture.
    pub captures: Vec<u32>,
    /// Colours; `None` until textured.
    pub texture: Option<Texture>,
}

impl Model {
    /// Its triangles whose corners all come `from` there, with all of its vertices.
    pub fn part(&self, from: Provenance) -> Mesh {
        let is_from = |corners: &&[u32; 3]| {
            let mut corners = corners.iter();
            corners.all(|&v| self.provenance[v as usize] == from)
        };
        let triangles = self.mesh.triangles.iter().filter(is_from);
        Mesh {
            vertices: self.mesh.vertices.clone(),
            triangles: triangles.copied().collect(),
        }
    }
}

/// A model's colours.
#[derive(Clone, Debug)]
pub struct Texture {
    /// The atlas, sRGB-encoded.
    pub atlas: RgbImage,
    /// For each triangle its three corners in the atlas, in [0, 1], v down from the top edge (as in glTF).
    pub corner_uv: Vec<[[f32; 2]; 3]>,
    /// For each vertex its colour.
    pub vertex_colors: Vec<[u8; 3]>,
    /// For each triangle whether a camera saw it and the atlas shows it; the others are grey, or have the colours
    /// around them. No triangle where the pictures do not fit into the atlas, which is a single texel then.
    pub seen: Vec<bool>,
}

impl Texture {
    /// How long a texel is on the surface of `mesh`, in metres: the root of the area that one covers on average, where
    /// cameras saw. `None` where none did.
    pub fn texel_size(&self, mesh: &Mesh) -> Option<f64> {
        let (mut area, mut texels) = (0.0, 0.0);
        for triangle in (0..self.corner_uv.len()).filter(|&t| self.seen[t]) {
            let [a, b, c] = mesh.corners(triangle).map(|p| p.cast::<f64>());
            area += 0.5 * (b - a).cross(&(c - a)).norm();
            texels += self.texels(triangle);
        }
        (texels > 0.0).then(|| (area / texels).sqrt())
    }

    /// Share of the atlas that triangles cover.
    pub fn used(&self) -> f64 {
        let texels: f64 = (0..self.corner_uv.len()).map(|t| self.texels(t)).sum();
        texels / (self.atlas.width() * self.atlas.height()) as f64
    }

    /// Texels that a triangle covers.
    fn texels(&self, triangle: usize) -> f64 {
        let size = [self.atlas.width(), self.atlas.height()].map(|side| side as f64);
        let [a, b, c] = self.corner_uv[triangle]
            .map(|uv| Vector2::new(f64::from(uv[0]) * size[0], f64::from(uv[1]) * size[1]));
        0.5 * (b - a).perp(&(c - a)).abs()
    }
}

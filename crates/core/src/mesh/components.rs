//! The connected pieces of a mesh: which vertex belongs to which, how large each is, and how to extract one.

use super::edges::is_sound;
use super::{Mesh, measure};

/// The connected pieces of a mesh. Triangles that share a vertex are connected.
#[derive(Clone, Debug, PartialEq)]
pub struct Components {
    /// For each vertex the piece it belongs to; [`Components::NONE`] where no triangle uses it.
    pub labels: Vec<u32>,
    /// The pieces, in the order of their lowest vertices.
    pub parts: Vec<Component>,
}

/// What is known of one connected piece.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Component {
    /// Vertices that its triangles use.
    pub vertices: usize,
    /// Triangles, without those that name a vertex twice.
    pub triangles: usize,
    /// Signed volume in cubic metres: negative for a cavity, or where it is inside out.
    pub volume: f64,
    /// Area in square metres.
    pub area: f64,
}

impl Component {
    /// Number of handles, if the piece is closed and manifold: its triangles share their three sides in pairs, so
    /// V − E + F (2 for a sphere, 0 for a torus) is V − F / 2.
    pub fn genus(&self) -> i64 {
        let euler_characteristic = self.vertices as i64 - self.triangles as i64 / 2;
        1 - euler_characteristic.div_euclid(2)
    }
}

impl Components {
    /// The label of vertices that no triangle uses.
    pub const NONE: u32 = u32::MAX;

    /// Index of the piece of the largest absolute volume (the first of equals).
    pub fn largest(&self) -> Option<u32> {
        let volumes = self.parts.iter().map(|p| p.volume.abs());
        let mut best: Option<(u32, f64)> = None;
        for (index, volume) in volumes.enumerate() {
            if best.is_none_or(|(_, most)| volume > most) {
                best = Some((index as u32, volume));
            }
        }
        best.map(|(index, _)| index)
    }
}

/// Finds the connected pieces of `mesh`, in linear time. Triangles that name a vertex twice or one that does
/// not exist connect nothing and are not counted.
pub fn components(mesh: &Mesh) -> Components {
    let count = mesh.vertices.len();
    let mut forest = Forest::new(count);
    let sound = || mesh.triangles.iter().filter(|t| is_sound(t, count));
    for &[a, b, c] in sound() {
        forest.join(a, b);
        forest.join(b, c);
    }
    let mut labels = vec![Components::NONE; count];
    sound().flatten().for_each(|&v| labels[v as usize] = 0);
    let mut roots = vec![Components::NONE; count];
    let mut parts: Vec<Component> = Vec::new();
    for v in 0..count as u32 {
        if labels[v as usize] == Components::NONE {
            continue;
        }
        let root = forest.root(v) as usize;
        if roots[root] == Components::NONE {
            roots[root] = parts.len() as u32;
            parts.push(Component::default());
        }
        labels[v as usize] = roots[root];
        parts[roots[root] as usize].vertices += 1;
    }
    for triangle in sound() {
        let part = &mut parts[labels[triangle[0] as usize] as usize];
        let (volume, area) = measure::volume_and_area(mesh, triangle);
        part.triangles += 1;
        part.volume += volume;
        part.area += area;
    }
    Components { labels, parts }
}

/// The triangles for whose piece `keep` says yes, with their vertices in their old order, and for each new
/// vertex its old index.
pub fn extract(mesh: &Mesh, found: &Components, keep: impl Fn(u32) -> bool) -> (Mesh, Vec<u32>) {
    let mut sources = Vec::new();
    let mut renumbered = vec![u32::MAX; mesh.vertices.len()];
    for (v, &label) in found.labels.iter().enumerate() {
        if label != Components::NONE && keep(label) {
            renumbered[v] = sources.len() as u32;
            sources.push(v as u32);
        }
    }
    let vertices = sources.iter().map(|&v| mesh.vertices[v as usize]).collect();
    let sound = mesh
        .triangles
        .iter()
        .filter(|t| is_sound(t, mesh.vertices.len()));
    let triangles = sound
        .map(|t| t.map(|v| renumbered[v as usize]))
        .filter(|t| t[0] != u32::MAX)
        .collect();
    (
        Mesh {
            vertices,
            triangles,
        },
        sources,
    )
}

/// Union-find with path halving; the lower index becomes the root, so results depend on nothing else.
pub(super) struct Forest(Vec<u32>);

impl Forest {
    pub(super) fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    pub(super) fn root(&mut self, mut v: u32) -> u32 {
        while self.0[v as usize] != v {
            let grandparent = self.0[self.0[v as usize] as usize];
            self.0[v as usize] = grandparent;
            v = grandparent;
        }
        v
    }

    pub(super) fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    #[test]
    fn two_pieces_are_told_apart_and_one_is_taken_out() {
        let small = shapes::tetrahedron(0.5);
        let mut both = small.clone();
        shapes::append(&mut both, &shapes::torus(1.0, 0.3, 24, 12));
        let found = components(&both);
        assert_eq!(found.parts.len(), 2);
        assert_eq!(found.parts[0].vertices, 4);
        assert_eq!(found.parts[0].genus(), 0);
        assert_eq!(found.parts[1].genus(), 1);
        assert_eq!(found.largest(), Some(1));
        let (taken, sources) = extract(&both, &found, |part| part == 0);
        assert_eq!(taken, small);
        assert_eq!(sources, [0, 1, 2, 3]);
        let (torus, sources) = extract(&both, &found, |part| part == 1);
        assert_eq!(torus, shapes::torus(1.0, 0.3, 24, 12));
        assert_eq!(sources[0], 4);
    }

    #[test]
    fn unused_vertices_and_broken_triangles_belong_to_nothing() {
        let mut mesh = shapes::tetrahedron(1.0);
        mesh.vertices.push([9.0, 9.0, 9.0].into());
        mesh.triangles.push([4, 4, 0]);
        mesh.triangles.push([0, 1, 77]);
        let found = components(&mesh);
        assert_eq!(found.parts.len(), 1);
        assert_eq!(found.parts[0].triangles, 4);
        assert_eq!(found.labels[4], Components::NONE);
    }
}

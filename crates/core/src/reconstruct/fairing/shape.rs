//! A mesh that is being faired: which vertices may move, and along which direction. Knows no camera.

use super::sides::Sides;
use crate::array::three;
use crate::mesh::Mesh;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// What a vertex may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// Moves along its direction.
    Free,
    /// On the outline of the face that the table cuts: moves within the table's plane.
    Foot,
    /// On an edge that the silhouettes show: stays, and the surface may bend there.
    Edge,
    /// On a flat side between such edges: stays.
    Side(u32),
    /// Within the face that the table cuts: stays.
    Table,
}

/// A mesh that is being faired.
pub(super) struct Shape {
    pub(super) positions: Vec<Point3<f64>>,
    pub(super) triangles: Vec<[u32; 3]>,
    pub(super) roles: Vec<Role>,
    /// Unit direction along which each vertex moves, outwards.
    pub(super) directions: Vec<Vector3<f64>>,
    /// The surface's unit normal at each vertex, averaged as the directions are, but not turned into the table's plane.
    pub(super) normals: Vec<Vector3<f64>>,
    /// How much of its way back to the hull each vertex went, 0 (faired) to 1 (the hull).
    pub(super) kept: Vec<f64>,
    /// Height of the table.
    floor: f64,
    starts: Vec<u32>,
    neighbours: Vec<u32>,
}

/// How often normals are averaged over neighbours, so that facets do not show in them.
const AVERAGED: usize = 2;

impl Shape {
    /// A closed mesh; the vertices within `on_table` of height `floor` lie on the table's plane.
    pub(super) fn new(mesh: &Mesh, floor: f64, on_table: f64) -> Self {
        let positions: Vec<Point3<f64>> = mesh.vertices.iter().map(|v| v.cast()).collect();
        let (starts, neighbours) = neighbours(&mesh.triangles, positions.len());
        let mut shape = Self {
            roles: vec![Role::Free; positions.len()],
            kept: vec![0.0; positions.len()],
            directions: vec![Vector3::z(); positions.len()],
            normals: vec![Vector3::z(); positions.len()],
            triangles: mesh.triangles.clone(),
            positions,
            floor,
            starts,
            neighbours,
        };
        let low: Vec<bool> = shape
            .positions
            .iter()
            .map(|p| (p.z - floor).abs() < on_table)
            .collect();
        for v in 0..low.len() {
            if low[v] {
                let outline = shape.around(v).iter().any(|&j| !low[j as usize]);
                shape.roles[v] = if outline { Role::Foot } else { Role::Table };
            }
        }
        for v in (0..low.len()).filter(|&v| low[v]) {
            shape.positions[v].z = floor;
        }
        shape.update_normals();
        shape
    }

    pub(super) fn len(&self) -> usize {
        self.positions.len()
    }

    /// The neighbours of a vertex, ascending.
    pub(super) fn around(&self, v: usize) -> &[u32] {
        &self.neighbours[self.starts[v] as usize..self.starts[v + 1] as usize]
    }

    /// Where the vertices on edges are.
    pub(super) fn edges(&self) -> Vec<Point3<f64>> {
        let all = self.positions.iter().zip(&self.roles);
        all.filter(|(_, role)| **role == Role::Edge)
            .map(|(p, _)| *p)
            .collect()
    }

    /// The sides that a triangle lies on, if all its corners lie on one.
    pub(super) fn sides_of(&self, t: &[u32; 3]) -> Option<[u32; 3]> {
        let side = |v: u32| match self.roles[v as usize] {
            Role::Side(side) => Some(side),
            _ => None,
        };
        Some([side(t[0])?, side(t[1])?, side(t[2])?])
    }

    /// Puts the vertices in front of flat sides onto them, where `bears` says of the point there that no outline
    /// excludes it.
    pub(super) fn put_on(&mut self, sides: &Sides, bears: impl Fn(Point3<f64>) -> bool + Sync) {
        let places: Vec<_> = (0..self.len())
            .into_par_iter()
            .map(|v| match self.roles[v] {
                Role::Table => None,
                _ => sides.nearest(self.positions[v]).filter(|(_, p)| bears(*p)),
            })
            .collect();
        for (v, place) in places.into_iter().enumerate() {
            if let Some((side, p)) = place {
                self.positions[v] = p;
                self.roles[v] = Role::Side(side);
            }
        }
    }

    /// What a vertex that lies on no edge may do, unless it is within the face that the table cuts.
    pub(super) fn role_without_edges(&self, v: usize) -> Role {
        if self.positions[v].z == self.floor {
            Role::Foot
        } else {
            Role::Free
        }
    }

    /// Whether a neighbour of the outline on the table belongs to it.
    pub(super) fn ends_at_foot(&self, v: usize) -> bool {
        match self.roles[v] {
            Role::Foot | Role::Edge => true,
            Role::Side(_) => self.positions[v].z == self.floor,
            Role::Free | Role::Table => false,
        }
    }

    /// Whether a vertex moves.
    pub(super) fn moves(&self, v: usize) -> bool {
        matches!(self.roles[v], Role::Free | Role::Foot)
    }

    /// Whether a triangle lies in the face that the table cuts.
    pub(super) fn is_on_table(&self, t: &[u32; 3]) -> bool {
        let on_table = |v: &u32| self.roles[*v as usize] != Role::Free;
        let level = || {
            let z = three(|i| self.positions[t[i] as usize].z);
            (z[0] - z[1]).abs().max((z[0] - z[2]).abs())
        };
        t.iter().all(on_table)
            && t.iter()
                .any(|&v| matches!(self.roles[v as usize], Role::Table | Role::Foot))
            && level() < 1e-6
    }

    /// Computes the normals, and the directions that follow from them, anew.
    pub(super) fn update_normals(&mut self) {
        let mut sums = vec![Vector3::<f64>::zeros(); self.len()];
        for t in self.triangles.iter().filter(|t| !self.is_on_table(t)) {
            let corners = three(|i| self.positions[t[i] as usize]);
            for (i, share) in corner_normals(corners).into_iter().enumerate() {
                sums[t[i] as usize] += share;
            }
        }
        let unit = |v: &Vector3<f64>| v.try_normalize(1e-12).unwrap_or_else(Vector3::z);
        let mut normals: Vec<Vector3<f64>> = sums.iter().map(unit).collect();
        for _ in 0..AVERAGED {
            let averaged = |v: usize| {
                let around = self.around(v).iter().map(|&j| j as usize);
                let sum = around.filter(|&j| self.moves(j)).map(|j| normals[j]);
                unit(&(normals[v] + sum.sum::<Vector3<f64>>()))
            };
            normals = (0..self.len()).map(averaged).collect();
        }
        for ((normal, role), direction) in normals.iter().zip(&self.roles).zip(&mut self.directions)
        {
            let flat = Vector3::new(normal.x, normal.y, 0.0);
            *direction = match role {
                Role::Foot if flat.norm() > 0.3 => flat.normalize(),
                Role::Foot => Vector3::zeros(),
                _ => *normal,
            };
        }
        self.normals = normals;
    }

    /// Mean length of the edges, in metres.
    pub(super) fn mean_edge(&self) -> f64 {
        let ends =
            (0..self.len()).flat_map(|v| self.around(v).iter().map(move |&j| (v, j as usize)));
        let sum: f64 = ends
            .map(|(v, j)| (self.positions[v] - self.positions[j]).norm())
            .sum();
        sum / self.neighbours.len().max(1) as f64
    }

    /// Area around each vertex, in square metres.
    pub(super) fn areas(&self) -> Vec<f64> {
        let mut areas = vec![0.0; self.len()];
        for t in &self.triangles {
            let [a, b, c] = three(|i| self.positions[t[i] as usize]);
            let third = (b - a).cross(&(c - a)).norm() / 6.0;
            t.iter().for_each(|&v| areas[v as usize] += third);
        }
        areas
    }

    /// Evens the vertices out along the surface: each goes half the way to the middle of its neighbours, less what
    /// lies across the surface.
    pub(super) fn smooth_tangentially(&mut self) {
        let moved: Vec<Point3<f64>> = (0..self.len())
            .map(|v| {
                let p = self.positions[v];
                let same_kind = |j: &&u32| match self.roles[v] {
                    Role::Foot => self.ends_at_foot(**j as usize),
                    _ => true,
                };
                let around = || {
                    self.around(v)
                        .iter()
                        .filter(same_kind)
                        .map(|&j| self.positions[j as usize] - p)
                };
                let count = around().count();
                if !self.moves(v) || count < 2 {
                    return p;
                }
                let way = around().sum::<Vector3<f64>>() / count as f64;
                let mut along = way - self.normals[v] * self.normals[v].dot(&way);
                if self.roles[v] == Role::Foot {
                    along = way - self.directions[v] * self.directions[v].dot(&way);
                    along.z = 0.0;
                }
                p + along * 0.5
            })
            .collect();
        self.positions = moved;
    }
}

/// The normal of a triangle at each of its corners, weighted by the angle there; zero without area.
pub(super) fn corner_normals(corners: [Point3<f64>; 3]) -> [Vector3<f64>; 3] {
    let face = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
    let Some(normal) = face.try_normalize(1e-18) else {
        return [Vector3::zeros(); 3];
    };
    three(|i| {
        let (a, b) = (
            corners[(i + 1) % 3] - corners[i],
            corners[(i + 2) % 3] - corners[i],
        );
        normal * a.angle(&b)
    })
}

/// Where each vertex' neighbours begin in the second list, and their number; neighbours ascend.
fn neighbours(triangles: &[[u32; 3]], count: usize) -> (Vec<u32>, Vec<u32>) {
    let mut starts = vec![0_u32; count + 1];
    for &v in triangles.as_flattened() {
        starts[v as usize + 1] += 1;
    }
    for v in 0..count {
        starts[v + 1] += starts[v];
    }
    let mut list = vec![0; starts[count] as usize];
    let mut next = starts.clone();
    for t in triangles {
        // Each edge of a closed mesh is met once in each direction.
        for i in 0..3 {
            let next = &mut next[t[i] as usize];
            list[*next as usize] = t[(i + 1) % 3];
            *next += 1;
        }
    }
    for v in starts.windows(2) {
        list[v[0] as usize..v[1] as usize].sort_unstable();
    }
    (starts, list)
}

//! The faired hull as a solid: the signed distance to its curved surface, known at the lattice's corners near it.

use super::columns::Columns;
use super::curved::{Curved, weights};
use super::nearest::Nearest;
use super::shape::Shape;
use super::sides::Sides;
use crate::mesh::closest_on_triangle;
use crate::reconstruct::hull;
use crate::reconstruct::surface::{Constraint, Lattice, Side, Solid, UndecidedConstraints};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// A value well inside a solid, as silhouettes have it.
const SURELY: f64 = 127.5;

/// The bit of the one constraint that there is.
const SURFACE: UndecidedConstraints = 1;

/// A faired hull.
pub struct FairedSolid {
    curved: Curved,
    /// Whether each triangle lies on the table.
    on_table: Vec<bool>,
    /// How much of the hull each vertex of the curved surface kept, 0 to 1.
    kept: Vec<f64>,
    /// The flat sides, if there are any, and those that each triangle lies on.
    sides: Option<Sides>,
    on_sides: Vec<Option<[u32; 3]>>,
    lattice: Lattice,
    bounds: hull::Bounds,
    nearest: Nearest,
    columns: Columns,
    /// The distance at each of the corners of `nearest`, in [`SURELY`] a cell.
    values: Vec<f32>,
}

impl FairedSolid {
    /// The solid that the surface of `shape`, its flat sides and the tables in `bounds` bound, to be extracted on
    /// `lattice`.
    pub(super) fn new(
        shape: &Shape,
        sides: Option<Sides>,
        lattice: Lattice,
        bounds: hull::Bounds,
    ) -> Self {
        let curved = Curved::new(shape);
        let triangles = curved.triangles.iter();
        let on_sides = triangles.map(|t| shape.sides_of(t)).collect();
        let nearest = Nearest::new(&curved, &lattice);
        let columns = Columns::new(&curved.positions, &curved.triangles, &lattice);
        let on_table = curved
            .triangles
            .iter()
            .map(|t| shape.is_on_table(t))
            .collect();
        let mut solid = Self {
            curved,
            on_table,
            kept: shape.kept.clone(),
            sides,
            on_sides,
            lattice,
            bounds,
            nearest,
            columns,
            values: Vec::new(),
        };
        solid.values = (0..solid.nearest.len())
            .into_par_iter()
            .map(|i| {
                let (at, triangle) = solid.nearest.corner(i);
                let p = lattice.origin + Vector3::from(at.map(f64::from)) * lattice.cell_size;
                solid.bounded(p, solid.distance(p, triangle).1)
            })
            .collect();
        solid
    }

    /// The solid that the surface of another `shape` bounds, with the same flat sides and tables, on the same lattice.
    pub(super) fn with_shape(self, shape: &Shape) -> Self {
        Self::new(shape, self.sides, self.lattice, self.bounds)
    }

    /// Whether the surface at a point near it is a flat side between certain edges.
    pub fn is_on_side(&self, p: Point3<f64>) -> bool {
        self.best(p)
            .is_some_and(|(triangle, _)| self.on_sides[triangle as usize].is_some())
    }

    /// How much of the hull is left at a point near the surface, 0 (faired) to 1 (the hull).
    pub fn kept(&self, p: Point3<f64>) -> f64 {
        let of_triangle = |(triangle, _): (u32, f64)| {
            let t = triangle as usize;
            let corners = self.curved.places(t);
            let weights = weights(corners, closest_on_triangle(p, corners));
            let ids = self.curved.triangles[t];
            (0..3)
                .map(|i| self.kept[ids[i] as usize] * weights[i])
                .sum()
        };
        self.best(p).map_or(1.0, of_triangle)
    }

    /// Squared distance to a flat triangle, and the signed one to the curved surface there, positive inside.
    fn distance(&self, p: Point3<f64>, triangle: u32) -> (f64, f64) {
        let t = triangle as usize;
        let corners = self.curved.places(t);
        let flat = closest_on_triangle(p, corners);
        let weights = weights(corners, flat);
        let (way, ids) = (p - flat, self.curved.triangles[t]);
        // At an edge or a corner the faces around it have to agree which side it is.
        let pseudo = (0..3).fold(Vector3::zeros(), |sum, i| {
            sum + self.curved.pseudo[ids[i] as usize] * weights[i]
        });
        let on_border = weights.iter().any(|&w| w < 1e-6);
        let side = if on_border {
            pseudo
        } else {
            self.curved.faces[t]
        };
        let signed = if way.dot(&side) > 0.0 {
            way.norm()
        } else {
            -way.norm()
        };
        let inside = match self.on_sides(triangle, p) {
            Some((inside, _)) => inside,
            None => self.curved.bulge(t, weights, flat) - signed,
        };
        (way.norm_squared(), inside)
    }

    /// How far within the flat sides that a triangle lies on a point is, with the nearest one's outward normal.
    fn on_sides(&self, triangle: u32, p: Point3<f64>) -> Option<(f64, Vector3<f64>)> {
        let sides = self.on_sides[triangle as usize]?;
        Some(self.sides.as_ref()?.inside(sides, p))
    }

    /// A distance as a value, no more than the tables allow.
    fn bounded(&self, p: Point3<f64>, inside: f64) -> f32 {
        let inside = inside.min(self.bounds.nearest_table(p).0);
        (inside * SURELY / self.lattice.cell_size).clamp(-SURELY, SURELY) as f32
    }

    /// Place in the lattice, in cells.
    fn place(&self, p: Point3<f64>) -> Vector3<f64> {
        (p - self.lattice.origin) / self.lattice.cell_size
    }

    fn far(&self, at: Vector3<f64>) -> f32 {
        if self.columns.is_inside(at.x, at.y, at.z) {
            SURELY as f32
        } else {
            -SURELY as f32
        }
    }

    /// The triangle nearest to a point among those that are nearest to the corners of its cell, with its distance.
    fn best(&self, p: Point3<f64>) -> Option<(u32, f64)> {
        let at = self.place(p).map(f64::floor);
        let mut tried = [u32::MAX; 8];
        let mut best: Option<(f64, u32, f64)> = None;
        for i in 0..8 {
            let corner = [0, 1, 2].map(|axis| at[axis] + f64::from(i >> axis & 1));
            let Some(found) = self.nearest.find(corner) else {
                continue;
            };
            let triangle = self.nearest.corner(found).1;
            if tried.contains(&triangle) {
                continue;
            }
            tried[i as usize] = triangle;
            let (squared, inside) = self.distance(p, triangle);
            if best.is_none_or(|b| squared < b.0) {
                best = Some((squared, triangle, inside));
            }
        }
        best.map(|(_, triangle, inside)| (triangle, inside))
    }
}

impl Solid for FairedSolid {
    fn side(&self, center: Point3<f64>, half: f64, _: UndecidedConstraints) -> Side {
        let size = 2.0 * half / self.lattice.cell_size;
        let level = size.round().max(1.0).log2().round() as u32;
        let at = self.place(center);
        let whole = |side: bool| if side { Side::Inside } else { Side::Outside };
        if level > 0 {
            let cube = at.map(|v| (v / size).floor().max(0.0) as u32);
            if self.nearest.reaches(level, cube.into()) {
                return Side::Across(SURFACE);
            }
            return whole(self.columns.is_inside(at.x, at.y, at.z));
        }
        let low = at.map(f64::floor);
        let (mut inside, mut known) = (0, 0);
        for i in 0..8 {
            let corner = [0, 1, 2].map(|axis| low[axis] + f64::from(i >> axis & 1));
            if let Some(found) = self.nearest.find(corner) {
                known += 1;
                inside += u32::from(self.values[found] > 0.0);
            }
        }
        match known {
            0 => whole(self.columns.is_inside(at.x, at.y, at.z)),
            _ if inside == 0 => Side::Outside,
            _ if inside == known => Side::Inside,
            _ => Side::Across(SURFACE),
        }
    }

    fn value(&self, p: Point3<f64>, undecided: UndecidedConstraints) -> f32 {
        if undecided & SURFACE == 0 {
            return SURELY as f32;
        }
        let at = self.place(p);
        let corner = at.map(f64::round);
        if (at - corner).amax() < 1e-6 {
            let found = self.nearest.find(corner.into());
            return found.map_or_else(|| self.far(at), |i| self.values[i]);
        }
        match self.best(p) {
            Some((_, inside)) => self.bounded(p, inside),
            None => self.far(at),
        }
    }

    fn normal(&self, p: Point3<f64>, _: UndecidedConstraints) -> (Vector3<f32>, Constraint) {
        let Some((triangle, inside)) = self.best(p) else {
            return (Vector3::z(), 0);
        };
        let t = triangle as usize;
        if self.on_table[t] {
            return (-Vector3::z(), hull::FLOOR);
        }
        let (distance, downward) = self.bounds.nearest_table(p);
        if distance < inside {
            return (downward.cast(), hull::FLOOR);
        }
        if let Some((_, normal)) = self.on_sides(triangle, p) {
            return (normal.cast(), 0);
        }
        let corners = self.curved.places(t);
        let weights = weights(corners, closest_on_triangle(p, corners));
        (self.curved.normal(t, weights).cast(), 0)
    }
}

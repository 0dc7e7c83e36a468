//! Fairs the hull: finds the surface of least bending whose outlines lie on the contours. Between views the hull stands
//! out from the object; at edges that silhouettes show it does not. This room uses no depth and carves nothing.
//!
//! - `contour` measures distances to a silhouette's contour;
//! - `shape` is the mesh that is moved, `certain` finds the edges that stay;
//! - `sides` finds flat sides between such edges: `corners` are the points that span them, `flat` the parts of their
//!   hull;
//! - `rounds` is one estimate of how far each vertex moves, `solve` its equations;
//! - `curved` is the smooth surface that a mesh stands for, `transfer` begins a finer mesh on it;
//! - `accept` keeps the hull where the outlines do not agree;
//! - `body` is the result as a solid.

mod accept;
mod body;
mod certain;
mod columns;
mod contour;
mod corners;
mod curved;
mod flat;
mod nearest;
mod rounds;
mod shape;
mod sides;
mod solve;
mod transfer;

pub use body::Body;

use super::hull::{self, Hull};
use super::surface::Lattice;
use crate::mesh::{self, Mesh};
use contour::Contour;
use rayon::prelude::*;
use rounds::Round;
use shape::Shape;
use sides::Sides;

/// Edges of the cells of the meshes that are faired, in those of the hull: a coarse one for the form, a finer one for
/// what is left.
const LEVELS: [RefinementLevel; 2] = [
    RefinementLevel {
        cells: 4,
        rounds: 8,
        steps: 150,
    },
    RefinementLevel {
        cells: 2,
        rounds: 4,
        steps: 80,
    },
];

/// Share of the object's radius within which a surface that bends resists ever less.
const SHARPEST: f64 = 0.2;
/// Objects of a smaller radius keep their hull: over so few pixels the noise of contours bends as much as the object.
const SMALLEST_RADIUS_PX: f64 = 50.0;
/// Rounds in which all resists alike, so that the hull's facets do not count as edges.
const ROUNDS_TO_SETTLE: usize = 2;

struct RefinementLevel {
    cells: u32,
    rounds: usize,
    /// Most steps of the solver in a round.
    steps: usize,
}

/// A faired hull.
pub struct Faired {
    /// It as a solid.
    pub body: Body,
    /// How it came out.
    pub facts: Facts,
}

/// How a fairing came out.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Facts {
    /// Root mean square distance of the contours to the faired hull's outlines, the nearest within four pixels along
    /// them, in pixels; where there is none, it counts as three.
    pub contour_rms_px: f64,
    /// What 99 % of these distances are below, in pixels.
    pub contour_p99_px: f64,
    /// Share of the surface that stays the hull, because outlines do not agree there.
    pub kept: f64,
    /// Area that moved by more than 0.5 mm, in square metres.
    pub moved_area: f64,
    /// The hull's area, in square metres.
    pub area: f64,
}

/// Fairs a hull whose surface on `lattice` is `extracted`; `None` where nothing of it may be faired.
pub fn fair(
    hull: &Hull,
    lattice: &Lattice,
    extracted: &Mesh,
    parameters: &hull::Parameters,
) -> Option<Faired> {
    let contours: Vec<Contour> = hull
        .cones()
        .par_iter()
        .map(|cone| Contour::new(cone.camera(), cone.level(), cone.unknown()))
        .collect();
    let [low, high] = mesh::bounding_box(&extracted.vertices)?;
    let middle = nalgebra::center(&low.cast(), &high.cast());
    let pixel = hull.pixel_footprint(middle);
    let radius = 0.5 * (high - low).cast::<f64>().norm() / 3f64.sqrt();
    if radius < SMALLEST_RADIUS_PX * pixel {
        return None;
    }
    let mut shapes = Vec::new();
    for level in &LEVELS {
        let coarser = coarser(lattice, level.cells);
        let found = hull::extract(hull, &coarser, parameters).ok()?;
        let floor = hull.volume().min.z;
        let mut shape = Shape::new(&found.surface.mesh, floor, 0.25 * coarser.cell_size);
        certain::mark(&mut shape, &contours, pixel);
        shapes.push(shape);
    }
    certain::confirm(&mut shapes);
    let sides = shapes
        .last()
        .and_then(|finest| Sides::find(&finest.edges(), &contours, pixel, hull.volume().min.z));
    let mut coarse: Option<transfer::MovedMesh> = None;
    let mut last = None;
    for (level, mut shape) in LEVELS.iter().zip(shapes) {
        let cell_size = lattice.cell_size * f64::from(level.cells);
        let start = shape.positions.clone();
        if let Some(sides) = &sides {
            shape.put_on(sides);
        }
        let coarse_is_done = coarse.is_some();
        if let Some(coarse) = coarse.take() {
            coarse.begin(&mut shape);
        }
        for round in 0..level.rounds {
            shape.direct();
            let settled = coarse_is_done || round >= ROUNDS_TO_SETTLE;
            let round_of = Round {
                steps: level.steps,
                farthest: cell_size,
                sharpest: if settled { SHARPEST * radius } else { 0.0 },
            };
            rounds::fair_once(&mut shape, &contours, round_of);
            if round + 1 < level.rounds {
                shape.even_out();
            }
        }
        coarse = Some(transfer::MovedMesh::new(&shape, &start));
        last = Some((shape, start));
    }
    let (mut shape, start) = last?;
    shape.direct();
    let facts = accept::keep_hull(&mut shape, &start, &contours)?;
    let body = Body::new(&shape, sides, *lattice, hull.bounds().clone());
    Some(Faired { body, facts })
}

/// The lattice with cells so many times as long.
fn coarser(lattice: &Lattice, times: u32) -> Lattice {
    Lattice {
        origin: lattice.origin,
        cell_size: lattice.cell_size * f64::from(times),
        cells: lattice.cells.map(|n| n.div_ceil(times) + 1),
    }
}

#[cfg(test)]
mod tests;

//! Fairs the hull: finds the surface of least bending whose outlines lie on the contours. Between views the hull stands
//! out from the object; at edges that silhouettes show it does not. This room uses no depth and carves nothing.
//!
//! - `contour` measures distances to a silhouette's contour, `reduced` makes silhouettes of larger pixels;
//! - `shape` is the mesh that is moved, `certain` finds the edges that stay;
//! - `sides` finds flat sides between such edges: `corners` are the points that span them, `flat` the parts of their
//!   hull, `table_corners` those where sides meet on the table, `bevels` the strips between sides that are none;
//! - `profile` finds relief that stands in profile, which stays;
//! - `rounds` is one estimate of how far each vertex moves, `bending` what resists it, `solve` its equations;
//! - `curved` is the smooth surface that a mesh stands for, `transfer` begins a finer mesh on it;
//! - `accept` keeps the hull where the outlines do not agree, `held` where something else shows that it has to stay;
//! - `faired_solid` is the result as a solid: `nearest` finds the triangle that is nearest to each corner of the
//!   lattice near the surface, and `columns` finds which of the other corners lie inside.

mod accept;
mod bending;
mod bevels;
mod certain;
mod columns;
mod contour;
mod corners;
mod curved;
mod faired_solid;
mod flat;
mod held;
mod nearest;
mod profile;
mod reduced;
mod rounds;
mod shape;
mod sides;
mod solve;
mod table_corners;
mod transfer;

pub use faired_solid::FairedSolid;

use super::hull::{self, Hull};
use super::surface::Lattice;
use crate::calibration::Volume;
use crate::mesh::{self, Mesh};
use bending::Bending;
use contour::Contour;
use nalgebra::{Point3, Vector3};
use profile::Profiles;
use rayon::prelude::*;
use reduced::Reduced;
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
        bending: Bending::Mean,
    },
    RefinementLevel {
        cells: 2,
        rounds: 4,
        steps: 80,
        bending: Bending::Each,
    },
];

/// Share of the object's radius: where the surface bends within a smaller radius, it resists less, the sharper it
/// bends.
const SHARPEST: f64 = 0.2;
/// Objects of a smaller radius keep their hull: over so few pixels the noise of contours bends as much as the object.
const SMALLEST_RADIUS_PX: f64 = 50.0;
/// Least and most rounds in which all vertices resist bending equally, so that the hull's facets do not count as edges.
const ROUNDS_TO_SETTLE: [usize; 2] = [2, 12];
/// These rounds go on while more than this share of the vertices would go farther in one than they may: with few views
/// the ridges between them stand off by many cells.
const SETTLED: f64 = 1e-3;

/// How many of its cells a hull may reach beyond a coarser surface of it. Edges reach half a cell beyond it, and what
/// is thinner than a cell all its length.
const MOST_LOST_CELLS: f64 = 2.0;
/// One of so many of the hull's vertices is asked for that: a part of two cells has dozens.
const ASKED_OF: usize = 4;

/// Pixels by which a flat side may lie outside an outline.
const OUTSIDE_PX: f64 = 0.5;

struct RefinementLevel {
    cells: u32,
    rounds: usize,
    /// Most steps of the solver in a round.
    steps: usize,
    bending: Bending,
}

/// A point of a faired surface at which an outline of it lies on a contour.
#[derive(Clone, Copy, Debug)]
pub struct Touch {
    /// Where it is, in metres in the hull's frame.
    pub point: Point3<f64>,
    /// The surface's outward unit normal there.
    pub normal: Vector3<f64>,
    /// The unit vector along which the contour's camera sees it.
    pub view: Vector3<f64>,
}

/// A faired hull.
pub struct Faired {
    /// The solid that it bounds.
    pub solid: FairedSolid,
    /// How it came out.
    pub facts: Facts,
    /// Where it is known best.
    pub touches: Vec<Touch>,
    /// The mesh that the solid's surface runs through.
    shape: Shape,
    /// Where the mesh's vertices were on the hull.
    start: Vec<Point3<f64>>,
}

impl Faired {
    /// The same hull, but not faired at `places` on its surface (in the hull's frame), where depth cameras read the
    /// object in front of it. Around them it passes over into the faired surface.
    pub fn held_at(mut self, places: &[Point3<f64>]) -> Self {
        if places.is_empty() {
            self.facts.held_by_depth_area = Some(0.0);
            return self;
        }
        held::keep_hull_at(&mut self.shape, &self.start, places, &mut self.facts);
        self.solid = self.solid.with_shape(&self.shape);
        self
    }
}

/// How a fairing came out.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Facts {
    /// Root mean square distance of the contours to the faired hull's outlines, in pixels of the pictures: the nearest
    /// within four pixels along them; where there is none, it counts as three. Where pixels were put together, because
    /// a cell of the hull is longer than four, these four and three are such larger pixels.
    pub contour_rms_px: f64,
    /// What 99 % of these distances are below, in pixels of the pictures.
    pub contour_p99_px: f64,
    /// Share of the surface that stays the hull, because outlines do not agree there, a part would become too thin, or
    /// depth cameras read the object in front of the faired surface.
    pub kept: f64,
    /// Area that stays the hull because of what depth cameras read, in square metres; `None` where none was asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub held_by_depth_area: Option<f64>,
    /// Area that moved by more than 0.5 mm, in square metres.
    pub moved_area: f64,
    /// The hull's area, in square metres.
    pub area: f64,
}

/// Why all of a hull stays as it is.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// The object has too few pixels.
    #[error(
        "the object's radius is {radius_px:.0} pixels; over fewer than {SMALLEST_RADIUS_PX} the noise of the contours bends \
         as much as the object"
    )]
    TooSmall {
        /// The object's radius in its nearest picture, in pixels.
        radius_px: f64,
    },
    /// On the coarser cells of the fairing there is no closed surface.
    #[error("the hull is thinner than the cells on which it is faired")]
    TooThin,
    /// A part is missing on the coarser cells of the fairing.
    #[error(
        "a part of the hull is thinner than the cells on which it is faired: it ends {:.1} mm from what is left on them",
        1e3 * distance
    )]
    ThinPart {
        /// How far the part's farthest point is from the surface on the coarser cells, in metres.
        distance: f64,
    },
    /// Too much would have to stay the hull.
    #[error(
        "fairing would leave {:.0} % of the surface as the hull, and at most {:.0} % is allowed: on {:.0} % the outlines \
         would move away from the contours, on {:.0} % a part would become too thin, and the rest lies beside these places",
        100.0 * kept, 100.0 * accept::TOO_MUCH, 100.0 * disagreeing, 100.0 * thin
    )]
    TooMuchKept {
        /// Share of the surface that would stay the hull.
        kept: f64,
        /// Share of it whose outlines would be farther from the contours than the hull's.
        disagreeing: f64,
        /// Share of it that would lose too much of its thickness.
        thin: f64,
    },
    /// The faired surface has other pieces or handles.
    #[error(
        "fairing changed the topology: its pieces have {after:?} handles, the hull's have {before:?}"
    )]
    OtherHandles {
        /// Handles of the hull's pieces.
        before: Vec<i64>,
        /// Handles of the faired surface's pieces.
        after: Vec<i64>,
    },
    /// The faired surface has a border: it leaves the lattice of the hull, as it may over the mouth of a bowl.
    #[error("the faired surface bulges out of the box around the hull")]
    Open,
}

/// Fairs a hull whose surface on `lattice` is `extracted`.
///
/// # Errors
/// Why nothing of it may be faired.
pub fn fair_hull(
    hull: &Hull,
    lattice: &Lattice,
    extracted: &Mesh,
    parameters: &hull::Parameters,
) -> Result<Faired, Refusal> {
    let [low, high] = mesh::bounding_box(&extracted.vertices).ok_or(Refusal::TooThin)?;
    let middle = nalgebra::center(&low.cast(), &high.cast());
    let footprint = hull.pixel_footprint(middle);
    let times = reduced::times(lattice.cell_size, footprint);
    let pixel = footprint * times as f64;
    let radius = 0.5 * (high - low).cast::<f64>().norm() / 3f64.sqrt();
    if radius < SMALLEST_RADIUS_PX * pixel {
        let radius_px = radius / pixel;
        return Err(Refusal::TooSmall { radius_px });
    }
    let cones = hull.cones();
    let reduce = |cone| (times > 1).then(|| Reduced::new(cone, times)).flatten();
    let reduced: Vec<Option<Reduced>> = cones.par_iter().map(reduce).collect();
    // A camera whose lens cannot be reduced binds as it is: without it, the surface might leave its cone.
    let contours: Vec<Contour> = cones
        .par_iter()
        .zip(&reduced)
        .map(|(cone, reduced)| Reduced::contour_or(reduced.as_ref(), cone))
        .collect();
    let shapes = shapes_of_levels(hull, lattice, &contours, pixel, parameters)?;
    for (level, shape) in LEVELS.iter().zip(&shapes) {
        let distance = farthest_from(shape, extracted);
        if distance > MOST_LOST_CELLS * f64::from(level.cells) * lattice.cell_size {
            return Err(Refusal::ThinPart { distance });
        }
    }
    let object = Volume {
        min: Point3::new(low.x.into(), low.y.into(), hull.volume().min.z),
        max: high.cast(),
    };
    let sides = shapes
        .last()
        .and_then(|finest| Sides::find(&finest.edges(), &contours, pixel, &object));
    let inputs = FairingInputs {
        contours: &contours,
        sides: sides.as_ref(),
        cell_size: lattice.cell_size,
        radius,
    };
    let (mut shape, start) = inputs.fair(shapes).ok_or(Refusal::TooThin)?;
    shape.update_normals();
    let (facts, touching) = accept::keep_hull(&mut shape, &start, &contours, times as f64)?;
    let touch = |&(vertex, contour): &(u32, usize)| {
        let point = shape.positions[vertex as usize];
        Touch {
            point,
            normal: shape.normals[vertex as usize],
            view: (point - contours[contour].camera.center()).normalize(),
        }
    };
    let touches = touching.iter().map(touch).collect();
    let solid = FairedSolid::new(&shape, sides, *lattice, hull.bounds().clone());
    Ok(Faired {
        solid,
        facts,
        touches,
        shape,
        start,
    })
}

/// The hull's mesh for each of the [`LEVELS`], with the edges that silhouettes show.
fn shapes_of_levels(
    hull: &Hull,
    lattice: &Lattice,
    contours: &[Contour],
    pixel: f64,
    parameters: &hull::Parameters,
) -> Result<Vec<Shape>, Refusal> {
    let mut shapes = Vec::new();
    for level in &LEVELS {
        let coarser = coarser(lattice, level.cells);
        let found = hull::extract(hull, &coarser, parameters).map_err(|_| Refusal::TooThin)?;
        let floor = hull.volume().min.z;
        let mut shape = Shape::new(&found.surface.mesh, floor, 0.25 * coarser.cell_size);
        certain::mark(&mut shape, contours, pixel);
        shapes.push(shape);
    }
    certain::confirm(&mut shapes);
    Ok(shapes)
}

/// How far the farthest of a hull's vertices is from a coarser surface of it, in metres.
fn farthest_from(coarser: &Shape, hull: &Mesh) -> f64 {
    let surface = mesh::Bvh::new(&Mesh {
        vertices: coarser.positions.iter().map(|p| p.cast()).collect(),
        triangles: coarser.triangles.clone(),
    });
    let asked = hull.vertices.par_iter().step_by(ASKED_OF);
    let distance = |v: &Point3<f32>| surface.closest_point(v.cast()).map(|c| c.distance);
    asked
        .filter_map(distance)
        .map(f64::from)
        .reduce(|| 0.0, f64::max)
}

/// What the meshes of all levels are faired with.
struct FairingInputs<'a> {
    contours: &'a [Contour<'a>],
    sides: Option<&'a Sides>,
    /// Edge of the hull's cells, in metres.
    cell_size: f64,
    /// The object's radius, in metres.
    radius: f64,
}

impl FairingInputs<'_> {
    /// Fairs the meshes of the [`LEVELS`], each of which begins on the surface that the one before became. Returns the
    /// last one, and where its vertices were on the hull; `None` if there is none.
    fn fair(&self, shapes: Vec<Shape>) -> Option<(Shape, Vec<Point3<f64>>)> {
        let mut coarse: Option<transfer::MovedMesh> = None;
        let mut last = None;
        for (level, mut shape) in LEVELS.iter().zip(shapes) {
            let start = shape.positions.clone();
            if let Some(sides) = self.sides {
                shape.put_on(sides, |p| {
                    let outside = |c: &Contour| c.inside_px(p).is_some_and(|px| px < -OUTSIDE_PX);
                    !self.contours.iter().any(outside)
                });
            }
            let is_first = coarse.is_none();
            // On coarse cells a relief is too small.
            let profiles = if is_first {
                Profiles::none(shape.len())
            } else {
                Profiles::of_hull(&shape, self.contours, SHARPEST * self.radius)
            };
            if let Some(coarse) = coarse.take() {
                coarse.begin(&mut shape);
            }
            self.fair_level(&mut shape, level, &profiles, is_first);
            coarse = Some(transfer::MovedMesh::new(&shape, &start));
            last = Some((shape, start));
        }
        last
    }

    /// Moves the vertices of one mesh in the rounds of its level. Those of the first level begin on the hull itself,
    /// whose facets are no edges: they settle first.
    fn fair_level(
        &self,
        shape: &mut Shape,
        level: &RefinementLevel,
        profiles: &Profiles,
        is_first: bool,
    ) {
        let mut round = Round {
            steps: level.steps,
            farthest: self.cell_size * f64::from(level.cells),
            sharpest: 0.0,
            bending: level.bending,
        };
        let mut left = level.rounds;
        if is_first {
            left -= settle(shape, self.contours, round);
        }
        round.sharpest = SHARPEST * self.radius;
        for number in 0..left {
            shape.update_normals();
            rounds::fair_once(shape, self.contours, profiles, round);
            if number + 1 < left {
                shape.smooth_tangentially();
            }
        }
    }
}

/// Moves the vertices in rounds in which all of them resist bending equally, until few of them would go farther than
/// they may. Returns how many of a level's rounds these replace.
fn settle(shape: &mut Shape, contours: &[Contour], round: Round) -> usize {
    let [least, most] = ROUNDS_TO_SETTLE;
    let profiles = Profiles::none(shape.len());
    for number in 1..=most {
        shape.update_normals();
        let held_back = rounds::fair_once(shape, contours, &profiles, round);
        shape.smooth_tangentially();
        if number >= least && held_back < SETTLED {
            break;
        }
    }
    least
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

//! Finds relief that stands in profile. Across a view the cone of a silhouette has the object's profile, and only along
//! the rays is it straight, because nothing was seen there. Where a profile bends sharply to and fro, the faired
//! surface is to bend as it does. This file moves nothing.

use super::contour::Contour;
use super::shape::Shape;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// A vertex of the hull lies on the cone whose contour is within this many pixels.
const ON_CONE_PX: f64 = 0.75;
/// Cosine between a ray and the surface's normal up to which the surface is seen in profile.
const GRAZING: f64 = 0.35;
/// A relief bends sharply to one side and to the other by turns: so often, within so many edges of the mesh to each
/// side. What bends so once is an edge, a foot or a tube.
const TURNS: usize = 3;
const EDGES: i32 = 6;
/// A cone is reached within this many pixels.
const REACHED_PX: f64 = 0.1;
/// Most steps on the way to a cone, and how far away it may be, in pixels.
const STEPS: usize = 10;
const FARTHEST_PX: f64 = 24.0;

/// For each vertex of a hull's mesh the view whose cone it lies on, if the profile there is that of a relief.
pub(super) struct Profiles(Vec<Option<u32>>);

impl Profiles {
    /// Of a mesh of so many vertices, on which no relief is looked for.
    pub(super) fn none(count: usize) -> Self {
        Self(vec![None; count])
    }

    /// Of a mesh that lies on the hull. `sharpest` is the radius in metres below which a bend is sharp.
    pub(super) fn of_hull(shape: &Shape, contours: &[Contour], sharpest: f64) -> Self {
        let edge = shape.mean_edge();
        let view = |v: usize| {
            let view = profile(shape, v, contours)?;
            let turns = turns(shape, v, &contours[view], edge, sharpest);
            (turns >= TURNS).then_some(view as u32)
        };
        Self((0..shape.len()).into_par_iter().map(view).collect())
    }

    /// For each vertex how high over its tangent plane each neighbour would lie on its view's cone, in metres; nothing
    /// where there is no relief.
    pub(super) fn heights(&self, shape: &Shape, contours: &[Contour]) -> Vec<Vec<f64>> {
        let views = self.0.par_iter().enumerate();
        let of = |(v, view): (usize, &Option<u32>)| {
            let contour = &contours[(*view)? as usize];
            heights(shape, v, contour)
        };
        views.map(|view| of(view).unwrap_or_default()).collect()
    }
}

/// The view on whose cone a vertex of the hull lies and which sees it in profile.
fn profile(shape: &Shape, v: usize, contours: &[Contour]) -> Option<usize> {
    if !shape.moves(v) {
        return None;
    }
    let (p, normal) = (shape.positions[v], shape.normals[v]);
    let off = |contour: &Contour| {
        let ray = (p - contour.camera.center()).normalize();
        let off = contour.offset(p)?.inside_px.abs();
        (ray.dot(&normal).abs() < GRAZING && off < ON_CONE_PX).then_some(off)
    };
    let views = contours.iter().enumerate();
    let views = views.filter_map(|(i, contour)| Some((off(contour)?, i)));
    views
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, view)| view)
}

/// How often a view's profile turns from a sharp bend to one side to a sharp bend to the other, around a vertex.
fn turns(shape: &Shape, v: usize, contour: &Contour, edge: f64, sharpest: f64) -> usize {
    let (p, normal) = (shape.positions[v], shape.normals[v]);
    let across = normal.cross(&(p - contour.camera.center()));
    let Some(step) = across.try_normalize(1e-12).map(|across| across * edge) else {
        return 0;
    };
    let known = |side: i32| {
        let places = (0..=EDGES).map(move |i| p + step * f64::from(side * i));
        places.map_while(|p| height(p, normal, contour))
    };
    let mut heights: Vec<f64> = known(-1).skip(1).collect();
    heights.reverse();
    heights.extend(known(1));
    // A bend along one line alone is twice the mean of it and none across.
    let bend = |h: &[f64]| 0.5 * (h[0] + h[2] - 2.0 * h[1]) / edge.powi(2);
    let bends = heights.windows(3).map(bend);
    let sharp: Vec<f64> = bends.filter(|bend| bend.abs() * sharpest > 1.0).collect();
    sharp
        .windows(2)
        .filter(|pair| pair[0] * pair[1] < 0.0)
        .count()
}

/// How high over a vertex' tangent plane each neighbour would lie if all of them lay on a view's cone, in metres;
/// `None` where the cone is not near.
fn heights(shape: &Shape, v: usize, contour: &Contour) -> Option<Vec<f64>> {
    let (p, normal) = (shape.positions[v], shape.directions[v]);
    let own = height(p, normal, contour)?;
    let of = |j: &u32| {
        let way = shape.positions[*j as usize] - p;
        let along = way - normal * normal.dot(&way);
        height(p + normal * own + along, normal, contour)
    };
    shape.around(v).iter().map(of).collect()
}

/// How far from a point a view's cone is along a direction, in metres.
fn height(from: Point3<f64>, direction: Vector3<f64>, contour: &Contour) -> Option<f64> {
    let pixel = contour.camera.pixel_footprint(from);
    let mut height = 0.0_f64;
    for _ in 0..STEPS {
        let inside_px = contour.inside_px(from + direction * height)?;
        if inside_px.abs() < REACHED_PX {
            return Some(height);
        }
        height += inside_px * pixel;
        if height.abs() > FARTHEST_PX * pixel {
            return None;
        }
    }
    None
}

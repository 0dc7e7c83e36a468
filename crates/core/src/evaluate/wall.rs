//! Measures how thick walls are: the truth's wall between two opposite points, and the model's wall at the same place.

use super::Parameters;
use super::sample::Sample;
use super::surface::Surface;
use nalgebra::{Point3, Vector3};

/// Faces whose normals are farther than this from opposite do not bound one wall: the cosine of 45°.
const OPPOSITE: f64 = 0.7;
/// Rays start this far past a surface, in metres.
const STEP: f64 = 1e-6;

/// A wall of the truth and what the model has in its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wall {
    /// The truth's thickness in metres.
    pub thickness: f64,
    /// The model's thickness in metres on the same line; `None` where the model has no wall there.
    pub found: Option<f64>,
}

/// The wall behind a point of the truth's surface, if it is thinner than [`Parameters::wall_mm`] and its two
/// faces lie about opposite each other.
pub(super) fn behind(
    truth: &Surface,
    model: &Surface,
    sample: &Sample,
    parameters: &Parameters,
) -> Option<Wall> {
    let inward = -truth.face_normal(sample.triangle);
    let exit = truth.cast(sample.point + inward * STEP, inward)?;
    let thickness = exit.distance + STEP;
    if thickness > parameters.wall_mm / 1e3 || exit.cosine < OPPOSITE {
        return None;
    }
    let middle = sample.point + inward * (thickness / 2.0);
    Some(Wall {
        thickness,
        found: thickness_near(model, middle, inward, parameters.wall_mm / 1e3),
    })
}

/// The thickness, along a line, of the solid that `middle` lies in; where it lies in none, of the nearest one
/// that begins within `reach`.
fn thickness_near(
    model: &Surface,
    middle: Point3<f64>,
    line: Vector3<f64>,
    reach: f64,
) -> Option<f64> {
    let both = [line, -line].map(|along| (along, model.cast(middle, along)));
    if let [(_, Some(ahead)), (_, Some(back))] = both
        && ahead.cosine > 0.0
        && back.cosine > 0.0
    {
        return Some(ahead.distance + back.distance);
    }
    let entries = both
        .into_iter()
        .filter_map(|(along, crossing)| Some((along, crossing?)));
    let entries = entries.filter(|(_, entry)| entry.cosine < 0.0 && entry.distance <= reach);
    let (along, entry) = entries.min_by(|a, b| a.1.distance.total_cmp(&b.1.distance))?;
    let inside = middle + along * (entry.distance + STEP);
    let exit = model.cast(inside, along)?;
    (exit.cosine > 0.0).then_some(exit.distance + STEP)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::sample::sample;
    use crate::mesh::{Mesh, shapes};

    fn slab(half_thickness: f32, shift: f32) -> Mesh {
        let mut slab = shapes::cube(0.05);
        for v in &mut slab.vertices {
            v.z = v.z.signum() * half_thickness + shift;
        }
        slab
    }

    fn walls(model: &Mesh) -> Vec<Wall> {
        let truth = slab(0.0015, 0.0);
        let surfaces = (Surface::new(&truth), Surface::new(model));
        let parameters = Parameters::default();
        let samples = sample(&truth, 400);
        let behind = |s| behind(&surfaces.0, &surfaces.1, s, &parameters);
        samples.iter().filter_map(behind).collect()
    }

    #[test]
    fn a_slab_is_as_thick_as_it_is_also_when_it_has_moved() {
        for shift in [0.0, 0.001, 0.004] {
            let walls = walls(&slab(0.002, shift));
            assert!(walls.len() > 350);
            for wall in walls {
                assert!((wall.thickness - 0.003).abs() < 1e-6);
                assert!((wall.found.unwrap() - 0.004).abs() < 2e-6, "{wall:?}");
            }
        }
    }

    #[test]
    fn a_wall_that_is_not_there_is_lost() {
        assert!(walls(&slab(0.002, 0.1)).iter().all(|w| w.found.is_none()));
    }
}

//! Tests that the atlas of a whole model wastes little: of a cup's most is covered by triangles, and no chart has only
//! a few texels.

use nalgebra::Vector2;
use scand_core::reconstruct::Model;
use std::collections::BTreeMap;

/// The charts' areas in texels: triangles belong to one if they share a corner's place in the atlas. Triangles that
/// take their colour at one place have none.
fn areas_of_charts(model: &Model) -> Vec<f64> {
    let texture = model.texture.as_ref().unwrap();
    let count = model.mesh.triangles.len();
    let mut parents: Vec<usize> = (0..count).collect();
    let mut first: BTreeMap<(u32, [u32; 2]), usize> = BTreeMap::new();
    for triangle in 0..count {
        for (vertex, uv) in corners(model, triangle) {
            let other = *first
                .entry((vertex, uv.map(f32::to_bits)))
                .or_insert(triangle);
            let (own, other) = (root(&mut parents, triangle), root(&mut parents, other));
            parents[own.max(other)] = own.min(other);
        }
    }
    let size = [texture.atlas.width(), texture.atlas.height()].map(|side| side as f64);
    let mut areas = vec![0.0; count];
    for (triangle, places) in texture.corner_uv.iter().enumerate() {
        let [a, b, c] =
            places.map(|uv| Vector2::new(f64::from(uv[0]) * size[0], f64::from(uv[1]) * size[1]));
        areas[root(&mut parents, triangle)] += 0.5 * (b - a).perp(&(c - a)).abs();
    }
    areas.retain(|&area| area > 0.0);
    areas
}

/// The vertices of a triangle's corners, and where these are in the atlas.
fn corners(model: &Model, triangle: usize) -> impl Iterator<Item = (u32, [f32; 2])> {
    let texture = model.texture.as_ref().unwrap();
    let vertices = model.mesh.triangles[triangle];
    vertices.into_iter().zip(texture.corner_uv[triangle])
}

fn root(parents: &mut [usize], mut of: usize) -> usize {
    while parents[of] != of {
        parents[of] = parents[parents[of]];
        of = parents[of];
    }
    of
}

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;
    use scand_core::reconstruct::{NoProgress, Parameters, reconstruct};
    use scand_lab::{Options, Shape, Simulation};

    #[test]
    fn the_atlas_of_a_cup_is_used_and_has_no_specks() {
        let options = Options {
            spacing_mm: 1.2,
            width: 1280,
            height: 960,
            ..Options::small(Shape::Cup)
        };
        let scene = Simulation::new(options).unwrap().scene(0);
        let found = reconstruct(&scene, &Parameters::default(), &NoProgress).unwrap();
        let used = found.model.texture.as_ref().unwrap().used();
        let areas = areas_of_charts(&found.model);
        let least = areas.iter().copied().fold(f64::INFINITY, f64::min);
        println!(
            "shown: {used:.3} of the atlas is used by {} charts, the smallest has {least:.0} texels",
            areas.len()
        );
        assert!(used >= 0.65, "{used}");
        assert!(areas.len() > 10 && least > 10.0, "{areas:?}");
    }
}

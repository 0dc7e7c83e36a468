//! Levels of detail: each level has a quarter of the vertices of the one before, by the simplification of `scand replay
//! --vertices`, and a new texture for its surface.

use super::bake::bake;
use crate::mesh::{Simplified, SimplifyError, mean_departures, simplify, vertex_normals};
use crate::reconstruct::Model;

/// What is left of the vertices at each level.
const SHARE: usize = 4;

/// The model at a level: 0 as it is, each further one with a quarter of the vertices, and a texture whose texels are
/// twice as long. No vertex moves: those that are left keep their provenance. Their expected errors include how far the
/// surface around them is from the model's.
///
/// # Errors
/// If the surface is not watertight.
pub fn level_of_detail(model: &Model, level: u32) -> Result<Model, SimplifyError> {
    if level == 0 {
        return Ok(model.clone());
    }
    let share = SHARE.saturating_pow(level);
    let Simplified { mesh, sources } = simplify(&model.mesh, model.mesh.vertices.len() / share)?;
    let pick = || sources.iter().map(|&v| v as usize);
    let departures = mean_departures(&mesh, &model.mesh.vertices);
    let texture = model.texture.as_ref();
    let texture = texture.map(|texture| {
        let mut baked = bake(
            &model.mesh,
            texture,
            &mesh,
            f64::from(1_u32 << level.min(16)),
        );
        baked.vertex_colors = pick().map(|v| texture.vertex_colors[v]).collect();
        baked
    });
    Ok(Model {
        normals: vertex_normals(&mesh),
        provenance: pick().map(|v| model.provenance[v]).collect(),
        expected_error: pick()
            .zip(departures)
            .map(|(v, departure)| model.expected_error[v].hypot(departure))
            .collect(),
        captures: match model.captures.is_empty() {
            true => Vec::new(),
            false => pick().map(|v| model.captures[v]).collect(),
        },
        texture,
        mesh,
    })
}

#[cfg(test)]
mod tests {
    use super::super::testing::painted_ball;
    use super::*;
    use crate::mesh::check;

    #[test]
    fn each_level_has_a_quarter_of_the_vertices_and_the_colours_of_the_surface() {
        let ball = painted_ball();
        let all = ball.mesh.vertices.len();
        for (level, share) in [(0, 1), (1, 4), (2, 16)] {
            let less = level_of_detail(&ball, level).unwrap();
            assert_eq!(less.mesh.vertices.len(), all / share);
            assert!(check(&less.mesh).is_watertight());
            let texture = less.texture.unwrap();
            assert_eq!(texture.corner_uv.len(), less.mesh.triangles.len());
            // A triangle's middle has the colour that tells where it is.
            for (t, uv) in texture.corner_uv.iter().enumerate() {
                let middle = |i: usize| uv.iter().map(|uv| uv[i]).sum::<f32>() / 3.0;
                let (atlas, place) = (&texture.atlas, [middle(0), middle(1)]);
                let x = (place[0] * atlas.width() as f32) as usize;
                let y = (place[1] * atlas.height() as f32) as usize;
                let color = atlas.row(y)[x];
                let corners = less.mesh.corners(t);
                for axis in 0..3 {
                    let at = corners.iter().map(|p| p.coords[axis]).sum::<f32>() / 3.0;
                    let at = if axis == 2 { at - 0.1 } else { at };
                    let expected = 128.0 + at / 0.05 * 120.0;
                    let off = (f32::from(color[axis]) - expected).abs();
                    assert!(
                        off < 10.0 + 20.0 * level as f32,
                        "level {level}, triangle {t}: {color:?}, {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn what_is_known_of_a_vertex_stays_with_it() {
        let ball = painted_ball();
        let less = level_of_detail(&ball, 1).unwrap();
        for (v, vertex) in less.mesh.vertices.iter().enumerate() {
            let before = ball.mesh.vertices.iter().position(|p| p == vertex).unwrap();
            assert_eq!(less.captures[v], ball.captures[before]);
            assert_eq!(less.provenance[v], ball.provenance[before]);
            assert!(less.expected_error[v] >= ball.expected_error[before]);
        }
    }

    #[test]
    fn a_level_states_how_far_it_is_from_the_model() {
        let mut ball = painted_ball();
        ball.expected_error.fill(0.0);
        let less = level_of_detail(&ball, 1).unwrap();
        let sum: f32 = less.expected_error.iter().sum();
        let mean = sum / less.expected_error.len() as f32;
        // Flat triangles of some 15 mm in a ball of 50 mm radius.
        assert!((1e-4..2e-3).contains(&mean), "{mean}");
    }

    #[test]
    fn an_open_surface_is_refused() {
        let mut ball = painted_ball();
        ball.mesh.triangles.pop();
        assert!(level_of_detail(&ball, 1).is_err());
    }
}

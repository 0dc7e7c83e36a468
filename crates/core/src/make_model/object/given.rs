//! Reads poses that a person gives, instead of having them found: a JSON file whose member `rig_from_object` has a 4 x
//! 4 matrix for each capture, in the order of their triggers.

use nalgebra::{Isometry3, Matrix3, Matrix4, Rotation3, Translation3, UnitQuaternion};
use serde::Deserialize;

/// How far a matrix may be from a rotation.
const TOLERANCE: f64 = 1e-3;

#[derive(Deserialize)]
struct File {
    rig_from_object: Vec<[[f64; 4]; 4]>,
}

/// The poses in a file's text.
///
/// # Errors
/// If it is no such file, or a matrix is no motion: in words for a person.
pub fn read_poses(text: &str) -> Result<Vec<Isometry3<f64>>, String> {
    let file: File = serde_json::from_str(text).map_err(|e| {
        format!("{e}; expected {{\"rig_from_object\": […]}} with a 4 x 4 matrix for each capture")
    })?;
    let poses = file.rig_from_object.iter().enumerate();
    poses
        .map(|(i, rows)| {
            pose(rows).ok_or_else(|| {
                format!("rig_from_object[{i}] is no rotation and translation in metres: {rows:?}")
            })
        })
        .collect()
}

fn pose(rows: &[[f64; 4]; 4]) -> Option<Isometry3<f64>> {
    let matrix = Matrix4::from_fn(|i, j| rows[i][j]);
    let turn: Matrix3<f64> = matrix.fixed_view::<3, 3>(0, 0).into_owned();
    let is_turn = (turn * turn.transpose() - Matrix3::identity()).norm() < TOLERANCE
        && (turn.determinant() - 1.0).abs() < TOLERANCE;
    let last = matrix.row(3).iter().copied().eq([0.0, 0.0, 0.0, 1.0]);
    let far = (0..3).any(|i| matrix[(i, 3)].abs() > 10.0);
    if !is_turn || !last || far {
        return None;
    }
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(turn));
    let shift = Translation3::new(matrix[(0, 3)], matrix[(1, 3)], matrix[(2, 3)]);
    Some(Isometry3::from_parts(shift, turn))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_motion_is_read_and_anything_else_is_refused() {
        let with = |first: &str| {
            format!(
                r#"{{"rig_from_object": [[[{first},0,0,0.1],[0,1,0,0],[0,0,1,0],[0,0,0,1]]], "seed": 3}}"#
            )
        };
        let poses = read_poses(&with("1")).unwrap();
        assert_eq!(poses[0].translation.vector.x, 0.1);
        assert!(read_poses(&with("-1")).is_err());
        assert!(read_poses(&with("1.1")).is_err());
        for other in ["{}", "[]", "3", "", "{\"rig_from_object\": [[1, 2]]}"] {
            let error = read_poses(other).unwrap_err();
            assert!(error.contains("expected {\"rig_from_object\""), "{error}");
        }
    }
}

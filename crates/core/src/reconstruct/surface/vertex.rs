//! Places a sheet's vertex: at the point that best fits the tangent planes of its crossings.

use super::Constraint;
use super::edges::Crossing;
use nalgebra::{Matrix3, Point3, Vector3};

/// Weight of the crossings' mean against their tangent planes: keeps the vertex in place along directions
/// that the planes leave open, without pulling it visibly off an edge.
const MEAN_WEIGHT: f32 = 0.05;

/// Minimises the squared distances to the tangent planes (the quadratic error function of dual contouring),
/// kept within the cell at `min`. Also tells the constraint that most crossings lie on.
pub(super) fn place<'a>(
    crossings: impl Iterator<Item = &'a Crossing> + Clone,
    min: Point3<f64>,
    cell_size: f64,
) -> (Point3<f32>, Constraint) {
    // Local coordinates keep f32 exact enough far from the origin.
    let local = |c: &Crossing| ((c.point - min) / cell_size).cast::<f32>();
    let count = crossings.clone().count() as f32;
    let mean = crossings
        .clone()
        .fold(Vector3::zeros(), |sum, c| sum + local(c))
        / count;
    let mut matrix = Matrix3::from_diagonal_element(MEAN_WEIGHT * count);
    let mut right = Vector3::zeros();
    for crossing in crossings.clone() {
        let n = crossing.normal;
        matrix += n * n.transpose();
        right += n * n.dot(&(local(crossing) - mean));
    }
    // Positive definite by MEAN_WEIGHT, so it can be solved.
    let offset = matrix
        .cholesky()
        .map_or_else(Vector3::zeros, |c| c.solve(&right));
    let inside = (mean + offset).map(|v| v.clamp(0.0, 1.0));
    let position = min + inside.cast::<f64>() * cell_size;
    (
        position.cast(),
        most_frequent(crossings.map(|c| c.constraint)),
    )
}

/// The most frequent constraint; the smallest of those that are equally frequent.
fn most_frequent(constraints: impl Iterator<Item = Constraint> + Clone) -> Constraint {
    let count = |c: Constraint| constraints.clone().filter(|&other| other == c).count();
    constraints
        .clone()
        .max_by_key(|&c| (count(c), std::cmp::Reverse(c)))
        .unwrap_or_default()
}

//! What one picture of a plane determines: its homography, focal lengths from several (Zhang, "A flexible new
//! technique for camera calibration", 2000, section 3.1, with square pixels and a known centre), and the plane's
//! pose.

use super::adjust::moved;
use super::lens::Lens;
use nalgebra::{
    DMatrix, Isometry3, Matrix2x6, Matrix3, Matrix6, Point2, Point3, Rotation3, Translation3,
    UnitQuaternion, Vector3, Vector6,
};

/// Points of a plane (z = 0) and their pixels.
pub(super) type Pairs = [(Point3<f64>, Point2<f64>)];

/// Shifts and scales points so that they are around 0 with a mean distance of √2 (Hartley).
fn normalizer(points: impl Iterator<Item = Point2<f64>> + Clone) -> Matrix3<f64> {
    let n = points.clone().count().max(1) as f64;
    let mean = points
        .clone()
        .map(|p| p.coords)
        .sum::<nalgebra::Vector2<f64>>()
        / n;
    let spread = points.map(|p| (p.coords - mean).norm()).sum::<f64>() / n;
    let s = std::f64::consts::SQRT_2 / spread.max(1e-12);
    Matrix3::new(s, 0.0, -s * mean.x, 0.0, s, -s * mean.y, 0.0, 0.0, 1.0)
}

/// The homography from a plane's x and y to image points, by the normalised direct linear transform (Hartley and
/// Zisserman, algorithm 4.2); `None` for fewer than four points or points in a line.
pub(super) fn homography(pairs: &[(Point2<f64>, Point2<f64>)]) -> Option<Matrix3<f64>> {
    if pairs.len() < 4 {
        return None;
    }
    let from = normalizer(pairs.iter().map(|p| p.0));
    let to = normalizer(pairs.iter().map(|p| p.1));
    let mut rows = DMatrix::zeros(9, 9);
    for (a, b) in pairs {
        let (a, b) = (from * a.to_homogeneous(), to * b.to_homogeneous());
        let zero = Vector3::zeros();
        for (first, second, third) in [(a, zero, -b.x * a), (zero, a, -b.y * a)] {
            let row =
                DMatrix::from_iterator(1, 9, first.iter().chain(&second).chain(&third).copied());
            rows += row.transpose() * row;
        }
    }
    let eigen = rows.symmetric_eigen();
    let mut order: Vec<usize> = (0..9).collect();
    order.sort_by(|&i, &j| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[j]));
    if eigen.eigenvalues[order[1]] < 1e-10 * eigen.eigenvalues[order[8]] {
        return None;
    }
    let h = Matrix3::from_row_iterator(eigen.eigenvectors.column(order[0]).iter().copied());
    let h = to.try_inverse()? * h * from;
    (h.iter().all(|v| v.is_finite()) && h.determinant().abs() > 1e-300).then(|| h / h.norm())
}

/// Focal length in pixels that makes the axes of all planes perpendicular and equally long, by least squares in
/// 1/f²; `homographies` map to pixels less the principal point. `None` where the planes face the camera or are too
/// few to tell.
pub(super) fn focal_length(homographies: &[Matrix3<f64>]) -> Option<f64> {
    let (mut aa, mut ab) = (0.0, 0.0);
    for h in homographies {
        // Pixels scaled, so that both parts of a constraint are of one size.
        let scale = 1e-3;
        let column = |i: usize| Vector3::new(h[(0, i)] * scale, h[(1, i)] * scale, h[(2, i)]);
        let (h1, h2) = (column(0), column(1));
        let unit = 1.0 / h1.norm_squared().max(h2.norm_squared()).max(1e-300);
        let constraints = [
            (h1.x * h2.x + h1.y * h2.y, h1.z * h2.z),
            (
                h1.x * h1.x + h1.y * h1.y - h2.x * h2.x - h2.y * h2.y,
                h1.z * h1.z - h2.z * h2.z,
            ),
        ];
        for (a, b) in constraints {
            aa += a * a * unit * unit;
            ab += a * b * unit * unit;
        }
    }
    let inverse_squared = -ab / aa.max(1e-300);
    let focal = 1e3 / inverse_squared.sqrt();
    (inverse_squared > 0.0 && focal.is_finite()).then_some(focal)
}

/// A plane's pose in the camera's frame and the root mean square of its points' residuals in pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct PlanePose {
    pub camera_from_plane: Isometry3<f64>,
    pub rms_px: f64,
}

/// The pose of a plane of known points: from its homography, and from the pose that looks nearly the same (the
/// plane tilted the other way), each refined, the better of the two.
pub(super) fn pose(lens: &Lens, pairs: &Pairs) -> Option<PlanePose> {
    let directions = lens.unproject(pairs.iter().map(|(_, pixel)| *pixel));
    let normalized: Vec<_> = pairs
        .iter()
        .zip(directions)
        .map(|((p, _), direction)| (p.xy(), Point2::from(direction)))
        .collect();
    let first = refined(lens, pairs, &from_homography(&homography(&normalized)?)?)?;
    let other = refined(lens, pairs, &tilted_back(&first.camera_from_plane, pairs));
    match other {
        Some(other) if other.rms_px < first.rms_px => Some(other),
        _ => Some(first),
    }
}

/// The pose in a homography to normalised image points, in front of the camera.
fn from_homography(h: &Matrix3<f64>) -> Option<Isometry3<f64>> {
    let scale = 2.0 / (h.column(0).norm() + h.column(1).norm());
    let scale = if h[(2, 2)] < 0.0 { -scale } else { scale };
    let (x, y, t) = (
        h.column(0) * scale,
        h.column(1) * scale,
        h.column(2) * scale,
    );
    let svd = Matrix3::from_columns(&[x, y, x.cross(&y)]).svd(true, true);
    let rotation = svd.u? * svd.v_t?;
    let rotation = Rotation3::from_matrix_unchecked(rotation);
    let sound = t.z > 0.0 && rotation.matrix().determinant() > 0.0;
    sound.then(|| {
        Isometry3::from_parts(
            Translation3::from(t),
            UnitQuaternion::from_rotation_matrix(&rotation),
        )
    })
}

/// The plane mirrored at the plane across the line of sight to its middle, which is what a weak perspective cannot
/// tell from it.
fn tilted_back(pose: &Isometry3<f64>, pairs: &Pairs) -> Isometry3<f64> {
    let n = pairs.len().max(1) as f64;
    let middle = Point3::from(pairs.iter().map(|(p, _)| p.coords).sum::<Vector3<f64>>() / n);
    let seen = pose * middle;
    let sight = seen.coords.normalize();
    let normal = pose.rotation * Vector3::z();
    let mirrored = 2.0 * sight.dot(&normal) * sight - normal;
    let turn = UnitQuaternion::rotation_between(&normal, &mirrored).unwrap_or_default();
    let rotation = turn * pose.rotation;
    let translation = seen.coords - rotation * middle.coords;
    Isometry3::from_parts(Translation3::from(translation), rotation)
}

/// Gauss–Newton on a pose alone, damped.
pub(super) fn refined(lens: &Lens, pairs: &Pairs, start: &Isometry3<f64>) -> Option<PlanePose> {
    let mut pose = *start;
    let mut cost = squared(lens, pairs, &pose)?;
    let mut lambda = 1e-3;
    for _ in 0..60 {
        let (h, g) = normal(lens, pairs, &pose)?;
        let mut damped = h;
        for i in 0..6 {
            damped[(i, i)] *= 1.0 + lambda;
        }
        let Some(factor) = damped.cholesky() else {
            break;
        };
        let next = moved(&pose, &-factor.solve(&g));
        match squared(lens, pairs, &next) {
            Some(better) if better < cost => {
                let gained = (cost - better) / cost;
                (pose, cost, lambda) = (next, better, lambda * 0.2);
                if gained < 1e-10 {
                    break;
                }
            }
            _ if lambda > 1e8 => break,
            _ => lambda *= 10.0,
        }
    }
    Some(PlanePose {
        camera_from_plane: pose,
        rms_px: (cost / pairs.len() as f64).sqrt(),
    })
}

fn squared(lens: &Lens, pairs: &Pairs, pose: &Isometry3<f64>) -> Option<f64> {
    pairs.iter().try_fold(0.0, |sum, (p, pixel)| {
        let seen = lens.project((pose * p).coords)?;
        Some(sum + (seen - pixel).norm_squared())
    })
}

fn normal(
    lens: &Lens,
    pairs: &Pairs,
    pose: &Isometry3<f64>,
) -> Option<(Matrix6<f64>, Vector6<f64>)> {
    let (mut h, mut g) = (Matrix6::zeros(), Vector6::zeros());
    for (p, pixel) in pairs {
        let turned = pose.rotation * p.coords;
        let (seen, _, by_point) = lens.derive(turned + pose.translation.vector)?;
        let mut j = Matrix2x6::zeros();
        let by_rotation = by_point * -turned.cross_matrix();
        j.fixed_view_mut::<2, 3>(0, 0).copy_from(&by_rotation);
        j.fixed_view_mut::<2, 3>(0, 3).copy_from(&by_point);
        h += j.transpose() * j;
        g += j.transpose() * (seen - pixel);
    }
    Some((h, g))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn board() -> Vec<Point3<f64>> {
        let at = |i: usize| Point3::new((i % 9) as f64 * 0.025, (i / 9) as f64 * 0.025, 0.0);
        (0..54).map(at).collect()
    }

    fn looked_at(tilt: Vector3<f64>, distance: f64) -> Isometry3<f64> {
        let middle = Vector3::new(0.1, 0.0625, 0.0);
        let rotation = UnitQuaternion::from_scaled_axis(tilt);
        let translation = Vector3::new(0.02, -0.01, distance) - rotation * middle;
        Isometry3::from_parts(Translation3::from(translation), rotation)
    }

    proptest! {
        #[test]
        fn poses_are_found_again(
            x in -0.9..0.9f64, y in -0.9..0.9f64, z in -3.0..3.0f64, distance in 0.3..2.0f64, k1 in -0.2..0.2f64,
        ) {
            let mut lens = Lens::pinhole([640, 480], 700.0);
            lens.values[4] = k1;
            let truth = looked_at(Vector3::new(x, y, 0.0), distance);
            let truth = truth * Isometry3::rotation(Vector3::new(0.0, 0.0, z));
            let pairs: Vec<_> = board().into_iter()
                .filter_map(|p| Some((p, lens.project((truth * p).coords)?))).collect();
            prop_assume!(pairs.iter().all(|(_, px)| px.x.abs() < 2000.0 && px.y.abs() < 2000.0));
            prop_assume!(pairs.iter().all(|(p, _)| (truth * p).z > 0.05));
            let found = pose(&lens, &pairs).unwrap();
            prop_assert!(found.rms_px < 1e-6, "{found:?}");
            prop_assert!(found.camera_from_plane.rotation.angle_to(&truth.rotation) < 1e-6);
        }
    }

    #[test]
    fn a_focal_length_is_found_and_frontal_planes_tell_none() {
        let lens = Lens::pinhole([640, 480], 700.0);
        let of = |tilt: Vector3<f64>| {
            let pose = looked_at(tilt, 0.6);
            let center = nalgebra::Vector2::new(lens.values[2], lens.values[3]);
            let pairs: Vec<_> = board()
                .iter()
                .map(|p| (p.xy(), lens.project((pose * p).coords).unwrap() - center))
                .collect();
            homography(&pairs).unwrap()
        };
        let tilted = [
            of(Vector3::new(0.5, 0.0, 0.0)),
            of(Vector3::new(0.1, -0.6, 0.2)),
        ];
        assert!((focal_length(&tilted).unwrap() - 700.0).abs() < 1e-3);
        let frontal = [of(Vector3::zeros()); 3];
        assert!(focal_length(&frontal).is_none_or(|f| !(10.0..1e5).contains(&f)));
    }
}

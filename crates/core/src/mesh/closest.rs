//! Finds the point of a triangle that is nearest to another point.

use nalgebra::Point3;

/// The point of triangle a, b, c nearest to `p`: finds the feature whose Voronoi region `p` lies in
/// (Ericson, "Real-Time Collision Detection", 2005, section 5.1.5).
pub fn closest_on_triangle(p: Point3<f64>, [a, b, c]: [Point3<f64>; 3]) -> Point3<f64> {
    let (ab, ac) = (b - a, c - a);
    let ap = p - a;
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 && d1 > d3 {
        return a + ab * (d1 / (d1 - d3));
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 && d2 > d6 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    let (along_b, along_c) = (d4 - d3, d5 - d6);
    if va <= 0.0 && along_b >= 0.0 && along_c >= 0.0 && along_b + along_c > 0.0 {
        return b + (c - b) * (along_b / (along_b + along_c));
    }
    let sum = va + vb + vc;
    if sum > 0.0 {
        return a + ab * (vb / sum) + ac * (vc / sum);
    }
    // No area and no length: rounding let it fall through every test.
    a
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_point_of_a_fine_grid_on_the_triangle_is_nearer(
            corners in prop::array::uniform3(prop::array::uniform3(-1.0..1.0f64)),
            p in prop::array::uniform3(-2.0..2.0f64),
        ) {
            let [a, b, c] = corners.map(Point3::from);
            let p = Point3::from(p);
            let distance = (closest_on_triangle(p, [a, b, c]) - p).norm();
            let mut nearest = f64::INFINITY;
            for i in 0..=40 {
                for j in 0..=40 - i {
                    let (u, v) = (f64::from(i) / 40.0, f64::from(j) / 40.0);
                    nearest = nearest.min((a + (b - a) * u + (c - a) * v - p).norm());
                }
            }
            prop_assert!(distance <= nearest + 1e-9);
            prop_assert!(nearest <= distance + 0.15, "{nearest} and {distance}");
        }
    }

    #[test]
    fn a_triangle_without_area_is_a_segment_or_a_point() {
        let [a, b] = [Point3::new(0.0, 0.0, 0.0), Point3::new(2.0, 0.0, 0.0)];
        let p = Point3::new(0.5, 3.0, 0.0);
        for corners in [[a, b, b], [a, a, b], [a, b, a], [b, a, a]] {
            assert!((closest_on_triangle(p, corners) - Point3::new(0.5, 0.0, 0.0)).norm() < 1e-12);
        }
        assert_eq!(closest_on_triangle(p, [a, a, a]), a);
    }
}

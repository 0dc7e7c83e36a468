//! Points as binary PLY: x, y, z, red, green, blue.

use super::points::Point;

/// Points as the bytes of a .ply.
pub(super) fn encode(points: &[Point]) -> Vec<u8> {
    let header = format!(
        "ply\nformat binary_little_endian 1.0\ncomment frame rig, z up, metres\nelement vertex {}\n\
         property float x\nproperty float y\nproperty float z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n",
        points.len()
    );
    let mut bytes = header.into_bytes();
    for point in points {
        let position = point.position.cast::<f32>();
        bytes.extend(position.coords.iter().flat_map(|c| c.to_le_bytes()));
        bytes.extend(point.color);
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::super::points;
    use super::super::testing::{ball, two_views};

    #[test]
    fn every_point_has_fifteen_bytes() {
        let points = points(&ball(), &two_views());
        let bytes = super::encode(&points);
        let header = bytes
            .windows(11)
            .position(|w| w == b"end_header\n")
            .unwrap()
            + 11;
        assert_eq!(bytes.len() - header, 15 * points.len());
    }
}

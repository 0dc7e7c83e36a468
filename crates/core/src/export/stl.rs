//! Binary STL: millimetres, z up, as slicers read it. The format has neither colours nor a unit of its own.

use super::Error;
use crate::reconstruct::Model;

/// Bytes of the header.
const HEADER: usize = 80;

/// A model as the bytes of a binary .stl.
///
/// # Errors
/// If it has more triangles than the format can count.
pub(super) fn encode(model: &Model) -> Result<Vec<u8>, Error> {
    let mesh = &model.mesh;
    let count = u32::try_from(mesh.triangles.len()).map_err(|_| Error::TooLarge {
        format: "STL",
        what: "it has more than 4 billion triangles",
    })?;
    // A header that began with "solid" would be taken for a text.
    let mut bytes = b"binary STL of scand; millimetres, z up".to_vec();
    bytes.resize(HEADER, b' ');
    bytes.extend(count.to_le_bytes());
    for t in 0..mesh.triangles.len() {
        let corners = mesh.corners(t).map(|p| p.coords * 1000.0);
        let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
        let normal = normal.try_normalize(0.0).unwrap_or_default();
        for vector in [normal, corners[0], corners[1], corners[2]] {
            bytes.extend(vector.iter().flat_map(|c| c.to_le_bytes()));
        }
        bytes.extend([0, 0]);
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::super::testing::textured_square;
    use super::*;

    #[test]
    fn triangles_stand_in_millimetres_with_their_normals() {
        let bytes = encode(&textured_square()).unwrap();
        assert_eq!(bytes.len(), 84 + 2 * 50);
        assert!(!bytes.starts_with(b"solid"));
        let float = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        assert_eq!([84, 88, 92].map(float), [0.0, 0.0, 1.0], "the normal");
        assert_eq!(
            [108, 112, 116].map(float),
            [1000.0, 0.0, 250.0],
            "its second corner"
        );
    }
}

//! Trial hulls, to find the camera that causes an error: from other cameras than those of the model, or from cameras at
//! other places. They are coarser than the model.

use crate::calibration::Camera;
use crate::mesh::Mesh;
use crate::reconstruct::hull::{self, Cone, Hull};
use crate::reconstruct::{Reconstruction, Scene};

/// Cells along the object's diagonal.
const RESOLUTION: f64 = 120.0;

/// The hull of the silhouettes for which `camera` gives a camera; `None` where there is none.
pub(super) fn trial_hull<'a>(
    scene: &'a Scene,
    made: &'a Reconstruction,
    camera: impl Fn(usize) -> Option<&'a Camera>,
) -> Option<Mesh> {
    let silhouettes = made.silhouettes.iter().enumerate();
    let cones = silhouettes
        .filter_map(|(i, silhouette)| {
            Some(Cone::with_unknown(
                camera(i)?,
                &silhouette.level,
                silhouette.unknown.as_ref(),
            ))
        })
        .collect();
    let parameters = hull::Parameters {
        resolution: RESOLUTION,
        ..hull::Parameters::default()
    };
    let hull = Hull::new(cones, scene.volume, parameters.least_views);
    let lattice = hull::lattice(&hull, &parameters).ok()?;
    let extracted = hull::extract(&hull, &lattice, &parameters).ok()?;
    Some(extracted.surface.mesh)
}

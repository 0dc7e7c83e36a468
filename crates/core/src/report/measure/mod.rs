//! The figures that a verdict is based on, for each camera and for the model. They are measured here; `verdict`
//! decides what they mean.

mod color;
mod depth;
mod model;
mod moved;
mod outline;

pub use color::{ColorMeasures, Consistency};
pub use depth::{DepthMeasures, RegionMeasures};
pub use model::{ModelMeasures, ProvenanceMeasures};
pub use moved::Moved;

use super::coarse::coarse;
use crate::reconstruct::{Method, Reconstruction, Scene};
use rayon::prelude::*;
use serde::Serialize;

/// The figures of one reconstruction.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Measurements {
    /// A colour camera each, in the order of the scene's.
    pub colors: Vec<ColorMeasures>,
    /// The camera that has moved since the calibration, if one has.
    pub moved: Option<Moved>,
    /// A depth camera each, in the order of the scene's; none where the method uses no depth.
    pub depths: Vec<DepthMeasures>,
    /// Depth cameras of the rig, used or not.
    pub depth_cameras: usize,
    /// The model.
    pub model: ModelMeasures,
    /// Which model was made.
    pub method: Method,
}

/// Measures a reconstruction of `scene` by `method`.
pub fn measure(scene: &Scene, made: &Reconstruction, method: Method) -> Measurements {
    let colors = || {
        let hull = coarse(&made.hull, 2.0 * made.cell_size as f32);
        let views = scene.colors.par_iter().zip(&made.silhouettes);
        let colors: Vec<ColorMeasures> = views
            .map(|(view, silhouette)| ColorMeasures::of(view, silhouette, &hull, scene.volume))
            .collect();
        let moved = moved::moved(scene, made, &colors);
        (colors, moved)
    };
    let rest = || {
        let depths = scene.depths.iter().zip(&made.depths);
        let depths = depths
            .map(|(view, result)| DepthMeasures::of(view, result, &made.model.mesh))
            .collect();
        (depths, ModelMeasures::of(made))
    };
    let ((colors, moved), (depths, model)) = rayon::join(colors, rest);
    Measurements {
        colors,
        moved,
        depths,
        depth_cameras: scene.depths.len(),
        model,
        method,
    }
}

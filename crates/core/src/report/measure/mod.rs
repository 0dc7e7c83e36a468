//! The figures that a verdict is based on, for each camera and for the model. They are measured here; `verdict`
//! decides what they mean.

mod color;
mod depth;
mod exchanged;
mod model;
mod moved;
mod outline;
mod trial_hull;
mod unobserved;

pub use color::{ColorMeasures, Consistency};
pub use depth::{DepthMeasures, RegionMeasures};
pub use exchanged::Exchanged;
pub(super) use model::by_provenance;
pub use model::{AtlasMeasures, ModelMeasures, ProvenanceMeasures};
pub use moved::MovedCamera;
pub use unobserved::UnobservedMeasures;

use super::coarse::coarse;
use crate::reconstruct::{Method, Reconstruction, Scene};
use crate::statistics::lower_median;
use rayon::prelude::*;
use serde::Serialize;

/// The figures of one reconstruction.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Measurements {
    /// A colour camera each, in the order of the scene's.
    pub colors: Vec<ColorMeasures>,
    /// The camera that has moved since the calibration, if one has.
    pub moved: Option<MovedCamera>,
    /// The two cameras whose pictures or poses were exchanged, if two were.
    pub exchanged: Option<Exchanged>,
    /// The median over the cameras of their silhouettes' shift, as a share of the object's longest side: what a
    /// calibration that is not of the recording leaves in all of them, and one camera that moved does not.
    pub common_shift_share: f64,
    /// A depth camera each, in the order of the scene's; none where the method uses no depth.
    pub depths: Vec<DepthMeasures>,
    /// Depth cameras that took part in the capture, used or not.
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
        let exchanged = exchanged::exchanged(scene, made, &colors);
        let moved = match exchanged {
            None => moved::moved(scene, made, &colors),
            Some(_) => None,
        };
        (colors, moved, exchanged)
    };
    let rest = || {
        let depths = scene.depths.iter().zip(&made.depths);
        let depths = depths
            .map(|(view, result)| DepthMeasures::of(view, result, &made.model.mesh))
            .collect();
        (depths, ModelMeasures::of(scene, made))
    };
    let ((colors, moved, exchanged), (depths, model)) = rayon::join(colors, rest);
    Measurements {
        common_shift_share: common_shift_share(&colors),
        colors,
        moved,
        exchanged,
        depths,
        depth_cameras: scene.depths.len(),
        model,
        method,
    }
}

fn common_shift_share(colors: &[ColorMeasures]) -> f64 {
    let shifts = colors.iter().map(|c| c.shift_share(c.consistency.shift_px));
    let mut shifts: Vec<f64> = shifts.collect();
    lower_median(&mut shifts).unwrap_or(0.0)
}

//! The depth camera of these tests and what it read.

use crate::calibration::DepthCamera;
use crate::image::Grid;
use crate::reconstruct::depth::EnhancedDepth;
use crate::reconstruct::region::Regions;
use crate::reconstruct::testing;

/// Width and height of the pictures of [`camera`].
pub(super) const SIDE: usize = 12;

/// A depth camera on the z axis that looks at the origin from `height` metres, above or below.
pub(super) fn camera(height: f64) -> DepthCamera {
    testing::camera(SIDE, height)
}

/// What such a camera read: one depth in metres everywhere, with a noise of 1 mm, and a region that is all of it.
pub(super) fn evidence(depth: f32) -> (EnhancedDepth, Regions) {
    testing::evidence(depth, Grid::filled(SIDE, SIDE, 1))
}

//! A depth camera on an axis and what it read, for tests.

use crate::calibration::{Camera, DepthCamera, DepthResponse, Distortion, Intrinsics};
use crate::frame::CameraId;
use crate::image::Grid;
use crate::reconstruct::depth::{DepthKind, EnhancedDepth, Facts, SensorNoise};
use crate::reconstruct::region::{Bias, BiasSource, HullRenderings, Regions};
use nalgebra::{Isometry3, Point3, Vector2, Vector3};

/// Width and height of the pictures of [`camera`].
pub(super) const SIDE: usize = 12;

/// A depth camera on the z axis that looks at the origin from `height` metres, above or below.
pub(super) fn camera(height: f64) -> DepthCamera {
    let middle = Vector2::repeat(0.5 * (SIDE as f64 - 1.0));
    let focal = Vector2::repeat(575.0);
    let lens = Intrinsics::new(SIDE, SIDE, focal, middle, Distortion::default());
    let from = Point3::new(0.0, 0.0, height);
    let pose = Isometry3::face_towards(&from, &Point3::origin(), &Vector3::y());
    DepthCamera {
        camera: Camera::new(CameraId::new("depth").unwrap(), lens.unwrap(), pose),
        response: DepthResponse::default(),
    }
}

/// What such a camera read: one depth in metres everywhere, with a noise of 1 mm, and a region that is all of it.
pub(super) fn evidence(depth: f32) -> (EnhancedDepth, Regions) {
    let all = |value: f32| Grid::filled(SIDE, SIDE, value);
    let enhanced = EnhancedDepth {
        depth: all(depth),
        kind: Grid::filled(SIDE, SIDE, DepthKind::Measured),
        sigma: all(1e-3),
        noise: SensorNoise {
            per_square_depth: 0.0,
            jitter_px: 0.0,
            fixed_per_square_depth: 0.0,
            median_deviation: 0.0,
        },
        facts: Facts::default(),
    };
    let regions = Regions {
        front: HullRenderings {
            depth: all(0.7),
            exit: all(0.9),
            is_front: Grid::filled(SIDE, SIDE, true),
        },
        difference: all(0.1),
        sigma_difference: 0.1,
        labels: Grid::filled(SIDE, SIDE, 1),
        count: 1,
        last_hollow: 1,
        bias: Bias {
            metres: 0.0,
            found: 0.0,
            remaining: 0.0,
            source: BiasSource::None,
        },
    };
    (enhanced, regions)
}

//! A depth camera on an axis and what it read, for tests of several stages.

use super::depth::{DepthKind, EnhancedDepth, Facts, SensorNoise};
use super::region::{Bias, BiasSource, HullRenderings, Regions};
use crate::calibration::{Camera, DepthCamera, DepthResponse, Distortion, Intrinsics};
use crate::frame::CameraId;
use crate::image::Grid;
use nalgebra::{Isometry3, Point3, Vector2, Vector3};

/// A depth camera on the z axis that looks at the origin from `height` metres, above or below; its pictures are `side`
/// pixels wide and high.
pub(super) fn camera(side: usize, height: f64) -> DepthCamera {
    let middle = Vector2::repeat(0.5 * (side as f64 - 1.0));
    let focal = Vector2::repeat(575.0);
    let lens = Intrinsics::new(side, side, focal, middle, Distortion::default());
    let from = Point3::new(0.0, 0.0, height);
    let pose = Isometry3::face_towards(&from, &Point3::origin(), &Vector3::y());
    DepthCamera {
        camera: Camera::new(CameraId::new("depth").unwrap(), lens.unwrap(), pose),
        response: DepthResponse::default(),
    }
}

/// What such a camera read: one depth in metres everywhere, with a noise of 1 mm, and the regions that `labels` has;
/// their numbers begin with 1, and 0 is no region.
pub(super) fn evidence(depth: f32, labels: Grid<u16>) -> (EnhancedDepth, Regions) {
    let (width, height) = (labels.width(), labels.height());
    let all = |value: f32| Grid::filled(width, height, value);
    let enhanced = EnhancedDepth {
        depth: all(depth),
        kind: Grid::filled(width, height, DepthKind::Measured),
        sigma: all(1e-3),
        noise: SensorNoise {
            per_square_depth: 0.0,
            jitter_px: 0.0,
            fixed_per_square_depth: 0.0,
            median_deviation: 0.0,
        },
        facts: Facts::default(),
    };
    let count = labels.pixels().iter().copied().max().map_or(0, usize::from);
    let regions = Regions {
        front: HullRenderings {
            depth: all(0.7),
            exit: all(0.9),
            is_front: Grid::filled(width, height, true),
        },
        difference: all(0.1),
        sigma_difference: 0.1,
        count,
        last_hollow: count,
        labels,
        bias: Bias {
            metres: 0.0,
            found: 0.0,
            remaining: 0.0,
            source: BiasSource::None,
            table: 0.0,
        },
    };
    (enhanced, regions)
}

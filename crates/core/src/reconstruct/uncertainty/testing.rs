//! A depth camera above a hull and what it read, for tests.

use super::Readings;
use crate::calibration::{Camera, DepthCamera, DepthResponse, Distortion, Intrinsics};
use crate::frame::CameraId;
use crate::image::Grid;
use crate::reconstruct::depth::{DepthKind, EnhancedDepth, Facts, SensorNoise};
use crate::reconstruct::region::{Bias, BiasSource, HullRenderings, Regions};
use nalgebra::{Isometry3, Point3, Vector2, Vector3};

/// Width and height of its pictures.
pub(crate) const SIDE: usize = 21;

/// What a camera 0.8 m above reads where the top of a hull, 0.1 m high, is at the height 0: `depth` metres with a
/// noise of 0.5 mm.
pub(crate) struct Above {
    pub(crate) camera: DepthCamera,
    pub(crate) depth: EnhancedDepth,
    pub(crate) regions: Regions,
}

impl Above {
    /// Every pixel reads `depth` metres; of its bias, `bias` metres are known and `remaining` may be left.
    pub(crate) fn reads(depth: f32, bias: f64, remaining: f64) -> Self {
        let middle = Vector2::repeat(0.5 * (SIDE as f64 - 1.0));
        let focal = Vector2::repeat(575.0);
        let lens = Intrinsics::new(SIDE, SIDE, focal, middle, Distortion::default());
        let eye = Point3::new(0.0, 0.0, 0.8);
        let pose = Isometry3::face_towards(&eye, &Point3::origin(), &Vector3::y());
        let all = |value: f32| Grid::filled(SIDE, SIDE, value);
        Self {
            camera: DepthCamera {
                camera: Camera::new(CameraId::new("depth").unwrap(), lens.unwrap(), pose),
                response: DepthResponse::default(),
            },
            depth: EnhancedDepth {
                depth: all(depth),
                kind: Grid::filled(SIDE, SIDE, DepthKind::Measured),
                sigma: all(0.5e-3),
                noise: SensorNoise {
                    per_square_depth: 0.0,
                    jitter_px: 0.0,
                    fixed_per_square_depth: 0.0,
                    median_deviation: 0.0,
                },
                facts: Facts::default(),
            },
            regions: Regions {
                front: HullRenderings {
                    depth: all(0.8),
                    exit: all(0.9),
                    is_front: Grid::filled(SIDE, SIDE, true),
                },
                difference: all(depth - 0.8),
                sigma_difference: 0.0,
                labels: Grid::filled(SIDE, SIDE, 0),
                count: 0,
                last_hollow: 0,
                bias: Bias {
                    metres: bias,
                    found: bias,
                    remaining,
                    source: BiasSource::None,
                    table: 0.0,
                },
            },
        }
    }

    pub(crate) fn readings(&self) -> [Readings<'_>; 1] {
        [Readings {
            camera: &self.camera,
            depth: &self.depth,
            regions: &self.regions,
        }]
    }
}

//! The simulated rig: where its cameras stand, their lenses, and the calibration that the recording gets.

use super::options::{Faults, Options, Response};
use super::random::Random;
use super::{Error, invalid};
use nalgebra::{
    Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3,
};
use scand_core::calibration::{Camera, DepthCamera, DepthResponse, Distortion, Intrinsics, Volume};
use scand_core::frame::CameraId;
use scand_core::mesh::Mesh;
use std::f64::consts::TAU;

/// Focal length of a colour camera over its picture's width.
const FOCAL: f64 = 2.023;
/// The Kinect's focal length in pixels, and its picture.
const KINECT_FOCAL_PX: f64 = 575.8;
const KINECT_SIZE: (usize, usize) = (640, 480);
/// Metres from a colour camera to the object.
const COLOR_DISTANCE: f64 = 0.95;
/// Metres by which the volume is larger than the object.
const MARGIN: f64 = 0.004;
/// A non-ideal sensor: its readings are not millimetres, and its picture is a little too wide.
const NON_IDEAL: DepthResponse = DepthResponse {
    slope: 0.001_04,
    intercept: -0.018,
    scale: [1.012, -0.009, 0.0, 0.0, 0.0],
    range: Some([0.4, 3.0]),
    uncertainty: 0.001,
};

/// A colour camera as it is and as the calibration has it.
#[derive(Clone, Debug)]
pub struct SimulatedColorCamera {
    /// As it is.
    pub actual: Camera,
    /// As a recording says it is.
    pub calibrated: Camera,
}

/// A depth camera as it is and as the calibration has it.
#[derive(Clone, Debug)]
pub struct DepthStation {
    /// As it is. Its depth is also biased and displaced as the options say.
    pub actual: DepthCamera,
    /// As a recording says it is.
    pub calibrated: DepthCamera,
}

/// All cameras, and the box around the object.
#[derive(Clone, Debug)]
pub struct Rig {
    /// The colour cameras, in the order of their ids.
    pub colors: Vec<SimulatedColorCamera>,
    /// The depth cameras, in the order of their ids.
    pub depths: Vec<DepthStation>,
    /// The volume, a few millimetres larger than the object, from the table up.
    pub volume: Volume,
}

impl Rig {
    /// Sets the cameras up around an object.
    ///
    /// # Errors
    /// If there are too many cameras, or a picture's size cannot be one.
    pub fn new(options: &Options, object: &Mesh) -> Result<Self, Error> {
        Self::around(options, &Bounds::of(object))
    }

    /// Sets the cameras up around what lies in a box.
    pub(super) fn around(options: &Options, bounds: &Bounds) -> Result<Self, Error> {
        for (what, count) in [
            ("cameras", options.cameras),
            ("depth cameras", options.depth_cameras),
        ] {
            if count > 99 {
                return Err(invalid(what, count, "at most 99"));
            }
        }
        let colors = (0..options.cameras).map(|k| color_station(options, bounds, k));
        let depths = (0..options.depth_cameras).map(|k| depth_station(options, bounds, k));
        Ok(Self {
            colors: colors.collect::<Result<_, _>>()?,
            depths: depths.collect::<Result<_, _>>()?,
            volume: Volume::new(
                Point3::new(bounds.min.x - MARGIN, bounds.min.y - MARGIN, 0.0),
                bounds.max + Vector3::repeat(MARGIN),
            )?,
        })
    }
}

/// The box of an object's vertices.
pub(super) struct Bounds {
    pub min: Point3<f64>,
    pub max: Point3<f64>,
}

impl Bounds {
    pub(super) fn of(mesh: &Mesh) -> Self {
        let start = (Point3::from([f64::MAX; 3]), Point3::from([f64::MIN; 3]));
        let (min, max) = mesh.vertices.iter().fold(start, |(min, max), v| {
            let v = v.cast::<f64>();
            (min.inf(&v), max.sup(&v))
        });
        Self { min, max }
    }

    /// The box of both.
    pub(super) fn with(self, other: &Self) -> Self {
        Self {
            min: self.min.inf(&other.min),
            max: self.max.sup(&other.max),
        }
    }

    pub(super) fn center(&self) -> Point3<f64> {
        nalgebra::center(&self.min, &self.max)
    }

    /// Largest horizontal distance of the box from the axis.
    pub(super) fn radius(&self) -> f64 {
        let far = |a: usize| self.min[a].abs().max(self.max[a].abs());
        far(0).hypot(far(1))
    }
}

/// Of eleven cameras seven are in a low ring and four in a high one, unless the options say how many are in the low
/// one; none looks up.
fn color_station(
    options: &Options,
    bounds: &Bounds,
    k: usize,
) -> Result<SimulatedColorCamera, Error> {
    let id = CameraId::new(&format!("c{k:02}"))?;
    let mut random = Random::new(&[options.seed, 1, k as u64]);
    let usual = (options.cameras * 7).div_ceil(11);
    let low = options.low_cameras.unwrap_or(usual).min(options.cameras);
    let (ring, of, elevation) = match k < low {
        true => (k as f64, low as f64, 0.245),
        false => ((k - low) as f64 + 0.5, (options.cameras - low) as f64, 0.80),
    };
    let azimuth = TAU * ring / of + random.between(-0.07, 0.07);
    let elevation: f64 = elevation + random.between(-0.04, 0.04);
    let distance = COLOR_DISTANCE * random.between(0.97, 1.03);
    let horizontal = distance * elevation.cos();
    let eye = Point3::new(
        horizontal * azimuth.cos(),
        horizontal * azimuth.sin(),
        distance * elevation.sin() + 0.03,
    );
    let jitter = Vector3::from_fn(|_, _| random.between(-0.01, 0.01));
    let roll = random.between(-0.03, 0.03);
    let lens = color_lens(options, &mut random)?;
    let mut pose = looking_at(eye, bounds.center() + jitter, roll);
    let cut_off = Faults::amount(&options.faults.cut_off, id.as_str());
    if cut_off > 0.0 {
        pose = moved_out(pose, &lens, bounds, cut_off);
    }
    let turned = Faults::amount(&options.faults.turned_deg, id.as_str()).to_radians();
    // Turned about an axis between up and right, so that the picture moves along both sides.
    let axis = Vector3::new(0.6, 0.8, 0.0) * turned;
    let actual = pose * UnitQuaternion::from_scaled_axis(axis);
    Ok(SimulatedColorCamera {
        actual: Camera::new(id.clone(), lens, actual),
        calibrated: calibrated(options, k, Camera::new(id, lens, pose)),
    })
}

/// A colour camera as a calibration with errors has it.
fn calibrated(options: &Options, k: usize, mut camera: Camera) -> Camera {
    let faults = &options.faults;
    let mut random = Random::new(&[options.seed, 23, k as u64]);
    let error_px = Vector2::from_fn(|_, _| random.normal()) * faults.calibration_px;
    camera.intrinsics.center_px += error_px;
    camera.rig_from_camera = larger(options, camera.rig_from_camera);
    camera
}

/// A pose in a rig that is calibrated too large.
fn larger(options: &Options, mut pose: Isometry3<f64>) -> Isometry3<f64> {
    pose.translation.vector *= 1.0 + options.faults.calibration_scale_percent / 100.0;
    pose
}

fn color_lens(options: &Options, random: &mut Random) -> Result<Intrinsics, Error> {
    let (width, height) = (options.width as f64, options.height as f64);
    let focal = FOCAL * width * random.between(0.99, 1.01);
    let mut center = Vector2::new((width - 1.0) / 2.0, (height - 1.0) / 2.0);
    let mut distortion = Distortion::default();
    if options.color.distortion {
        center += Vector2::from_fn(|_, _| random.between(-0.008, 0.008)) * width;
        distortion.radial[0] = random.between(-0.08, 0.08);
        distortion.radial[1] = random.between(-0.1, 0.1);
        distortion.tangential = [random.between(-5e-4, 5e-4), random.between(-5e-4, 5e-4)];
    }
    let focal = Vector2::repeat(focal);
    Ok(Intrinsics::new(
        options.width,
        options.height,
        focal,
        center,
        distortion,
    )?)
}

/// Turns a camera sideways until the left edge of its picture cuts off a part of the object's width.
fn moved_out(
    pose: Isometry3<f64>,
    lens: &Intrinsics,
    bounds: &Bounds,
    part: f64,
) -> Isometry3<f64> {
    let center = pose.inverse() * bounds.center();
    let half_width = bounds.radius() / center.z;
    let edge = -lens.center_px.x / lens.focal_px.x;
    let wanted = edge + half_width * (1.0 - 2.0 * part);
    let angle = (center.x / center.z).atan() - wanted.atan();
    pose * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle)
}

fn depth_station(options: &Options, bounds: &Bounds, k: usize) -> Result<DepthStation, Error> {
    let name = match k {
        0 => "kinect".to_owned(),
        _ => format!("kinect{:02}", k + 1),
    };
    let id = CameraId::new(&name)?;
    let mut random = Random::new(&[options.seed, 2, k as u64]);
    let slant = options.depth_slant_deg.to_radians() + if k == 0 { 0.0 } else { 0.61 };
    let azimuth = 0.46 + TAU * k as f64 / 3.0;
    let up = Vector3::new(
        slant.sin() * azimuth.cos(),
        slant.sin() * azimuth.sin(),
        slant.cos(),
    );
    let target = Point3::new(bounds.center().x, bounds.center().y, bounds.max.z / 2.0);
    let jitter = Vector3::from_fn(|_, _| random.between(-0.004, 0.004));
    let pose = looking_at(
        target + up * options.depth_distance,
        target + jitter,
        azimuth + random.between(-0.1, 0.1),
    );
    let (width, height) = KINECT_SIZE;
    let lens = Intrinsics::new(
        width,
        height,
        Vector2::repeat(KINECT_FOCAL_PX),
        Vector2::new(319.5, 239.5),
        Distortion::default(),
    )?;
    let camera = Camera::new(id, lens, pose);
    let ideal = DepthResponse::default();
    let (actual, told) = match options.depth.response {
        Response::Ideal => (ideal, ideal),
        Response::Written => (NON_IDEAL, NON_IDEAL),
        Response::Hidden => (NON_IDEAL, ideal),
    };
    let mut calibrated = camera.clone();
    calibrated.rig_from_camera = larger(options, calibrated.rig_from_camera);
    Ok(DepthStation {
        actual: DepthCamera {
            camera,
            response: actual,
        },
        calibrated: DepthCamera {
            camera: calibrated,
            response: told,
        },
    })
}

/// The pose of a camera at `eye` that looks at `target`, upright but for `roll` (radians).
pub(super) fn looking_at(eye: Point3<f64>, target: Point3<f64>, roll: f64) -> Isometry3<f64> {
    let forward = (target - eye).normalize();
    let up = match forward.z.abs() < 0.99 {
        true => Vector3::z(),
        false => Vector3::y(),
    };
    let right = forward.cross(&up).normalize();
    let down = forward.cross(&right);
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[right, down, forward]))
        * Rotation3::from_axis_angle(&Vector3::z_axis(), roll);
    Isometry3::from_parts(Translation3::from(eye.coords), rotation.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Shape;

    #[test]
    fn every_camera_sees_the_whole_of_every_object_and_none_looks_up() {
        for shape in Shape::ALL {
            let object = shape.mesh(0.004);
            let options = Options {
                shape,
                depth_cameras: 2,
                ..Options::default()
            };
            let rig = Rig::new(&options, &object).unwrap();
            let colors = rig.colors.iter().map(|s| &s.actual);
            let depths = rig.depths.iter().map(|s| &s.actual.camera);
            for camera in colors.chain(depths) {
                let forward = camera.rig_from_camera * Vector3::z();
                assert!(forward.z < -0.1, "{} looks along {forward}", camera.id);
                for v in &object.vertices {
                    let (pixel, _) = camera.project(v.cast()).unwrap();
                    assert!(camera.intrinsics.contains(pixel), "{} {shape:?}", camera.id);
                }
            }
            assert!(object.vertices.iter().all(|v| {
                let inside = |a: usize| {
                    rig.volume.min[a] <= f64::from(v[a]) + 1e-6
                        && f64::from(v[a]) < rig.volume.max[a]
                };
                inside(0) && inside(1) && inside(2)
            }));
        }
    }

    #[test]
    fn a_rig_without_low_cameras_looks_down_from_all_around() {
        let object = Shape::Tray.mesh(0.004);
        let steepness = |low_cameras| {
            let options = Options {
                shape: Shape::Tray,
                cameras: 8,
                low_cameras,
                ..Options::default()
            };
            let rig = Rig::new(&options, &object).unwrap();
            let downwards = |s: &SimulatedColorCamera| -(s.actual.rig_from_camera * Vector3::z()).z;
            rig.colors.iter().map(downwards).collect::<Vec<f64>>()
        };
        let is_high = |d: &&f64| **d > 0.6;
        let usual = steepness(None);
        assert_eq!(usual.iter().filter(is_high).count(), 2, "{usual:?}");
        let high = steepness(Some(0));
        assert_eq!(high.iter().filter(is_high).count(), 8, "{high:?}");
        assert_eq!(steepness(Some(6)), usual);
    }

    #[test]
    fn a_smaller_picture_has_the_same_field_of_view() {
        let object = Shape::Ball.mesh(0.01);
        let at = |width: usize| {
            let options = Options {
                width,
                height: width * 3 / 4,
                ..Options::default()
            };
            let rig = Rig::new(&options, &object).unwrap();
            let lens = rig.colors[3].actual.intrinsics;
            lens.focal_px.x / width as f64
        };
        assert!((at(2560) - at(320)).abs() < 1e-12);
    }
}

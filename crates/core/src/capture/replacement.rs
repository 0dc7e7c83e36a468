//! Puts another calibration in place of the recorded one.

use crate::calibration::RigCalibration;
use crate::frame::CameraId;
use crate::reconstruct::Scene;

/// Why a calibration does not fit a scene.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum CalibrationMismatch {
    /// A camera of the scene that the calibration lacks.
    #[error("the calibration has no camera {0}")]
    Missing(CameraId),
    /// Pictures of another size than the calibration's.
    #[error(
        "camera {camera}: its pictures have {found:?} pixels, but the calibration is for \
        {expected:?}"
    )]
    Size {
        camera: CameraId,
        /// The pictures' width and height.
        found: [usize; 2],
        expected: [usize; 2],
    },
}

/// Puts the cameras of `calibration` in place of the scene's. A depth camera without a response in it keeps
/// the recorded one.
///
/// # Errors
/// If a camera is missing or made for pictures of another size.
pub fn replace_cameras(
    scene: &mut Scene,
    calibration: &RigCalibration,
) -> Result<(), CalibrationMismatch> {
    let cameras = scene.colors.iter_mut().map(|v| (&mut v.camera, None));
    let depths = scene
        .depths
        .iter_mut()
        .map(|v| (&mut v.camera.camera, Some(&mut v.camera.response)));
    for (camera, response) in cameras.chain(depths) {
        let (other, other_response) = calibration
            .cameras
            .get(&camera.id)
            .ok_or_else(|| CalibrationMismatch::Missing(camera.id.clone()))?;
        let size = |c: &crate::calibration::Camera| [c.intrinsics.width, c.intrinsics.height];
        if size(camera) != size(other) {
            let (camera, found, expected) = (camera.id.clone(), size(camera), size(other));
            return Err(CalibrationMismatch::Size {
                camera,
                found,
                expected,
            });
        }
        *camera = other.clone();
        if let (Some(response), Some(other)) = (response, other_response) {
            *response = *other;
        }
    }
    Ok(())
}

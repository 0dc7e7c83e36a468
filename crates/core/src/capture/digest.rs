//! The digests: short texts computed from everything that a model depends on, so that the same digest means the
//! same model.

use crate::calibration::{CalibrationVerdict, Camera};
use crate::reconstruct::{DepthView, Scene, SilhouetteSource};
use crate::words::hexadecimal;
use rayon::prelude::*;
use sha2::{Digest, Sha256};

/// SHA-256 of everything that a model's files depend on: the input ([`input_digest`]), the verdict of its calibration
/// if that is known, the configuration as text, the data about the object, and the program's version.
pub fn digest(
    input: &str,
    calibration: Option<&CalibrationVerdict>,
    configuration: &str,
    description: &str,
) -> String {
    let mut hash = Sha256::new();
    let mut add = |part: &str| {
        hash.update((part.len() as u64).to_le_bytes());
        hash.update(part);
    };
    for part in [env!("CARGO_PKG_VERSION"), input, configuration, description] {
        add(part);
    }
    if let Some(verdict) = calibration {
        // Written out, and not taken from the type: renaming that would make every model stale.
        let CalibrationVerdict { level, reasons } = verdict;
        add(&format!(
            "Verdict {{ level: {level:?}, reasons: {reasons:?} }}"
        ));
    }
    hexadecimal(&hash.finalize())
}

/// SHA-256 over the cameras of a scene and its volume, to the last bit.
pub fn calibration_digest(scene: &Scene) -> String {
    let mut hash = Sha256::new();
    add_rig(&mut hash, scene, |_, _| {});
    hexadecimal(&hash.finalize())
}

/// SHA-256 over a scene: its cameras to the last bit, the CRC-32 of each picture.
pub fn input_digest(scene: &Scene) -> String {
    let mut hash = Sha256::new();
    add_rig(&mut hash, scene, |hash, view| {
        hash.update(view.frames.len().to_le_bytes());
    });
    for (length, crc) in pictures(scene).par_iter().map(sum).collect::<Vec<_>>() {
        hash.update(length.to_le_bytes());
        hash.update(crc.to_le_bytes());
    }
    hexadecimal(&hash.finalize())
}

/// SHA-256 over digests, a line each.
pub fn joint_digest(digests: &[String]) -> String {
    let mut hash = Sha256::new();
    for digest in digests {
        hash.update(digest);
        hash.update("\n");
    }
    hexadecimal(&hash.finalize())
}

/// The pixels of one picture.
enum Pixels<'a> {
    Bytes(&'a [u8]),
    Readings(&'a [u16]),
    /// So many bytes of grey, for a colour picture that was not recorded.
    Grey(usize),
}

/// All pictures of a scene, in a fixed order.
fn pictures(scene: &Scene) -> Vec<Pixels<'_>> {
    let mut pictures = Vec::new();
    for view in &scene.colors {
        pictures.push(Pixels::Bytes(view.image.pixels().as_flattened()));
        pictures.push(Pixels::Bytes(match &view.silhouette {
            SilhouetteSource::Mask(mask) => mask.pixels(),
            SilhouetteSource::Background(plate) => plate.pixels().as_flattened(),
        }));
        pictures.extend(view.ignored.as_ref().map(|m| Pixels::Bytes(m.pixels())));
    }
    for frame in scene.depths.iter().flat_map(|view| &view.frames) {
        pictures.push(Pixels::Readings(frame.readings.pixels()));
        pictures.push(match &frame.color {
            Some(color) => Pixels::Bytes(color.pixels().as_flattened()),
            None => Pixels::Grey(3 * frame.readings.pixels().len()),
        });
    }
    pictures
}

/// Length in bytes and CRC-32 of a picture.
fn sum(pixels: &Pixels) -> (usize, u32) {
    match pixels {
        Pixels::Bytes(bytes) => (bytes.len(), crc32fast::hash(bytes)),
        Pixels::Readings(readings) => {
            let bytes: Vec<u8> = readings.iter().flat_map(|r| r.to_le_bytes()).collect();
            (bytes.len(), crc32fast::hash(&bytes))
        }
        Pixels::Grey(length) => (*length, crc32fast::hash(&vec![128; *length])),
    }
}

/// Adds the volume and all cameras of a scene; `add` adds more for each depth camera. The texts are part of the format
/// of models (docs/formats.md), and a test holds them: a type or a member cannot be renamed without noticing.
fn add_rig(hash: &mut Sha256, scene: &Scene, add: impl Fn(&mut Sha256, &DepthView)) {
    hash.update(format!("{:?}", scene.volume));
    for view in &scene.colors {
        add_camera(hash, &view.camera);
    }
    for view in &scene.depths {
        add_camera(hash, &view.camera.camera);
        hash.update(format!("{:?}", view.camera.response));
        add(hash, view);
    }
}

fn add_camera(hash: &mut Sha256, camera: &Camera) {
    // Debug prints the shortest text that reads back as the same number, so no bit is lost.
    hash.update(format!("{camera:?}"));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{DepthResponse, Distortion, Intrinsics, Volume};
    use crate::frame::CameraId;
    use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};

    /// The texts of which digests are made, as `docs/formats.md` shows them: others must be able to make them too.
    #[test]
    fn the_texts_are_those_that_are_documented() {
        let lens = Intrinsics::new(
            640,
            480,
            Vector2::new(800.0, 801.5),
            Vector2::new(319.5, 239.5),
            Distortion::default(),
        );
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 0.5);
        let pose = Isometry3::from_parts(Translation3::new(0.25, 0.0, -0.5), rotation);
        let camera = Camera::new(CameraId::new("c00").unwrap(), lens.unwrap(), pose);
        let volume = Volume::new(Point3::new(-0.1, -0.1, 0.0), Point3::new(0.1, 0.1, 0.2));
        let texts = [
            format!("{:?}", volume.unwrap()),
            format!("{camera:?}"),
            format!("{:?}", DepthResponse::default()),
        ];
        let page = include_str!("../../../../docs/formats.md");
        for text in texts {
            assert!(page.contains(&text), "{text}");
        }
    }
}

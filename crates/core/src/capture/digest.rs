//! What a model depends on, as one short text: the same digest means the same model.

use crate::calibration::Camera;
use crate::reconstruct::{Scene, SilhouetteSource};
use rayon::prelude::*;
use sha2::{Digest, Sha256};

/// SHA-256 over the scene (its cameras to the last bit, CRC-32 of each picture), the configuration as text
/// and the program's version, as hexadecimal.
pub fn digest(scene: &Scene, configuration: &str) -> String {
    let mut hash = Sha256::new();
    hash.update(env!("CARGO_PKG_VERSION"));
    hash.update(configuration);
    hash.update(format!("{:?}", scene.volume));
    for view in &scene.colors {
        add_camera(&mut hash, &view.camera);
    }
    for view in &scene.depths {
        add_camera(&mut hash, &view.camera.camera);
        hash.update(format!("{:?}", view.camera.response));
        hash.update(view.frames.len().to_le_bytes());
    }
    for (length, crc) in pictures(scene).par_iter().map(sum).collect::<Vec<_>>() {
        hash.update(length.to_le_bytes());
        hash.update(crc.to_le_bytes());
    }
    hash.finalize().iter().map(|b| format!("{b:02x}")).collect()
}

/// The pixels of one picture.
enum Pixels<'a> {
    Bytes(&'a [u8]),
    Readings(&'a [u16]),
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
    }
    for frame in scene.depths.iter().flat_map(|view| &view.frames) {
        pictures.push(Pixels::Readings(frame.readings.pixels()));
        pictures.push(Pixels::Bytes(frame.color.pixels().as_flattened()));
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
    }
}

fn add_camera(hash: &mut Sha256, camera: &Camera) {
    // Debug prints the shortest text that reads back as the same number, so no bit is lost.
    hash.update(format!("{camera:?}"));
}

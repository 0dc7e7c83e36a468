//! What a model depends on, as one short text: the same digest means the same model.

use crate::calibration::Camera;
use crate::reconstruct::{Scene, SilhouetteSource};
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
        add(&mut hash, view.image.pixels().as_flattened());
        match &view.silhouette {
            SilhouetteSource::Mask(mask) => add(&mut hash, mask.pixels()),
            SilhouetteSource::Background(plate) => add(&mut hash, plate.pixels().as_flattened()),
        }
    }
    let mut bytes = Vec::new();
    for view in &scene.depths {
        add_camera(&mut hash, &view.camera.camera);
        hash.update(format!("{:?}", view.camera.response));
        for frame in &view.frames {
            bytes.clear();
            bytes.extend(frame.readings.pixels().iter().flat_map(|r| r.to_le_bytes()));
            add(&mut hash, &bytes);
            add(&mut hash, frame.color.pixels().as_flattened());
        }
    }
    hash.finalize().iter().map(|b| format!("{b:02x}")).collect()
}

fn add(hash: &mut Sha256, bytes: &[u8]) {
    hash.update(bytes.len().to_le_bytes());
    hash.update(crc32fast::hash(bytes).to_le_bytes());
}

fn add_camera(hash: &mut Sha256, camera: &Camera) {
    // Debug prints the shortest text that reads back as the same number, so no bit is lost.
    hash.update(format!("{camera:?}"));
}

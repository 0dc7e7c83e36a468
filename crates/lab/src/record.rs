//! Writes a simulated session as a recording, and its truth as a PLY file.

use super::{Error, Simulation};
use scand_core::calibration::{CalibrationLevel, CalibrationRecord, CalibrationVerdict};
use scand_core::frame::Stream;
use scand_core::mesh::Mesh;
use scand_core::recording::{Compression, Writer};
use std::collections::BTreeMap;
use std::path::Path;

/// Writes the session to a new recording: calibration, backgrounds or masks, captures, and in its metadata
/// the options that make it again.
///
/// # Errors
/// If there is something at `path` already, or it cannot be written.
pub fn write(simulation: &Simulation, path: &Path, compression: Compression) -> Result<(), Error> {
    let program = concat!("scand ", env!("CARGO_PKG_VERSION"));
    let mut writer = Writer::create(path, program, compression)?;
    let options = serde_json::to_string(simulation.options()).unwrap_or_default();
    let session = BTreeMap::from([("simulation".to_owned(), options)]);
    writer.metadata("session", &session)?;
    if let Some(reason) = &simulation.options().faults.doubtful_calibration {
        writer.calibration_record(&CalibrationRecord {
            verdict: CalibrationVerdict {
                level: CalibrationLevel::Doubtful,
                reasons: vec![reason.clone()],
            },
            file_sha256: None,
        })?;
    }
    write_rig(simulation, &mut writer)?;
    for index in 0..simulation.options().captures {
        write_capture(simulation, index, &mut writer)?;
    }
    Ok(writer.finish()?)
}

fn write_rig(simulation: &Simulation, writer: &mut Writer) -> Result<(), Error> {
    let (rig, begin) = (simulation.rig(), simulation.begin());
    for station in &rig.colors {
        writer.color_camera(&station.calibrated, begin)?;
    }
    for station in &rig.depths {
        writer.depth_camera(&station.calibrated, begin)?;
    }
    writer.volume(&rig.volume, begin)?;
    if !simulation.options().masks {
        for plate in simulation.backgrounds() {
            writer.background(&plate.camera, &plate.picture, plate.timestamp)?;
        }
    }
    Ok(())
}

fn write_capture(simulation: &Simulation, index: usize, writer: &mut Writer) -> Result<(), Error> {
    let capture = simulation.capture(index)?;
    writer.trigger(&capture.trigger)?;
    for frame in &capture.frames {
        writer.frame(frame)?;
    }
    if simulation.options().masks {
        let colors = capture.frames.iter().filter(|f| f.stream == Stream::Color);
        for frame in colors {
            let stations = simulation.rig().colors.iter();
            for station in stations.filter(|s| s.actual.id == frame.camera) {
                let mask = simulation.mask(index, station);
                writer.mask(&frame.camera, &mask, frame.timestamp)?;
            }
        }
    }
    let colors = capture.frames.iter().filter(|f| f.stream == Stream::Color);
    for frame in colors {
        let stations = simulation.rig().colors.iter();
        for station in stations.filter(|s| s.actual.id == frame.camera) {
            if let Some(ignored) = simulation.ignored(index, station) {
                writer.ignore(&frame.camera, &ignored, frame.timestamp)?;
            }
        }
    }
    Ok(writer.sync()?)
}

/// What was in front of the cameras, as JSON: the object, its poses and the seed, and for each capture
/// `rig_from_object` as a matrix of 4 x 4 in metres. The object's frame is the rig's at the first capture, as in the
/// truth.
pub fn poses_json(simulation: &Simulation) -> serde_json::Value {
    let options = simulation.options();
    let poses = (0..options.captures).map(|index| {
        let pose = simulation.rig_from_object(index).to_homogeneous();
        let row = |i: usize| [0, 1, 2, 3].map(|j| pose[(i, j)]);
        [0, 1, 2, 3].map(row)
    });
    serde_json::json!({
        "object": options.shape,
        "poses": options.poses,
        "seed": options.seed,
        "rig_from_object": poses.collect::<Vec<_>>(),
    })
}

/// A mesh as binary PLY, positions in metres.
pub fn ply(mesh: &Mesh) -> Vec<u8> {
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\n\
         property float z\nelement face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        mesh.vertices.len(),
        mesh.triangles.len()
    )
    .into_bytes();
    for value in mesh.vertices.iter().flat_map(|v| v.iter()) {
        bytes.extend(value.to_le_bytes());
    }
    for triangle in &mesh.triangles {
        bytes.push(3);
        bytes.extend(triangle.iter().flat_map(|v| v.to_le_bytes()));
    }
    bytes
}

//! The simulated rig: objects whose form is known, rendered into the pictures and depth readings that real
//! cameras would give of them, with their noise and their faults, so that accuracy is a number.

mod coverage;
mod options;
mod random;
mod rig;
mod shape;

pub use options::{CameraFault, ColorSensor, DepthSensor, Encoding, Faults, Options, Response};
pub use rig::{ColorStation, DepthStation, Rig};
pub use shape::Shape;

use crate::calibration;
use crate::frame::BadName;
use crate::image::{Grid, Mask};
use crate::mesh::Mesh;
use coverage::Layer;
use rayon::prelude::*;

/// Why nothing is simulated.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum Error {
    /// An option that cannot be met.
    #[error("{what} is {found}, expected {expected}")]
    BadOption {
        /// Which.
        what: &'static str,
        /// What was asked.
        found: String,
        /// What would do.
        expected: &'static str,
    },
    /// A camera that cannot be.
    #[error(transparent)]
    Calibration(#[from] calibration::Error),
    /// A camera's id that is none.
    #[error(transparent)]
    Name(#[from] BadName),
}

fn invalid(what: &'static str, found: impl ToString, expected: &'static str) -> Error {
    Error::BadOption {
        what,
        found: found.to_string(),
        expected,
    }
}

/// An object among cameras, ready to be looked at.
#[derive(Clone, Debug)]
pub struct Simulation {
    options: Options,
    truth: Mesh,
    rig: Rig,
}

impl Simulation {
    /// Makes the object and sets up the rig around it. Nothing is rendered yet.
    ///
    /// # Errors
    /// If an option cannot be met.
    pub fn new(options: Options) -> Result<Self, Error> {
        if !(0.1..=50.0).contains(&options.spacing_mm) {
            return Err(invalid("spacing", options.spacing_mm, "0.1 to 50 mm"));
        }
        let truth = options.shape.mesh(options.spacing_mm * 1e-3);
        let rig = Rig::new(&options, &truth)?;
        Ok(Self {
            options,
            truth,
            rig,
        })
    }

    /// What was asked.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// The object's true surface.
    pub fn truth(&self) -> &Mesh {
        &self.truth
    }

    /// The cameras and the volume.
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// The exact silhouettes, one a colour camera: 255 times the part of each pixel that the object covers.
    pub fn masks(&self) -> Vec<Mask> {
        let mask = |station: &ColorStation| {
            let lens = &station.actual.intrinsics;
            Layer::new(&station.actual, &self.truth).map_or_else(
                || Mask::filled(lens.width, lens.height, 0),
                |layer| layer.mask(lens.width, lens.height),
            )
        };
        self.rig.colors.par_iter().map(mask).collect()
    }

    /// The exact depth of the object in metres along the optical axis at each pixel of depth camera
    /// `index`, as it is calibrated; infinite where the object is not.
    pub fn exact_depth(&self, index: usize) -> Grid<f32> {
        let station = &self.rig.depths[index].calibrated;
        let lens = &station.camera.intrinsics;
        let mut depth = Grid::filled(lens.width, lens.height, f32::INFINITY);
        let project = |p| {
            let p = station.camera.camera_from_rig(p);
            let pixel = station.response.project(lens, p)?;
            Some([pixel.x, pixel.y, p.z])
        };
        if let Some(layer) = Layer::with(&self.truth, project, lens.width, lens.height) {
            let [x0, y0] = layer.origin;
            for y in 0..layer.fragments.height() {
                for (x, fragment) in layer.fragments.row(y).iter().enumerate() {
                    depth[(x0 + x, y0 + y)] = fragment.depth;
                }
            }
        }
        depth
    }
}

#[cfg(test)]
mod tests;

//! The driver that a depth camera's thread uses to open the camera, and to reopen it.

use super::camera::Camera;
use super::parameters::Parameters;
use crate::clock::Clock;
use crate::drivers::live::{Device, Driver, Fault, Pool};
use crate::frame::CameraId;

/// Opens one depth camera.
#[derive(Debug, Clone)]
pub struct OpenNi2 {
    id: CameraId,
    parameters: Parameters,
    pool: Pool,
    clock: Clock,
}

impl OpenNi2 {
    /// A camera that is set so, whose frames lie in this memory and are stamped by this clock.
    pub fn new(id: CameraId, parameters: Parameters, pool: Pool, clock: Clock) -> Self {
        Self {
            id,
            parameters,
            pool,
            clock,
        }
    }

    /// Opens it, for what a [`Device`] has no word for.
    ///
    /// # Errors
    /// If it is not there or did not take a setting. Nothing is held then.
    pub fn open_camera(&self) -> Result<Camera, Fault> {
        Camera::open(
            self.id.clone(),
            self.parameters.clone(),
            self.pool.clone(),
            self.clock,
        )
    }
}

impl Driver for OpenNi2 {
    fn open(&mut self) -> Result<Box<dyn Device>, Fault> {
        Ok(Box::new(self.open_camera()?))
    }
}

//! The input of a reconstruction: the decoded pictures of one capture with their cameras.

use crate::calibration::{Camera, DepthCamera, Volume};
use crate::image::{Grid, Mask, RgbImage};
use std::sync::Arc;

/// One capture, decoded.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The colour cameras' views, in the order of their ids.
    pub colors: Vec<ColorView>,
    /// The depth cameras' views, in the order of their ids.
    pub depths: Vec<DepthView>,
    /// The box that bounds the object.
    pub volume: Volume,
}

/// What one colour camera saw.
#[derive(Clone, Debug)]
pub struct ColorView {
    /// The camera.
    pub camera: Camera,
    /// Its picture, of the size of the camera's intrinsics, sRGB-encoded.
    pub image: RgbImage,
    /// What distinguishes the object from the backdrop.
    pub silhouette: SilhouetteSource,
    /// 128 and up where something that is no part of the object hides what is behind it: unknown.
    pub ignored: Option<Mask>,
}

/// What a silhouette comes from.
#[derive(Clone, Debug)]
pub enum SilhouetteSource {
    /// A mask, used as it is.
    Mask(Mask),
    /// The view with no object in it.
    Background(Arc<RgbImage>),
}

/// What one depth camera saw.
#[derive(Clone, Debug)]
pub struct DepthView {
    /// The camera and its response.
    pub camera: DepthCamera,
    /// The burst.
    pub frames: Vec<DepthFrame>,
}

/// One reading of a depth camera.
#[derive(Clone, Debug)]
pub struct DepthFrame {
    /// Raw readings; 0 means no reading.
    pub readings: Grid<u16>,
    /// The colour picture nearest in time; shared where colour is rarer than depth. `None` where none was recorded.
    pub color: Option<Arc<RgbImage>>,
}

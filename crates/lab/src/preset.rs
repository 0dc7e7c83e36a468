//! Cases that a reconstruction must pass, each as a session with an everyday object.

use super::{Options, Shape};
use serde::{Deserialize, Serialize};

/// A case by its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, clap::ValueEnum, Deserialize, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// A ball of 30 mm radius; the depth is 5 mm too deep and one pixel beside the colour. Nothing of it may
    /// be carved.
    Ball,
    /// An egg, with the same hidden faults.
    Egg,
    /// A box, with the same hidden faults.
    Box,
    /// A bowl whose depth is 8 mm too deep: its wall must not be perforated.
    BiasedBowl,
    /// A mug: its handle's hole stays a hole, its inside is restored.
    Mug,
    /// A ring: nothing of its hole may be closed.
    Torus,
    /// A block with two concave regions.
    TwoPits,
    /// A cup seen by two depth cameras.
    TwoDepthCameras,
    /// A cup whose sensor's readings need the written response.
    WrittenResponse,
}

impl Preset {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Ball,
        Self::Egg,
        Self::Box,
        Self::BiasedBowl,
        Self::Mug,
        Self::Torus,
        Self::TwoPits,
        Self::TwoDepthCameras,
        Self::WrittenResponse,
    ];

    /// The session: eleven cameras of 640 x 480 pixels, ten depth frames.
    pub fn options(self) -> Options {
        let shape = match self {
            Self::Ball => Shape::Ball,
            Self::Egg => Shape::Egg,
            Self::Box => Shape::Box,
            Self::BiasedBowl => Shape::Bowl,
            Self::Mug => Shape::Mug,
            Self::Torus => Shape::Torus,
            Self::TwoPits => Shape::TwoPits,
            Self::TwoDepthCameras | Self::WrittenResponse => Shape::Cup,
        };
        let mut options = Options {
            width: 640,
            height: 480,
            spacing_mm: 2.0,
            ..Options::small(shape)
        };
        match self {
            Self::Ball | Self::Egg | Self::Box => {
                options.depth.bias_mm = 5.0;
                options.depth.misregistration_px = 1.0;
            }
            Self::BiasedBowl => options.depth.bias_mm = 8.0,
            Self::TwoDepthCameras => options.depth_cameras = 2,
            Self::WrittenResponse => options.depth.response = super::Response::Written,
            Self::Mug | Self::Torus | Self::TwoPits => {}
        }
        options
    }
}

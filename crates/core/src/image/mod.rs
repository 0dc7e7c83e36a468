//! Pixel grids, and operations on them that do not depend on the camera. Nothing in this room knows of calibration,
//! frames or files.

mod decode;
#[cfg(test)]
mod decode_tests;
mod demosaic;
mod grid;
mod pack_shapes;
mod rect;
mod sharpness;
pub mod srgb;
mod text;

pub use decode::{
    AS_STORED, DecodeError, RawPixels, encode_linear_as_srgb, grey_from_file, grey_from_raw,
    grey_from_rgb, grey_of_used_bits, orientation_of_file, readings_from_raw, rgb_from_file,
    rgb_from_raw, size_of_file,
};
pub use demosaic::{BayerOrder, demosaic};
pub use grid::Grid;
pub use pack_shapes::{CellShape, PackingOrder, PlacedShape, pack_shapes};
pub use rect::PixelRect;
pub use sharpness::sharpness_percent;
pub use text::{draw_text, text_size};

/// An sRGB-encoded colour picture.
pub type RgbImage = Grid<[u8; 3]>;

/// A silhouette: 128 and up is object, 255 is certainly object, 0 certainly not.
pub type Mask = Grid<u8>;

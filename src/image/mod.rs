//! Pixel grids, and what can be done to them without knowing which camera they came from. Nothing in this
//! room knows of calibration, frames or files.

mod grid;
mod rect;
pub mod srgb;
mod text;

pub use grid::Grid;
pub use rect::PixelRect;
pub use text::{draw_text, text_size};

/// An sRGB-encoded colour picture.
pub type RgbImage = Grid<[u8; 3]>;

/// A silhouette: 128 and up is object, 255 is certainly object, 0 certainly not.
pub type Mask = Grid<u8>;

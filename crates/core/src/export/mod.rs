//! Models in the formats of other programs, with the units and the axis that their readers expect, made from the
//! `model.glb` that scand wrote. Turns bytes into bytes; nothing here reconstructs a model or writes to the disk.

mod bake;
mod glb;
mod level;
mod obj;
mod read;
mod stl;
mod three_mf;
mod unwrap;
mod usdz;
mod zip;

#[cfg(test)]
mod testing;

pub use glb::Compression;
pub use level::level_of_detail;
pub use read::{ReadModel, read};

use crate::description::{Description, clean};
use crate::output;
use crate::reconstruct::{Model, Texture};
use std::collections::HashMap;
use std::path::PathBuf;

/// A format that a model can be written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Wavefront OBJ with MTL and PNG: metres, y up.
    Obj,
    /// Binary STL: millimetres, z up, no colours.
    Stl,
    /// 3D Manufacturing Format: millimetres, z up, texture as PNG.
    ThreeMf,
    /// Universal Scene Description in a package: metres, y up, texture as PNG.
    Usdz,
    /// Binary glTF: metres, y up.
    Glb,
}

impl Format {
    /// All formats, in the order in which help names them.
    pub const ALL: [Self; 5] = [Self::Obj, Self::Stl, Self::ThreeMf, Self::Usdz, Self::Glb];

    /// The format's name, which is the ending of its files too.
    pub fn name(self) -> &'static str {
        match self {
            Self::Obj => "obj",
            Self::Stl => "stl",
            Self::ThreeMf => "3mf",
            Self::Usdz => "usdz",
            Self::Glb => "glb",
        }
    }

    /// The format's unit and upward axis, in words.
    pub fn conventions(self) -> &'static str {
        match self {
            Self::Obj | Self::Usdz | Self::Glb => "metres, y up",
            Self::Stl | Self::ThreeMf => "millimetres, z up",
        }
    }
}

/// Why a model cannot be exported.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read {}: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        cause: std::io::Error,
    },
    /// The file is not a model that scand wrote, or it is damaged.
    #[error("{}: {what}", path.display())]
    NotAModel {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// The model cannot be simplified.
    #[error(transparent)]
    Simplify(#[from] crate::mesh::SimplifyError),
    /// The bytes of a file could not be made.
    #[error(transparent)]
    Output(#[from] output::Error),
    /// The model is too large for the format.
    #[error("the model is too large for {format}: {what}")]
    TooLarge {
        /// The format.
        format: &'static str,
        /// What there is too much of.
        what: &'static str,
    },
}

/// One file of an exported model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct File {
    /// Its name, without a folder.
    pub name: String,
    /// Its content.
    pub bytes: Vec<u8>,
}

/// The files of a model in a format, all of whose names begin with `stem`: the file that a reader opens comes last, so
/// that it is there only when the others are. glTF is encoded anew here, as `glb` says; a model that is not changed
/// needs no encoding.
///
/// # Errors
/// If the model's parts do not fit each other, or it is larger than the format allows.
pub fn encode(
    model: &Model,
    about: &Description,
    format: Format,
    stem: &str,
    glb: &output::glb::Parameters,
) -> Result<Vec<File>, Error> {
    let name = format!("{stem}.{}", format.name());
    let one = |bytes| Ok(vec![File { name, bytes }]);
    match format {
        Format::Obj => obj::encode(model, about, stem),
        Format::Stl => one(stl::encode(model)?),
        Format::ThreeMf => one(three_mf::encode(model, about)?),
        Format::Usdz => one(usdz::encode(model, about)?),
        Format::Glb => one(output::glb::encode(model, about, glb)?),
    }
}

/// A binary glTF that scand wrote, compressed.
///
/// # Errors
/// If it is not one that scand wrote.
pub fn compress(bytes: &[u8], compression: Compression) -> Result<Vec<u8>, String> {
    match compression {
        Compression::Quantization => glb::quantize(bytes),
    }
}

/// A binary glTF that scand wrote, with another description in it. Nothing else changes.
///
/// # Errors
/// If it is not one that scand wrote.
pub fn describe(bytes: &[u8], about: &Description) -> Result<Vec<u8>, String> {
    glb::describe(bytes, about)
}

/// Places in the atlas, each once, and for each triangle which of them its corners have.
fn unique_uv(texture: &Texture) -> (Vec<[f32; 2]>, Vec<[u32; 3]>) {
    let (mut seen, mut places) = (HashMap::new(), Vec::new());
    let mut index = |uv: [f32; 2]| {
        *seen.entry(uv.map(f32::to_bits)).or_insert_with(|| {
            places.push(uv);
            places.len() as u32 - 1
        })
    };
    let corners = texture.corner_uv.iter().map(|uv| uv.map(&mut index));
    let corners = corners.collect();
    (places, corners)
}

/// What is known of a model as lines of `name text`, without line breaks in a text.
fn known(about: &Description) -> Vec<String> {
    let pairs = about.pairs().into_iter();
    pairs
        .filter_map(|(name, text)| Some(format!("{name} {}", clean(text)?)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_in_the_atlas_are_listed_once() {
        let texture = testing::textured_square().texture.unwrap();
        let (places, corners) = unique_uv(&texture);
        assert_eq!(places.len(), 4);
        for (corner, uv) in corners.iter().zip(&texture.corner_uv) {
            assert_eq!(corner.map(|i| places[i as usize]), *uv);
        }
    }
}

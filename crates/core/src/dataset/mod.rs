//! A capture as a dataset for other programs that reconstruct: undistorted pictures, masks, poses, and points of a
//! model. Turns a scene into the bytes of files; other rooms write them to the disk.

mod colmap;
mod nerfstudio;
mod openmvs;
mod ply;
mod points;
#[cfg(test)]
mod testing;
mod undistort;

pub use points::{Point, points};
pub use undistort::{Pinhole, View, views};

use crate::output::{self, encode_grey_png, encode_png};
use rayon::prelude::*;

/// A program whose datasets can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// COLMAP: a sparse model as text, as most programs that learn scenes from pictures read it too.
    Colmap,
    /// nerfstudio: `transforms.json`.
    Nerfstudio,
    /// OpenMVS: `scene.mvs`.
    OpenMvs,
}

impl Kind {
    /// All kinds, in the order in which help names them.
    pub const ALL: [Self; 3] = [Self::Colmap, Self::Nerfstudio, Self::OpenMvs];

    /// The kind's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Colmap => "colmap",
            Self::Nerfstudio => "nerfstudio",
            Self::OpenMvs => "openmvs",
        }
    }

    /// The name of a picture's mask below `masks`.
    fn mask_name(self, picture: &str) -> String {
        match self {
            // COLMAP looks for the picture's whole name with another ending.
            Self::Colmap => format!("{picture}.png"),
            Self::Nerfstudio | Self::OpenMvs => picture.to_owned(),
        }
    }
}

/// A file of a dataset.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct File {
    /// Its path in the dataset's folder, with `/`.
    pub path: String,
    /// Its content.
    pub bytes: Vec<u8>,
}

/// The files of a dataset. The world is the rig's frame: metres, z up.
///
/// # Errors
/// If a picture cannot be encoded.
pub fn files(kind: Kind, views: &[View], points: &[Point]) -> Result<Vec<File>, output::Error> {
    let pictures: Vec<Vec<File>> = views
        .par_iter()
        .map(|view| pictures(kind, view))
        .collect::<Result<_, _>>()?;
    let mut files: Vec<File> = pictures.into_iter().flatten().collect();
    let described = match kind {
        Kind::Colmap => colmap::describe(views, points),
        Kind::Nerfstudio => nerfstudio::describe(views, points),
        Kind::OpenMvs => openmvs::describe(views, points),
    };
    files.extend(described);
    Ok(files)
}

fn pictures(kind: Kind, view: &View) -> Result<Vec<File>, output::Error> {
    let name = view.picture_name();
    let mut files = vec![File {
        path: format!("images/{name}"),
        bytes: encode_png(&view.picture)?,
    }];
    if let Some(mask) = &view.mask {
        files.push(File {
            path: format!("masks/{}", kind.mask_name(&name)),
            bytes: encode_grey_png(mask)?,
        });
    }
    Ok(files)
}

//! The visual hull V (the paper's template, section 2.C): everything within the volume that lies inside the
//! silhouette of each camera that can see it. Bounded by the cones and the volume; its surface is extracted
//! by `surface`, with vertices on exact crossings of the silhouettes.

mod carving;
mod cone;
mod creases;
mod directions;
mod extremes;
mod solid;
mod steps;
mod up_directions;
mod viewing;

pub use carving::{Carved, Carving, carving_of};
pub use cone::Cone;
pub use directions::Directions;
pub use solid::{Bounds, FLOOR, Hull, Plane};
pub use up_directions::UpDirections;
pub use viewing::Exit;

use super::surface::{self, Constraint, Lattice, SampledSolid, Solid, Surface};
use crate::calibration::Volume;
use crate::mesh;
use nalgebra::Point3;

/// How the hull is computed.
#[derive(Clone, Debug, PartialEq, serde::Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// Edge of a cell in metres; 0 chooses it from `resolution`.
    /// Default 0, range 0 to 1000.
    #[serde(deserialize_with = "crate::range::within::<_, f64, 0, 1000>")]
    pub cell_size: f64,
    /// Cells along the diagonal of the object's bounds, if `cell_size` is 0. 200 give 70,000 to 90,000 vertices.
    /// Default 200, range 8 to 1000.
    #[serde(deserialize_with = "crate::range::within::<_, f64, 8, 1000>")]
    pub resolution: f64,
    /// If `cell_size` is 0, cells are not made smaller than this many pixels.
    /// Default 0.6, range 0 to 1000.
    #[serde(deserialize_with = "crate::range::within::<_, f64, 0, 1000>")]
    pub smallest_cell_px: f64,
    /// Cameras that must see a point before it can be part of the object.
    /// Default 2, range 1 to 1000.
    #[serde(deserialize_with = "crate::range::count::<_, usize, 1, 1000>")]
    pub least_views: usize,
    /// Pieces with a smaller share of the largest one's volume are dropped: they are specks, or phantoms where cones
    /// meet away from the object.
    /// Default 0.05, range 0 to 1.
    #[serde(deserialize_with = "crate::range::within::<_, f64, 0, 1>")]
    pub smallest_piece: f64,
    /// How the facets that it has between views are treated. Default `touch`.
    pub fairing: Fairing,
}

/// How the facets that the hull has where no view touches the object are treated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Fairing {
    /// They stay: the paper's visual hull.
    None,
    /// The surface of least bending whose outlines lie on the contours takes their place.
    #[default]
    Touch,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            cell_size: 0.0,
            resolution: 200.0,
            smallest_cell_px: 0.6,
            least_views: 2,
            smallest_piece: 0.05,
            fairing: Fairing::Touch,
        }
    }
}

/// Pieces with a smaller share of the largest one's volume are dropped without being counted.
const SPECK: f64 = 1e-4;

/// Why there is no hull.
#[derive(Debug, thiserror::Error, PartialEq)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Error {
    /// The cones meet nowhere.
    #[error(
        "the silhouettes meet nowhere within the volume {min:.3?} to {max:.3?} m: the object lies outside it, \
         or a camera's silhouette or pose is wrong{}",
        empty.as_ref().map(|id| format!(" (nothing of the volume is inside camera {id}'s silhouette)"))
            .unwrap_or_default()
    )]
    Empty {
        /// The volume's smallest corner.
        min: [f64; 3],
        /// The volume's largest corner.
        max: [f64; 3],
        /// A camera that sees nothing of the object within the volume, if there is one.
        empty: Option<String>,
    },
    /// Something in the volume, but nothing that a cell could hold.
    #[error(
        "the visual hull is thinner than its cells of {cell_size:.2e} m everywhere: the rig is empty, or \
         hull.cell_size must be smaller"
    )]
    Thin {
        /// Edge of a cell.
        cell_size: f64,
    },
    /// Silhouettes that cannot be those of an object.
    #[error(
        "the hull's surface crosses {cells} cells, expected at most {most} for an object of this size: \
         silhouettes are speckled{}",
        camera.as_ref().map(|id| format!(" (camera {id}'s most)")).unwrap_or_default()
    )]
    Ragged {
        /// Cells that the surface may cross.
        cells: usize,
        /// Most that it may.
        most: usize,
        /// The camera whose silhouette has the longest outline for its size.
        camera: Option<String>,
    },
    /// Pixels in which no form can be seen, as with a focal length that is a thousandth of the right one.
    #[error(
        "a pixel of camera {camera} covers {pixel:.2e} m at the object, which is {diagonal:.2e} m across: check the focal \
         lengths and places in the calibration"
    )]
    CoarsePixels {
        /// The camera with the coarsest pixels.
        camera: String,
        /// Edge of its pixel at the object, in metres.
        pixel: f64,
        /// Diagonal of what the silhouettes leave of the volume, in metres.
        diagonal: f64,
    },
    /// A cell size so small that it would need too much work.
    #[error(
        "hull.cell_size is {found} m: expected {:.3} mm or more for an object of this size, or 0", 1e3 * least
    )]
    CellTooSmall { found: f64, least: f64 },
    /// A cell size so large that the object's form is lost, as when it was given in millimetres.
    #[error(
        "hull.cell_size is {found} m: expected {:.3} mm or less for an object of this size, or 0", 1e3 * most
    )]
    CellTooLarge { found: f64, most: f64 },
}

/// A solid's surface.
pub struct ExtractedSurface {
    /// The surface, without stray pieces.
    pub surface: Surface,
    /// What was seen of the solid, to extract another one on the same lattice that differs in places.
    pub sampled: SampledSolid,
    /// Pieces that were dropped, but for specks.
    pub dropped_pieces: usize,
}

/// Cells along the diagonal of an object's bounds, as `hull.resolution` may have them.
const FEWEST_ACROSS: f64 = 8.0;
const MOST_ACROSS: f64 = 1000.0;

/// Chooses the lattice for an object: over its bounds, with cells of the right size.
///
/// # Errors
/// If the hull is empty, or the cell size asked for cannot be.
pub fn lattice(hull: &Hull, parameters: &Parameters) -> Result<Lattice, Error> {
    let (low, high) = bounds(hull)?;
    let diagonal = (high - low).norm().max(Volume::SHORTEST_EDGE);
    let (least, most) = (diagonal / MOST_ACROSS, diagonal / FEWEST_ACROSS);
    let cell_size = if parameters.cell_size == 0.0 {
        let middle = nalgebra::center(&low, &high);
        let footprint = hull.pixel_footprint(middle);
        if footprint > most {
            let (camera, pixel) = hull.coarsest_camera(middle);
            return Err(Error::CoarsePixels {
                camera,
                pixel,
                diagonal,
            });
        }
        (diagonal / parameters.resolution).max(parameters.smallest_cell_px * footprint)
    } else if parameters.cell_size < least {
        return Err(Error::CellTooSmall {
            found: parameters.cell_size,
            least,
        });
    } else if parameters.cell_size > most {
        return Err(Error::CellTooLarge {
            found: parameters.cell_size,
            most,
        });
    } else {
        parameters.cell_size
    };
    Ok(Lattice::covering(low, high, cell_size))
}

/// A box around the hull, some cells of a coarse lattice wider than it.
fn bounds(hull: &Hull) -> Result<(Point3<f64>, Point3<f64>), Error> {
    /// Cells along the diagonal of the box that is searched.
    const ACROSS: f64 = 96.0;
    /// Where the hull is shorter than so much of what was searched, it is searched again, with cells of its size.
    const ROOMY: f64 = 0.5;
    let Volume { min, max } = hull.volume();
    let (mut low, mut high) = (min, max);
    loop {
        let searched = (high - low).norm();
        let found = surface::bounds(hull, &Lattice::covering(low, high, searched / ACROSS));
        let (lowest, highest) = found.ok_or_else(|| Error::Empty {
            min: min.into(),
            max: max.into(),
            empty: hull.blind_camera().map(ToString::to_string),
        })?;
        (low, high) = (lowest.sup(&min), highest.inf(&max));
        let diagonal = (high - low).norm();
        if diagonal > ROOMY * searched || diagonal < Volume::SHORTEST_EDGE {
            return Ok((low, high));
        }
    }
}

/// Cells that a hull's surface may cross, as a multiple of the square of those along its diagonal: a cube
/// crosses twice the square, speckled silhouettes most cells there are.
const MOST_CELLS: f64 = 10.0;
/// Where pixels are coarser than cells, a silhouette decides nothing about the cells within about two pixels of its
/// contour: so many times more cells count as crossed, for pixels of one cell's size. At most `MOST_UNDECIDED` times.
const UNDECIDED_A_PIXEL: f64 = 2.0;
const MOST_UNDECIDED: f64 = 8.0;

fn most_cells(hull: &Hull, lattice: &Lattice) -> usize {
    let cells = nalgebra::Vector3::from(lattice.cells.map(f64::from));
    let middle = lattice.corner(lattice.cells.map(|n| n / 2));
    let pixel_in_cells = hull.pixel_footprint(middle) / lattice.cell_size;
    let undecided = (UNDECIDED_A_PIXEL * pixel_in_cells).clamp(1.0, MOST_UNDECIDED);
    (MOST_CELLS * undecided * cells.norm_squared()) as usize
}

/// Extracts the hull's surface and drops stray pieces.
///
/// # Errors
/// If there is no surface, or one that is far more ragged than that of any object.
pub fn extract(
    hull: &Hull,
    lattice: &Lattice,
    parameters: &Parameters,
) -> Result<ExtractedSurface, Error> {
    let most = most_cells(hull, lattice);
    match surface::extract(hull, lattice, most) {
        Ok((surface, _)) if surface.mesh.triangles.is_empty() => Err(Error::Thin {
            cell_size: lattice.cell_size,
        }),
        Ok(surface) => Ok(without_stray_pieces(surface, parameters)),
        Err(cells) => Err(Error::Ragged {
            cells,
            most,
            camera: hull.most_ragged_camera().map(ToString::to_string),
        }),
    }
}

/// Extracts the surface of another solid than a hull, about as large as one, and drops stray pieces; `None` where there
/// is none.
pub fn extract_solid(
    solid: &impl Solid,
    lattice: &Lattice,
    parameters: &Parameters,
) -> Option<ExtractedSurface> {
    let cells = nalgebra::Vector3::from(lattice.cells.map(f64::from));
    let most = (MOST_CELLS * cells.norm_squared()) as usize;
    let found = surface::extract(solid, lattice, most).ok()?;
    (!found.0.mesh.triangles.is_empty()).then(|| without_stray_pieces(found, parameters))
}

/// Extracts the surface of a solid that is the one of `before` but in the cubes (given by center and half edge)
/// in which it `may_differ`, and drops stray pieces.
pub fn extract_changed(
    solid: &impl Solid,
    lattice: &Lattice,
    before: &SampledSolid,
    may_differ: impl Fn(Point3<f64>, f64) -> bool + Sync,
    parameters: &Parameters,
) -> ExtractedSurface {
    let changed = surface::extract_changed(solid, lattice, before, may_differ);
    without_stray_pieces(changed, parameters)
}

fn without_stray_pieces(
    (surface, sampled): (Surface, SampledSolid),
    parameters: &Parameters,
) -> ExtractedSurface {
    let pieces = mesh::components(&surface.mesh);
    let largest = pieces.parts.iter().map(|p| p.volume).fold(0.0, f64::max);
    let keep: Vec<bool> = pieces
        .parts
        .iter()
        .map(|p| p.volume >= parameters.smallest_piece * largest)
        .collect();
    if keep.iter().all(|&k| k) {
        return ExtractedSurface {
            surface,
            sampled,
            dropped_pieces: 0,
        };
    }
    let is_speck = |volume: f64| volume.abs() < SPECK * largest;
    let dropped = pieces
        .parts
        .iter()
        .zip(&keep)
        .filter(|(p, k)| !**k && !is_speck(p.volume));
    let dropped_pieces = dropped.count();
    let (mesh, sources) = mesh::extract(&surface.mesh, &pieces, |piece| keep[piece as usize]);
    let constraints = sources
        .iter()
        .map(|&v| surface.constraints[v as usize])
        .collect();
    ExtractedSurface {
        surface: Surface { mesh, constraints },
        sampled,
        dropped_pieces,
    }
}

/// Whether a constraint is a table: the volume's floor, or that of a capture that was fused into the scene.
pub fn is_floor(constraint: Constraint) -> bool {
    constraint == solid::FLOOR
}

#[cfg(test)]
mod tests;

//! Restoration of the concave regions (the paper's section 2.F), in two forms.
//!
//! - `carve` (the default): the hull is carved by the enhanced depth in the regions, which opens handles and
//!   rings as a height field cannot, then the patches that face the camera are relaxed towards the depth;
//! - `lid` (the paper's): the hull's patch over each region is given the Laplacian coordinates of the depth.

mod between;
mod carve;
mod coating;
mod consistency;
mod even_walls;
mod factor;
mod iterate;
mod laplacian;
mod provenance;
mod relax;
#[cfg(test)]
mod testing;

pub use even_walls::EvenWalls;
use even_walls::{Sight, even_walls};
pub use laplacian::Singular;

use super::depth::EnhancedDepth;
use super::fairing::FairedSolid;
use super::hull::{self, Carved, Carving, ExtractedSurface, Hull, carving_of};
use super::region::Regions;
use super::surface::{Constraint, Lattice, Solid};
use super::{FusedCaptures, Model};
use crate::calibration::DepthCamera;
use crate::image::Grid;
use nalgebra::Point3;

/// How much of the plain hull may be left where the outside counts as faired.
const MOST_KEPT: f64 = 0.5;

/// The form of the restoration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Form {
    /// Carving, then relaxing.
    #[default]
    Carve,
    /// The paper's coating transfer onto the hull's lid.
    #[serde(rename = "lid")]
    Coating,
}

/// How concave regions are restored. Lengths in millimetres where the name says so.
#[derive(Clone, Debug, PartialEq, serde::Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// Which form.
    pub form: Form,
    /// Thinnest wall that is kept unless the depth clearly shows that there is no wall.
    /// Default 2, range 0 to 1000000.
    #[serde(deserialize_with = "crate::range::within::<_, f32, 0, 1000000>")]
    pub least_wall_mm: f32,
    /// How many readings must agree before the object is opened all the way through.
    /// Default 6, range 1 to 1000000.
    #[serde(deserialize_with = "crate::range::count::<_, usize, 1, 1000000>")]
    pub least_opening_px: usize,
    /// For `carve`: weight of smoothness relative to the depth. 0 leaves the carved surface as it is.
    /// Default 1, range 0 to 1000000.
    #[serde(deserialize_with = "crate::range::within::<_, f64, 0, 1000000>")]
    pub smoothness: f64,
    /// For `carve`: whether the inside of a wall whose outside is faired goes to where the wall's thickness is even, as
    /// far as it may be off. Default true.
    pub even_walls: bool,
    /// For `lid`: weight of the depth's positions relative to its Laplacian coordinates. With 0 the border is the only
    /// anchor.
    /// Default 0.1, range 0 to 1000000.
    #[serde(deserialize_with = "crate::range::within::<_, f64, 0, 1000000>")]
    pub anchor_weight: f64,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            form: Form::Carve,
            least_wall_mm: 2.0,
            least_opening_px: 6,
            smoothness: 1.0,
            even_walls: true,
            anchor_weight: 0.1,
        }
    }
}

/// What one depth camera contributes.
#[derive(Clone, Copy)]
pub struct Source<'a> {
    /// The number of its view in the scene.
    pub number: usize,
    /// The camera.
    pub camera: &'a DepthCamera,
    /// Its enhanced depth.
    pub depth: &'a EnhancedDepth,
    /// The regions that it sees.
    pub regions: &'a Regions,
}

/// What a restoration starts from.
pub struct Template<'a> {
    /// The plain hull, and its cones.
    pub hull: &'a Hull<'a>,
    /// How the object stood in the captures that the hull is of.
    pub fused_captures: &'a FusedCaptures,
    /// What is carved: the hull, plain or faired.
    pub solid: &'a dyn Solid,
    /// The faired hull, if that is what is carved.
    pub faired: Option<&'a FairedSolid>,
    /// The surface of `solid`.
    pub extracted: &'a ExtractedSurface,
    /// The lattice that it was extracted on.
    pub lattice: &'a Lattice,
    /// How it was extracted.
    pub parameters: &'a hull::Parameters,
    /// T of equation 4.
    pub front_threshold: f32,
}

/// A restored model and what happened to it.
pub struct Restored {
    /// The model, not yet textured.
    pub model: Model,
    /// Pieces that were cut off and dropped.
    pub dropped_pieces: usize,
    /// Rays of colour cameras that carving had opened and that were closed again.
    pub closed_openings: usize,
    /// What became of its walls; `None` where none was made even.
    pub even_walls: Option<EvenWalls>,
}

impl Restored {
    /// A model that nothing was carved off.
    pub fn uncarved(model: Model) -> Self {
        Self {
            model,
            dropped_pieces: 0,
            closed_openings: 0,
            even_walls: None,
        }
    }
}

/// The hull as it is: for objects without concave regions, and as a baseline.
pub fn plain(template: &Template) -> Model {
    provenance::describe(template.extracted.surface.clone(), template, &[])
}

/// Restores the regions of all `sources`. Without any region the result is [`plain`], bit for bit.
///
/// # Errors
/// If a Laplacian system has no anchor.
pub fn restore(
    template: &Template,
    sources: &[Source],
    parameters: &Parameters,
) -> Result<Restored, Singular> {
    let sources: Vec<Source> = sources
        .iter()
        .copied()
        .filter(|s| s.regions.count > 0)
        .collect();
    if sources.is_empty() {
        return Ok(Restored::uncarved(plain(template)));
    }
    let cell_size = template.lattice.cell_size;
    let mut depths: Vec<Grid<f32>> = sources
        .iter()
        .map(|s| carve::carving_depth(s, cell_size, parameters))
        .collect();
    between::keep_between(&mut depths, &sources, cell_size, parameters);
    match parameters.form {
        Form::Carve => carve_and_relax(template, &sources, depths, parameters),
        Form::Coating => {
            let mut model = plain(template);
            for (source, depth) in sources.iter().zip(&depths) {
                coating::restore(&mut model, source, depth, parameters, template)?;
            }
            Ok(Restored::uncarved(model))
        }
    }
}

fn carve_and_relax(
    template: &Template,
    sources: &[Source],
    depths: Vec<Grid<f32>>,
    parameters: &Parameters,
) -> Result<Restored, Singular> {
    let (surface, mut restored) = carve_by(template, sources, depths);
    let source_of = |v: usize| carving_of(surface[v]);
    if parameters.smoothness > 0.0 {
        relax::relax(&mut restored.model, sources, source_of, parameters)?;
    }
    if let Some(faired) = template.faired.filter(|_| parameters.even_walls) {
        let sight_of = |v: usize, model: &Model| {
            let camera = &sources[source_of(v)?].camera.camera;
            let p: Point3<f64> = model.mesh.vertices[v].cast();
            let view = (camera.center() - p).normalize();
            Some(Sight {
                pixel: camera.pixel_footprint(p),
                facing: view.dot(&model.normals[v].cast()),
            })
        };
        let is_faired = |p| faired.kept(p) < MOST_KEPT;
        restored.even_walls = even_walls(&mut restored.model, sight_of, is_faired);
    }
    Ok(restored)
}

/// The depth hull of the paper's Fig. 6: the hull carved by every reading, in a region or not, but for thin
/// walls, which noise would perforate.
pub fn depth_hull(template: &Template, sources: &[Source], parameters: &Parameters) -> Restored {
    let cell_size = template.lattice.cell_size;
    let depths = sources
        .iter()
        .map(|s| carve::carving_depth_everywhere(s, cell_size, parameters))
        .collect();
    carve_by(template, sources, depths).1
}

/// Carves the hull, and closes what that opened; also tells the constraint of each vertex.
fn carve_by(
    template: &Template,
    sources: &[Source],
    mut depths: Vec<Grid<f32>>,
) -> (Vec<Constraint>, Restored) {
    let cell_size = template.lattice.cell_size;
    let carvings_by = |depths: &[Grid<f32>]| -> Vec<Carving> {
        let pairs = sources.iter().zip(depths);
        let carvings = pairs.map(|(s, d)| Carving::new(s.camera, d.clone(), cell_size));
        if sources.len() == 1 {
            carvings.map(Carving::with_edges).collect()
        } else {
            carvings.collect()
        }
    };
    // Whatever differs from what was extracted before lies where these carvings reach.
    let extract = |carvings: &[Carving], before, changed: &[Carving]| {
        let may_differ = |center, half| changed.iter().any(|c| c.touches(center, half));
        let carved = Carved::new(template.solid, carvings);
        hull::extract_changed(
            &carved,
            template.lattice,
            before,
            may_differ,
            template.parameters,
        )
    };
    let carvings = carvings_by(&depths);
    let mut extracted = extract(&carvings, &template.extracted.sampled, &carvings);
    let closed_openings = consistency::close_openings(
        template,
        &extracted.surface.mesh,
        &carvings,
        &mut depths,
        cell_size,
    );
    // Once: hardly any is left after that.
    if closed_openings > 0 {
        let closed = carvings_by(&depths);
        let changed: Vec<Carving> = carvings.iter().zip(&closed).map(Carving::changed).collect();
        extracted = extract(&closed, &extracted.sampled, &changed);
    }
    let constraints = extracted.surface.constraints.clone();
    let model = provenance::describe(extracted.surface, template, sources);
    let restored = Restored {
        model,
        dropped_pieces: extracted.dropped_pieces,
        closed_openings,
        even_walls: None,
    };
    (constraints, restored)
}

//! Runs the stages in their order: no other file knows it. A stage's work is done in its own folder.

use super::depth::{self, EnhancedDepth};
use super::faired_surface::{FairedSurface, FairingResult, PlainHull};
use super::fairing;
use super::hull::{self, Cone, Hull, UpDirections};
use super::region::{
    self, BesideRegions, Bias, HullRenderings, InFrontOfHull, OutlineOffset, Regions,
};
use super::restore::{self, EvenWalls, Restored, Source, Template};
use super::silhouette::{self, Silhouette};
use super::surface::Solid;
use super::texture;
use super::uncertainty::{self, FairedHull, OutsideErrors, RoundBody, UnrequiredPiece};
use super::{DepthView, FusedCaptures, Model, Progress, Scene, Stage, Texture};
use crate::calibration::DepthCamera;
use crate::image::Mask;
use crate::mesh::{Mesh, Simplified, SimplifyError, mean_departures, simplify, vertex_normals};
use nalgebra::Point3;
use rayon::prelude::*;

/// Which model is made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// The hull with its concave regions restored from the depth.
    #[default]
    Hybrid,
    /// The visual hull alone.
    Hull,
    /// The hull carved by depth everywhere, but for thin walls.
    DepthHull,
}

/// The parameters of every stage. Values the paper gives are the defaults.
#[derive(Clone, Debug, Default, PartialEq, serde::Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// Which model is made.
    pub method: Method,
    /// Vertices to simplify the model to; 0 leaves it as it is.
    pub vertices: usize,
    /// Silhouettes from masks or backgrounds.
    pub silhouette: silhouette::Parameters,
    /// The visual hull.
    pub hull: hull::Parameters,
    /// Depth enhancement.
    pub depth: depth::Parameters,
    /// The concave regions.
    pub region: region::Parameters,
    /// Their restoration.
    pub restoration: restore::Parameters,
    /// The colours.
    pub texture: texture::Parameters,
}

/// Why there is no model.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A silhouette cannot be found.
    #[error(transparent)]
    Silhouette(#[from] silhouette::Error),
    /// There is no hull.
    #[error(transparent)]
    Hull(#[from] hull::Error),
    /// A depth burst cannot be enhanced.
    #[error(transparent)]
    Depth(#[from] depth::Error),
    /// A region cannot be restored.
    #[error(transparent)]
    Restoration(#[from] restore::Singular),
    /// The model cannot be simplified.
    #[error(transparent)]
    Simplify(#[from] SimplifyError),
    /// Too few cameras.
    #[error("only {found} colour camera(s) gave a silhouette: a visual hull needs two or more")]
    TooFewCameras {
        /// How many there are.
        found: usize,
    },
    /// The volume is not where the object is.
    #[error(
        "the volume {min:?} to {max:?} m is not where the object is, or the rig is empty: {blind} of {cameras} colour \
         cameras see no object in it, and {away} of these do not see the volume at all (the first says: {first})"
    )]
    Volume {
        /// The volume's smallest corner.
        min: [f64; 3],
        /// The volume's largest corner.
        max: [f64; 3],
        /// Cameras without an object in the volume.
        blind: usize,
        /// Those of them whose picture the volume is not in.
        away: usize,
        /// All colour cameras.
        cameras: usize,
        /// What is wrong with the first of them.
        first: silhouette::Error,
    },
    /// Someone asked it to stop.
    #[error("the reconstruction was cancelled")]
    Cancelled,
}

/// A model, and what was found on the way to it.
pub struct Reconstruction {
    /// The model, textured.
    pub model: Model,
    /// The plain hull that it was made from.
    pub hull: Mesh,
    /// How the hull was faired, or why nothing of it could be; `None` where that was not asked for.
    pub fairing: Option<Result<fairing::Facts, fairing::Refusal>>,
    /// Edge of a cell of the surfaces, in metres.
    pub cell_size: f64,
    /// The directions that were up in the scene's captures.
    pub up: UpDirections,
    /// A silhouette for each colour view of the scene.
    pub silhouettes: Vec<Silhouette>,
    /// What was found in each depth view of the scene.
    pub depths: Vec<DepthResult>,
    /// Stray pieces dropped from the hull.
    pub dropped_hull_pieces: usize,
    /// Pieces that carving cut off, dropped.
    pub dropped_carved_pieces: usize,
    /// Cubic metres that no camera objects to, but too few see past what they ignore; `None` where none ignores any.
    pub unproved_volume: Option<f64>,
    /// Pieces of the model that no silhouette requires, marked as unseen, the largest first.
    pub unrequired_pieces: Vec<UnrequiredPiece>,
    /// Rays of colour cameras that carving had opened and that were closed again.
    pub closed_openings: usize,
    /// What became of the walls of the model; `None` where none was made even.
    pub even_walls: Option<EvenWalls>,
}

/// What was found in one depth view.
pub struct DepthResult {
    /// Its enhanced depth.
    pub enhanced: EnhancedDepth,
    /// Its concave regions.
    pub regions: Regions,
    /// How far the object's outline is from the hull's; `None` where that cannot be told.
    pub outline: Option<OutlineOffset>,
    /// How far its readings are from the hull where the model stays the hull; `None` where that cannot be told.
    pub beside_regions: Option<BesideRegions>,
    /// What was read in front of the hull, if that can be told.
    pub in_front_of_hull: Option<InFrontOfHull>,
}

/// Pixels around the hull's image in which depth is enhanced: the filter's kernel wants them.
const OBJECT_MARGIN_PX: usize = 4;

/// Makes a model of a scene. The result depends on nothing but its arguments.
///
/// # Errors
/// What makes a model impossible, with the camera and the value that are to blame.
pub fn reconstruct(
    scene: &Scene,
    parameters: &Parameters,
    progress: &dyn Progress,
) -> Result<Reconstruction, Error> {
    begin(Stage::Silhouettes, progress)?;
    let silhouettes = silhouettes(scene, parameters)?;
    reconstruct_from(
        scene,
        silhouettes,
        &FusedCaptures::default(),
        parameters,
        progress,
    )
}

/// Makes a model of a scene whose silhouettes are known, which may be fused of several captures: `fused_captures` says
/// how the object stood in each.
///
/// # Errors
/// What makes a model impossible, with the camera and the value that are to blame.
pub fn reconstruct_from(
    scene: &Scene,
    silhouettes: Vec<Silhouette>,
    fused_captures: &FusedCaptures,
    parameters: &Parameters,
    progress: &dyn Progress,
) -> Result<Reconstruction, Error> {
    let begin = |stage| begin(stage, progress);
    begin(Stage::Hull)?;
    let hull = hull_of(scene, &silhouettes, fused_captures, &parameters.hull);
    let lattice = hull::lattice(&hull, &parameters.hull)?;
    let extracted = hull::extract(&hull, &lattice, &parameters.hull)?;

    begin(Stage::Fairing)?;
    let plain = PlainHull {
        hull: &hull,
        lattice: &lattice,
        extracted: &extracted,
        is_fused: fused_captures.is_of_several(),
        parameters: &parameters.hull,
    };
    let faired = plain.faired();

    begin(Stage::Depth)?;
    let inputs = DepthInputs {
        scene,
        fused_captures,
        plain: &extracted.surface.mesh,
        parameters,
    };
    let (faired, seen) = held_by_depth(&plain, faired, &inputs)?;
    let start = plain.start(&faired);
    let solid: &dyn Solid = match &faired {
        Some(Ok(surface)) => &surface.faired.solid,
        _ => &hull,
    };
    let round_body = match &faired {
        Some(Ok(surface)) => RoundBody::find(&surface.faired.touches),
        _ => None,
    };
    let faired_hull = match &faired {
        Some(Ok(surface)) => Some(FairedHull {
            plain: &extracted.surface.mesh,
            solid: &surface.faired.solid,
            contour_rms_px: surface.faired.facts.contour_rms_px,
            touches: &surface.faired.touches,
            round_body: round_body.as_ref(),
        }),
        _ => None,
    };
    let template = Template {
        hull: &hull,
        fused_captures,
        solid,
        faired: faired_hull.map(|faired| faired.solid),
        extracted: start,
        lattice: &lattice,
        parameters: &parameters.hull,
        front_threshold: parameters.region.front_threshold,
    };

    if parameters.method != Method::Hull {
        begin(Stage::Region)?;
    }
    let errors = OutsideErrors::new(&hull, faired_hull, lattice.cell_size);
    let mut depths = regions_of(scene, fused_captures, seen, &errors, parameters);
    let regions = depths.iter_mut().map(|d| (&d.enhanced, &mut d.regions));
    fused_captures.leave_each_region_to_one(&mut regions.collect::<Vec<_>>());

    begin(Stage::Restoration)?;
    let mut restored = restore(&template, scene, &depths, parameters)?;
    let read = scene.depths.iter().zip(&depths);
    let evidence = uncertainty::Evidence {
        hull: &hull,
        faired: faired_hull,
        readings: read
            .map(|(view, found)| uncertainty::Readings {
                camera: &view.camera,
                depth: &found.enhanced,
                regions: &found.regions,
            })
            .collect(),
        cell_size: lattice.cell_size,
    };
    uncertainty::state_errors(&mut restored.model, &evidence);
    let unrequired_pieces =
        uncertainty::mark_unrequired(&mut restored.model, hull.cones(), &evidence.readings);

    if parameters.vertices > 0 {
        restored.model = simplified(restored.model, parameters.vertices)?;
    }

    begin(Stage::Texture)?;
    let unproved_volume = hull.unproved_volume();
    let texture = paint(
        &restored.model,
        scene,
        &silhouettes,
        fused_captures,
        parameters,
    );
    restored.model.texture = Some(texture);
    Ok(Reconstruction {
        model: restored.model,
        cell_size: lattice.cell_size,
        up: UpDirections::of(hull.bounds()),
        silhouettes,
        depths,
        dropped_hull_pieces: extracted.dropped_pieces,
        dropped_carved_pieces: restored
            .dropped_pieces
            .saturating_sub(extracted.dropped_pieces),
        unproved_volume,
        unrequired_pieces,
        closed_openings: restored.closed_openings,
        even_walls: restored.even_walls,
        fairing: faired.map(|faired| faired.map(|surface| surface.faired.facts)),
        hull: extracted.surface.mesh,
    })
}

fn begin(stage: Stage, progress: &dyn Progress) -> Result<(), Error> {
    progress.stage(stage);
    if progress.is_cancelled() {
        Err(Error::Cancelled)
    } else {
        Ok(())
    }
}

/// The solid that the cones of all silhouettes bound, above the tables on which the object stood.
fn hull_of<'a>(
    scene: &'a Scene,
    silhouettes: &'a [Silhouette],
    fused_captures: &FusedCaptures,
    parameters: &hull::Parameters,
) -> Hull<'a> {
    let cones = scene
        .colors
        .par_iter()
        .zip(silhouettes)
        .map(|(v, s)| Cone::with_unknown(&v.camera, &s.level, s.unknown.as_ref()))
        .collect();
    Hull::new(cones, scene.volume, parameters.least_views).within(&fused_captures.tables)
}

/// Paints a model with the pictures of the colour views, those of the captures first that have priority.
fn paint(
    model: &Model,
    scene: &Scene,
    silhouettes: &[Silhouette],
    fused_captures: &FusedCaptures,
    parameters: &Parameters,
) -> Texture {
    let masks: Vec<&Mask> = silhouettes.iter().map(|s| &s.level).collect();
    let order = texture::ViewPriority {
        ranks: &fused_captures.ranks,
        captures: &fused_captures.captures,
    };
    texture::paint_in_order(model, scene, &masks, &order, &parameters.texture)
}

/// The silhouettes of a capture's colour views, in their order.
///
/// # Errors
/// If one cannot be found, with its camera.
pub fn silhouettes(scene: &Scene, parameters: &Parameters) -> Result<Vec<Silhouette>, Error> {
    if scene.colors.len() < 2 {
        return Err(Error::TooFewCameras {
            found: scene.colors.len(),
        });
    }
    let extract = |view| silhouette::extract(view, &scene.volume, &parameters.silhouette);
    // Collected in the order of the cameras, so that the first error is always the same one.
    let found: Vec<_> = scene.colors.par_iter().map(extract).collect();
    if let Some(error) = misplaced_volume(scene, &found) {
        return Err(error);
    }
    Ok(found.into_iter().collect::<Result<_, _>>()?)
}

/// Where most cameras see no object in the volume, or half of them do not have the volume in their pictures, the volume
/// is to blame, and not the first of them.
fn misplaced_volume(
    scene: &Scene,
    found: &[Result<Silhouette, silhouette::Error>],
) -> Option<Error> {
    use silhouette::Error::{Empty, VolumeNotSeen};
    let errors = || found.iter().filter_map(|f| f.as_ref().err());
    let blind = errors().filter(|e| matches!(e, Empty { .. } | VolumeNotSeen { .. }));
    let blind: Vec<_> = blind.collect();
    let away = errors()
        .filter(|e| matches!(e, VolumeNotSeen { .. }))
        .count();
    let is_misplaced = 2 * blind.len() > found.len() || 2 * away >= found.len();
    is_misplaced.then(|| Error::Volume {
        min: scene.volume.min.into(),
        max: scene.volume.max.into(),
        blind: blind.len(),
        away,
        cameras: found.len(),
        first: blind[0].clone(),
    })
}

/// What depth is compared with the hull by.
struct DepthInputs<'a> {
    scene: &'a Scene,
    fused_captures: &'a FusedCaptures,
    /// The plain hull's surface, which contains the object.
    plain: &'a Mesh,
    parameters: &'a Parameters,
}

impl DepthInputs<'_> {
    /// What each depth camera sees of `start`, the surface that regions are found on, with its depth enhanced; nothing
    /// where the model is the hull alone.
    fn see(&self, start: &Mesh) -> Result<Vec<DepthOfHull>, Error> {
        let (scene, parameters) = (self.scene, self.parameters);
        if parameters.method == Method::Hull {
            return Ok(Vec::new());
        }
        let normals = vertex_normals(start);
        let threshold = parameters.region.front_threshold;
        let mut seen: Vec<DepthOfHull> = Vec::new();
        for (i, view) in scene.depths.iter().enumerate() {
            let front = HullRenderings::render(start, &normals, &view.camera, threshold);
            let object = front.object_pixels(OBJECT_MARGIN_PX);
            let enhanced = depth::enhance(view, &object, &parameters.depth)?;
            let (in_rig, volume) = self.fused_captures.depth_in_its_rig(scene, i);
            let plain = || self.plain_front(&view.camera);
            let bias = region::bias(
                plain,
                in_rig,
                &enhanced,
                volume,
                &object,
                &parameters.region,
            );
            seen.push(DepthOfHull {
                front,
                object,
                enhanced,
                bias,
            });
        }
        fuse_depths(scene, self.fused_captures, &mut seen);
        Ok(seen)
    }

    /// The plain hull as a depth camera sees it.
    fn plain_front(&self, camera: &DepthCamera) -> HullRenderings {
        let normals = vertex_normals(self.plain);
        let threshold = self.parameters.region.front_threshold;
        HullRenderings::render(self.plain, &normals, camera, threshold)
    }

    /// The points of the faired hull in front of which depth cameras read the object.
    fn read_in_front(&self, seen: &[DepthOfHull]) -> Vec<Point3<f64>> {
        let of_camera = |(view, seen): (&DepthView, &DepthOfHull)| {
            let camera = &view.camera;
            let view = region::FairedHullView {
                camera,
                depth: &seen.enhanced,
                bias: &seen.bias,
                faired: &seen.front,
            };
            let plain = || self.plain_front(camera);
            region::read_in_front(&view, plain, &self.parameters.region)
        };
        self.scene
            .depths
            .iter()
            .zip(seen)
            .flat_map(of_camera)
            .collect()
    }
}

/// What each depth camera sees of the surface that a model starts from, and how that was faired: not where a depth
/// camera reads the object in front of it.
fn held_by_depth(
    plain: &PlainHull,
    faired: FairingResult,
    inputs: &DepthInputs,
) -> Result<(FairingResult, Vec<DepthOfHull>), Error> {
    let seen = inputs.see(&plain.start(&faired).surface.mesh)?;
    let surface: FairedSurface = match faired {
        Some(Ok(surface)) if !seen.is_empty() => surface,
        other => return Ok((other, seen)),
    };
    let places = inputs.read_in_front(&seen);
    let held = Some(plain.held_at(surface, &places));
    if places.is_empty() {
        return Ok((held, seen));
    }
    let seen = inputs.see(&plain.start(&held).surface.mesh)?;
    Ok((held, seen))
}

/// Finds the regions in what each depth camera sees of a surface that is expected to be off by `errors`, how far the
/// object's outline is from that surface's, and how far its readings are from it outside of the regions.
fn regions_of(
    scene: &Scene,
    fused_captures: &FusedCaptures,
    seen: Vec<DepthOfHull>,
    errors: &OutsideErrors,
    parameters: &Parameters,
) -> Vec<DepthResult> {
    let find = |(number, (view, seen)): (usize, (&DepthView, DepthOfHull))| {
        let DepthOfHull {
            front,
            object,
            enhanced,
            bias,
        } = seen;
        let (in_rig, volume) = fused_captures.depth_in_its_rig(scene, number);
        let outline = region::outline_offset(in_rig, &front, &bias);
        let mut regions = region::find(front, &enhanced, bias, &object, &parameters.region);
        let camera = &view.camera;
        add_free_space(&mut regions, &enhanced, &object, camera, errors, parameters);
        let beside_regions = region::beside_regions(in_rig, &enhanced, &regions, volume, &object);
        let in_front_of_hull =
            region::in_front_of_hull(in_rig, &enhanced, &regions, volume, &object);
        DepthResult {
            enhanced,
            regions,
            outline,
            beside_regions,
            in_front_of_hull,
        }
    };
    let each = scene.depths.iter().zip(seen).enumerate();
    each.map(find).collect()
}

/// Adds what a depth camera sees through although the hull claims it, if the model is carved in regions: the paper's
/// lid cannot be opened, and the depth hull is carved everywhere.
fn add_free_space(
    regions: &mut Regions,
    enhanced: &EnhancedDepth,
    object: &Mask,
    camera: &DepthCamera,
    errors: &OutsideErrors,
    parameters: &Parameters,
) {
    let form = parameters.restoration.form;
    if parameters.method != Method::Hybrid || form != restore::Form::Carve {
        return;
    }
    let doubt = region::Doubt {
        bias: region::stated_bias(camera, &parameters.region),
        least_pixels: parameters.restoration.least_opening_px,
        hull_errors: &|places| errors.along_views(camera, places),
    };
    region::add_free_space(regions, enhanced, object, &doubt, &parameters.region);
}

/// What one depth camera sees of the hull.
struct DepthOfHull {
    front: HullRenderings,
    object: Mask,
    enhanced: EnhancedDepth,
    bias: Bias,
}

/// Gives each depth camera the depth that all of them agree on whose captures' turns are known to each other.
fn fuse_depths(scene: &Scene, fused_captures: &FusedCaptures, depths: &mut [DepthOfHull]) {
    if depths.len() < 2 {
        return;
    }
    let seen: Vec<depth::CameraDepth> = scene
        .depths
        .iter()
        .zip(&*depths)
        .enumerate()
        .map(|(number, (view, of_hull))| depth::CameraDepth {
            camera: &view.camera,
            enhanced: &of_hull.enhanced,
            bias: of_hull.bias.metres,
            remaining: of_hull.bias.remaining,
            turned_with: fused_captures.depths.get(number).map_or(0, |d| d.rank),
        })
        .collect();
    let fused = depth::fuse(&seen);
    for (of_hull, (depth, sigma)) in depths.iter_mut().zip(fused) {
        (of_hull.enhanced.depth, of_hull.enhanced.sigma) = (depth, sigma);
    }
}

/// The model with fewer vertices, each of which it had before. Their expected errors include how far the surface around
/// them is from the one before.
fn simplified(model: Model, vertices: usize) -> Result<Model, SimplifyError> {
    let Simplified { mesh, sources } = simplify(&model.mesh, vertices)?;
    let normals = vertex_normals(&mesh);
    let of = |v: &u32| *v as usize;
    let departures = mean_departures(&mesh, &model.mesh.vertices);
    Ok(Model {
        mesh,
        normals,
        provenance: sources.iter().map(|v| model.provenance[of(v)]).collect(),
        expected_error: sources
            .iter()
            .zip(departures)
            .map(|(v, departure)| model.expected_error[of(v)].hypot(departure))
            .collect(),
        captures: match model.captures.is_empty() {
            true => Vec::new(),
            false => sources.iter().map(|v| model.captures[of(v)]).collect(),
        },
        texture: None,
    })
}

fn restore(
    template: &Template,
    scene: &Scene,
    depths: &[DepthResult],
    parameters: &Parameters,
) -> Result<Restored, Error> {
    let sources: Vec<Source> = scene
        .depths
        .iter()
        .zip(depths)
        .enumerate()
        .map(
            |(number, (view, result)): (usize, (&DepthView, &DepthResult))| Source {
                number,
                camera: &view.camera,
                depth: &result.enhanced,
                regions: &result.regions,
            },
        )
        .collect();
    Ok(match parameters.method {
        Method::Hull => Restored::uncarved(restore::plain(template)),
        Method::DepthHull => restore::depth_hull(template, &sources, &parameters.restoration),
        Method::Hybrid => restore::restore(template, &sources, &parameters.restoration)?,
    })
}

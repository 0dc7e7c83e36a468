//! The expected error of a model's vertices. `inside` states that of what depth cameras carved; all else is about the
//! hull's vertices, from the silhouettes around each. `touch` finds the viewing edge through a vertex and where the
//! true surface touches it, `depth_of_surface` computes how far the surface then lies beneath the vertex, `readings`
//! tells what depth cameras read of it, `disagreement` by how much they contradict it, `hollow` what may hide beneath a
//! lid, `cut` where the volume cuts the object, `round_body` how well a body of revolution is known between touches,
//! and `patches` spreads the results of some vertices over all. `outside` states before any carving what silhouettes
//! alone leave open. `unrequired` marks whole pieces that no silhouette requires. Nothing here moves a vertex.

mod cut;
mod depth_of_surface;
mod disagreement;
mod hollow;
mod inside;
mod outside;
mod patches;
mod readings;
mod round_body;
#[cfg(test)]
pub(crate) mod testing;
mod touch;
mod unrequired;

use super::fairing::{FairedSolid, Touch};
use super::hull::{Directions, Hull, UpDirections};
use super::{Model, Provenance};
use crate::mesh::{Bvh, Mesh};
use cut::Outlined;
use disagreement::disagreement;
pub use hollow::may_be_lid;
use nalgebra::{Point3, Vector3};
pub use outside::OutsideErrors;
use patches::Patches;
use rayon::prelude::*;
pub use readings::{Readings, beneath};
pub use round_body::RoundBody;
use touch::ViewingEdge;
pub use unrequired::{UnrequiredPiece, mark_unrequired};

/// Cells along a patch: between touches there are more.
const PATCH_CELLS: f64 = 3.0;

/// Pixels by which a contour is off: no hull is better known than its outlines.
const CONTOUR_PX: f64 = 0.25;

/// What fairing made of a hull.
#[derive(Clone, Copy)]
pub struct FairedHull<'a> {
    /// The plain hull's surface.
    pub plain: &'a Mesh,
    /// The faired one.
    pub solid: &'a FairedSolid,
    /// Root mean square distance of the contours to its outlines, in pixels.
    pub contour_rms_px: f64,
    /// Points of its surface at which an outline lies on a contour.
    pub touches: &'a [Touch],
    /// The body of revolution that it is, if they show one.
    pub round_body: Option<&'a RoundBody>,
}

impl FairedHull<'_> {
    /// How far a point is from the nearest one at which an outline lies on a contour, in metres; 0 where there is none.
    fn way_to_touch(&self, p: Point3<f64>) -> f64 {
        let squares = self
            .touches
            .iter()
            .map(|touch| (touch.point - p).norm_squared());
        squares.reduce(f64::min).unwrap_or(0.0).sqrt()
    }
}

/// What fairing is expected to be off, in shares of what it did; `design/surface.md` tells what they were chosen on.
/// All errors are far from normal: the largest tenth are thirty times the smallest.
mod share {
    /// Pixels at which half as much is expected as in proportion to the way that a vertex was moved: long ways end at
    /// a surface as smooth as short ones do.
    pub(super) const MOVED_PX: f64 = 10.0;
    /// Beyond so many pixels from the nearest touch, the expected error grows in proportion to the way there. Nearer,
    /// it grows with the square of that way, because a smooth surface is tangential to the viewing rays that touch it.
    pub(super) const WAY_PX: f64 = 25.0;
    /// Of a contour's error, on a flat side that many contours hold.
    pub(super) const OF_CONTOUR: f64 = 0.5;
    /// Pixels within which an outline confirms a place.
    pub(super) const CONFIRMING_PX: f64 = 3.0;
    /// By how much each such outline lowers what is expected, and how many of them count.
    pub(super) const OF_OUTLINE: f64 = 0.115;
    pub(super) const MOST_OUTLINES: usize = 5;
    /// Distance of contours to outlines, in pixels, at which the object is as smooth as `STATED` assumes, and the power
    /// by which more is expected where contours are farther off: at edges that fairing rounded.
    pub(super) const USUAL_RMS_PX: f64 = 0.12;
    pub(super) const POWER_OF_RMS: f64 = 0.77;
    /// Height of a unit normal below which a place faces down: cameras look down at the object, and below what stands
    /// out the hull is filled.
    pub(super) const DOWN: f32 = -0.3;
    /// Power of the share of the hull's expected depth that fairing left, below such places.
    pub(super) const POWER_OF_LEFT: i32 = 3;
}

/// An outline confirms that the object is at a place if it is this near in pixels and its cone's normal at most 25
/// degrees (given as a cosine) from the surface's; so many of them make it sure.
const CONFIRMED_PX: f64 = 1.5;
const ALONG: f64 = 0.9;
const CONFIRMED: usize = 3;

/// Shares of what is expected of a faired place that is not flat.
struct Shares {
    /// Of the way that it was moved.
    of_moved: f64,
    /// Of what fairing left of the hull's expected depth.
    of_left: f64,
    /// Of the hull's expected depth, where the hull was kept.
    of_kept: f64,
    /// Of a contour's error.
    of_contour: f64,
    /// Of the way to the nearest place at which an outline lies on a contour.
    of_way: f64,
    /// Of what fairing left below a place that faces down, if it moved it by little.
    of_left_below: f64,
}

/// What a place bears before a reading of depth carves it.
const BORNE: Shares = Shares {
    of_moved: 0.5,
    of_left: 0.42,
    of_kept: 0.6,
    of_contour: 1.0,
    of_way: 0.0,
    of_left_below: 0.0,
};

/// What a model states of a place that no outline confirms, if contours fit as usual.
const STATED: Shares = Shares {
    of_moved: 0.4,
    of_left: 0.1,
    of_kept: 0.6,
    of_contour: 0.8,
    of_way: 0.12,
    of_left_below: 1.2,
};

/// What the stated errors follow from.
pub struct Evidence<'a> {
    /// The plain hull.
    pub hull: &'a Hull<'a>,
    /// What fairing made of it, if it was faired.
    pub faired: Option<FairedHull<'a>>,
    /// What the depth cameras read; empty where none was used.
    pub readings: Vec<Readings<'a>>,
    /// Edge of the cells that the hull was extracted in, in metres.
    pub cell_size: f64,
}

/// States the expected error of a model's vertices. Those that depth cameras carved come with the error that the
/// readings alone suggest. Of those on the hull it also states which nothing observed, because the volume cuts the
/// object there.
pub fn state_errors(model: &mut Model, evidence: &Evidence) {
    inside::state(model, evidence.hull, &evidence.readings);
    state_errors_of_hull(model, evidence);
}

fn state_errors_of_hull(model: &mut Model, evidence: &Evidence) {
    let vertices = model.mesh.vertices.iter().zip(&model.provenance);
    let on_hull = vertices
        .zip(0..)
        .filter(|((_, provenance), _)| **provenance == Provenance::Hull)
        .map(|((&p, _), index)| (index, p));
    let patches = Patches::new(on_hull, PATCH_CELLS * evidence.cell_size);
    let plain = evidence.faired.as_ref().map(|f| Bvh::new(f.plain));
    let of_patch = |indices: &[u32]| {
        let vertex = indices[indices.len() / 2] as usize;
        let p = model.mesh.vertices[vertex].cast();
        evidence.at(plain.as_ref(), p, model.normals[vertex])
    };
    let each: Vec<&[u32]> = patches.indices().collect();
    let places: Vec<Place> = each.into_par_iter().map(of_patch).collect();
    let known: Vec<Option<Outlined>> = places.par_iter().map(|p| evidence.known(p)).collect();
    let known: Vec<Outlined> = known.into_iter().flatten().collect();
    let up = UpDirections::of(evidence.hull.bounds());
    let found: Vec<Stated> = places
        .par_iter()
        .map(|place| evidence.stated(place, &known, &up))
        .collect();
    let errors: Vec<f64> = found.iter().map(|stated| stated.error).collect();
    let stated = found.iter().zip(patches.smoothed(&errors));
    for (indices, (stated, error)) in patches.indices().zip(stated) {
        for &index in indices {
            model.expected_error[index as usize] = error as f32;
            if stated.is_guess {
                model.provenance[index as usize] = Provenance::Unseen;
            }
        }
    }
}

/// What is stated of a place.
#[derive(Clone, Copy)]
struct Stated {
    /// Its expected error, in metres.
    error: f64,
    /// Whether nothing observed it.
    is_guess: bool,
}

/// A place of the model's surface that lies on the hull, and what the silhouettes around it tell.
struct Place {
    point: Point3<f64>,
    normal: Vector3<f32>,
    /// The point of the plain hull's surface that it came from.
    on_hull: Point3<f64>,
    /// How far fairing moved it, in metres; `None` where the hull was not faired.
    moved: Option<f64>,
    /// Expected error of the outlines, in metres.
    of_contour: f64,
    /// The viewing edge through it; `None` where it is the volume that bounds the hull.
    edge: Option<ViewingEdge>,
}

impl Place {
    /// It as one that an outline bounds, if one does.
    fn outlined(&self) -> Option<Outlined> {
        let edge = self.edge?;
        Some(Outlined {
            point: self.on_hull,
            of_hull: depth_of_surface::expected(&edge).hypot(self.of_contour),
            way_to_object: hollow::way_to_object(&edge),
        })
    }
}

impl Evidence<'_> {
    /// What the silhouettes tell of a point of the model's surface that lies on the hull. `plain` finds places on the
    /// plain hull's surface, where that was faired.
    fn at(&self, plain: Option<&Bvh>, p: Point3<f64>, normal: Vector3<f32>) -> Place {
        let above = plain.and_then(|plain| plain.closest_point(p));
        let on_hull = above.as_ref().map_or(p, |above| above.point);
        Place {
            point: p,
            normal,
            on_hull,
            moved: above.map(|above| above.distance),
            of_contour: CONTOUR_PX * self.hull.pixel_footprint(p),
            edge: ViewingEdge::through(self.hull, on_hull, self.cell_size),
        }
    }

    /// A place as one that an outline bounds, if one does. Where several confirm that the object is there, the way to
    /// it is 0.
    fn known(&self, place: &Place) -> Option<Outlined> {
        let mut outlined = place.outlined()?;
        if self.confirming(place, CONFIRMED_PX, CONFIRMED) == CONFIRMED {
            outlined.way_to_object = Some(0.0);
        }
        Some(outlined)
    }

    /// How many outlines within so many pixels of a place run along the surface there, seen from different directions;
    /// counted up to `most`. Outlines that run another way belong to what stands in front of the place or behind.
    fn confirming(&self, place: &Place, radius_px: f64, most: usize) -> usize {
        let normal = place.normal.cast::<f64>();
        let outlines = self.hull.outlines_near(place.point, radius_px);
        let along = outlines.filter(|(_, outwards)| outwards.dot(&normal) > ALONG);
        let mut directions = Directions::default();
        for (camera, _) in along {
            directions.number(place.point, self.hull.cones()[camera].camera());
            if directions.count() == most {
                break;
            }
        }
        directions.count()
    }

    /// What is expected at a place: what outlines let expect of the outside, or what depth cameras show it to be off if
    /// that is more; half of how far the object is at most where a hollow may hide or the volume cuts the object; and
    /// half the way to where a depth camera read it. `known` are the places that outlines bound, `up` the directions in
    /// which hollows open.
    fn stated(&self, place: &Place, known: &[Outlined], up: &UpDirections) -> Stated {
        let Place { point, normal, .. } = *place;
        let own = place.outlined();
        let is_guess = own.is_none() && self.is_cut(place, known);
        let beside = || cut::nearest(place.on_hull, known).map(|(beside, _)| beside);
        let outlined = own.or_else(|| beside().filter(|_| !is_guess));
        let of_hull = outlined.map_or(place.of_contour, |outlined| outlined.of_hull);
        let of_outside = match self.is_on_table(point) {
            true => self.hull.pixel_footprint(point),
            false => self.of_outside(place, of_hull, &self.stated_shares(place)),
        };
        let may_be_lid = hollow::may_be_lid(point, normal, up, &self.readings).is_some();
        let hidden = if is_guess || may_be_lid {
            let inwards = -normal.cast::<f64>();
            let reach = self.hull.reach(place.on_hull, inwards, self.cell_size);
            if is_guess {
                reach
            } else {
                reach.min(cut::way_to_object(place.on_hull, known))
            }
        } else {
            0.0
        };
        // What hides below a lid is not shown by how round its border is.
        let of_round_body = self.of_round_body(place).filter(|_| hidden == 0.0);
        let of_outside = of_round_body.map_or(of_outside, |error| error.min(of_outside));
        let of_outside = of_outside.max(disagreement(point, normal, &self.readings));
        let beneath = beneath(point, normal, &self.readings).unwrap_or(0.0);
        Stated {
            error: of_outside.hypot(0.5 * hidden.hypot(beneath)),
            is_guess,
        }
    }

    /// What is expected of the outside at a place where `of_hull` metres are expected of the plain hull.
    fn of_outside(&self, place: &Place, of_hull: f64, shares: &Shares) -> f64 {
        match (&self.faired, place.moved) {
            (Some(faired), Some(moved)) => of_faired(faired, place, of_hull, moved, shares),
            _ => of_hull,
        }
    }

    /// What is expected of the outside at a place where the object is shown to be a body of revolution.
    fn of_round_body(&self, place: &Place) -> Option<f64> {
        let body = self.faired?.round_body?;
        let expected = body.expected(place.point, place.normal.cast())?;
        Some(expected.hypot(STATED.of_contour * place.of_contour))
    }

    /// The shares that a model states at a place: the more, the fewer outlines confirm it, and the worse the faired
    /// hull's outlines fit the contours.
    fn stated_shares(&self, place: &Place) -> Shares {
        let rms_px = self
            .faired
            .map_or(share::USUAL_RMS_PX, |f| f.contour_rms_px);
        let outlines = self.confirming(place, share::CONFIRMING_PX, share::MOST_OUTLINES) as f64;
        let fit = (rms_px / share::USUAL_RMS_PX).powf(share::POWER_OF_RMS);
        let times = fit / (1.0 + share::OF_OUTLINE * outlines);
        Shares {
            of_moved: times * STATED.of_moved,
            of_left: times * STATED.of_left,
            of_way: times * STATED.of_way,
            of_left_below: if place.normal.z < share::DOWN {
                STATED.of_left_below
            } else {
                0.0
            },
            ..STATED
        }
    }

    /// Whether a place lies on the table of one of several captures. A table bounds the object itself, and the volume
    /// does not cut it there.
    fn is_on_table(&self, p: Point3<f64>) -> bool {
        let bounds = self.hull.bounds();
        let (height, _) = bounds.nearest_table(p);
        !bounds.planes().is_empty() && height < 0.5 * self.cell_size
    }

    /// Whether the volume may cut the object at a place where it bounds the hull.
    fn is_cut(&self, place: &Place, known: &[Outlined]) -> bool {
        let is_on_side = |faired: &FairedHull| faired.solid.is_on_side(place.point);
        if self.faired.as_ref().is_some_and(is_on_side) || self.is_on_table(place.point) {
            return false;
        }
        let outwards = place.normal.cast();
        let beside = cut::nearest(place.on_hull, known);
        beside.is_none_or(|(_, away)| {
            cut::goes_on(self.hull, place.on_hull, outwards, away, self.cell_size)
        })
    }
}

/// The expected error in metres at a point of a faired hull, which moved by `moved` from where `of_hull` is expected:
/// on a flat side a share of that of the contours, where the hull was kept a share of its own, and elsewhere of how
/// far the surface was moved, of what is left of the hull's own, and of how far away the nearest touch is.
fn of_faired(faired: &FairedHull, place: &Place, of_hull: f64, moved: f64, shares: &Shares) -> f64 {
    let (solid, p, of_contour) = (faired.solid, place.point, place.of_contour);
    if solid.is_on_side(p) {
        return share::OF_CONTOUR * of_contour;
    }
    let pixel = of_contour / CONTOUR_PX;
    let much = share::MOVED_PX * pixel;
    let left = (of_hull - moved).max(0.0);
    // A hollow below what stands out is filled so smoothly that fairing hardly moves it; what is round moves far.
    let of_below = if shares.of_left_below > 0.0 && left > 0.0 {
        shares.of_left_below * left * (left / of_hull).powi(share::POWER_OF_LEFT)
    } else {
        0.0
    };
    let of_way = if shares.of_way > 0.0 {
        let way = faired.way_to_touch(p);
        shares.of_way * way * (way / (share::WAY_PX * pixel)).min(1.0)
    } else {
        0.0
    };
    let of_moved = (shares.of_moved * moved / (1.0 + moved / much))
        .hypot(shares.of_left * left)
        .hypot(of_way)
        .hypot(of_below)
        .hypot(shares.of_contour * of_contour);
    let of_kept = (shares.of_kept * of_hull).hypot(of_contour);
    let kept = solid.kept(p);
    (1.0 - kept) * of_moved + kept * of_kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{Camera, Distortion, Intrinsics, Volume};
    use crate::frame::CameraId;
    use crate::image::Grid;
    use crate::reconstruct::hull::Cone;
    use nalgebra::{Isometry3, Vector2};

    /// A camera half a metre away along an axis, 0.05 m above the table.
    fn camera(eye: Point3<f64>) -> Camera {
        let (focal, middle) = (Vector2::repeat(300.0), Vector2::repeat(99.5));
        let lens = Intrinsics::new(200, 200, focal, middle, Distortion::default());
        let target = Point3::new(0.0, 0.0, 0.05);
        let pose = Isometry3::face_towards(&eye, &target, &-Vector3::z());
        Camera::new(CameraId::new("c00").unwrap(), lens.unwrap(), pose)
    }

    /// What a column that is 66 mm wide states of points of its surface, from what it is seen as: pixels of each row
    /// of the pictures that are object.
    fn stated(
        is_object: impl Fn(usize, usize) -> bool,
        vertices: [(Point3<f32>, Vector3<f32>); 2],
    ) -> Model {
        let cameras = [Point3::new(0.0, -0.5, 0.05), Point3::new(0.5, 0.0, 0.05)].map(camera);
        let level = Grid::from_fn(200, 200, |x, y| if is_object(x, y) { 255 } else { 0 });
        let cones = cameras.iter().map(|c| Cone::new(c, &level)).collect();
        let low = Point3::new(-0.06, -0.06, 0.0);
        let volume = Volume::new(low, Point3::new(0.06, 0.06, 0.1)).unwrap();
        let hull = Hull::new(cones, volume, 2);
        let evidence = Evidence {
            hull: &hull,
            faired: None,
            readings: Vec::new(),
            cell_size: 1e-3,
        };
        let mut model = Model {
            mesh: Mesh {
                vertices: vertices.map(|(p, _)| p).to_vec(),
                triangles: Vec::new(),
            },
            normals: vertices.map(|(_, normal)| normal).to_vec(),
            provenance: vec![Provenance::Hull; 2],
            expected_error: vec![0.0; 2],
            ..Model::default()
        };
        state_errors(&mut model, &evidence);
        model
    }

    #[test]
    fn what_the_volume_cuts_off_was_not_seen_and_is_known_least() {
        let top = (Point3::new(0.0, 0.0, 0.1), Vector3::z());
        let side = (Point3::new(0.033, 0.0, 0.05), Vector3::x());
        let column = stated(|x, _| (80..120).contains(&x), [top, side]);
        assert_eq!(column.provenance, [Provenance::Unseen, Provenance::Hull]);
        let [of_top, of_side] = [column.expected_error[0], column.expected_error[1]];
        // Half of how far the object is at most: it is at the side.
        assert!((0.02..0.08).contains(&of_top), "{of_top}");
        assert!(of_side < 0.5 * of_top, "{of_side}");
    }

    #[test]
    fn an_outline_that_is_seen_twice_from_one_direction_confirms_a_place_once() {
        // A column that is 66 mm wide, which reaches from the top of the pictures to their foot.
        let level = Grid::from_fn(200, 200, |x, _| if x.abs_diff(100) < 20 { 255 } else { 0 });
        let eyes = [[-0.5, 0.05], [-0.5, 0.052], [-0.48, 0.19]];
        let cameras = eyes.map(|[y, z]| camera(Point3::new(0.0, y, z)));
        let confirming = |count: usize| {
            let cones = cameras[..count].iter().map(|c| Cone::new(c, &level));
            let corner = Point3::new(0.06, 0.06, 0.1);
            let volume = Volume::new(Point3::new(-0.06, -0.06, 0.0), corner).unwrap();
            let evidence = Evidence {
                hull: &Hull::new(cones.collect(), volume, 1),
                faired: None,
                readings: Vec::new(),
                cell_size: 1e-3,
            };
            let place = evidence.at(None, Point3::new(0.033, 0.0, 0.05), Vector3::x());
            [1, 5].map(|most| evidence.confirming(&place, 3.0, most))
        };
        assert_eq!([1, 2, 3].map(confirming), [[1, 1], [1, 1], [1, 2]]);
    }

    #[test]
    fn where_the_volume_cuts_what_stands_out_it_is_as_beside_the_cut() {
        // A tip whose outlines lean inwards: 20 pixels high, it ends 8 pixels above the volume's top, at row 69.5.
        let is_object = |x: usize, y: usize| {
            let half = (y as f64 - 61.5).clamp(0.0, 20.0);
            (x as f64 - 99.5).abs() < half
        };
        let top = (Point3::new(0.0, 0.0, 0.1), Vector3::z());
        let slope = (
            Point3::new(0.0195, 0.0, 0.0923),
            Vector3::new(0.7, 0.0, 0.7),
        );
        let tip = stated(is_object, [top, slope]);
        assert_eq!(tip.provenance, [Provenance::Hull; 2]);
    }
}

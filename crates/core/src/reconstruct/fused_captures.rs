//! How the object stood in each of the captures of which a scene is fused: tables, depth views and ranks. All of it is
//! empty for a scene of one capture.

use super::depth::EnhancedDepth;
use super::hull::{Hull, Plane};
use super::region::Regions;
use super::{DepthView, Scene};
use crate::calibration::Volume;
use nalgebra::{Isometry3, Point2, Point3, Vector3};

/// Share of a region's pixels that another camera's better one must see too, to take its place.
const COMMON: f64 = 0.3;
/// Metres within which two cameras' readings are of one place.
const SAME_PLACE: f64 = 0.012;
/// Pixels within which an outline touches a point of the hull's surface.
const TOUCHING_PX: f64 = 1.0;
/// Captures that a model is fused of at most: so many bits a number of glTF holds exactly.
pub const MOST_CAPTURES: usize = 24;

/// How the object stood in the captures that a scene is fused of.
#[derive(Clone, Debug, Default)]
pub struct FusedCaptures {
    /// The tables of all captures but the one whose frame the scene has, in that frame.
    pub tables: Vec<Plane>,
    /// The depth views in the frames of their own captures' rigs, in the order of the scene's; empty where that is the
    /// scene's frame.
    pub depths: Vec<DepthInRigFrame>,
    /// For each colour view, then each depth view, its rank in painting; empty where all are alike.
    pub ranks: Vec<u8>,
    /// For each colour view, then each depth view, the number of its capture; empty where there is one.
    pub captures: Vec<u16>,
    /// The numbers of the captures of `tables`, after that of the capture whose frame the scene has.
    pub table_captures: Vec<u16>,
}

/// A depth view in its own rig's frame.
#[derive(Clone, Debug)]
pub struct DepthInRigFrame {
    /// The view.
    pub view: DepthView,
    /// The box that bounds the object in that rig.
    pub volume: Volume,
    /// Maps a point of that rig into the scene.
    pub scene_from_rig: Isometry3<f64>,
    /// The number of its capture.
    pub capture: usize,
    /// Of two that see one hollow, the one of the lower rank carves it, and of one rank the one that sees more of it.
    /// Only between captures of one rank is it known how the object was turned, so that their depths are averaged.
    pub rank: u8,
}

impl FusedCaptures {
    /// Whether the scene is fused of several captures.
    pub(super) fn is_of_several(&self) -> bool {
        self.captures.windows(2).any(|pair| pair[0] != pair[1])
    }

    /// The capture of a depth view, as a bit.
    pub(super) fn of_depth_view(&self, number: usize) -> u32 {
        let colors = self.captures.len().saturating_sub(self.depths.len());
        let capture = self.captures.get(colors + number);
        capture.map_or(0, |&capture| bit(capture))
    }

    /// The captures whose outlines or table touch a point of the hull's surface, a bit each; the one that comes
    /// nearest where none does.
    pub(super) fn touching(&self, hull: &Hull, p: Point3<f64>) -> u32 {
        let of_color = |camera: usize| self.captures.get(camera).map_or(0, |&capture| bit(capture));
        let outlines = hull.outlines_near(p, TOUCHING_PX);
        let touching = outlines.fold(0, |bits, (camera, _)| bits | of_color(camera));
        let heights = hull.bounds().heights(p).zip(&self.table_captures);
        let lowest = heights.min_by(|a, b| a.0.total_cmp(&b.0));
        let footprint = hull.pixel_footprint(p);
        match lowest {
            Some((height, &capture)) if height < TOUCHING_PX * footprint => touching | bit(capture),
            _ if touching != 0 => touching,
            _ => match (hull.bounding_camera(p), lowest) {
                (Some((camera, _)), _) => of_color(camera),
                (None, Some((_, &capture))) => bit(capture),
                (None, None) => 0,
            },
        }
    }

    /// A depth view with its table, both in the frame of its own rig.
    pub(super) fn depth_in_its_rig<'a>(
        &'a self,
        scene: &'a Scene,
        index: usize,
    ) -> (&'a DepthView, &'a Volume) {
        match self.depths.get(index) {
            Some(own) => (&own.view, &own.volume),
            None => (&scene.depths[index], &scene.volume),
        }
    }

    /// Where depth cameras of several captures see one hollow, leaves it to the one that sees most of it: the nearest
    /// of several readings would be too near, for noise.
    pub(super) fn leave_each_region_to_one(&self, depths: &mut [(&EnhancedDepth, &mut Regions)]) {
        if self.depths.len() < 2 || self.depths.len() != depths.len() {
            return;
        }
        let seen: Vec<Region> = (0..depths.len())
            .flat_map(|view| self.regions(view, depths[view].0, &*depths[view].1))
            .collect();
        let mut order: Vec<usize> = (0..seen.len()).collect();
        order.sort_by_key(|&i| (seen[i].rank, std::cmp::Reverse(seen[i].size), i));
        let mut kept: Vec<&Region> = Vec::new();
        for &i in &order {
            let region = &seen[i];
            let is_taken = kept.iter().any(|k| {
                k.capture != region.capture
                    && region.is_seen_from_the_side_of(k)
                    && region.common(k) > COMMON
            });
            if is_taken {
                let regions = &mut *depths[region.view].1;
                let labels = &mut regions.labels;
                let all = labels.pixels_mut().iter_mut();
                all.filter(|l| **l == region.label).for_each(|l| *l = 0);
                regions.count -= 1;
            } else {
                kept.push(region);
            }
        }
    }

    fn regions(&self, view: usize, enhanced: &EnhancedDepth, regions: &Regions) -> Vec<Region> {
        const STEP: usize = 3;
        let own = &self.depths[view];
        let depth = &enhanced.depth;
        let mut found: Vec<Region> = (1..=regions.count)
            .map(|label| Region {
                view,
                capture: own.capture,
                rank: own.rank,
                label: label as u16,
                size: 0,
                eye: own.scene_from_rig * own.view.camera.camera.center(),
                points: Vec::new(),
            })
            .collect();
        for y in 0..depth.height() {
            for x in 0..depth.width() {
                let label = usize::from(regions.labels[(x, y)]);
                let Some(region) = label.checked_sub(1).and_then(|i| found.get_mut(i)) else {
                    continue;
                };
                region.size += 1;
                if x % STEP == 0 && y % STEP == 0 {
                    let pixel = Point2::new(x as f64, y as f64);
                    let metres = f64::from(depth[(x, y)]) - regions.bias.metres;
                    let point = own.view.camera.point(pixel, metres);
                    region.points.extend(point.map(|p| own.scene_from_rig * p));
                }
            }
        }
        found
    }
}

/// A capture as a bit.
fn bit(capture: u16) -> u32 {
    1_u32.checked_shl(capture.into()).unwrap_or(0)
}

/// A concave region that one depth view sees.
struct Region {
    view: usize,
    capture: usize,
    rank: u8,
    label: u16,
    size: usize,
    /// The depth camera's centre.
    eye: Point3<f64>,
    points: Vec<Point3<f64>>,
}

impl Region {
    /// Whether both are seen from one side: the two faces of a thin floor lie near each other and are two hollows.
    fn is_seen_from_the_side_of(&self, other: &Self) -> bool {
        self.view_direction().dot(&other.view_direction()) > 0.0
    }

    /// From the camera to the middle of its points.
    fn view_direction(&self) -> Vector3<f64> {
        let count = self.points.len().max(1) as f64;
        let sum: Vector3<f64> = self.points.iter().map(|point| point - self.eye).sum();
        sum / count
    }

    /// The share of its points that lie near points of another.
    fn common(&self, other: &Self) -> f64 {
        let near = |p: &&Point3<f64>| {
            let squared = SAME_PLACE * SAME_PLACE;
            other
                .points
                .iter()
                .any(|q| (q - **p).norm_squared() < squared)
        };
        self.points.iter().filter(near).count() as f64 / self.points.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Grid;
    use crate::reconstruct::testing::{camera, evidence};
    use nalgebra::UnitQuaternion;
    use std::ops::Range;
    use std::slice::from_ref;

    /// Width and height of a depth picture; at 0.8 m it is 67 mm wide.
    const SIDE: usize = 48;

    /// A depth camera 0.8 m above the origin of its own rig, which lies at `x` in the scene.
    fn seen_from(capture: usize, rank: u8, x: f64) -> DepthInRigFrame {
        let corner = Point3::new(0.1, 0.1, 0.1);
        DepthInRigFrame {
            view: DepthView {
                camera: camera(SIDE, 0.8),
                frames: Vec::new(),
            },
            volume: Volume::new(-corner, corner).unwrap(),
            scene_from_rig: Isometry3::translation(x, 0.0, 0.0),
            capture,
            rank,
        }
    }

    /// A depth of 0.8 m everywhere, and a region in each of some ranges of columns.
    fn read(columns: &[Range<usize>]) -> (EnhancedDepth, Regions) {
        let label = |x: usize, _| {
            let place = columns.iter().position(|range| range.contains(&x));
            place.map_or(0, |place| place as u16 + 1)
        };
        evidence(0.8, Grid::from_fn(SIDE, SIDE, label))
    }

    /// The labels that are left of the regions in some columns of two depth views.
    fn left(
        [a, b]: [DepthInRigFrame; 2],
        [of_a, of_b]: [&[Range<usize>]; 2],
    ) -> [(usize, Vec<u16>); 2] {
        let fused = FusedCaptures {
            depths: vec![a, b],
            ..FusedCaptures::default()
        };
        let (mut first, mut second) = (read(of_a), read(of_b));
        let mut depths = [(&first.0, &mut first.1), (&second.0, &mut second.1)];
        fused.leave_each_region_to_one(&mut depths);
        [first.1, second.1].map(|regions| {
            let mut labels: Vec<u16> = regions.labels.pixels().to_vec();
            labels.sort_unstable();
            labels.dedup();
            labels.retain(|&label| label != 0);
            (regions.count, labels)
        })
    }

    #[test]
    fn a_hollow_that_two_captures_see_is_left_to_the_one_that_sees_more_of_it() {
        let views = || [seen_from(0, 0, 0.0), seen_from(1, 0, 0.0)];
        let (wide, narrow) = (0..24, 0..16);
        let found = left(views(), [from_ref(&wide), from_ref(&narrow)]);
        assert_eq!(found, [(1, vec![1]), (0, vec![])]);
        let found = left(views(), [from_ref(&narrow), from_ref(&wide)]);
        assert_eq!(found, [(0, vec![]), (1, vec![1])]);
        // One that only the second sees stays its own, 20 mm from the other.
        let found = left(views(), [&[wide], &[narrow, 36..SIDE]]);
        assert_eq!(found, [(1, vec![1]), (1, vec![2])]);
    }

    #[test]
    fn both_faces_of_a_thin_floor_keep_their_regions() {
        // The second one sees the floor from below: its readings are 4 mm under those of the first.
        let mut below = seen_from(1, 0, 0.0);
        let turned = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::PI);
        below.scene_from_rig = Isometry3::from_parts(Vector3::new(0.0, 0.0, -4e-3).into(), turned);
        let columns = 0..SIDE;
        let found = left(
            [seen_from(0, 0, 0.0), below],
            [from_ref(&columns), from_ref(&columns)],
        );
        assert_eq!(found, [(1, vec![1]), (1, vec![1])]);
    }

    #[test]
    fn a_capture_whose_turn_is_known_carves_before_one_that_sees_more() {
        let views = [seen_from(0, 1, 0.0), seen_from(1, 0, 0.0)];
        let found = left(views, [&[0..24, 30..SIDE], &[0..16, 30..36]]);
        assert_eq!(found, [(0, vec![]), (2, vec![1, 2])]);
    }

    #[test]
    fn other_hollows_and_cameras_of_one_capture_keep_their_regions() {
        let both: [(usize, Vec<u16>); 2] = [(1, vec![1]), (1, vec![1])];
        let elsewhere = [seen_from(0, 0, 0.0), seen_from(1, 0, 0.1)];
        let [wide, narrow] = [0..24, 0..16].map(|range| [range]);
        assert_eq!(left(elsewhere, [&wide, &narrow]), both);
        // Two cameras of one rig are fused before they carve.
        let of_one = [seen_from(0, 0, 0.0), seen_from(0, 0, 0.0)];
        assert_eq!(left(of_one, [&wide, &narrow]), both);
    }
}

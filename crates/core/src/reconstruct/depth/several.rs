//! Fuses the depths that several cameras measured of one surface, before any of them carves: the mean of their signed
//! distances to it, weighted by their noise (Curless and Levoy 1996). If each carved for itself, the deepest error
//! would win, and the surface would sink with every camera. Knows nothing of hulls; its caller knows the biases.

use super::EnhancedDepth;
use crate::calibration::DepthCamera;
use crate::image::Grid;
use nalgebra::{Point2, Point3, Vector3};

/// One camera's depth, and what is known of its bias.
pub struct CameraDepth<'a> {
    /// The camera.
    pub camera: &'a DepthCamera,
    /// Its enhanced depth.
    pub enhanced: &'a EnhancedDepth,
    /// Metres that it reads too deep.
    pub bias: f64,
    /// Metres that may be left of its bias after that.
    pub remaining: f64,
    /// How the object was turned to other cameras is known if they have the same number.
    pub turned_with: u8,
}

/// Two readings are of one surface if they differ by less than this many standard errors of their difference. From
/// half of that on they count less and less.
const SAME_SURFACE: f64 = 4.0;

/// Smallest cosine between the normals of two readings of one surface.
const SAME_SIDE: f64 = 0.5;

/// Surfaces seen at less than this cosine are taken as seen at it: where they are depends on the pixel's width.
const GRAZING: f64 = 0.15;

/// A step between neighbouring pixels of more than this many pixels' width is no surface.
const STEP_PX: f64 = 6.0;

/// Steps towards the place where the weighted distances cancel.
const ROUNDS: usize = 3;

/// A depth as a piece of surface.
#[derive(Clone, Copy)]
struct Patch {
    /// Outward unit normal.
    normal: Vector3<f64>,
    /// Metres across the surface for each metre of depth.
    across: f64,
    /// Variance of the distance across the surface, in square metres.
    variance: f64,
}

/// For each camera its depth and error with the other cameras' readings of the same surfaces taken into account, each
/// in the camera's own terms, that is with its bias. The depth of a single camera, and places that one camera alone
/// read, are as they were. The errors are those of noise: a bias that the cameras share does not become smaller.
pub fn fuse(seen: &[CameraDepth]) -> Vec<(Grid<f32>, Grid<f32>)> {
    let patches: Vec<Grid<Option<Patch>>> = seen.iter().map(patches).collect();
    (0..seen.len()).map(|i| fused(seen, &patches, i)).collect()
}

fn fused(
    seen: &[CameraDepth],
    patches: &[Grid<Option<Patch>>],
    own: usize,
) -> (Grid<f32>, Grid<f32>) {
    let CameraDepth { enhanced, bias, .. } = seen[own];
    let (width, height) = (enhanced.depth.width(), enhanced.depth.height());
    let both = Grid::from_fn_parallel(width, height, |x, y| {
        let unchanged = (enhanced.depth[(x, y)], enhanced.sigma[(x, y)]);
        let Some(patch) = &patches[own][(x, y)] else {
            return unchanged;
        };
        let start = f64::from(unchanged.0) - bias;
        let found = agreed(seen, patches, own, (x, y), (start, patch));
        found.map_or(unchanged, |(depth, share)| {
            let error = f64::from(unchanged.1) * share.sqrt();
            ((depth + bias) as f32, error as f32)
        })
    });
    (both.map(|b| b.0), both.map(|b| b.1))
}

/// The depth along the ray of a pixel at which the weighted distances of all cameras cancel, and the share that the
/// camera's own depth has in it; `None` where no other camera read the same surface. `start` is its own depth without
/// the bias.
fn agreed(
    seen: &[CameraDepth],
    patches: &[Grid<Option<Patch>>],
    own: usize,
    (x, y): (usize, usize),
    (start, patch): (f64, &Patch),
) -> Option<(f64, f64)> {
    let pixel = Point2::new(x as f64, y as f64);
    let own_weight = patch.variance.recip();
    let (mut depth, mut share) = (start, 1.0);
    for _ in 0..ROUNDS {
        let p = seen[own].camera.point(pixel, depth)?;
        let own_distance = (depth - start) * patch.across;
        let (mut sum, mut weights) = (own_weight * own_distance, own_weight);
        let is_comparable =
            |other: &usize| *other != own && seen[*other].turned_with == seen[own].turned_with;
        for other in (0..seen.len()).filter(is_comparable) {
            let Some((distance, theirs)) = distance(&seen[other], &patches[other], p) else {
                continue;
            };
            if theirs.normal.dot(&patch.normal) < SAME_SIDE {
                continue;
            }
            let doubt = SAME_SURFACE * (patch.variance + theirs.variance).sqrt()
                + seen[own].remaining
                + seen[other].remaining;
            let weight = likeness((distance - own_distance).abs() / doubt) / theirs.variance;
            sum += weight * distance;
            weights += weight;
        }
        share = own_weight / weights;
        depth -= sum / weights / patch.across;
    }
    (share < 1.0 && depth > 0.0).then_some((depth, share))
}

/// How much a reading counts that differs by such a part of what two readings of one surface may differ by.
fn likeness(part: f64) -> f64 {
    (2.0 - 2.0 * part).clamp(0.0, 1.0)
}

/// How far a point lies behind the surface that a camera read, in metres across it, with that piece of surface; `None`
/// where the camera read none.
fn distance<'a>(
    seen: &CameraDepth,
    patches: &'a Grid<Option<Patch>>,
    p: Point3<f64>,
) -> Option<(f64, &'a Patch)> {
    let (pixel, z) = seen.camera.project(p)?;
    let patch = patches
        .get(pixel.x.round() as isize, pixel.y.round() as isize)?
        .as_ref()?;
    let depth = read_between(seen, pixel)?;
    Some(((z - (depth - seen.bias)) * patch.across, patch))
}

/// The bilinear depth of four readings of one surface.
fn read_between(seen: &CameraDepth, pixel: Point2<f64>) -> Option<f64> {
    let CameraDepth {
        enhanced, camera, ..
    } = seen;
    let (left, top) = (pixel.x.floor(), pixel.y.floor());
    let (fx, fy) = (pixel.x - left, pixel.y - top);
    let mut depths = [0.0; 4];
    for (i, depth) in depths.iter_mut().enumerate() {
        let x = left as isize + (i & 1) as isize;
        let y = top as isize + (i >> 1) as isize;
        *depth = f64::from(enhanced.reading(x, y)?);
    }
    let near = depths.iter().copied().fold(f64::INFINITY, f64::min);
    let far = depths.iter().copied().fold(0.0, f64::max);
    if far - near > step(camera, near) {
        return None;
    }
    let [a, b, c, d] = depths;
    Some((1.0 - fy) * ((1.0 - fx) * a + fx * b) + fy * ((1.0 - fx) * c + fx * d))
}

/// Metres between neighbouring pixels that are a step.
fn step(camera: &DepthCamera, depth: f64) -> f64 {
    STEP_PX * depth / camera.camera.intrinsics.focal_px.min()
}

/// Each pixel's depth as a piece of surface; `None` where there is none, or no neighbours on the same surface.
fn patches(seen: &CameraDepth) -> Grid<Option<Patch>> {
    let (width, height) = (seen.enhanced.depth.width(), seen.enhanced.depth.height());
    let points = Grid::from_fn_parallel(width, height, |x, y| {
        let depth = f64::from(seen.enhanced.depth[(x, y)]);
        let point = || {
            seen.camera
                .point(Point2::new(x as f64, y as f64), depth - seen.bias)
        };
        (depth > 0.0).then(point).flatten()
    });
    Grid::from_fn_parallel(width, height, |x, y| patch(seen, &points, x, y))
}

fn patch(
    seen: &CameraDepth,
    points: &Grid<Option<Point3<f64>>>,
    x: usize,
    y: usize,
) -> Option<Patch> {
    let here = points[(x, y)]?;
    let depth = f64::from(seen.enhanced.depth[(x, y)]);
    let beside = |dx: isize, dy: isize| {
        let at = (x as isize + dx, y as isize + dy);
        let point = (*points.get(at.0, at.1)?)?;
        let there = f64::from(seen.enhanced.depth[(at.0 as usize, at.1 as usize)]);
        ((there - depth).abs() <= step(seen.camera, depth)).then_some(point)
    };
    let along = |dx: isize, dy: isize| match (beside(-dx, -dy), beside(dx, dy)) {
        (None, None) => None,
        (before, after) => Some(after.unwrap_or(here) - before.unwrap_or(here)),
    };
    let towards_camera = seen.camera.camera.center() - here;
    let normal = along(1, 0)?.cross(&along(0, 1)?).try_normalize(1e-12)?;
    let normal = if normal.dot(&towards_camera) < 0.0 {
        -normal
    } else {
        normal
    };
    let facing = normal.dot(&towards_camera.normalize()).max(GRAZING);
    let across = facing * towards_camera.norm() / depth;
    // A pixel is off by up to a half to its sides, of which the surface's slant makes a distance.
    let sideways = 0.3 * depth / seen.camera.camera.intrinsics.focal_px.min();
    let sigma = f64::from(seen.enhanced.sigma[(x, y)]).max(1e-6);
    let variance = (sigma * across).powi(2) + sideways.powi(2) * (1.0 - facing * facing);
    Some(Patch {
        normal,
        across,
        variance,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{Camera, DepthResponse, Distortion, Intrinsics};
    use crate::frame::CameraId;
    use crate::reconstruct::depth::DepthKind;
    use crate::reconstruct::depth::{Facts, SensorNoise};
    use nalgebra::{Isometry3, Vector2};

    const SIDE: usize = 40;

    /// A camera at `from` that looks at the origin.
    fn camera(from: [f64; 3]) -> DepthCamera {
        let middle = Vector2::repeat(0.5 * (SIDE as f64 - 1.0));
        let lens = Intrinsics::new(
            SIDE,
            SIDE,
            Vector2::repeat(575.0),
            middle,
            Distortion::default(),
        );
        let pose = Isometry3::face_towards(&from.into(), &Point3::origin(), &Vector3::y());
        DepthCamera {
            camera: Camera::new(CameraId::new("depth").unwrap(), lens.unwrap(), pose),
            response: DepthResponse::default(),
        }
    }

    /// What a camera reads of the plane at this height over z = 0, with this error.
    fn plane(camera: &DepthCamera, height: f64, sigma: f32) -> EnhancedDepth {
        let center = camera.camera.center();
        let depth = Grid::from_fn(SIDE, SIDE, |x, y| {
            let ray = camera.camera.ray(Point2::new(x as f64, y as f64)).unwrap();
            let p = center + ray * ((height - center.z) / ray.z);
            camera.project(p).unwrap().1 as f32
        });
        EnhancedDepth {
            sigma: Grid::filled(SIDE, SIDE, sigma),
            kind: Grid::filled(SIDE, SIDE, DepthKind::Measured),
            depth,
            noise: SensorNoise {
                per_square_depth: 0.0,
                jitter_px: 0.0,
                fixed_per_square_depth: 0.0,
                median_deviation: 0.0,
            },
            facts: Facts::default(),
        }
    }

    /// The height of the middle pixel's depth, and its error, for each of two cameras that read a plane at the given
    /// heights with the given errors.
    fn fused(cameras: [&DepthCamera; 2], heights: [f64; 2], sigmas: [f32; 2]) -> [(f64, f32); 2] {
        fused_of_turns(cameras, heights, sigmas, [0, 0])
    }

    fn fused_of_turns(
        cameras: [&DepthCamera; 2],
        heights: [f64; 2],
        sigmas: [f32; 2],
        turned_with: [u8; 2],
    ) -> [(f64, f32); 2] {
        let read = [0, 1].map(|i| plane(cameras[i], heights[i], sigmas[i]));
        let seen = [0, 1].map(|i| CameraDepth {
            camera: cameras[i],
            enhanced: &read[i],
            bias: 0.0,
            remaining: 0.0,
            turned_with: turned_with[i],
        });
        let found = fuse(&seen);
        let at = SIDE / 2;
        [0, 1].map(|i| {
            let pixel = Point2::new(at as f64, at as f64);
            let depth = f64::from(found[i].0[(at, at)]);
            (
                cameras[i].point(pixel, depth).unwrap().z,
                found[i].1[(at, at)],
            )
        })
    }

    #[test]
    fn two_readings_of_a_plane_become_their_weighted_mean_from_both_sides() {
        let (above, aside) = (camera([0.0, 0.01, 0.8]), camera([0.4, 0.0, 0.7]));
        let found = fused([&above, &aside], [0.4e-3, -0.4e-3], [1e-3, 1e-3]);
        for (height, sigma) in found {
            assert!(height.abs() < 0.12e-3, "{height}");
            assert!((0.6e-3..0.8e-3).contains(&sigma), "{sigma}");
        }
        // The one that is surer counts more.
        let found = fused([&above, &aside], [0.4e-3, -0.4e-3], [0.2e-3, 1e-3]);
        for (height, _) in found {
            assert!((0.25e-3..0.4e-3).contains(&height), "{height}");
        }
    }

    #[test]
    fn surfaces_farther_apart_than_their_errors_and_those_seen_from_behind_stay() {
        let (above, aside) = (camera([0.0, 0.01, 0.8]), camera([0.4, 0.0, 0.7]));
        let below = camera([0.0, 0.01, -0.8]);
        for (other, heights) in [(&aside, [8e-3, 0.0]), (&below, [0.5e-3, 0.0])] {
            let found = fused([&above, other], heights, [1e-3, 1e-3]);
            for ((height, sigma), true_height) in found.into_iter().zip(heights) {
                assert!(
                    (height - true_height).abs() < 1e-6,
                    "{height} {true_height}"
                );
                assert_eq!(sigma, 1e-3);
            }
        }
    }

    #[test]
    fn readings_of_captures_whose_turns_are_not_known_to_each_other_stay() {
        let (above, aside) = (camera([0.0, 0.01, 0.8]), camera([0.4, 0.0, 0.7]));
        let heights = [0.4e-3, -0.4e-3];
        let found = fused_of_turns([&above, &aside], heights, [1e-3, 1e-3], [0, 1]);
        for ((height, sigma), own) in found.into_iter().zip(heights) {
            assert!((height - own).abs() < 1e-6, "{height} {own}");
            assert_eq!(sigma, 1e-3);
        }
    }

    #[test]
    fn each_depth_keeps_its_own_bias() {
        let cameras = [camera([0.0, 0.01, 0.8]), camera([0.1, 0.0, 0.8])];
        let read = cameras.each_ref().map(|c| plane(c, 0.0, 1e-3));
        let deeper = read[1].depth.map(|d| d + 5e-3);
        let biased = EnhancedDepth {
            depth: deeper.clone(),
            ..read[1].clone()
        };
        let seen = |i: usize, enhanced, bias| CameraDepth {
            camera: &cameras[i],
            enhanced,
            bias,
            remaining: 0.0,
            turned_with: 0,
        };
        let found = fuse(&[seen(0, &read[0], 0.0), seen(1, &biased, 5e-3)]);
        let at = (SIDE / 2, SIDE / 2);
        assert!((found[0].0[at] - read[0].depth[at]).abs() < 1e-6);
        assert!((found[1].0[at] - deeper[at]).abs() < 1e-6);
        assert!(found[1].1[at] < 0.8e-3, "two readings are surer than one");
    }
}

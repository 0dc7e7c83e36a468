//! Measures how far a point's projection is from the contour of a silhouette: the exact distance to the level set, in a
//! band around it. It knows one view only; other files decide what the distances mean.

use crate::calibration::Camera;
use crate::image::{Grid, PixelRect};
use crate::reconstruct::hull::Cone;
use nalgebra::{Point2, Point3, Vector2, Vector3};

/// The value of a silhouette's contour.
const CONTOUR: f32 = 127.5;
/// Distances are known this far from the contour, in pixels.
const BAND_PX: f32 = 5.0;
/// Beyond this many pixels a picture point has nothing to do with the contour.
pub(super) const REACH_PX: f64 = 3.0;

/// A silhouette's contour as one camera sees it.
pub(super) struct Contour<'a> {
    pub(super) camera: &'a Camera,
    /// 128 and more where the silhouette says nothing.
    unknown: Option<&'a Grid<u8>>,
    /// The part of the picture that the band lies in.
    part: PixelRect,
    /// Signed distance in pixels, positive inside; saturated at [`BAND_PX`].
    distance: Grid<f32>,
    /// Points of the contour, the middle of the piece in each square of four pixels, and the lengths of the pieces.
    pub(super) points: Vec<(Point2<f64>, f64)>,
}

/// Where a point lies against a contour.
#[derive(Clone, Copy)]
pub(super) struct Offset {
    /// The point's picture.
    pub(super) pixel: Point2<f64>,
    /// Distance of the point's picture to the contour in pixels, positive inside.
    pub(super) inside_px: f64,
    /// How much that grows along each axis of the rig, in pixels a metre.
    pub(super) gradient: Vector3<f64>,
}

impl<'a> Contour<'a> {
    /// The contour that a cone was made of.
    pub(super) fn of(cone: &'a Cone<'_>) -> Self {
        Self::new(cone.camera(), cone.level(), cone.unknown())
    }

    /// The contour of a level set of the size of the camera's pictures, but where `unknown` is 128 or more.
    pub(super) fn new(camera: &'a Camera, level: &Grid<u8>, unknown: Option<&'a Grid<u8>>) -> Self {
        let is_unknown = |x: usize, y: usize| unknown.is_some_and(|grid| grid[(x, y)] >= 128);
        let (width, height) = (level.width(), level.height());
        let object = level.extent(PixelRect::whole(width, height), |&l| f32::from(l) > CONTOUR);
        let part = object
            .unwrap_or_default()
            .grown(BAND_PX as usize + 2, width, height);
        let (columns, rows) = (part.x1 - part.x0, part.y1 - part.y0);
        let mut distance = Grid::filled(columns, rows, BAND_PX);
        let mut points = Vec::new();
        for y in part.y0..part.y1.saturating_sub(1) {
            let (top, bottom) = (level.row(y), level.row(y + 1));
            for x in part.x0..part.x1.saturating_sub(1) {
                let corners = [top[x], top[x + 1], bottom[x + 1], bottom[x]].map(f32::from);
                let above = corners.map(|c| c > CONTOUR);
                if above == [true; 4] || above == [false; 4] {
                    continue;
                }
                let around = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)];
                if around.iter().any(|&(x, y)| is_unknown(x, y)) {
                    continue;
                }
                let origin = Vector2::new((x - part.x0) as f32, (y - part.y0) as f32);
                for [a, b] in pieces(corners).into_iter().flatten() {
                    let (a, b) = (a + origin, b + origin);
                    note_nearest(&mut distance, a, b);
                    let middle = (a + b).cast::<f64>() * 0.5;
                    let corner = Vector2::new(part.x0 as f64, part.y0 as f64);
                    points.push((Point2::from(middle + corner), f64::from((a - b).norm())));
                }
            }
        }
        for y in 0..rows {
            let levels = &level.row(part.y0 + y)[part.x0..part.x1];
            for (d, &l) in distance.row_mut(y).iter_mut().zip(levels) {
                if f32::from(l) <= CONTOUR {
                    *d = -*d;
                }
            }
        }
        Self {
            camera,
            unknown,
            part,
            distance,
            points,
        }
    }

    /// Signed distance of a pixel to the contour; `None` farther than [`REACH_PX`] from it.
    pub(super) fn distance(&self, pixel: Point2<f64>) -> Option<f64> {
        self.sample(pixel).filter(|d| d.abs() < REACH_PX)
    }

    /// The same, saturated at [`BAND_PX`]; `None` outside the part of the picture that is known.
    fn sample(&self, pixel: Point2<f64>) -> Option<f64> {
        let last_x = self.distance.width().checked_sub(2)? + 1;
        let last_y = self.distance.height().checked_sub(2)? + 1;
        // Half of an outermost pixel lies beyond its middle.
        let on_middles = |c: f64, last: usize| {
            let is_within = (-0.5..last as f64 + 0.5).contains(&c);
            is_within.then(|| c.clamp(0.0, last as f64))
        };
        let x = on_middles(pixel.x - self.part.x0 as f64, last_x)?;
        let y = on_middles(pixel.y - self.part.y0 as f64, last_y)?;
        let x0 = (x as usize).min(last_x - 1);
        let y0 = (y as usize).min(last_y - 1);
        let (fx, fy) = (x - x0 as f64, y - y0 as f64);
        let (top, bottom) = (self.distance.row(y0), self.distance.row(y0 + 1));
        let mix = |row: &[f32]| f64::from(row[x0]) * (1.0 - fx) + f64::from(row[x0 + 1]) * fx;
        Some(mix(top) * (1.0 - fy) + mix(bottom) * fy)
    }

    /// How many pixels the picture of a point of the rig's frame lies inside the silhouette, saturated at [`BAND_PX`];
    /// `None` where the camera's picture does not have it, or the silhouette says nothing.
    pub(super) fn inside_px(&self, p: Point3<f64>) -> Option<f64> {
        let (pixel, _) = self.camera.project(p)?;
        let [x, y] = [pixel.x, pixel.y].map(|c| c.round() as isize);
        let unknown = self.unknown.and_then(|mask| mask.get(x, y));
        let is_seen =
            self.camera.intrinsics.contains(pixel) && unknown.is_none_or(|&value| value < 128);
        is_seen.then(|| self.sample(pixel).unwrap_or(-f64::from(BAND_PX)))
    }

    /// Where a point of the rig's frame lies against the contour; `None` where its picture is far from it.
    pub(super) fn offset(&self, p: Point3<f64>) -> Option<Offset> {
        const STEP_PX: f64 = 0.75;
        let (pixel, depth) = self.camera.project(p)?;
        let inside_px = self.distance(pixel)?;
        let at = |dx: f64, dy: f64| self.sample(Point2::new(pixel.x + dx, pixel.y + dy));
        let slope_x = (at(STEP_PX, 0.0)? - at(-STEP_PX, 0.0)?) / (2.0 * STEP_PX);
        let slope_y = (at(0.0, STEP_PX)? - at(0.0, -STEP_PX)?) / (2.0 * STEP_PX);
        // The derivative of the pinhole; the lens' distortion turns it by next to nothing.
        let lens = &self.camera.intrinsics;
        let q = self.camera.camera_from_rig(p);
        let (gx, gy) = (
            slope_x * lens.focal_px.x / depth,
            slope_y * lens.focal_px.y / depth,
        );
        let in_camera = Vector3::new(gx, gy, -(gx * q.x + gy * q.y) / depth);
        Some(Offset {
            pixel,
            inside_px,
            gradient: self.camera.rig_from_camera.rotation * in_camera,
        })
    }
}

/// The pieces of the contour within a square, given the levels at its corners in order around it.
fn pieces(corners: [f32; 4]) -> [Option<[Vector2<f32>; 2]>; 2] {
    const PLACES: [[f32; 2]; 4] = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    let mut crossings = [Vector2::zeros(); 4];
    let mut count = 0;
    for i in 0..4 {
        let j = (i + 1) % 4;
        let (a, b) = (corners[i] - CONTOUR, corners[j] - CONTOUR);
        if (a > 0.0) != (b > 0.0) {
            let (p, q) = (Vector2::from(PLACES[i]), Vector2::from(PLACES[j]));
            crossings[count] = p + (q - p) * (a / (a - b));
            count += 1;
        }
    }
    let [a, b, c, d] = crossings;
    if count < 4 {
        return [(count == 2).then_some([a, b]), None];
    }
    // A saddle: the middle decides which corners belong together.
    let middle = corners.iter().sum::<f32>() > 4.0 * CONTOUR;
    if middle == (corners[0] > CONTOUR) {
        [Some([a, b]), Some([c, d])]
    } else {
        [Some([d, a]), Some([b, c])]
    }
}

/// Lowers the distances of the pixels around a piece of the contour.
fn note_nearest(distance: &mut Grid<f32>, a: Vector2<f32>, b: Vector2<f32>) {
    let along = b - a;
    let length_squared = along.norm_squared().max(1e-12);
    let (low, high) = (a.inf(&b), a.sup(&b));
    let first = |v: f32| (v - BAND_PX).ceil().max(0.0) as usize;
    let last = |v: f32, n: usize| ((v + BAND_PX).floor() as usize).min(n - 1);
    for y in first(low.y)..=last(high.y, distance.height()) {
        let columns = first(low.x)..=last(high.x, distance.width());
        let row = distance.row_mut(y);
        for x in columns {
            let from = Vector2::new(x as f32, y as f32) - a;
            let t = (from.dot(&along) / length_squared).clamp(0.0, 1.0);
            row[x] = row[x].min((from - along * t).norm());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{Distortion, Intrinsics};
    use crate::frame::CameraId;
    use nalgebra::Isometry3;

    #[test]
    fn the_distance_to_a_circle_is_exact_and_grows_inwards() {
        let lens = Intrinsics::new(
            120,
            100,
            Vector2::repeat(150.0),
            Vector2::new(59.5, 49.5),
            Distortion::default(),
        );
        let camera = Camera::new(
            CameraId::new("c00").unwrap(),
            lens.unwrap(),
            Isometry3::identity(),
        );
        let (center, radius) = (Point2::new(60.3, 48.9), 30.2);
        let inside = |x: f64, y: f64| radius - (Point2::new(x, y) - center).norm();
        let level = Grid::from_fn(120, 100, |x, y| {
            (127.5 + 90.0 * inside(x as f64, y as f64))
                .round()
                .clamp(0.0, 255.0) as u8
        });
        let contour = Contour::new(&camera, &level, None);
        for i in 0..400 {
            let turn = f64::from(i) * 0.37;
            let off = f64::from(i % 50) / 10.0 - 2.5;
            let at = center + Vector2::new(turn.cos(), turn.sin()) * (radius - off);
            let found = contour.distance(at).unwrap();
            assert!((found - off).abs() < 0.06, "{found} for {off}");
            let p = camera.ray(at).unwrap() * 0.5;
            let offset = contour.offset(Point3::from(p)).unwrap();
            let towards = Vector3::new(-turn.cos(), -turn.sin(), 0.0);
            // A metre at half a metre is 300 pixels, less by the slant of the ray.
            let grows = offset.gradient.dot(&towards);
            assert!((280.0..325.0).contains(&grows), "{grows}");
        }
        assert!(contour.distance(center).is_none());
        let around = contour.points.iter().map(|(_, length)| length).sum::<f64>();
        assert!(
            (around - std::f64::consts::TAU * radius).abs() < 0.5,
            "{around}"
        );
    }
}

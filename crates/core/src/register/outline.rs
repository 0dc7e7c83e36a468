//! One camera's silhouette as a signed distance image from which the lens' distortion is removed, with points of its
//! contour. Comparing a point of space with it takes a few operations.

use super::contour::{self, Chain};
use crate::calibration::{Camera, Intrinsics};
use crate::image::{Grid, Mask};
use crate::reconstruct::silhouette::Silhouette;
use nalgebra::{Isometry3, Matrix3, Point2, Point3, Vector2, Vector3};

/// Cells of the distance image along its longer side, at most.
const MOST_CELLS: f64 = 640.0;
/// Points of a view's contour, and the fewest pixels between two.
const POINTS: f64 = 360.0;
const LEAST_SPACING_PX: f64 = 1.5;
/// Cells around the contour.
const MARGIN: f64 = 16.0;
/// Cells along the side of a block, of which the least distance is known.
const BLOCK: usize = 8;
/// Share of the largest distance of a block by which rounding may bring what is interpolated below the least one.
const ROUNDING: f32 = 1e-6;

/// A point of a contour and the viewing ray through it.
#[derive(Clone, Copy, Debug)]
pub(super) struct ContourPoint {
    /// Unit direction in the rig's frame.
    pub(super) direction: Vector3<f64>,
    /// Pixels of contour from here to the next point of its chain.
    pub(super) length_px: f64,
    /// Which chain of the view it belongs to.
    pub(super) chain: usize,
}

/// A silhouette and its camera.
#[derive(Clone, Debug)]
pub(super) struct Outline {
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
    /// The camera's centre in the rig's frame.
    pub(super) eye: Point3<f64>,
    /// Cells a unit of the normalised picture plane.
    scale: f64,
    /// Normalised coordinates of cell (0, 0).
    corner: Vector2<f64>,
    /// Distance to the contour in units of the normalised picture plane, positive inside.
    distance: Grid<f32>,
    /// What no interpolated distance of a block of cells is below. It fits into the processor's cache, where the
    /// distances of all cells do not.
    least: Grid<f32>,
    /// Points of the contour at equal distances, in the order of the chains.
    pub(super) points: Vec<ContourPoint>,
    /// For each chain whether it is closed.
    pub(super) is_closed: Vec<bool>,
}

/// A straight piece of the contour on the normalised picture plane.
struct Segment {
    from: Vector2<f64>,
    to: Vector2<f64>,
}

impl Outline {
    /// The outline of a silhouette; `None` where it has no contour. Where it says nothing it has none, and objects to
    /// nothing.
    pub(super) fn new(camera: &Camera, silhouette: &Silhouette) -> Option<Self> {
        let lens = &camera.intrinsics;
        let level: &Mask = &silhouette.possible_object();
        let unknown = silhouette.unknown.as_ref();
        let chains = contour::chains(&silhouette.level, unknown, silhouette.bounds);
        let mut segments = Vec::new();
        for chain in &chains {
            let points = chain.points.iter().filter_map(|&p| lens.unproject(p));
            let points: Vec<Vector2<f64>> = points.collect();
            let closing = chain.is_closed.then(|| points.first()).flatten();
            let next = points.iter().skip(1).chain(closing);
            let pairs = points.iter().zip(next);
            segments.extend(pairs.map(|(&from, &to)| Segment { from, to }));
        }
        let first = segments.first()?;
        let (mut low, mut high) = (first.from, first.from);
        for s in &segments {
            low = low.inf(&s.from).inf(&s.to);
            high = high.sup(&s.from).sup(&s.to);
        }
        let focal_px = lens.focal_px.min();
        let extent = (high - low).max().max(1e-6);
        let scale = focal_px.min((MOST_CELLS - 2.0 * MARGIN) / extent);
        let corner = low - Vector2::repeat(MARGIN / scale);
        let cells = ((high - low) * scale).map(|c| (c + 2.0 * MARGIN).ceil() as usize + 1);
        let mut distance = unsigned(&segments, corner, scale, [cells.x, cells.y]);
        for y in 0..cells.y {
            for (x, d) in distance.row_mut(y).iter_mut().enumerate() {
                let n = corner + Vector2::new(x as f64, y as f64) / scale;
                if !is_inside(lens, level, n) {
                    *d = -*d;
                }
            }
        }
        let camera_from_rig: Isometry3<f64> = camera.rig_from_camera.inverse();
        Some(Self {
            rotation: camera_from_rig.rotation.to_rotation_matrix().into_inner(),
            translation: camera_from_rig.translation.vector,
            eye: camera.center(),
            scale,
            corner,
            least: least_of_blocks(&distance),
            distance,
            points: contour_points(camera, &chains),
            is_closed: chains.iter().map(|c| c.is_closed).collect(),
        })
    }

    /// The same outline, if its camera were `scale` times as far from the rig's origin.
    pub(super) fn scaled(&self, scale: f64) -> Self {
        Self {
            translation: self.translation * scale,
            eye: self.eye * scale,
            ..self.clone()
        }
    }

    /// A point of the rig's frame in the camera's.
    #[inline]
    pub(super) fn in_camera(&self, p: Point3<f64>) -> Vector3<f64> {
        self.rotation * p.coords + self.translation
    }

    /// A direction of the rig's frame in the camera's.
    #[inline]
    pub(super) fn direction_in_camera(&self, d: Vector3<f64>) -> Vector3<f64> {
        self.rotation * d
    }

    /// How far in metres a point of the camera's frame lies within the silhouette's cone; negative outside. A camera
    /// does not object to what is behind it, or outside its picture.
    #[inline]
    pub(super) fn value(&self, q: Vector3<f64>) -> f64 {
        match self.cell(q) {
            Some(cell) => self.interpolated(cell) * q.z,
            None => f64::INFINITY,
        }
    }

    /// The sum of [`Self::value`] and another length where it is below a limit. Most points lie well within most cones:
    /// then a look at a block of cells is enough.
    #[inline]
    pub(super) fn sum_below(&self, limit: f64, q: Vector3<f64>, other: f64) -> Option<f64> {
        let cell = self.cell(q)?;
        if f64::from(self.least_around(cell)) * q.z + other >= limit {
            return None;
        }
        let sum = self.interpolated(cell) * q.z + other;
        (sum < limit).then_some(sum)
    }

    /// Where a point of the camera's frame lies on the distance image; `None` behind the camera.
    #[inline]
    fn cell(&self, q: Vector3<f64>) -> Option<Vector2<f64>> {
        (q.z > 1e-6).then(|| (Vector2::new(q.x / q.z, q.y / q.z) - self.corner) * self.scale)
    }

    /// A distance that [`Self::interpolated`] is not below.
    #[inline]
    fn least_around(&self, cell: Vector2<f64>) -> f32 {
        let (last_x, last_y) = (self.distance.width() - 1, self.distance.height() - 1);
        let is_within = |c: f64, last: usize| (0.0..=last as f64).contains(&c);
        if is_within(cell.x, last_x) && is_within(cell.y, last_y) {
            self.least[(cell.x as usize / BLOCK, cell.y as usize / BLOCK)]
        } else {
            f32::NEG_INFINITY
        }
    }

    /// Distance to the contour in units of the normalised picture plane; outside the image, what its edge has and the
    /// way from there.
    #[inline]
    fn interpolated(&self, cell: Vector2<f64>) -> f64 {
        let (x, y) = (cell.x, cell.y);
        let (last_x, last_y) = (self.distance.width() - 1, self.distance.height() - 1);
        let (cx, cy) = (x.clamp(0.0, last_x as f64), y.clamp(0.0, last_y as f64));
        let (x0, y0) = ((cx as usize).min(last_x - 1), (cy as usize).min(last_y - 1));
        let (fx, fy) = ((cx - x0 as f64) as f32, (cy - y0 as f64) as f32);
        let (top, bottom) = (self.distance.row(y0), self.distance.row(y0 + 1));
        let upper = top[x0] + (top[x0 + 1] - top[x0]) * fx;
        let lower = bottom[x0] + (bottom[x0 + 1] - bottom[x0]) * fx;
        let mut value = f64::from(upper + (lower - upper) * fy);
        if value < 0.0 && (cx != x || cy != y) {
            value -= (x - cx).hypot(y - cy) / self.scale;
        }
        value
    }
}

/// For each block of cells the least of its distances, those on its border among them, and less than that by what
/// rounding may cost.
fn least_of_blocks(distance: &Grid<f32>) -> Grid<f32> {
    let (width, height) = (distance.width(), distance.height());
    let mut least = Grid::filled(width.div_ceil(BLOCK), height.div_ceil(BLOCK), 0.0);
    for block_y in 0..least.height() {
        for block_x in 0..least.width() {
            let (x, y) = (block_x * BLOCK, block_y * BLOCK);
            let rows = y..=(y + BLOCK).min(height - 1);
            let row = |y| distance.row(y)[x..=(x + BLOCK).min(width - 1)].iter();
            let all = rows.flat_map(row);
            let (low, largest) = all.fold((f32::INFINITY, 0.0_f32), |(low, largest), d| {
                (low.min(*d), largest.max(d.abs()))
            });
            least[(block_x, block_y)] = low - ROUNDING * largest;
        }
    }
    least
}

/// Whether a direction is in the silhouette. What lies outside the picture may be.
fn is_inside(lens: &Intrinsics, level: &Mask, n: Vector2<f64>) -> bool {
    let Some(pixel) = lens.project(n.x, n.y, 1.0) else {
        return true;
    };
    if !lens.contains(pixel) {
        return true;
    }
    sample(level, pixel) > contour::CONTOUR
}

fn sample(level: &Mask, pixel: Point2<f64>) -> f32 {
    let (last_x, last_y) = (level.width() - 1, level.height() - 1);
    let (x, y) = (
        pixel.x.clamp(0.0, last_x as f64),
        pixel.y.clamp(0.0, last_y as f64),
    );
    let (x0, y0) = (x as usize, y as usize);
    let (x1, y1) = ((x0 + 1).min(last_x), (y0 + 1).min(last_y));
    let (fx, fy) = ((x - x0 as f64) as f32, (y - y0 as f64) as f32);
    let mix = |y| {
        let (a, b) = (f32::from(level[(x0, y)]), f32::from(level[(x1, y)]));
        a + (b - a) * fx
    };
    mix(y0) + (mix(y1) - mix(y0)) * fy
}

/// Points of the chains at equal distances along them, with their rays.
fn contour_points(camera: &Camera, chains: &[Chain]) -> Vec<ContourPoint> {
    let mut found = Vec::new();
    let perimeter: f64 = chains.iter().map(Chain::length).sum();
    let spacing_px = (perimeter / POINTS).max(LEAST_SPACING_PX);
    for (index, chain) in chains.iter().enumerate() {
        let closing = chain.is_closed.then(|| chain.points.first()).flatten();
        let mut points = chain.points.iter().chain(closing);
        let Some(mut before) = points.next() else {
            continue;
        };
        let mut wanted = 0.5 * spacing_px;
        let mut passed = 0.0;
        for p in points {
            let length = (p - before).norm();
            while passed + length >= wanted && length > 0.0 {
                let at = before + (p - before) * ((wanted - passed) / length);
                if let Some(direction) = camera.ray(at) {
                    found.push(ContourPoint {
                        direction,
                        length_px: spacing_px,
                        chain: index,
                    });
                }
                wanted += spacing_px;
            }
            passed += length;
            before = p;
        }
    }
    found
}

/// The distance of each cell to the nearest segment: each cell asks its neighbours for their nearest segments, in four
/// sweeps, which finds the nearest or one as near within a hundredth of a cell.
fn unsigned(
    segments: &[Segment],
    corner: Vector2<f64>,
    scale: f64,
    [width, height]: [usize; 2],
) -> Grid<f32> {
    const NONE: u32 = u32::MAX;
    let mut nearest = Grid::filled(width, height, NONE);
    let mut distance = Grid::filled(width, height, f32::INFINITY);
    let to_segment = |x: usize, y: usize, index: u32| {
        let Segment { from, to } = &segments[index as usize];
        let p = corner + Vector2::new(x as f64, y as f64) / scale - from;
        let along = to - from;
        let t = (p.dot(&along) / along.norm_squared().max(1e-30)).clamp(0.0, 1.0);
        (p - along * t).norm() as f32
    };
    for (index, s) in segments.iter().enumerate() {
        let (low, high) = (s.from.inf(&s.to), s.from.sup(&s.to));
        let cell = |v: Vector2<f64>| (v - corner) * scale;
        let (low, high) = (cell(low), cell(high));
        for y in (low.y.floor().max(0.0) as usize)..=(high.y.ceil() as usize).min(height - 1) {
            for x in (low.x.floor().max(0.0) as usize)..=(high.x.ceil() as usize).min(width - 1) {
                let d = to_segment(x, y, index as u32);
                if d < distance[(x, y)] {
                    (distance[(x, y)], nearest[(x, y)]) = (d, index as u32);
                }
            }
        }
    }
    let mut ask = |x: usize, y: usize, dx: isize, dy: isize| {
        let (nx, ny) = (x as isize + dx, y as isize + dy);
        let Some(&index) = nearest.get(nx, ny).filter(|&&index| index != NONE) else {
            return;
        };
        if index != nearest[(x, y)] {
            let d = to_segment(x, y, index);
            if d < distance[(x, y)] {
                (distance[(x, y)], nearest[(x, y)]) = (d, index);
            }
        }
    };
    for y in 0..height {
        for x in 0..width {
            for (dx, dy) in [(-1, 0), (-1, -1), (0, -1), (1, -1)] {
                ask(x, y, dx, dy);
            }
        }
        for x in (0..width).rev() {
            ask(x, y, 1, 0);
        }
    }
    for y in (0..height).rev() {
        for x in (0..width).rev() {
            for (dx, dy) in [(1, 0), (1, 1), (0, 1), (-1, 1)] {
                ask(x, y, dx, dy);
            }
        }
        for x in 0..width {
            ask(x, y, -1, 0);
        }
    }
    distance
}

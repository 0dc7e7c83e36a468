//! A solid carved by depth: the space in front of a depth camera's surface is empty, on rays that may carve.

use super::creases::Creases;
use super::extremes::Extremes;
use super::steps::{Step, Steps};
use crate::calibration::DepthCamera;
use crate::image::{Grid, PixelRect};
use crate::reconstruct::surface::{Constraint, Side, Solid, UndecidedConstraints};
use nalgebra::{Point2, Point3, Vector3};

/// Depth cameras are numbered downwards from here, cameras from 0 upwards.
const FIRST_CARVING: Constraint = Constraint::MAX - 64;

/// The bit for all carvings together.
const CARVING: UndecidedConstraints = 1 << 63;

/// What one depth camera carves away.
pub struct Carving<'a> {
    camera: &'a DepthCamera,
    /// For each pixel the depth before which space is empty; 0 where the ray carves nothing.
    depth: Grid<f32>,
    extremes: Extremes<f32>,
    edges: Option<Edges>,
    /// Turns metres before the surface into the units of a silhouette.
    values_per_metre: f64,
}

/// Where depth between pixels is not bilinear.
struct Edges {
    creases: Creases,
    steps: Steps,
}

impl<'a> Carving<'a> {
    /// From the depth, in metres, before which space is empty; 0 for pixels that carve nothing. Between
    /// pixels depth is bilinear. `cell_size` is that of the lattice it will be extracted on.
    pub fn new(camera: &'a DepthCamera, depth: Grid<f32>, cell_size: f64) -> Self {
        Self {
            camera,
            extremes: Extremes::new(&depth),
            edges: None,
            depth,
            values_per_metre: 127.5 / cell_size,
        }
    }

    /// Lets depth go on straight to creases, and to the middle of steps. Where an edge is, is known to half a pixel
    /// only, so depth may go too deep there. With several depth cameras the deepest would win: this is for one alone.
    pub fn with_edges(mut self) -> Self {
        let pixel = (1.0 / self.camera.camera.intrinsics.focal_px.min()) as f32;
        self.edges = Some(Edges {
            creases: Creases::new(&self.depth, pixel),
            steps: Steps::new(&self.depth, pixel),
        });
        self
    }

    /// What reaches wherever two carvings of one camera may differ: all of the rays on which they do, and those beside
    /// them, where creases and steps depend on them.
    pub fn changed((a, b): (&Self, &Self)) -> Self {
        let differ = |x, y| a.depth[(x, y)] != b.depth[(x, y)];
        let (width, height) = (a.depth.width(), a.depth.height());
        let mut depth = Grid::filled(width, height, 0.0);
        for y in 0..height {
            for x in (0..width).filter(|&x| differ(x, y)) {
                let part = PixelRect {
                    x0: x,
                    y0: y,
                    x1: x + 1,
                    y1: y + 1,
                }
                .grown(1, width, height);
                for y in part.y0..part.y1 {
                    depth.row_mut(y)[part.x0..part.x1].fill(f32::MAX);
                }
            }
        }
        Self {
            camera: a.camera,
            extremes: Extremes::new(&depth),
            edges: None,
            depth,
            values_per_metre: a.values_per_metre,
        }
    }

    /// The depth camera.
    pub fn camera(&self) -> &'a DepthCamera {
        self.camera
    }

    /// Depth of the carving surface; `None` where a pixel around carves nothing.
    pub fn depth_at(&self, pixel: Point2<f64>) -> Option<f64> {
        let (cell, shares) = self.cell(pixel)?;
        let corners = self.corners(cell, shares)?;
        if self.is_stepped(cell) {
            return Some(Step::new(corners).depth());
        }
        if let Some(Edges { creases, .. }) = &self.edges
            && creases.is_creased(cell.0, cell.1)
        {
            let shares = shares.map(|share| share as f32);
            return Some(f64::from(creases.depth_at(&self.depth, cell, shares)));
        }
        let weighted = corners
            .iter()
            .map(|(depth, weight)| f64::from(*depth) * weight);
        Some(weighted.sum())
    }

    fn is_stepped(&self, (x, y): (usize, usize)) -> bool {
        let edges = self.edges.as_ref();
        edges.is_some_and(|edges| edges.steps.is_stepped(x, y))
    }

    /// The cell that a place lies in, by its left upper pixel, and its shares of the way to the opposite one.
    fn cell(&self, pixel: Point2<f64>) -> Option<((usize, usize), [f64; 2])> {
        let (x, y) = (pixel.x.floor(), pixel.y.floor());
        let (width, height) = (self.depth.width() as f64, self.depth.height() as f64);
        let is_inside = x >= 0.0 && y >= 0.0 && x + 1.0 < width && y + 1.0 < height;
        is_inside.then_some(((x as usize, y as usize), [pixel.x - x, pixel.y - y]))
    }

    /// The depths of a cell's corners with their bilinear weights, if all of them have one.
    fn corners(&self, (x, y): (usize, usize), [fx, fy]: [f64; 2]) -> Option<[(f32, f64); 4]> {
        let corners = [
            (self.depth[(x, y)], (1.0 - fx) * (1.0 - fy)),
            (self.depth[(x + 1, y)], fx * (1.0 - fy)),
            (self.depth[(x, y + 1)], (1.0 - fx) * fy),
            (self.depth[(x + 1, y + 1)], fx * fy),
        ];
        corners.iter().all(|(d, _)| *d != 0.0).then_some(corners)
    }

    /// How far, in metres, a point at depth `z` lies behind the carving surface, or, if that is less, within the side
    /// of a step.
    fn behind(&self, pixel: Point2<f64>, z: f64) -> Option<f64> {
        let (cell, shares) = self.cell(pixel)?;
        if self.is_stepped(cell) {
            let size = z / self.camera.camera.intrinsics.focal_px.min();
            return Some(Step::new(self.corners(cell, shares)?).behind(z, size));
        }
        Some(z - self.depth_at(pixel)?)
    }

    /// How far, in metres, a point lies before the carving surface: positive for what is taken off, `None`
    /// where nothing is carved.
    pub fn carved_depth(&self, p: Point3<f64>) -> Option<f64> {
        let (pixel, z) = self.camera.project(p)?;
        Some(self.depth_at(pixel)? - z)
    }

    /// Whether anything may be carved in the cube of half edge `half` around `center`.
    pub fn touches(&self, center: Point3<f64>, half: f64) -> bool {
        self.side(center, half) != Side::Inside
    }

    /// Positive behind the surface; `None` where nothing is carved.
    fn value(&self, p: Point3<f64>) -> Option<f32> {
        let (pixel, z) = self.camera.project(p)?;
        let behind = self.behind(pixel, z)?;
        Some((behind * self.values_per_metre).clamp(-127.5, 127.5) as f32)
    }

    /// Unit outward normal of the carving surface at a point: towards the camera; `None` where nothing is carved.
    pub fn normal(&self, p: Point3<f64>) -> Option<Vector3<f64>> {
        const STEP_PX: f64 = 0.5;
        let (pixel, _) = self.camera.project(p)?;
        let at = |dx: f64, dy: f64| self.depth_at(Point2::new(pixel.x + dx, pixel.y + dy));
        let slope_x = at(STEP_PX, 0.0)? - at(-STEP_PX, 0.0)?;
        let slope_y = at(0.0, STEP_PX)? - at(0.0, -STEP_PX)?;
        let pose = &self.camera.camera;
        let (q, lens) = (pose.camera_from_rig(p), &pose.intrinsics);
        let (gx, gy) = (
            slope_x * lens.focal_px.x / q.z,
            slope_y * lens.focal_px.y / q.z,
        );
        // The gradient of z - D(x/z, y/z) points into the object.
        let inwards = Vector3::new(-gx, -gy, 1.0 + (gx * q.x + gy * q.y) / q.z);
        (-(pose.rig_from_camera.rotation * inwards)).try_normalize(1e-12)
    }

    fn side(&self, center: Point3<f64>, half: f64) -> Side {
        let radius = half * 3f64.sqrt();
        let Some((pixel, z)) = self
            .camera
            .project(center)
            .filter(|(_, z)| *z > 2.0 * radius)
        else {
            return Side::Across(CARVING);
        };
        let lens = &self.camera.camera.intrinsics;
        let extent = 1.2 * lens.focal_px.max() * radius / (z - radius) + 1.0;
        let (last_x, last_y) = (
            self.depth.width() as f64 - 1.0,
            self.depth.height() as f64 - 1.0,
        );
        let [x0, x1, y0, y1] = [
            pixel.x - extent,
            pixel.x + extent,
            pixel.y - extent,
            pixel.y + extent,
        ];
        if x1 < 0.0 || y1 < 0.0 || x0 > last_x || y0 > last_y {
            return Side::Inside;
        }
        let pixels = |a: f64, b: f64, last: f64| {
            [
                a.clamp(0.0, last) as usize,
                b.clamp(0.0, last).ceil() as usize,
            ]
        };
        let [low, high] = self
            .extremes
            .within(pixels(x0, x1, last_x), pixels(y0, y1, last_y));
        let whole = x0 >= 0.0 && y0 >= 0.0 && x1 <= last_x && y1 <= last_y;
        if z - radius > f64::from(high) {
            Side::Inside
        } else if low > 0.0 && whole && z + radius < f64::from(low) {
            Side::Outside
        } else {
            Side::Across(CARVING)
        }
    }
}

/// The hull with everything taken away that a depth camera sees through: the paper's depth hull where all
/// rays carve, the start of the restoration where only those of the concave regions do.
pub struct Carved<'a> {
    hull: &'a dyn Solid,
    carvings: &'a [Carving<'a>],
}

impl<'a> Carved<'a> {
    /// Carves a hull.
    pub fn new(hull: &'a dyn Solid, carvings: &'a [Carving<'a>]) -> Self {
        Self { hull, carvings }
    }

    /// The carving whose surface lies deepest behind a point, and by how much.
    fn deepest(&self, p: Point3<f64>) -> Option<(f32, usize)> {
        let values = self
            .carvings
            .iter()
            .enumerate()
            .filter_map(|(i, c)| Some((c.value(p)?, i)));
        values.min_by(|a, b| a.0.total_cmp(&b.0))
    }
}

/// The number of the carving that a constraint stands for.
pub fn carving_of(constraint: Constraint) -> Option<usize> {
    (FIRST_CARVING - 1024..=FIRST_CARVING)
        .contains(&constraint)
        .then(|| (FIRST_CARVING - constraint) as usize)
}

impl Solid for Carved<'_> {
    fn side(&self, center: Point3<f64>, half: f64, undecided: UndecidedConstraints) -> Side {
        let hull = self.hull.side(center, half, undecided);
        if hull == Side::Outside {
            return Side::Outside;
        }
        let mut left = if let Side::Across(left) = hull {
            left
        } else {
            0
        };
        if undecided & CARVING != 0 {
            for carving in self.carvings {
                match carving.side(center, half) {
                    Side::Outside => return Side::Outside,
                    Side::Inside => {}
                    Side::Across(_) => left |= CARVING,
                }
            }
        }
        if left == 0 {
            Side::Inside
        } else {
            Side::Across(left)
        }
    }

    fn value(&self, p: Point3<f64>, undecided: UndecidedConstraints) -> f32 {
        let hull = self.hull.value(p, undecided);
        if undecided & CARVING == 0 {
            return hull;
        }
        self.deepest(p).map_or(hull, |(value, _)| value.min(hull))
    }

    fn normal(
        &self,
        p: Point3<f64>,
        undecided: UndecidedConstraints,
    ) -> (Vector3<f32>, Constraint) {
        if undecided & CARVING != 0
            && let Some((value, i)) = self.deepest(p)
            && value < self.hull.value(p, undecided)
            && let Some(normal) = self.carvings[i].normal(p)
        {
            return (normal.cast(), FIRST_CARVING - i as Constraint);
        }
        self.hull.normal(p, undecided)
    }
}

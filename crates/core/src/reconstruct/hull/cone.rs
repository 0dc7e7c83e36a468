//! One camera's silhouette cone: everything that projects into its silhouette.

use super::extremes::Extremes;
use crate::calibration::Camera;
use crate::image::Grid;
use crate::reconstruct::surface::Side;
use nalgebra::{Point2, Point3, Vector3};

/// The value of a silhouette's contour, between the values inside (up to 255) and outside (down to 0).
const CONTOUR: f32 = 127.5;

/// Values well inside and outside a cone.
pub(super) const SURELY: f32 = CONTOUR;

/// A silhouette seen by a camera.
pub struct Cone<'a> {
    camera: &'a Camera,
    level: &'a Grid<u8>,
    extremes: Extremes<u8>,
    unknown: Option<Unknown<'a>>,
    /// To the camera's axis, in radians, beyond which nothing is in the picture.
    largest_angle: f64,
}

/// Pixels through which the camera sees nothing of the object, nor past it.
struct Unknown<'a> {
    /// 128 and up.
    mask: &'a Grid<u8>,
    extremes: Extremes<u8>,
}

/// The first value of a pixel that is unknown.
const UNKNOWN: u8 = 128;

impl<'a> Cone<'a> {
    /// From a silhouette as a level set (the contour at 127.5, bilinear between pixels) of the size of the
    /// camera's pictures.
    ///
    /// # Panics
    /// If the sizes differ.
    pub fn new(camera: &'a Camera, level: &'a Grid<u8>) -> Self {
        Self::with_unknown(camera, level, None)
    }

    /// As [`Cone::new`], of a silhouette that says nothing where `unknown` is 128 or more. What projects there is as
    /// what projects beyond the frame.
    ///
    /// # Panics
    /// If the sizes differ.
    pub fn with_unknown(
        camera: &'a Camera,
        level: &'a Grid<u8>,
        unknown: Option<&'a Grid<u8>>,
    ) -> Self {
        let size = (camera.intrinsics.width, camera.intrinsics.height);
        assert_eq!(
            (level.width(), level.height()),
            size,
            "the silhouette of camera {}",
            camera.id
        );
        Self {
            camera,
            level,
            extremes: Extremes::new(level),
            largest_angle: camera.intrinsics.largest_angle_in_picture(),
            unknown: unknown.map(|mask| {
                assert!(mask.same_size(level), "what camera {} ignores", camera.id);
                Unknown {
                    mask,
                    extremes: Extremes::new(mask),
                }
            }),
        }
    }

    /// 128 and up where the silhouette says nothing.
    pub fn unknown(&self) -> Option<&'a Grid<u8>> {
        self.unknown.as_ref().map(|unknown| unknown.mask)
    }

    /// Whether the camera sees at a pixel: it is in the picture, and so is no pixel around it unknown.
    #[inline]
    pub(super) fn sees(&self, pixel: Point2<f64>) -> bool {
        self.camera.intrinsics.contains(pixel)
            && self.unknown.as_ref().is_none_or(|unknown| {
                let [_, high] = self.bounds(&unknown.extremes, [pixel.x; 2], [pixel.y; 2]);
                high < UNKNOWN
            })
    }

    /// Whether it would see a point, were nothing unknown.
    pub(super) fn frames(&self, p: Point3<f64>) -> bool {
        let lens = &self.camera.intrinsics;
        let projected = self.camera.project(p);
        projected.is_some_and(|(pixel, _)| lens.contains(pixel))
    }

    /// Bounds of the values in the part of a rectangle that is in the picture.
    fn bounds(&self, of: &Extremes<u8>, [x0, x1]: [f64; 2], [y0, y1]: [f64; 2]) -> [u8; 2] {
        let lens = &self.camera.intrinsics;
        let (width, height) = (lens.width as f64 - 1.0, lens.height as f64 - 1.0);
        let pixels = |a: f64, b: f64, last: f64| {
            [
                a.clamp(0.0, last) as usize,
                b.clamp(0.0, last).ceil() as usize,
            ]
        };
        of.within(pixels(x0, x1, width), pixels(y0, y1, height))
    }

    /// The silhouette as a level set.
    pub fn level(&self) -> &'a Grid<u8> {
        self.level
    }

    /// The camera.
    pub fn camera(&self) -> &'a Camera {
        self.camera
    }

    /// Whether a pixel is inside the silhouette by more than the contour's uncertainty.
    #[inline]
    pub fn is_well_inside(&self, pixel: Point2<f64>) -> bool {
        const WELL_INSIDE: f32 = 250.0;
        self.sees(pixel) && self.sample(pixel) > WELL_INSIDE
    }

    /// Steps across the contour along the picture's rows, per row.
    pub(super) fn raggedness(&self) -> f64 {
        let inside = |v: u8| f32::from(v) > CONTOUR;
        let rows = (0..self.level.height()).map(|y| self.level.row(y).windows(2));
        let steps = rows.map(|row| row.filter(|p| inside(p[0]) != inside(p[1])).count());
        steps.sum::<usize>() as f64 / self.level.height() as f64
    }

    /// What the camera knows of a cube: whether it is inside its silhouette, outside it or both, and what of it is in
    /// the picture.
    pub(super) fn side(&self, center: Point3<f64>, half: f64) -> CubeEvidence {
        let radius = half * 3f64.sqrt();
        let lens = &self.camera.intrinsics;
        let projected = self.camera.project(center);
        let is_centered = projected.is_some_and(|(pixel, _)| lens.contains(pixel));
        if !is_centered && self.is_beside_picture(center, radius) {
            return UNSEEN;
        }
        let Some((pixel, depth)) = projected.filter(|(_, depth)| *depth > 2.0 * radius) else {
            return UNDECIDED;
        };
        // The sphere's image, with room for the lens and for the neighbours that bilinear sampling reads.
        let off_axis = (pixel - lens.center_px)
            .coords
            .component_div(&lens.focal_px)
            .norm_squared();
        let slack = 1.1 * (1.0 + off_axis);
        let extent = lens.focal_px.max() * radius / (depth - radius) * slack + 1.0;
        let (width, height) = (lens.width as f64 - 1.0, lens.height as f64 - 1.0);
        let [x0, x1] = [pixel.x - extent, pixel.x + extent];
        let [y0, y1] = [pixel.y - extent, pixel.y + extent];
        if x1 < -0.5 || y1 < -0.5 || x0 > width + 0.5 || y0 > height + 0.5 {
            return UNSEEN;
        }
        let [low, high] = self.bounds(&self.extremes, [x0, x1], [y0, y1]);
        let within = x0 >= -0.5 && y0 >= -0.5 && x1 <= width + 0.5 && y1 <= height + 0.5;
        let [all, any] = match &self.unknown {
            Some(unknown) => self
                .bounds(&unknown.extremes, [x0, x1], [y0, y1])
                .map(|v| v >= UNKNOWN),
            None => [false; 2],
        };
        let seen = within && !any;
        let side = if all || f32::from(low) > CONTOUR {
            Side::Inside
        } else if f32::from(high) < CONTOUR && seen {
            Side::Outside
        } else {
            Side::Across(0)
        };
        CubeEvidence {
            side,
            seen,
            may_confirm: !all && f32::from(high) > CONTOUR,
        }
    }

    /// Whether a ball is surely beside the picture, or behind the camera.
    fn is_beside_picture(&self, center: Point3<f64>, radius: f64) -> bool {
        let center = self.camera.camera_from_rig(center);
        let distance = center.coords.norm();
        let angle = center.x.hypot(center.y).atan2(center.z);
        let nearest = angle - (radius / distance).min(1.0).asin();
        radius < distance && nearest > self.largest_angle
    }

    /// Positive inside the silhouette, negative outside; `None` where the camera does not see.
    #[inline]
    pub(super) fn value(&self, p: Point3<f64>) -> Option<f32> {
        let (pixel, _) = self.camera.project(p)?;
        self.sees(pixel).then(|| self.sample(pixel) - CONTOUR)
    }

    /// Unit outward normal of the cone at a point of its surface.
    pub(super) fn normal(&self, p: Point3<f64>) -> Option<Vector3<f64>> {
        const STEP_PX: f64 = 0.75;
        let (pixel, depth) = self.camera.project(p)?;
        let at = |dx: f64, dy: f64| f64::from(self.sample(Point2::new(pixel.x + dx, pixel.y + dy)));
        let slope_x = at(STEP_PX, 0.0) - at(-STEP_PX, 0.0);
        let slope_y = at(0.0, STEP_PX) - at(0.0, -STEP_PX);
        self.normal_of(p, depth, [slope_x, slope_y])
    }

    /// The cone's unit outward normal at a point whose image is within `radius_px` of the outline; `None` of any other.
    pub(super) fn normal_near(&self, p: Point3<f64>, radius_px: f64) -> Option<Vector3<f64>> {
        const DIAGONAL: f64 = std::f64::consts::FRAC_1_SQRT_2;
        const AROUND: [[f64; 2]; 8] = [
            [1.0, 0.0],
            [DIAGONAL, DIAGONAL],
            [0.0, 1.0],
            [-DIAGONAL, DIAGONAL],
            [-1.0, 0.0],
            [-DIAGONAL, -DIAGONAL],
            [0.0, -1.0],
            [DIAGONAL, -DIAGONAL],
        ];
        let (pixel, depth) = self.camera.project(p)?;
        if !self.sees(pixel) {
            return None;
        }
        let (mut slope, mut inside) = ([0.0, 0.0], 0);
        for [dx, dy] in AROUND.map(|along| along.map(|part| radius_px * part)) {
            let value = self.sample(Point2::new(pixel.x + dx, pixel.y + dy)) - CONTOUR;
            inside += usize::from(value > 0.0);
            slope[0] += f64::from(value) * dx;
            slope[1] += f64::from(value) * dy;
        }
        let is_near = inside > 0 && inside < AROUND.len();
        is_near.then(|| self.normal_of(p, depth, slope)).flatten()
    }

    /// The unit outward normal at a point where the level rises along x and y of the picture in this proportion.
    fn normal_of(
        &self,
        p: Point3<f64>,
        depth: f64,
        [slope_x, slope_y]: [f64; 2],
    ) -> Option<Vector3<f64>> {
        // The derivative of the pinhole; the lens' distortion turns it by next to nothing.
        let lens = &self.camera.intrinsics;
        let q = self.camera.camera_from_rig(p);
        let (gx, gy) = (slope_x * lens.focal_px.x, slope_y * lens.focal_px.y);
        let inwards = Vector3::new(gx, gy, -(gx * q.x + gy * q.y) / depth);
        let outwards = -(self.camera.rig_from_camera.rotation * inwards);
        outwards.try_normalize(1e-12)
    }

    /// Bilinear; beyond the outermost pixel centres the outermost value.
    #[inline]
    fn sample(&self, pixel: Point2<f64>) -> f32 {
        let (last_x, last_y) = (self.level.width() - 1, self.level.height() - 1);
        let x = pixel.x.clamp(0.0, last_x as f64);
        let y = pixel.y.clamp(0.0, last_y as f64);
        let (x0, y0) = (
            (x as usize).min(last_x.max(1) - 1),
            (y as usize).min(last_y.max(1) - 1),
        );
        let (x1, y1) = ((x0 + 1).min(last_x), (y0 + 1).min(last_y));
        let (fx, fy) = ((x - x0 as f64) as f32, (y - y0 as f64) as f32);
        let (top, bottom) = (self.level.row(y0), self.level.row(y1));
        let lerp = |row: &[u8]| {
            let (a, b) = (f32::from(row[x0]), f32::from(row[x1]));
            a + (b - a) * fx
        };
        let (a, b) = (lerp(top), lerp(bottom));
        a + (b - a) * fy
    }
}

/// What a camera knows of a cube.
pub(super) struct CubeEvidence {
    /// Where the cube is; `Inside` also where the camera sees nothing of it and so cannot object.
    pub(super) side: Side,
    /// Whether all of the cube is within the picture.
    pub(super) seen: bool,
    /// Whether the camera may see a part of it within its silhouette.
    pub(super) may_confirm: bool,
}

/// Of a cube of which the camera sees nothing.
const UNSEEN: CubeEvidence = CubeEvidence {
    side: Side::Inside,
    seen: false,
    may_confirm: false,
};

/// Of a cube near the camera, or beside its picture but not surely.
const UNDECIDED: CubeEvidence = CubeEvidence {
    side: Side::Across(0),
    seen: false,
    may_confirm: true,
};

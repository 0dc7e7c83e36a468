//! Makes pictures and masks as a camera without distortion would have taken them: the pose, focal lengths and principal
//! point stay the same, and each pixel is taken from where the lens put it.

use crate::calibration::{Camera, Intrinsics};
use crate::frame::CameraId;
use crate::image::{Grid, Mask, RgbImage};
use crate::reconstruct::{ColorView, Scene, silhouette};
use nalgebra::{Isometry3, Point2, Point3, Vector2};
use rayon::prelude::*;

/// A camera without distortion. Pixel centres are at whole numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinhole {
    /// Width of its pictures in pixels.
    pub width: usize,
    /// Height of its pictures in pixels.
    pub height: usize,
    /// Focal lengths fx, fy in pixels.
    pub focal_px: Vector2<f64>,
    /// Principal point cx, cy in pixels.
    pub center_px: Vector2<f64>,
}

impl Pinhole {
    /// The camera that a lens would be without its distortion.
    pub fn of(lens: &Intrinsics) -> Self {
        Self {
            width: lens.width,
            height: lens.height,
            focal_px: lens.focal_px,
            center_px: lens.center_px,
        }
    }

    /// The pixel of a point in the camera's frame, with x right, y down and z ahead; `None` behind the camera.
    pub fn project(&self, p: Point3<f64>) -> Option<Point2<f64>> {
        let normalized = Vector2::new(p.x / p.z, p.y / p.z);
        let pixel = normalized.component_mul(&self.focal_px) + self.center_px;
        (p.z > 1e-9).then(|| pixel.into())
    }

    /// Whether a pixel lies within the picture.
    pub fn contains(&self, pixel: Point2<f64>) -> bool {
        let within = |c: f64, length: usize| c >= -0.5 && c < length as f64 - 0.5;
        within(pixel.x, self.width) && within(pixel.y, self.height)
    }

    /// Where the lens put what this camera sees at a pixel; `None` if that lies outside the lens's picture.
    pub fn pixel_of_lens(&self, lens: &Intrinsics, pixel: Point2<f64>) -> Option<Point2<f64>> {
        let n = (pixel.coords - self.center_px).component_div(&self.focal_px);
        lens.project(n.x, n.y, 1.0).filter(|p| lens.contains(*p))
    }
}

/// What a colour camera saw, undistorted.
#[derive(Clone, Debug)]
pub struct View {
    /// The camera.
    pub camera: CameraId,
    /// The camera that the picture is of.
    pub pinhole: Pinhole,
    /// Its pose.
    pub rig_from_camera: Isometry3<f64>,
    /// The picture; black where the lens's picture has nothing.
    pub picture: RgbImage,
    /// 255 where the object is, 0 elsewhere; `None` if the object could not be told from the background.
    pub mask: Option<Mask>,
}

impl View {
    /// The name of the picture's file.
    pub fn picture_name(&self) -> String {
        format!("{}.png", self.camera)
    }

    /// The pixel of a point of the rig's frame, if it lies within the picture.
    pub fn project(&self, p_in_rig: Point3<f64>) -> Option<Point2<f64>> {
        let p = self.rig_from_camera.inverse_transform_point(&p_in_rig);
        self.pinhole
            .project(p)
            .filter(|pixel| self.pinhole.contains(*pixel))
    }

    fn new(view: &ColorView, mask: Option<&Mask>) -> Self {
        let Camera {
            id,
            intrinsics,
            rig_from_camera,
            ..
        } = &view.camera;
        let pinhole = Pinhole::of(intrinsics);
        let from = Undistorter {
            pinhole,
            lens: *intrinsics,
        };
        let mask = mask.map(|level| {
            from.picture(level, |level, at| {
                // The contour is where the level crosses the middle.
                let inside =
                    at.is_some_and(|at| interpolate(level, at, |v| [f64::from(*v)])[0] >= 127.5);
                if inside { 255 } else { 0 }
            })
        });
        Self {
            camera: id.clone(),
            pinhole,
            rig_from_camera: *rig_from_camera,
            picture: from.picture(&view.image, |picture, at| match at {
                Some(at) => interpolate(picture, at, |p| p.map(f64::from)).map(|c| c.round() as u8),
                None => [0; 3],
            }),
            mask,
        }
    }
}

/// The views of a capture's colour cameras, in the order of their ids, and what a person should know of them.
pub fn views(scene: &Scene, parameters: &silhouette::Parameters) -> (Vec<View>, Vec<String>) {
    let made: Vec<(View, Option<String>)> = scene
        .colors
        .par_iter()
        .map(
            |view| match silhouette::extract(view, &scene.volume, parameters) {
                Ok(found) => (View::new(view, Some(&found.level)), None),
                Err(error) => (
                    View::new(view, None),
                    Some(format!("{error}; its picture has no mask")),
                ),
            },
        )
        .collect();
    let (views, warnings): (Vec<View>, Vec<Option<String>>) = made.into_iter().unzip();
    (views, warnings.into_iter().flatten().collect())
}

struct Undistorter {
    pinhole: Pinhole,
    lens: Intrinsics,
}

impl Undistorter {
    /// Each pixel of the picture without distortion from the place in the lens's picture.
    fn picture<T: Sync, U: Send + Clone>(
        &self,
        source: &Grid<T>,
        pixel: impl Fn(&Grid<T>, Option<Point2<f64>>) -> U + Sync,
    ) -> Grid<U> {
        let Pinhole { width, height, .. } = self.pinhole;
        Grid::from_fn_parallel(width, height, |x, y| {
            let at = self
                .pinhole
                .pixel_of_lens(&self.lens, Point2::new(x as f64, y as f64));
            pixel(source, at)
        })
    }
}

/// A picture between its pixels, linearly; at its border that of the border.
fn interpolate<T, const N: usize>(
    picture: &Grid<T>,
    at: Point2<f64>,
    value: impl Fn(&T) -> [f64; N],
) -> [f64; N] {
    let whole = |c: f64, length: usize| {
        let c = c.clamp(0.0, (length - 1) as f64);
        (c as usize, (c as usize + 1).min(length - 1), c.fract())
    };
    let (left, right, x) = whole(at.x, picture.width());
    let (top, bottom, y) = whole(at.y, picture.height());
    let row = |y: usize| {
        let (a, b) = (value(&picture.row(y)[left]), value(&picture.row(y)[right]));
        std::array::from_fn::<f64, N, _>(|i| a[i] * (1.0 - x) + b[i] * x)
    };
    let (a, b) = (row(top), row(bottom));
    std::array::from_fn(|i| a[i] * (1.0 - y) + b[i] * y)
}

#[cfg(test)]
mod tests {
    use super::super::testing::{distorted_camera, picture_of_places};
    use super::*;
    use crate::reconstruct::SilhouetteSource;

    #[test]
    fn a_point_lies_in_the_picture_where_the_lens_saw_it() {
        let camera = distorted_camera();
        let source = picture_of_places(&camera);
        let mask = Mask::filled(source.width(), source.height(), 255);
        let view = ColorView {
            image: source.clone(),
            silhouette: SilhouetteSource::Mask(mask.clone()),
            ignored: None,
            camera: camera.clone(),
        };
        let view = View::new(&view, Some(&mask));
        let (mut farthest, mut seen) = (0.0_f64, 0);
        for i in 0..400 {
            let spread = |k: usize| (i * k % 101) as f64 / 101.0 - 0.5;
            let p = Point3::new(spread(37) * 0.4, spread(53) * 0.4, 0.1 + spread(71) * 0.2);
            let (Some((in_lens, _)), Some(pixel)) = (camera.project(p), view.project(p)) else {
                continue;
            };
            // At the border there is black beside it.
            let inner = |p: Point2<f64>| (3.0..236.0).contains(&p.x) && (3.0..176.0).contains(&p.y);
            if !inner(in_lens) || !inner(pixel) {
                continue;
            }
            seen += 1;
            let back = view
                .pinhole
                .pixel_of_lens(&camera.intrinsics, pixel)
                .unwrap();
            farthest = farthest.max((back - in_lens).norm());
            // The picture tells where its pixels came from.
            let color = interpolate(&view.picture, pixel, |p| p.map(f64::from));
            let expected = interpolate(&source, in_lens, |p| p.map(f64::from));
            assert!(
                (0..2).all(|c| (color[c] - expected[c]).abs() < 1.5),
                "{color:?}, {expected:?}"
            );
        }
        assert!(seen > 100, "{seen}");
        assert!(farthest < 1e-6, "{farthest} px");
        let moved = (camera.project(Point3::new(0.15, 0.1, 0.1)).unwrap().0
            - view.project(Point3::new(0.15, 0.1, 0.1)).unwrap())
        .norm();
        assert!(moved > 0.2, "the lens distorts by {moved} px");
    }

    #[test]
    fn what_the_lens_did_not_see_is_black_and_masked() {
        let camera = distorted_camera();
        let source = RgbImage::filled(camera.intrinsics.width, camera.intrinsics.height, [200; 3]);
        let mask = Mask::filled(source.width(), source.height(), 255);
        let view = ColorView {
            image: source,
            silhouette: SilhouetteSource::Mask(mask.clone()),
            ignored: None,
            camera: camera.clone(),
        };
        let view = View::new(&view, Some(&mask));
        let mask = view.mask.unwrap();
        let mut outside = 0;
        for (y, x) in (0..mask.height()).flat_map(|y| (0..mask.width()).map(move |x| (y, x))) {
            let at = view
                .pinhole
                .pixel_of_lens(&camera.intrinsics, Point2::new(x as f64, y as f64));
            assert_eq!(mask.row(y)[x], if at.is_some() { 255 } else { 0 });
            assert_eq!(
                view.picture.row(y)[x],
                [if at.is_some() { 200 } else { 0 }; 3]
            );
            outside += usize::from(at.is_none());
        }
        assert!(outside > 0);
    }
}

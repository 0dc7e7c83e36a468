//! Measures how well a colour camera agrees with the others, by comparing the hull's projection with the camera's
//! silhouette at a reduced resolution. The hull never exceeds a silhouette, but where cameras disagree it does not
//! fill it.

use super::outline;
use crate::calibration::{Camera, Volume};
use crate::frame::CameraId;
use crate::image::{Grid, PixelRect, sharpness_percent};
use crate::mesh::{Fragment, Mesh, cuboid, rasterize};
use crate::reconstruct::ColorView;
use crate::reconstruct::silhouette::{Facts, Silhouette};
use nalgebra::{Matrix2, Point3, Vector2};
use serde::Serialize;

/// Longest side, in cells, of the grid that silhouette and projection are compared on.
const CELLS: f64 = 200.0;

/// Share of a cell that a silhouette fills where the cell is missing in the hull's projection. A wire that is narrower
/// than a cell fills none, and the noise of silhouettes fills little of any.
const LEAST_MISSING: f64 = 0.3;

/// The figures of one colour camera.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ColorMeasures {
    /// The camera.
    pub camera: CameraId,
    /// Width and height in pixels of the object in its picture.
    pub object_px: [usize; 2],
    /// How sharp the edges of the object are in its picture, 0 to 100, to be compared between captures of this camera;
    /// `None` if there are too few. See [`sharpness_percent`].
    pub sharpness_percent: Option<u32>,
    /// Its silhouette, compared with the hull.
    pub consistency: Consistency,
    /// What was found of its silhouette alone.
    pub silhouette: Facts,
}

/// A silhouette, compared with the hull's projection, within the projection of the volume.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Consistency {
    /// Share of the silhouette's area that the hull's projection covers.
    pub coverage: f64,
    /// Share of the silhouette's area that lies more than a few pixels (one cell of the comparison) away
    /// from the hull's projection.
    pub missing: f64,
    /// Area of both over area of either.
    pub iou: f64,
    /// By how many of its pixels the silhouette is displaced against the hull's projection, in x and y: twice the mean
    /// of what the contours show, because only one side of a displaced silhouette shows it.
    pub shift_px: [f64; 2],
    /// Edge of a cell of the comparison, in pixels.
    pub cell_px: f64,
}

impl ColorMeasures {
    /// Compares one camera's silhouette with the hull.
    pub fn of(view: &ColorView, silhouette: &Silhouette, hull: &Mesh, volume: Volume) -> Self {
        let bounds = silhouette.bounds;
        Self {
            camera: view.camera.id.clone(),
            object_px: [bounds.width(), bounds.height()],
            sharpness_percent: sharpness_percent(&view.image, bounds),
            consistency: Consistency::of(&view.camera, silhouette, hull, volume),
            silhouette: silhouette.facts.clone(),
        }
    }

    /// The object's longest side in the picture, in pixels.
    pub fn longest_side_px(&self) -> f64 {
        self.object_px.into_iter().fold(1, usize::max) as f64
    }

    /// The length of a shift over the object's longest side.
    pub fn shift_share(&self, [dx, dy]: [f64; 2]) -> f64 {
        dx.hypot(dy) / self.longest_side_px()
    }
}

impl Consistency {
    /// Compares on cells of a few pixels around the silhouette.
    pub(super) fn of(
        camera: &Camera,
        silhouette: &Silhouette,
        hull: &Mesh,
        volume: Volume,
    ) -> Self {
        let cells = Cells::around(camera, silhouette.bounds);
        let inside = cells.inside(camera, volume);
        let projected = cells.draw(camera, hull);
        let unknown = cells.unknown(silhouette);
        let level = known(cells.level(silhouette, &inside), &projected, &unknown);
        let [area, both, either, missing] = sums(&level, &projected);
        let share = |part: f64, whole: f64| if whole > 0.0 { part / whole } else { 0.0 };
        Self {
            coverage: share(both, area),
            missing: share(missing, area),
            iou: share(both, either),
            shift_px: shift(&level, &projected)
                .map(|d| 2.0 * d * cells.pixels)
                .into(),
            cell_px: cells.pixels,
        }
    }

    /// By how many pixels, in x and y, a silhouette is displaced against a hull that was made without it.
    pub(super) fn shift_against(
        camera: &Camera,
        silhouette: &Silhouette,
        others: &Mesh,
        volume: Volume,
    ) -> [f64; 2] {
        let cells = Cells::around(camera, silhouette.bounds);
        let level = cells.level(silhouette, &cells.inside(camera, volume));
        let projected = cells.draw(camera, others);
        let unknown = cells.unknown(silhouette);
        let level = known(level, &projected, &unknown);
        let gaps = outline::gaps(&smooth(&level), &smooth(&projected), |x, y| {
            unknown.as_ref().is_some_and(|unknown| unknown[(x, y)])
        });
        (outline::displacement(&gaps) * cells.pixels).into()
    }
}

/// A coarse grid over a part of a picture.
struct Cells {
    /// The picture's coordinates of the middle of cell (0, 0).
    origin: [f64; 2],
    /// Edge of a cell in pixels.
    pixels: f64,
    width: usize,
    height: usize,
}

impl Cells {
    fn around(camera: &Camera, bounds: PixelRect) -> Self {
        let lens = &camera.intrinsics;
        let margin = bounds.width().max(bounds.height()) / 12 + 4;
        let rect = bounds.grown(margin, lens.width, lens.height);
        let longest = rect.width().max(rect.height()) as f64;
        let pixels = (longest / CELLS).max(1.0);
        Self {
            origin: [rect.x0, rect.y0].map(|first| first as f64 + 0.5 * (pixels - 1.0)),
            pixels,
            width: (rect.width() as f64 / pixels) as usize,
            height: (rect.height() as f64 / pixels) as usize,
        }
    }

    /// The part of each cell that a mesh covers, at the middle of its four quarters.
    fn draw(&self, camera: &Camera, mesh: &Mesh) -> Grid<f32> {
        let drawn = self.covered(camera, mesh, 2);
        let covered = |x, y| f32::from(u8::from(drawn[(x, y)].is_covered()));
        Grid::from_fn(self.width, self.height, |x, y| {
            let (x, y) = (2 * x, 2 * y);
            0.25 * (covered(x, y) + covered(x + 1, y) + covered(x, y + 1) + covered(x + 1, y + 1))
        })
    }

    /// Whether the middle of each cell sees the volume; all of them, where the camera is inside of it.
    fn inside(&self, camera: &Camera, volume: Volume) -> Grid<bool> {
        let corner = |p: Point3<f64>| p.cast::<f32>().coords.into();
        let corners = cuboid(corner(volume.min), corner(volume.max));
        let is_seen = |&v: &Point3<f32>| camera.project_for_raster(v)[2].is_finite();
        if !corners.vertices.iter().all(is_seen) {
            return Grid::filled(self.width, self.height, true);
        }
        self.covered(camera, &corners, 1).map(Fragment::is_covered)
    }

    /// A mesh drawn with this many samples a cell along each axis.
    fn covered(&self, camera: &Camera, mesh: &Mesh, samples: usize) -> Grid<Fragment> {
        let scale = samples as f64;
        let project = |&v: &Point3<f32>| {
            let [x, y, depth] = camera.project_for_raster(v);
            let to = |p: f32, origin: f64| {
                (((f64::from(p) - origin) / self.pixels + 0.5) * scale - 0.5) as f32
            };
            [to(x, self.origin[0]), to(y, self.origin[1]), depth]
        };
        let projected: Vec<_> = mesh.vertices.iter().map(project).collect();
        let (width, height) = (samples * self.width, samples * self.height);
        rasterize(&projected, &mesh.triangles, width, height)
    }

    /// Whether a cell, or one beside it, has pixels of which the silhouette says nothing; `None` where it says
    /// something of all.
    fn unknown(&self, silhouette: &Silhouette) -> Option<Grid<bool>> {
        let mask = silhouette.unknown.as_ref()?;
        let reach = (1.5 * self.pixels).ceil() as isize;
        let middle = |first: f64, k: usize| (first + k as f64 * self.pixels).round() as isize;
        Some(Grid::from_fn(self.width, self.height, |cx, cy| {
            let (x, y) = (middle(self.origin[0], cx), middle(self.origin[1], cy));
            (-reach..=reach).any(|dy| {
                (-reach..=reach).any(|dx| mask.get(x + dx, y + dy).is_some_and(|&m| m >= 128))
            })
        }))
    }

    /// The part of each cell that is silhouette, where the volume is.
    fn level(&self, silhouette: &Silhouette, inside: &Grid<bool>) -> Grid<f32> {
        let samples = (self.pixels.round() as usize).clamp(1, 3);
        let offset = |i: usize| ((i as f64 + 0.5) / samples as f64 - 0.5) * self.pixels;
        let along = |first: f64, cells: usize| -> Vec<isize> {
            let middle = |k: usize| (k / samples) as f64 * self.pixels;
            let nearest = |k: usize| (first + middle(k) + offset(k % samples)).round() as isize;
            (0..cells * samples).map(nearest).collect()
        };
        let columns = along(self.origin[0], self.width);
        let rows = along(self.origin[1], self.height);
        Grid::from_fn(self.width, self.height, |cx, cy| {
            if !inside[(cx, cy)] {
                return 0.0;
            }
            let mut count = 0u16;
            for &y in &rows[cy * samples..][..samples] {
                for &x in &columns[cx * samples..][..samples] {
                    let level = silhouette.level.get(x, y);
                    count += u16::from(level.is_some_and(|&l| l >= 128));
                }
            }
            f32::from(count) / (samples * samples) as f32
        })
    }
}

/// A silhouette that agrees with the projection wherever it says nothing.
fn known(level: Grid<f32>, projected: &Grid<f32>, unknown: &Option<Grid<bool>>) -> Grid<f32> {
    let Some(unknown) = unknown else {
        return level;
    };
    Grid::from_fn(level.width(), level.height(), |x, y| {
        match unknown[(x, y)] {
            true => projected[(x, y)],
            false => level[(x, y)],
        }
    })
}

/// Areas, in cells: of the silhouette, of what it shares with the projection, of either, and of what is missing in the
/// projection.
fn sums(level: &Grid<f32>, projected: &Grid<f32>) -> [f64; 4] {
    let mut sums = [0.0f64; 4];
    for y in 0..level.height() {
        for x in 0..level.width() {
            let s = f64::from(level[(x, y)]);
            let m = f64::from(projected[(x, y)]);
            let is_missing = s > LEAST_MISSING && is_far(projected, x, y);
            let missing = if is_missing { s } else { 0.0 };
            for (sum, value) in sums.iter_mut().zip([s, s.min(m), s.max(m), missing]) {
                *sum += value;
            }
        }
    }
    sums
}

/// Whether neither a cell nor its neighbours are covered.
fn is_far(projected: &Grid<f32>, x: usize, y: usize) -> bool {
    let (x, y) = (x as isize, y as isize);
    (-1..=1).all(|dy| {
        (-1..=1).all(|dx| {
            projected
                .get(x + dx, y + dy)
                .is_none_or(|&covered| covered == 0.0)
        })
    })
}

/// The displacement, in cells, that best explains the difference: one step of Lucas and Kanade's registration
/// ("An iterative image registration technique", 1981, equation 9) on both pictures, smoothed.
fn shift(level: &Grid<f32>, projected: &Grid<f32>) -> Vector2<f64> {
    let (level, projected) = (smooth(&smooth(level)), smooth(&smooth(projected)));
    let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
    for y in 1..level.height().saturating_sub(1) {
        for x in 1..level.width().saturating_sub(1) {
            let slope = |dx: usize, dy: usize| {
                let along = |g: &Grid<f32>| g[(x + dx, y + dy)] - g[(x - dx, y - dy)];
                f64::from(0.25 * (along(&level) + along(&projected)))
            };
            let gradient = Vector2::new(slope(1, 0), slope(0, 1));
            let difference = f64::from(projected[(x, y)] - level[(x, y)]);
            normal += gradient * gradient.transpose();
            right += gradient * difference;
        }
    }
    let solved = normal.try_inverse().map(|inverse| inverse * right);
    solved.unwrap_or_else(Vector2::zeros)
}

/// Binomial weights over 3 x 3; the grid's edge is repeated beyond it.
fn smooth(grid: &Grid<f32>) -> Grid<f32> {
    let (width, height) = (grid.width(), grid.height());
    let along = Grid::from_fn(width, height, |x, y| {
        let row = grid.row(y);
        0.25 * (row[x.saturating_sub(1)] + 2.0 * row[x] + row[(x + 1).min(width - 1)])
    });
    Grid::from_fn(width, height, |x, y| {
        let (above, below) = (y.saturating_sub(1), (y + 1).min(height - 1));
        0.25 * (along[(x, above)] + 2.0 * along[(x, y)] + along[(x, below)])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_narrower_than_a_cell_is_missing_and_the_noise_of_a_contour_is_not() {
        let half = |extra: fn(usize, usize) -> f32| {
            Grid::from_fn(100, 100, |x, y| if x < 50 { 1.0 } else { extra(x, y) })
        };
        let projected = half(|_, _| 0.0);
        let missing = |level: &Grid<f32>| sums(level, &projected)[3];
        let wire = half(|_, y| if y == 40 { 0.6 } else { 0.0 });
        assert!(
            (missing(&wire) - 49.0 * 0.6).abs() < 1e-3,
            "{}",
            missing(&wire)
        );
        let beside = half(|x, _| if x == 50 { 0.9 } else { 0.0 });
        assert_eq!(missing(&beside), 0.0);
        let speckled = half(|x, y| if (x * 7 + y * 13) % 5 == 0 { 0.2 } else { 0.0 });
        assert_eq!(missing(&speckled), 0.0);
    }

    #[test]
    fn a_shift_is_found_to_a_fraction_of_a_cell() {
        let disc = |dx: f32, dy: f32| {
            Grid::from_fn(120, 100, |x, y| {
                let r = (x as f32 - 60.0 - dx).hypot(y as f32 - 50.0 - dy);
                (30.5 - r).clamp(0.0, 1.0)
            })
        };
        for (dx, dy) in [(0.0, 0.0), (0.4, -0.2), (-1.0, 0.7)] {
            let found = shift(&disc(dx, dy), &disc(0.0, 0.0));
            assert!((found.x - f64::from(dx)).abs() < 0.1, "{found}");
            assert!((found.y - f64::from(dy)).abs() < 0.1, "{found}");
        }
    }
}

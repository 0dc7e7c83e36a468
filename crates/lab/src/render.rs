//! Renders object and light into linear light on a camera's sensor, before the sensor adds its noise. The object's
//! edges are blended by coverage, and the lens' blur is applied.

use super::coverage::Layer;
use super::light::{BACKDROP, Light};
use super::material::Material;
use super::noise::field;
use nalgebra::{Point2, Point3, Vector3};
use scand_core::calibration::Camera;
use scand_core::image::Grid;
use scand_core::mesh::Mesh;

/// Red, green and blue, linear; white paper in the open is about 0.75.
pub(super) type Light3 = [f32; 3];

/// The table's cloth rises into a wall at this distance from the middle, in metres.
const WALL: f64 = 0.75;
/// Exposure: light of a white surface in the open on the sensor.
const EXPOSURE: f32 = 1.05;

/// An object as it is to be drawn.
pub(super) struct Subject<'a> {
    pub mesh: &'a Mesh,
    pub light: &'a Light,
    pub material: Material,
    /// Triangles from this one on are a prop's, in the backdrop's cloth.
    pub object_triangles: usize,
    /// Metres of the object that the camera does not tell from the backdrop.
    pub lost: Option<f64>,
    /// How much of the object's shadow and of the backdrop's colour on it there is, 0 to 1.
    pub shadows: f32,
    pub spill: f32,
}

/// Light on a camera's sensor: a smooth backdrop by its nodes, and a window with the object.
pub(super) struct Rendered {
    width: usize,
    height: usize,
    step: usize,
    nodes: Grid<Light3>,
    window: Option<([usize; 2], Grid<Light3>)>,
}

impl Rendered {
    /// Draws the rig without an object.
    pub(super) fn background(camera: &Camera) -> Self {
        Self::backdrop(camera, |_, _| 1.0)
    }

    /// Draws the rig with an object, seen through a lens of a point spread of `blur_px`.
    pub(super) fn with_object(camera: &Camera, subject: &Subject<'_>, blur_px: f64) -> Self {
        let shadow = |x, y| 1.0 - subject.shadows * (1.0 - subject.light.on_table(x, y));
        let mut rendered = Self::backdrop(camera, shadow);
        if let Some(mut layer) = Layer::new(camera, subject.mesh) {
            if let Some(radius) = subject.lost {
                layer.lose(camera, radius);
            }
            let colors = shade(camera, subject, &layer);
            let mut window = rendered.blended(&layer, &colors);
            blur(&mut window, blur_px);
            rendered.window = Some((layer.origin, window));
        }
        rendered
    }

    fn backdrop(camera: &Camera, shadow: impl Fn(f64, f64) -> f32) -> Self {
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        // Some thousand nodes whatever the picture's size: the backdrop is smooth.
        let step = (width / 160).max(4);
        let nodes = Grid::from_fn(width / step + 2, height / step + 2, |i, j| {
            let pixel = Point2::new((i * step) as f64, (j * step) as f64);
            let across = (pixel - camera.intrinsics.center_px).coords / width as f64;
            let vignette = 1.0 - 0.25 * across.norm_squared() as f32;
            match camera.ray(pixel) {
                Some(ray) => cloth(camera.center(), ray, &shadow).map(|c| c * vignette),
                None => [0.0; 3],
            }
        });
        Self {
            width,
            height,
            step,
            nodes,
            window: None,
        }
    }

    /// Paints a part of the picture, given by its first column and row and its size, over the backdrop; the lens' blur
    /// is applied to it.
    pub(super) fn with_window(
        mut self,
        origin: [usize; 2],
        size: [usize; 2],
        blur_px: f64,
        paint: impl FnOnce([usize; 2], &mut Grid<Light3>),
    ) -> Self {
        let mut window = Grid::filled(size[0], size[1], [0.0; 3]);
        for y in 0..size[1] {
            self.fill_backdrop(origin[1] + y, origin[0], window.row_mut(y));
        }
        paint(origin, &mut window);
        blur(&mut window, blur_px);
        self.window = Some((origin, window));
        self
    }

    /// Width and height in pixels.
    pub(super) fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Writes row `y` into `row`.
    pub(super) fn fill_row(&self, y: usize, row: &mut [Light3]) {
        self.fill_backdrop(y, 0, row);
        let Some(([x0, y0], window)) = &self.window else {
            return;
        };
        if (*y0..y0 + window.height()).contains(&y) {
            row[*x0..x0 + window.width()].copy_from_slice(window.row(y - y0));
        }
    }

    /// The backdrop in row `y` from column `x0` on, between its nodes.
    fn fill_backdrop(&self, y: usize, x0: usize, row: &mut [Light3]) {
        let (j, v) = (y / self.step, (y % self.step) as f32 / self.step as f32);
        let (above, below) = (self.nodes.row(j), self.nodes.row(j + 1));
        let at = |i: usize| [0, 1, 2].map(|c| above[i][c] * (1.0 - v) + below[i][c] * v);
        let (mut i, mut u) = (x0 / self.step, x0 % self.step);
        let (mut left, mut right) = (at(i), at(i + 1));
        for pixel in row {
            let t = u as f32 / self.step as f32;
            *pixel = [0, 1, 2].map(|c| left[c] + (right[c] - left[c]) * t);
            u += 1;
            if u == self.step {
                (i, u) = (i + 1, 0);
                left = right;
                right = if i + 1 < self.nodes.width() {
                    at(i + 1)
                } else {
                    left
                };
            }
        }
    }

    /// The object's colours over the backdrop, by coverage.
    fn blended(&self, layer: &Layer, colors: &Grid<Light3>) -> Grid<Light3> {
        let (width, height) = (colors.width(), colors.height());
        let mut window = Grid::filled(width, height, [0.0; 3]);
        for y in 0..height {
            let row = window.row_mut(y);
            self.fill_backdrop(layer.origin[1] + y, layer.origin[0], row);
            for x in 0..width {
                let part = layer.coverage[(x, y)];
                if part > 0.0 {
                    let color = colors[(x, y)];
                    row[x] = [0, 1, 2].map(|c| row[x][c] * (1.0 - part) + color[c] * part);
                }
            }
        }
        window
    }
}

/// Light from the cloth on the table or the wall behind it along a ray.
fn cloth(eye: Point3<f64>, ray: Vector3<f64>, shadow: impl Fn(f64, f64) -> f32) -> Light3 {
    let down = if ray.z < 0.0 {
        -eye.z / ray.z
    } else {
        f64::INFINITY
    };
    let on_table = eye + ray * down;
    let radius = on_table.x.hypot(on_table.y);
    let (brightness, at) = if down.is_finite() && radius < WALL {
        let fall_off = 1.0 - 0.3 * (radius / WALL).powi(2) as f32;
        (fall_off * shadow(on_table.x, on_table.y), on_table)
    } else {
        let on_wall = eye + ray * wall_distance(eye, ray);
        let fall_off = 0.7 - 0.5 * on_wall.z.clamp(0.0, 0.8) as f32;
        (fall_off, on_wall)
    };
    let uneven = 0.95 + 0.1 * field(11, [at.x / 0.09, at.y / 0.09, at.z / 0.09]) as f32;
    BACKDROP.map(|c| c * EXPOSURE * brightness * uneven)
}

/// Where a ray leaves the cylinder of the wall: the far side, because cameras look in through the near one.
fn wall_distance(eye: Point3<f64>, ray: Vector3<f64>) -> f64 {
    let a = ray.x * ray.x + ray.y * ray.y;
    let b = eye.x * ray.x + eye.y * ray.y;
    let c = eye.x * eye.x + eye.y * eye.y - WALL * WALL;
    (-b + (b * b - a * c).max(0.0).sqrt()) / a.max(1e-9)
}

/// Colours of the pixels that the object touches.
fn shade(camera: &Camera, subject: &Subject<'_>, layer: &Layer) -> Grid<Light3> {
    let (width, height) = (layer.fragments.width(), layer.fragments.height());
    let mut colors = Grid::filled(width, height, [f32::NAN; 3]);
    for y in 0..height {
        for x in 0..width {
            let fragment = layer.fragments[(x, y)];
            if fragment.is_covered() {
                let at = [x as f32, y as f32];
                colors[(x, y)] = shade_at(camera, subject, layer, fragment.triangle as usize, at);
            }
        }
    }
    fill_contour(layer, &mut colors);
    colors
}

fn shade_at(
    camera: &Camera,
    subject: &Subject<'_>,
    layer: &Layer,
    triangle: usize,
    at: [f32; 2],
) -> Light3 {
    let corners = subject.mesh.triangles[triangle].map(|v| v as usize);
    let weights = weights(corners.map(|v| layer.projected[v]), at);
    let (light, mesh) = (subject.light, subject.mesh);
    let (mut p, mut normal) = (Vector3::zeros(), Vector3::zeros());
    let (mut white, mut below) = (0.0, 0.0);
    for (weight, v) in weights.into_iter().zip(corners) {
        p += mesh.vertices[v].coords * weight;
        normal += light.normals[v] * weight;
        white += light.white[v] * weight;
        below += light.spill[v] * weight;
    }
    let p: Point3<f64> = p.cast::<f64>().into();
    let view = (camera.center() - p).normalize().cast::<f32>();
    let facing = (normal.dot(&view) / normal.norm().max(1e-6)).abs();
    let sheen = 0.25 * (1.0 - facing).max(0.0).powi(4);
    let reflectance = match triangle < subject.object_triangles {
        true => subject.material.reflectance(p),
        false => BACKDROP,
    };
    [0, 1, 2].map(|c| {
        let spill = subject.spill * BACKDROP[c];
        EXPOSURE * (reflectance[c] * (white + below * spill) + sheen * spill)
    })
}

/// Weights of a triangle's corners at a pixel, as they are in space (perspective undone).
fn weights(corners: [[f32; 3]; 3], [x, y]: [f32; 2]) -> [f32; 3] {
    let area = |a: [f32; 3], b: [f32; 3]| (a[0] - x) * (b[1] - y) - (a[1] - y) * (b[0] - x);
    let [a, b, c] = corners;
    let in_picture = [area(b, c), area(c, a), area(a, b)];
    let in_space = [0, 1, 2].map(|k| in_picture[k] / corners[k][2]);
    let sum: f32 = in_space.iter().sum();
    match sum.abs() > f32::MIN_POSITIVE {
        true => in_space.map(|w| w / sum),
        false => [1.0 / 3.0; 3],
    }
}

/// Pixels that the object touches beside their centre take the mean colour of their neighbours.
fn fill_contour(layer: &Layer, colors: &mut Grid<Light3>) {
    let (width, height) = (colors.width(), colors.height());
    let missing: Vec<(usize, usize)> = (0..width * height)
        .map(|k| (k % width, k / width))
        .filter(|&at| layer.coverage[at] > 0.0 && !layer.fragments[at].is_covered())
        .collect();
    for (x, y) in missing {
        let (mut sum, mut count) = ([0.0; 3], 0.0);
        for ny in y.saturating_sub(1)..(y + 2).min(height) {
            for nx in x.saturating_sub(1)..(x + 2).min(width) {
                if layer.fragments[(nx, ny)].is_covered() {
                    let color = colors[(nx, ny)];
                    sum = [0, 1, 2].map(|c| sum[c] + color[c]);
                    count += 1.0;
                }
            }
        }
        colors[(x, y)] = sum.map(|s| s / f32::max(count, 1.0));
    }
}

/// A Gaussian of standard deviation `sigma` pixels; the border repeats.
fn blur(picture: &mut Grid<Light3>, sigma: f64) {
    let reach = (3.0 * sigma).ceil() as isize;
    if reach < 1 {
        return;
    }
    let weight = |k: isize| (-0.5 * (k as f64 / sigma).powi(2)).exp() as f32;
    let mut kernel: Vec<f32> = (-reach..=reach).map(weight).collect();
    let sum: f32 = kernel.iter().sum();
    kernel.iter_mut().for_each(|k| *k /= sum);
    let (width, height) = (picture.width(), picture.height());
    let mut padded = vec![[0.0; 3]; width + 2 * reach as usize];
    for y in 0..height {
        let row = picture.row_mut(y);
        for (k, pixel) in padded.iter_mut().enumerate() {
            *pixel = row[(k as isize - reach).clamp(0, width as isize - 1) as usize];
        }
        for (x, pixel) in row.iter_mut().enumerate() {
            *pixel = convolved(padded[x..].iter().zip(&kernel));
        }
    }
    let source = picture.clone();
    for y in 0..height {
        let rows: Vec<&[Light3]> = (-reach..=reach)
            .map(|k| source.row((y as isize + k).clamp(0, height as isize - 1) as usize))
            .collect();
        for (x, pixel) in picture.row_mut(y).iter_mut().enumerate() {
            *pixel = convolved(rows.iter().map(|row| &row[x]).zip(&kernel));
        }
    }
}

fn convolved<'a>(weighted: impl Iterator<Item = (&'a Light3, &'a f32)>) -> Light3 {
    weighted.fold([0.0; 3], |sum, (pixel, weight)| {
        [0, 1, 2].map(|c| sum[c] + pixel[c] * weight)
    })
}

//! A depth camera's sensor after the Kinect of 2010, which projects dots and reads their disparity. Its readings
//! are quantised, noisy from frame to frame, and have a fixed pattern; it is blind at grazing angles and where the
//! projector does not reach, and mixes depths at rims.

use super::coverage::Layer;
use super::noise::field;
use super::options::{DepthSensor, Options};
use super::random::Random;
use super::rig::{Bounds, DepthStation};
use nalgebra::{Point2, Point3, Vector2};
use scand_core::calibration::DepthCamera;
use scand_core::frame::Picture;
use scand_core::image::Grid;
use scand_core::mesh::{Bvh, Fragment, Mesh};

/// The sensor's disparity: 1/z in 1/cm is OFFSET − SLOPE · disparity (openkinect's fit).
const DISPARITY_SLOPE: f64 = 0.000_028_827_667_679_679_4;
const DISPARITY_OFFSET: f64 = 0.031_448_695_264_218_8;
/// Metres from the camera to the projector.
const BASELINE: f64 = 0.075;
/// The table is a disc that ends so far beyond the object, in metres, and is no smaller than this.
const TABLE_BEYOND: f64 = 0.06;
const TABLE_SMALLEST: f64 = 0.12;
/// Cosines of the angle of incidence between which readings become rare: 68 and 75 degrees.
const GRAZING: [f64; 2] = [0.375, 0.259];
/// Readings mixed from surfaces farther apart than this (steps of the disparity) are lost.
const LOST_MIX: f64 = 40.0;
/// Parts of pixels that read nothing for no visible reason: always, and in one frame.
const DEAD: f64 = 0.003;
const DROPPED: f64 = 0.003;
/// Samples a pixel along each axis, for mixed readings.
const FINE: usize = 3;

/// Disparity of a depth in metres.
pub(super) fn disparity(z: f64) -> f64 {
    (DISPARITY_OFFSET - 0.01 / z) / DISPARITY_SLOPE
}

/// Depth in metres of a disparity.
pub(super) fn depth(disparity: f64) -> f64 {
    0.01 / (DISPARITY_OFFSET - DISPARITY_SLOPE * disparity)
}

/// What one depth camera would read without noise: disparity and, for each pixel, how often it fails.
pub(super) struct DepthScene {
    /// Disparity in steps; NaN where there is nothing to read. Bias and displacement are in it.
    disparity: Grid<f64>,
    /// Probability that a reading fails.
    failure: Grid<f32>,
    /// Columns and rows that hold any reading.
    window: [std::ops::Range<usize>; 2],
}

impl DepthScene {
    /// Looks at the object, if there is one, on its table.
    pub(super) fn new(options: &Options, station: &DepthStation, object: Option<&Mesh>) -> Self {
        let sensor = &options.depth;
        let lens = station.actual.camera.intrinsics;
        let mesh = with_table(object);
        let displaced = displacement(sensor);
        let fine = FINE as f64;
        // A pixel's samples are centred on it: pixel p is sample FINE·p + (FINE − 1) / 2.
        let project = |p: Point3<f64>| {
            let p = station.actual.camera.camera_from_rig(p);
            let pixel = station.actual.response.project(&lens, p)?;
            let at = |v: f64| fine * v + (fine - 1.0) / 2.0;
            Some([at(pixel.x + displaced.x), at(pixel.y + displaced.y), p.z])
        };
        let layer = Layer::with(&mesh, project, lens.width * FINE, lens.height * FINE);
        let mut scene = Self {
            disparity: Grid::filled(lens.width, lens.height, f64::NAN),
            failure: Grid::filled(lens.width, lens.height, 1.0),
            window: [0..0, 0..0],
        };
        if let Some(layer) = layer {
            let looker = PixelReader {
                sensor,
                station,
                bvh: object.map(Bvh::new),
                mesh: &mesh,
                of_object: object.map_or(0, |o| o.triangles.len()),
                layer: &layer,
                reach: object.map_or(0.0, |o| Bounds::of(o).radius() + 0.04),
            };
            scene.window = looker.window(lens.width, lens.height);
            for y in scene.window[1].clone() {
                for x in scene.window[0].clone() {
                    if let Some((disparity, failure)) = looker.look(x, y) {
                        scene.disparity[(x, y)] = disparity;
                        scene.failure[(x, y)] = failure;
                    }
                }
            }
        }
        scene
    }

    /// One frame: noise and quantisation, in the sensor's raw unit. `frame` numbers it in the session.
    pub(super) fn read(
        &self,
        options: &Options,
        station: &DepthStation,
        camera: u64,
        frame: u64,
    ) -> Grid<u16> {
        let sensor = &options.depth;
        let response = &station.actual.response;
        let mut readings = Grid::filled(self.disparity.width(), self.disparity.height(), 0);
        let [columns, rows] = self.window.clone();
        let key = [options.seed, 5, camera, frame];
        let noise = correlated_noise(&key, columns.len(), rows.len());
        for (j, y) in rows.enumerate() {
            let mut pattern = Random::new(&[options.seed, 6, camera, y as u64]);
            let mut chance = Random::new(&[key[0], 7, camera, frame, y as u64]);
            for (i, x) in columns.clone().enumerate() {
                let fixed = fixed_pattern(&mut pattern, options.seed, camera, x, y);
                // Whether a reading fails depends to 70 % on the pixel, the same in every frame, and to 30 % on the
                // frame.
                let luck = pattern.uniform() * 0.7 + chance.uniform() * 0.3;
                let ideal = self.disparity[(x, y)];
                let lost = sensor.holes
                    && (luck < f64::from(self.failure[(x, y)])
                        || pattern.uniform() < DEAD
                        || chance.uniform() < DROPPED);
                if ideal.is_nan() || lost {
                    continue;
                }
                let mut read = ideal
                    + fixed * sensor.pattern_steps
                    + f64::from(noise[(i, j)]) * sensor.noise_steps;
                if sensor.quantized {
                    read = read.round();
                }
                let raw = (depth(read) - response.intercept) / response.slope;
                readings[(x, y)] = raw.round().clamp(0.0, 65_535.0) as u16;
            }
        }
        readings
    }
}

/// Pixels by which the depth picture is displaced from where the calibration says it is.
fn displacement(sensor: &DepthSensor) -> Vector2<f64> {
    Vector2::new(0.8, 0.6) * sensor.misregistration_px
}

/// Looks for what one pixel reads.
struct PixelReader<'a> {
    sensor: &'a DepthSensor,
    station: &'a DepthStation,
    bvh: Option<Bvh>,
    mesh: &'a Mesh,
    /// So many triangles of the mesh, the first ones, are the object's; the others are the table's.
    of_object: usize,
    layer: &'a Layer,
    /// Beyond this distance from the axis nothing can lie in the projector's shadow.
    reach: f64,
}

impl PixelReader<'_> {
    /// Columns and rows of pixels whose samples the layer holds.
    fn window(&self, width: usize, height: usize) -> [std::ops::Range<usize>; 2] {
        let [x0, y0] = self.layer.origin;
        let (x1, y1) = (
            x0 + self.layer.fragments.width(),
            y0 + self.layer.fragments.height(),
        );
        [
            x0 / FINE..(x1 / FINE + 1).min(width),
            y0 / FINE..(y1 / FINE + 1).min(height),
        ]
    }

    /// Disparity at a pixel and the probability that it cannot be read; `None` where nothing is.
    fn look(&self, x: usize, y: usize) -> Option<(f64, f32)> {
        let (mut sum, mut count, mut all) = (0.0, 0.0, 0.0);
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        let half = ((self.sensor.smear_px * FINE as f64 - 1.0) / 2.0)
            .round()
            .max(0.0) as isize;
        for dy in -half..=half {
            for dx in -half..=half {
                all += 1.0;
                if let Some(fragment) = self.sample(x, y, dx, dy) {
                    let value = disparity(f64::from(fragment.depth) + self.bias_at(fragment));
                    (low, high) = (low.min(value), high.max(value));
                    sum += value;
                    count += 1.0;
                }
            }
        }
        let middle = self.sample(x, y, 0, 0)?;
        if count * 2.0 <= all {
            return None;
        }
        let (point, cosine) = self.surface(x, y, middle)?;
        let [rare, never] = GRAZING;
        let grazing = ((rare - cosine) / (rare - never)).clamp(0.0, 1.0);
        // A slope is no mix: what counts is the spread beyond what the slope explains over the window.
        let mixed = high - low > 6.0 && cosine > rare;
        let mut failure = grazing;
        if mixed {
            failure = failure.max(if high - low > LOST_MIX { 0.6 } else { 0.2 });
        }
        if self.is_in_shadow(point) {
            failure = 1.0;
        }
        Some((sum / count, failure as f32))
    }

    /// Metres that the sensor reads what is there too deep.
    fn bias_at(&self, fragment: Fragment) -> f64 {
        let is_object = (fragment.triangle as usize) < self.of_object;
        let of_material = if is_object {
            self.sensor.object_bias_mm
        } else {
            0.0
        };
        1e-3 * (self.sensor.bias_mm + of_material)
    }

    fn sample(&self, x: usize, y: usize, dx: isize, dy: isize) -> Option<Fragment> {
        let at = |v: usize, d: isize, a: usize| {
            (v * FINE + FINE / 2) as isize + d - self.layer.origin[a] as isize
        };
        let fragment = self.layer.fragments.get(at(x, dx, 0), at(y, dy, 1))?;
        fragment.is_covered().then_some(*fragment)
    }

    /// The point of the surface that a pixel shows, lifted off it a little, in the rig, and the cosine of the
    /// angle of incidence there.
    fn surface(&self, x: usize, y: usize, shown: Fragment) -> Option<(Point3<f64>, f64)> {
        let corners = self
            .mesh
            .corners(shown.triangle as usize)
            .map(|c| c.cast::<f64>());
        let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
        let normal = normal.try_normalize(0.0)?;
        let DepthCamera { camera, response } = &self.station.actual;
        let pixel = Point2::new(x as f64, y as f64) - displacement(self.sensor);
        let p = response.point(&camera.intrinsics, pixel, f64::from(shown.depth))?;
        let p = camera.rig_from_camera * p;
        let cosine = normal.dot(&(camera.center() - p).normalize()).abs();
        Some((p + normal * 4e-4, cosine))
    }

    /// Whether the object hides a point from the projector.
    fn is_in_shadow(&self, p: Point3<f64>) -> bool {
        let Some(bvh) = &self.bvh else {
            return false;
        };
        let camera = &self.station.actual.camera;
        let projector = camera.rig_from_camera * Point3::new(BASELINE, 0.0, 0.0);
        p.x.hypot(p.y) < self.reach && bvh.is_occluded(p, projector - p, 1.0)
    }
}

/// The sensor's own pattern at a pixel: half of it smooth over some 25 pixels, half without a neighbour.
fn fixed_pattern(random: &mut Random, seed: u64, camera: u64, x: usize, y: usize) -> f64 {
    let at = [x as f64 / 25.0, y as f64 / 25.0, camera as f64 + 0.5];
    // The field's standard deviation is 0.2 at most places; both halves have a variance of 1/2.
    let smooth = (field(seed ^ 0xf1, at) - 0.5) / 0.2;
    (smooth + random.normal()) * 0.5_f64.sqrt()
}

/// Normal noise of which half the variance is shared with the neighbours, as windows that are matched
/// overlap.
fn correlated_noise(key: &[u64; 4], width: usize, height: usize) -> Grid<f32> {
    let mut white = Grid::filled(width + 2, height + 2, 0.0_f32);
    for y in 0..height + 2 {
        Random::new(&[key[0], key[1], key[2], key[3], y as u64]).fill_normal(white.row_mut(y));
    }
    Grid::from_fn(width, height, |x, y| {
        let rows = [0, 1, 2].map(|d| &white.row(y + d)[x..x + 3]);
        let sum: f32 = rows.iter().flat_map(|row| row.iter()).sum();
        // The sum of nine has a variance of 9 and a covariance of 1 with the one in the middle.
        (sum / 3.0 + rows[1][1]) / (2.0 + 2.0 / 3.0_f32).sqrt()
    })
}

/// The object and the disc it stands on, of small triangles, so that projections between corners are exact.
fn with_table(object: Option<&Mesh>) -> Mesh {
    let mut mesh = object.cloned().unwrap_or_default();
    let radius = object.map_or(0.0, |o| Bounds::of(o).radius() + TABLE_BEYOND);
    let radius = radius.max(TABLE_SMALLEST);
    let first = mesh.vertices.len() as u32;
    let (rings, sides) = (12_u32, 96_u32);
    // A tenth of a millimetre below the object, so that the two never fight for a pixel.
    mesh.vertices.push(Point3::new(0.0, 0.0, -1e-4));
    for ring in 1..=rings {
        for side in 0..sides {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(side) / f64::from(sides)).sin_cos();
            let r = radius * f64::from(ring) / f64::from(rings);
            mesh.vertices
                .push(Point3::new(r * cos, r * sin, -1e-4).cast());
        }
    }
    let at = |ring: u32, side: u32| match ring {
        0 => first,
        _ => first + 1 + (ring - 1) * sides + side % sides,
    };
    for side in 0..sides {
        mesh.triangles.push([first, at(1, side), at(1, side + 1)]);
        for ring in 1..rings {
            let [a, b] = [at(ring, side), at(ring + 1, side)];
            let [c, d] = [at(ring + 1, side + 1), at(ring, side + 1)];
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    mesh
}

/// Readings as a picture.
pub(super) fn picture(readings: &Grid<u16>) -> Picture {
    Picture::Raw {
        width: readings.width() as u32,
        height: readings.height() as u32,
        encoding: "16UC1".to_owned(),
        step: readings.width() as u32 * 2,
        data: readings
            .pixels()
            .iter()
            .flat_map(|r| r.to_le_bytes())
            .collect(),
    }
}

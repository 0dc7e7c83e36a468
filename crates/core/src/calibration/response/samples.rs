//! The pixels of a depth camera that lie on a board, with the plane that the colour picture tells. Nothing is fitted
//! here.

use super::misfit::{self, Patch};
use super::plane_view::{PlaneParameters, PlaneView};
use crate::calibration::{Board, DepthResponse, Intrinsics};
use nalgebra::{Point2, Point3, Vector3, Vector4};

/// Pixels that make a view.
pub(super) const FEWEST_IN_VIEW: usize = 100;
/// Part of a square at the pattern's rim that is not looked at: readings mix there, and an unknown scale displaces it.
const RIM: f64 = 0.4;

/// A pixel on a board.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub pixel: [f64; 2],
    /// Normalised direction.
    direction: [f64; 2],
    /// Mean of the valid readings.
    pub reading: f64,
}

/// A view's pixels and its plane: n·X = offset.
#[derive(Clone)]
pub(super) struct Plane<'a> {
    pub placement: &'a str,
    pub normal: Vector3<f64>,
    pub offset: f64,
    pub samples: Vec<Sample>,
    pub tilt_degrees: f64,
}

/// Parameters of a response: slope, intercept, and the two of the scale.
pub(super) type Values = Vector4<f64>;

impl<'a> Plane<'a> {
    /// The board's pixels that have readings.
    pub(super) fn gather(
        lens: &Intrinsics,
        board: &Board,
        view: &PlaneView<'a>,
        parameters: &PlaneParameters,
    ) -> Result<Self, String> {
        let normal = view.camera_from_face * Vector3::z();
        let offset = normal.dot(&view.camera_from_face.translation.vector);
        let found = [view.readings.width(), view.readings.height()];
        if found != [lens.width, lens.height] {
            return Err(format!(
                "the depth camera's frames have {}x{} pixels, but its lens is for pictures of {}x{}",
                found[0], found[1], lens.width, lens.height
            ));
        }
        let [columns, rows] = window(lens, board, view).ok_or("the board is not in its picture")?;
        let face_from_camera = view.camera_from_face.inverse();
        let inner = inner(board);
        let steepest = parameters.steepest_degrees.to_radians().cos();
        let (mut samples, mut cosines) = (Vec::new(), 0.0);
        let mut on_board = 0;
        for y in rows {
            for x in columns.clone() {
                let pixel = Point2::new(x as f64, y as f64);
                let Some(n) = lens.unproject(pixel) else {
                    continue;
                };
                let ray = Vector3::new(n.x, n.y, 1.0);
                let along = normal.dot(&ray);
                let cosine = along / ray.norm();
                let p = face_from_camera * Point3::from(ray * (offset / along));
                let is_on = (0..2).all(|a| (inner[0][a]..=inner[1][a]).contains(&p[a]));
                if !is_on || cosine < steepest {
                    continue;
                }
                on_board += 1;
                let reading = f64::from(view.readings[(x, y)]);
                if reading > 0.0 {
                    let (pixel, direction) = ([pixel.x, pixel.y], [n.x, n.y]);
                    samples.push(Sample {
                        pixel,
                        direction,
                        reading,
                    });
                    cosines += cosine;
                }
            }
        }
        if samples.len() < FEWEST_IN_VIEW {
            if on_board == 0 {
                return Err("the board is seen too steeply".into());
            }
            let found = samples.len();
            return Err(format!(
                "{found} of {on_board} pixels on the board have a reading"
            ));
        }
        let tilt = (cosines / samples.len() as f64).clamp(-1.0, 1.0).acos();
        let tilt_degrees = tilt.to_degrees();
        let placement = view.placement;
        Ok(Self {
            placement,
            normal,
            offset,
            samples,
            tilt_degrees,
        })
    }

    /// Leaves out samples that lie where the response is not used.
    pub(super) fn keep_within_range(&mut self, response: &DepthResponse) {
        let Some([near, far]) = response.range else {
            return;
        };
        let samples = self.samples.iter();
        let within = samples.filter(|s| (near..=far).contains(&self.depth(s, 1.0)));
        self.samples = within.copied().collect();
    }

    /// True depth of a sample whose lateral scale is known.
    pub(super) fn depth(&self, sample: &Sample, scale: f64) -> f64 {
        self.offset / self.along(sample, scale)
    }

    /// Mean distance of its samples in metres.
    pub(super) fn distance(&self) -> f64 {
        let sum: f64 = self.samples.iter().map(|s| self.depth(s, 1.0)).sum();
        sum / self.samples.len() as f64
    }

    /// The plane's normal along a sample's ray of depth 1.
    fn along(&self, sample: &Sample, scale: f64) -> f64 {
        self.normal.z + scale * self.across(sample)
    }

    pub(super) fn across(&self, sample: &Sample) -> f64 {
        let [x, y] = sample.direction;
        self.normal.x * x + self.normal.y * y
    }

    /// What its readings are off by where a line turns them into depth and the lateral scale is 1.
    pub(super) fn patches(&self, lens: &Intrinsics, [slope, intercept]: [f64; 2]) -> Vec<Patch> {
        let (middle, size) = (lens.center_px, [lens.width as f64, lens.height as f64]);
        let corner = 0.25 * (size[0].powi(2) + size[1].powi(2));
        let patch = |sample: &Sample| {
            let depth = self.depth(sample, 1.0);
            let steep = -depth * depth / self.offset;
            let [x, y] = [0, 1].map(|k| sample.pixel[k] - middle[k]);
            let own = Patch {
                depth,
                error: slope * sample.reading + intercept - depth,
                gradient: [
                    steep * self.normal.x / lens.focal_px.x,
                    steep * self.normal.y / lens.focal_px.y,
                ],
                radius_squared: (x * x + y * y) / corner,
            };
            (sample.pixel, own)
        };
        misfit::patches(self.samples.iter().map(patch))
    }

    /// Measured less true depth of a sample.
    pub(super) fn error(&self, sample: &Sample, values: &Values) -> f64 {
        let z = values[0] * sample.reading + values[1];
        z - self.depth(sample, values[2] + values[3] * z)
    }
}

/// The part of the pattern that is looked at: smallest and largest x and y in the face's frame.
fn inner(board: &Board) -> [[f64; 2]; 2] {
    let outline = board.outline();
    let rim = RIM * board.square;
    [outline.min.map(|v| v + rim), outline.max.map(|v| v - rim)]
}

/// Columns and rows that the board may cover.
fn window(
    lens: &Intrinsics,
    board: &Board,
    view: &PlaneView<'_>,
) -> Option<[std::ops::Range<usize>; 2]> {
    let [min, max] = inner(board);
    let rim = (0..32).map(|k| {
        let t = f64::from(k % 8) / 8.0;
        let between = |a: usize, t: f64| min[a] + (max[a] - min[a]) * t;
        match k / 8 {
            0 => [between(0, t), min[1]],
            1 => [max[0], between(1, t)],
            2 => [between(0, 1.0 - t), max[1]],
            _ => [min[0], between(1, 1.0 - t)],
        }
    });
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for [x, y] in rim {
        let p = view.camera_from_face * Point3::new(x, y, 0.0);
        if let Some(pixel) = lens.project(p.x, p.y, p.z) {
            low = [0, 1].map(|a| low[a].min(pixel[a]));
            high = [0, 1].map(|a| high[a].max(pixel[a]));
        }
    }
    let all = [lens.width, lens.height];
    let range = |a: usize| {
        let from = low[a].floor().clamp(0.0, all[a] as f64) as usize;
        from..(high[a].ceil() + 1.0).clamp(0.0, all[a] as f64) as usize
    };
    let ranges = [range(0), range(1)];
    let is_seen = ranges.iter().all(|r| !r.is_empty());
    is_seen.then_some(ranges)
}

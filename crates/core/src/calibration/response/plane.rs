//! Fits a depth camera's response from boards. The colour picture tells where the board's plane is, so each depth
//! pixel on it has a known depth. A line for the depth and one for the lateral scale are fitted to all of them at
//! once.

use super::correction::Correction;
use super::jackknife::{self, BoardEquations, NormalEquations};
use super::lateral::{self, Lateral};
use super::misfit::{self, Misfit, Patch};
use super::reading_change::{BoardError, ReadingChange, smaller_part};
use super::{ResponseError, too_little};
use crate::calibration::{Board, DepthResponse, Intrinsics};
use crate::image::Grid;
use crate::range;
use crate::statistics::upper_median;
use nalgebra::{Isometry3, Matrix4, Point2, Point3, Vector3, Vector4};
use rayon::prelude::*;
use std::ops::Range;

/// What a depth camera saw of one placement.
#[derive(Clone, Copy, Debug)]
pub struct PlaneView<'a> {
    /// The placement's name.
    pub placement: &'a str,
    /// Maps the frame of the face that is seen into the depth camera's.
    pub camera_from_face: Isometry3<f64>,
    /// The mean of its burst, as [`mean_readings`] takes it, of the lens' size.
    pub readings: &'a Grid<f32>,
}

/// How a response is fitted to planes.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct PlaneParameters {
    /// Largest angle in degrees between a ray and the board's normal.
    /// Default 60, range 1 to 89.
    #[serde(deserialize_with = "range::within::<_, _, 1, 89>")]
    pub steepest_degrees: f64,
    /// Fewest views that are needed.
    /// Default 3, range 1 to 1000.
    #[serde(deserialize_with = "range::count::<_, _, 1, 1000>")]
    pub min_views: usize,
    /// Nearest and farthest board, as a part of the nearest one's distance, that say enough: below it
    /// only the offset is fitted.
    /// Default 1.1, range 1 to 1000.
    #[serde(deserialize_with = "range::within::<_, _, 1, 1000>")]
    pub min_span: f64,
    /// Standard deviation of a pixel's mean reading at 1 m, in metres; it grows with the square of
    /// the distance.
    /// Default 0.0015, range 0.000001 to 1.
    #[serde(deserialize_with = "range::at_least_a_millionth::<_, _, 1>")]
    pub noise_at_1m: f64,
    /// Expected deviation of the scale s(z) from 1, and expected change of it per metre, as one standard deviation.
    /// Default 0.02, range 0.000001 to 1.
    #[serde(deserialize_with = "range::at_least_a_millionth::<_, _, 1>")]
    pub scale_expected: f64,
    /// Number of neighbouring pixels that share one error, because the sensor matches windows.
    /// Default 100, range 1 to 1000000.
    #[serde(deserialize_with = "range::within::<_, _, 1, 1_000_000>")]
    pub correlated_pixels: f64,
}

impl Default for PlaneParameters {
    fn default() -> Self {
        Self {
            steepest_degrees: 60.0,
            min_views: 3,
            min_span: 1.1,
            noise_at_1m: 0.0015,
            scale_expected: 0.02,
            correlated_pixels: 100.0,
        }
    }
}

/// A fitted response with what it leaves.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaneFit {
    /// The response; its range reaches a quarter beyond the nearest and the farthest board.
    pub response: DepthResponse,
    /// Standard deviation of its slope, in metres a unit; `None` where the boards' distances do not say what the slope
    /// is.
    pub slope_deviation: Option<f64>,
    /// Bias that is left, by distance, in ascending order.
    pub bias: Vec<DistanceBias>,
    /// Each view that was used, in the order given.
    pub views: Vec<ViewBias>,
    /// Views without enough readings, and why.
    pub unread: Vec<(String, String)>,
    /// Views whose readings contradict all others and were left out, and why.
    pub left_out: Vec<(String, String)>,
    /// What those that were left out agree on, if they do.
    pub change: Option<ReadingChange>,
    /// A smooth correction a pixel, and whether it would pay.
    pub correction: Correction,
    /// Why the line does not fit, if it does not and a cause explains it.
    pub misfit: Option<Misfit>,
}

/// Readings at one distance, against the boards' planes.
#[derive(serde::Serialize, Clone, Copy, Debug, PartialEq)]
pub struct DistanceBias {
    /// Middle of the step, in metres.
    pub distance: f64,
    /// Views and pixels in it.
    pub views: usize,
    /// Pixels in it.
    pub pixels: usize,
    /// Mean of measured less true depth after the fit, in metres.
    pub bias: f64,
    /// The same before it, with readings taken for millimetres.
    pub bias_before: f64,
    /// Standard deviation of a pixel after the fit, in metres.
    pub spread: f64,
}

/// One view against its plane.
#[derive(serde::Serialize, Clone, Debug, PartialEq)]
pub struct ViewBias {
    /// The placement's name.
    pub placement: String,
    /// Mean distance in metres.
    pub distance: f64,
    /// Mean angle between rays and the normal, in degrees.
    pub tilt_degrees: f64,
    /// Pixels on the board.
    pub pixels: usize,
    /// Mean of measured less true depth after the fit, in metres.
    pub bias: f64,
}

/// Metres of a step of [`DistanceBias`], and pixels that make one.
const STEP: f64 = 0.1;
const FEWEST_IN_STEP: usize = 200;
/// Pixels that make a view.
const FEWEST_IN_VIEW: usize = 100;
/// Part of a square at the pattern's rim that is not looked at: readings mix there, and an unknown scale displaces it.
const RIM: f64 = 0.4;
/// How far beyond the boards the line may be followed, as a part of the distance.
const BEYOND: f64 = 0.25;
/// A view is left out if it is off by more than this many deviations, and by this many metres at 1 m.
const VIEW_DEVIATIONS: f64 = 6.0;
const VIEW_OFF: f64 = 0.004;

/// How many times what is expected of it the lateral scale may be off 1 anywhere in the response's range.
const MOST_LATERAL: f64 = 1.5;
/// Weight of a value that stays.
const HELD: f64 = 1e18;

/// Least error that is taken for usual, in units of what is expected; and the least uncertainty, in metres, that is
/// stated.
const LEAST_USUAL: f64 = 0.3;
const LEAST_DOUBT: f64 = 1e-4;

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
pub(super) struct Plane<'a> {
    pub placement: &'a str,
    normal: Vector3<f64>,
    offset: f64,
    pub samples: Vec<Sample>,
    tilt_degrees: f64,
}

/// Parameters of a response: slope, intercept, and the two of the scale.
type Values = Vector4<f64>;

/// Fits a response to boards.
///
/// # Errors
/// If too few views show enough of the board in depth, or no real sensor would have the fitted response.
pub fn fit_plane(
    lens: &Intrinsics,
    board: &Board,
    views: &[PlaneView<'_>],
    parameters: &PlaneParameters,
) -> Result<PlaneFit, ResponseError> {
    let gathered: Vec<Result<Plane<'_>, String>> = views
        .par_iter()
        .map(|view| Plane::gather(lens, board, view, parameters))
        .collect();
    let (mut planes, mut unread) = (Vec::new(), Vec::new());
    for (view, plane) in views.iter().zip(gathered) {
        match plane {
            Ok(plane) => planes.push(plane),
            Err(reason) => unread.push((view.placement.to_owned(), reason)),
        }
    }
    let consistent = Consistent::of(planes, &unread, parameters)?;
    let planes = &consistent.planes;
    let values = settled(planes, consistent.line, parameters);
    let fit = report(lens, planes, &values, parameters)?;
    let change = consistent.change(&values);
    let left_out = consistent.left_out.iter();
    Ok(PlaneFit {
        unread,
        left_out: left_out.map(|c| c.told(change.is_some())).collect(),
        change,
        ..fit
    })
}

/// A view that contradicts all others.
struct Contradiction<'a> {
    /// Its place among the views with readings.
    order: usize,
    plane: Plane<'a>,
    /// Metres at 1 m by which it was off.
    off: f64,
}

impl Contradiction<'_> {
    /// The placement, and why it was left out: the readings changed, or perhaps the board moved.
    fn told(&self, is_change: bool) -> (String, String) {
        let off = 1e3 * self.off;
        let reason = match is_change {
            true => format!(
                "its depth is {off:.1} mm off, like that of its neighbours: the readings changed"
            ),
            false => format!(
                "its depth is {off:.1} mm off what all other boards say: did the board move?"
            ),
        };
        (self.plane.placement.to_owned(), reason)
    }
}

/// Views that agree, and those that were left out so that they do.
struct Consistent<'a> {
    planes: Vec<Plane<'a>>,
    /// The place of each among the views with readings.
    order: Vec<usize>,
    left_out: Vec<Contradiction<'a>>,
    /// What fits the views that agree, with all of the lateral scale.
    line: Values,
}

impl<'a> Consistent<'a> {
    /// Leaves out views that contradict the others, the worst first; if none does, the fewer ones of those before and
    /// after a change of the readings.
    ///
    /// # Errors
    /// If fewer than `min_views` are left: with what is amiss with the others.
    fn of(
        planes: Vec<Plane<'a>>,
        unread: &[(String, String)],
        parameters: &PlaneParameters,
    ) -> Result<Self, ResponseError> {
        let (mut order, mut planes): (Vec<usize>, Vec<Plane<'a>>) =
            planes.into_iter().enumerate().unzip();
        let mut left_out: Vec<Contradiction<'a>> = Vec::new();
        loop {
            if planes.len() < parameters.min_views.max(1) {
                return too_few(&planes, unread, &left_out, parameters);
            }
            let line = solve(&planes, Lateral::Line, parameters);
            if let Some((k, off)) = worst(&planes, &line) {
                left_out.push(Contradiction {
                    order: order.remove(k),
                    plane: planes.remove(k),
                    off,
                });
                continue;
            }
            // No response fits most boards if the readings of half of them are others.
            let part = match left_out.is_empty() {
                true => changed_part(&planes, parameters),
                false => None,
            };
            let Some(part) = part else {
                return Ok(Self {
                    planes,
                    order,
                    left_out,
                    line,
                });
            };
            let orders = order.drain(part.clone());
            let changed: Vec<(usize, Plane<'a>)> = orders.zip(planes.drain(part)).collect();
            let line = solve(&planes, Lateral::Line, parameters);
            let contradictions = changed.into_iter().map(|(order, plane)| Contradiction {
                off: view_error(&plane, &line),
                order,
                plane,
            });
            left_out.extend(contradictions);
        }
    }

    /// What the views that were left out agree on, compared with the response to the others.
    fn change(&self, values: &Values) -> Option<ReadingChange> {
        let kept = self.order.iter().zip(&self.planes);
        let kept = kept.map(|(order, plane)| (*order, plane, false));
        let others = self.left_out.iter().map(|c| (c.order, &c.plane, true));
        let mut all: Vec<(usize, &Plane<'a>, bool)> = kept.chain(others).collect();
        all.sort_by_key(|(order, _, _)| *order);
        let boards = all
            .iter()
            .map(|(_, plane, is_left_out)| board_error(plane, values, *is_left_out));
        let boards: Vec<BoardError<'_>> = boards.collect();
        ReadingChange::of(&boards, most_off(&self.planes, values)?)
    }
}

/// Says why no response can be fitted.
fn too_few<T>(
    planes: &[Plane<'_>],
    unread: &[(String, String)],
    left_out: &[Contradiction<'_>],
    parameters: &PlaneParameters,
) -> Result<T, ResponseError> {
    let told = left_out.iter().map(|c| c.told(false));
    let reasons = unread.iter().cloned().chain(told);
    let reasons = reasons.map(|(name, reason)| format!("; {name}: {reason}"));
    let found = format!(
        "{} usable views{}",
        planes.len(),
        reasons.collect::<String>()
    );
    let expected = format!(
        "{} or more of the board by the depth camera, near and far",
        parameters.min_views
    );
    too_little(found, expected)
}

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

    /// True depth of a sample whose lateral scale is known.
    pub(super) fn depth(&self, sample: &Sample, scale: f64) -> f64 {
        self.offset / self.along(sample, scale)
    }

    /// Mean distance of its samples in metres.
    fn distance(&self) -> f64 {
        let sum: f64 = self.samples.iter().map(|s| self.depth(s, 1.0)).sum();
        sum / self.samples.len() as f64
    }

    /// The plane's normal along a sample's ray of depth 1.
    fn along(&self, sample: &Sample, scale: f64) -> f64 {
        self.normal.z + scale * self.across(sample)
    }

    fn across(&self, sample: &Sample) -> f64 {
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
    fn error(&self, sample: &Sample, values: &Values) -> f64 {
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
    let is_size = view.readings.width() == lens.width && view.readings.height() == lens.height;
    let range = |a: usize| {
        let from = low[a].floor().clamp(0.0, all[a] as f64) as usize;
        from..(high[a].ceil() + 1.0).clamp(0.0, all[a] as f64) as usize
    };
    let ranges = [range(0), range(1)];
    let fits = is_size && ranges.iter().all(|r| !r.is_empty());
    fits.then_some(ranges)
}

/// Mean of a burst's raw readings at each pixel that has them in half of the frames or more, 0 at others; `None`
/// without frames of one size.
pub fn mean_readings(frames: &[Grid<u16>]) -> Option<Grid<f32>> {
    let first = frames.first()?;
    let is_same = frames.iter().all(|f| f.same_size(first));
    let mean = |x: usize, y: usize| {
        let (mut sum, mut count) = (0_u64, 0);
        for frame in frames {
            let reading = frame[(x, y)];
            sum += u64::from(reading);
            count += usize::from(reading > 0);
        }
        let enough = count > 0 && 2 * count >= frames.len();
        if enough {
            sum as f32 / count as f32
        } else {
            0.0
        }
    };
    is_same.then(|| Grid::from_fn(first.width(), first.height(), mean))
}

/// Slope, intercept and scale by weighted least squares with a robust loss, from an offset alone on.
fn solve(planes: &[Plane<'_>], lateral: Lateral, parameters: &PlaneParameters) -> Values {
    const ROUNDS: usize = 12;
    let mut values = start(planes, parameters);
    let is_line = spans(planes, parameters.min_span);
    for _ in 0..ROUNDS {
        // Tukey's and Huber's idea in one: a pixel counts less the farther off it is, in units of what is usual.
        let usual = usual_error(planes, &values, parameters).max(LEAST_USUAL);
        let mut normal = prior(&values, lateral, parameters, is_line);
        for plane in planes {
            for sample in &plane.samples {
                add(&mut normal, plane, sample, &values, parameters, usual);
            }
        }
        match normal.0.cholesky() {
            Some(solved) => values -= solved.solve(&normal.1),
            None => break,
        }
        for (k, held) in [(2, 1.0), (3, 0.0)] {
            if !lateral.is_free()[k - 2] {
                values[k] = held;
            }
        }
    }
    values
}

/// The values with no more of a lateral scale than boards that are held out bear out, from those with all of it.
fn settled(planes: &[Plane<'_>], line: Values, parameters: &PlaneParameters) -> Values {
    let normals = normals(planes, &line, Lateral::Line, parameters);
    let is_line = spans(planes, parameters.min_span);
    let [near, far] = distances(planes);
    let ends = [near * (1.0 - BEYOND), far * (1.0 + BEYOND)];
    let most = MOST_LATERAL * parameters.scale_expected;
    for lateral in lateral::in_order_of_merit(&normals, |lateral| {
        prior(&line, lateral, parameters, is_line)
    }) {
        let values = match lateral {
            Lateral::Line => line,
            less => solve(planes, less, parameters),
        };
        let off = |z: f64| (values[2] + values[3] * z - 1.0).abs();
        if ends.iter().all(|&z| off(z) <= most) {
            return values;
        }
    }
    solve(planes, Lateral::One, parameters)
}

/// What each board says of the values that were found, and all of them together with what is expected.
fn normals(
    planes: &[Plane<'_>],
    values: &Values,
    lateral: Lateral,
    parameters: &PlaneParameters,
) -> BoardEquations {
    let usual = usual_error(planes, values, parameters).max(LEAST_USUAL);
    let of_plane = |plane: &Plane<'_>| {
        let (mut normal, mut squares) = ((Matrix4::zeros(), Vector4::zeros()), 0.0);
        for sample in &plane.samples {
            squares += add(&mut normal, plane, sample, values, parameters, usual);
        }
        (normal, squares)
    };
    let of_planes: Vec<_> = planes.par_iter().map(of_plane).collect();
    let (of_boards, squares): (Vec<NormalEquations>, Vec<f64>) = of_planes.into_iter().unzip();
    let is_line = spans(planes, parameters.min_span);
    let expected = prior(values, lateral, parameters, is_line);
    let all = of_boards
        .iter()
        .fold(expected, |all, own| (all.0 + own.0, all.1 + own.1));
    BoardEquations {
        all,
        of_boards,
        squares,
    }
}

/// Millimetres, with the offset that is right for half of the views.
fn start(planes: &[Plane<'_>], parameters: &PlaneParameters) -> Values {
    let mut ratios: Vec<f64> = Vec::new();
    for plane in planes {
        ratios.extend(
            plane
                .samples
                .iter()
                .map(|s| plane.depth(s, 1.0) / s.reading),
        );
    }
    let usual = upper_median(&mut ratios).filter(|_| spans(planes, parameters.min_span));
    let slope = usual.unwrap_or(0.001);
    Values::new(slope, 0.0, 1.0, 0.0)
}

/// Whether the boards' distances differ enough to say what the slope is.
fn spans(planes: &[Plane<'_>], min_span: f64) -> bool {
    let [near, far] = distances(planes);
    far > min_span * near
}

/// Mean distance of the nearest and the farthest view.
fn distances(planes: &[Plane<'_>]) -> [f64; 2] {
    let means = planes.iter().map(Plane::distance);
    means.fold([f64::INFINITY, 0.0], |[near, far], z| {
        [near.min(z), far.max(z)]
    })
}

/// What is expected before any reading, as normal equations about `values`. With boards at one distance the slope
/// stays.
fn prior(
    values: &Values,
    lateral: Lateral,
    parameters: &PlaneParameters,
    is_line: bool,
) -> (Matrix4<f64>, Vector4<f64>) {
    let expected = Values::new(values[0], values[1], 1.0, 0.0);
    let slope = if is_line { 0.0 } else { 1e-18_f64.recip() };
    let scale = parameters.scale_expected.max(1e-6).powi(-2);
    let [constant, change] = lateral
        .is_free()
        .map(|free| if free { scale } else { HELD });
    let weights = Vector4::new(slope, 0.0, constant, change);
    let gradient = weights.component_mul(&(values - expected));
    (Matrix4::from_diagonal(&weights), gradient)
}

/// Adds a sample's equation; gives its weighted squared error.
fn add(
    normal: &mut (Matrix4<f64>, Vector4<f64>),
    plane: &Plane<'_>,
    sample: &Sample,
    values: &Values,
    parameters: &PlaneParameters,
    usual: f64,
) -> f64 {
    let z = values[0] * sample.reading + values[1];
    let scale = values[2] + values[3] * z;
    let across = plane.across(sample);
    let along = plane.normal.z + scale * across;
    // Distance from the plane, and by z: the lateral scale changes with it too.
    let error = z * along - plane.offset;
    let by_z = along + z * values[3] * across;
    let derivative = Vector4::new(by_z * sample.reading, by_z, z * across, z * z * across);
    let deviation = parameters.noise_at_1m * z * z * along.abs();
    let off = (error / deviation / usual).abs();
    let robust = if off <= 2.0 { 1.0 } else { (2.0 / off).powi(2) };
    let weight = robust / (deviation * deviation * parameters.correlated_pixels.max(1.0));
    normal.0 += derivative * derivative.transpose() * weight;
    normal.1 += derivative * (error * weight);
    error * error * weight
}

/// Median error of all samples in units of what is expected, times 1.4826: 1 where the noise is as expected.
fn usual_error(planes: &[Plane<'_>], values: &Values, parameters: &PlaneParameters) -> f64 {
    let mut errors: Vec<f64> = Vec::new();
    for plane in planes {
        errors.extend(plane.samples.iter().map(|s| {
            let z = values[0] * s.reading + values[1];
            (plane.error(s, values) / (parameters.noise_at_1m * z * z)).abs()
        }));
    }
    1.4826 * upper_median(&mut errors).unwrap_or(0.0)
}

/// Median of a view's errors over z².
fn view_error(plane: &Plane<'_>, values: &Values) -> f64 {
    let error = |s: &Sample| plane.error(s, values) / plane.depth(s, 1.0).powi(2);
    let mut errors: Vec<f64> = plane.samples.iter().map(error).collect();
    upper_median(&mut errors).unwrap_or(0.0)
}

/// What a view's readings are off by as a whole.
fn board_error<'a>(plane: &Plane<'a>, values: &Values, is_left_out: bool) -> BoardError<'a> {
    BoardError {
        placement: plane.placement,
        distance: plane.distance(),
        at_1m: view_error(plane, values),
        is_left_out,
    }
}

/// The views before or after a change of the readings, whichever are fewer, if there is such a change.
fn changed_part(planes: &[Plane<'_>], parameters: &PlaneParameters) -> Option<Range<usize>> {
    // A lateral scale would take a part of the change, and leave of it what no line and step explain.
    let line = solve(planes, Lateral::One, parameters);
    let boards = planes.iter().map(|plane| board_error(plane, &line, false));
    let boards: Vec<BoardError<'_>> = boards.collect();
    smaller_part(&boards, VIEW_OFF)
}

/// The view that disagrees with all others, if there is one, and by how much at 1 m.
fn worst(planes: &[Plane<'_>], values: &Values) -> Option<(usize, f64)> {
    if planes.len() < 5 {
        return None;
    }
    let limit = most_off(planes, values)?;
    let errors: Vec<f64> = planes.iter().map(|p| view_error(p, values)).collect();
    let (k, &error) = errors
        .iter()
        .enumerate()
        .max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
    (error.abs() > limit).then_some((k, error))
}

/// By how many metres at 1 m a view may be off what all others say; `None` without views.
fn most_off(planes: &[Plane<'_>], values: &Values) -> Option<f64> {
    let sizes = planes.iter().map(|p| view_error(p, values).abs());
    let mut sizes: Vec<f64> = sizes.collect();
    Some((VIEW_DEVIATIONS * 1.4826 * upper_median(&mut sizes)?).max(VIEW_OFF))
}

/// The response with what it leaves of the views that agree.
fn report(
    lens: &Intrinsics,
    planes: &[Plane<'_>],
    values: &Values,
    parameters: &PlaneParameters,
) -> Result<PlaneFit, ResponseError> {
    let bias = by_distance(planes, values);
    let [near, far] = distances(planes);
    let readings = [near, far].map(|z| (z - values[1]) / values[0]);
    let lateral = Lateral::of([values[2], values[3]]);
    let normals = normals(planes, values, lateral, parameters);
    let doubt = jackknife::deviation(&normals, readings).max(LEAST_DOUBT);
    let is_line = spans(planes, parameters.min_span);
    let line = [values[0], values[1]];
    let patches: Vec<Vec<Patch>> = planes.iter().map(|p| p.patches(lens, line)).collect();
    let placements: Vec<&str> = planes.iter().map(|p| p.placement).collect();
    let misfit = misfit::explain_session(&placements, &patches);
    // What does not fit grows with the squared distance.
    let unfit = misfit.as_ref().map_or(0.0, |m| m.held_out * far.powi(2));
    let response = DepthResponse {
        slope: values[0],
        intercept: values[1],
        scale: [values[2], values[3], 0.0, 0.0, 0.0],
        range: Some([near * (1.0 - BEYOND), far * (1.0 + BEYOND)]),
        uncertainty: bias
            .iter()
            .map(|b| b.bias.abs())
            .fold(doubt.max(unfit), f64::max),
    };
    let views = planes
        .iter()
        .map(|plane| view_bias(plane, values))
        .collect();
    let correction = Correction::weigh(lens, &correction_samples(planes, values));
    let response = response.checked()?;
    Ok(PlaneFit {
        response,
        slope_deviation: jackknife::slope_deviation(&normals).filter(|_| is_line),
        bias,
        views,
        unread: Vec::new(),
        left_out: Vec::new(),
        change: None,
        correction,
        misfit,
    })
}

fn view_bias(plane: &Plane<'_>, values: &Values) -> ViewBias {
    let count = plane.samples.len() as f64;
    let mean = |of: &dyn Fn(&Sample) -> f64| plane.samples.iter().map(of).sum::<f64>() / count;
    ViewBias {
        placement: plane.placement.to_owned(),
        distance: mean(&|s| plane.depth(s, 1.0)),
        tilt_degrees: plane.tilt_degrees,
        pixels: plane.samples.len(),
        bias: mean(&|s| plane.error(s, values)),
    }
}

/// For each view its samples' pixels with their error over z²: what a disparity is off.
fn correction_samples(planes: &[Plane<'_>], values: &Values) -> Vec<Vec<([f64; 2], f64)>> {
    let of = |plane: &Plane<'_>| {
        let error = |s: &Sample| {
            let z = plane.depth(s, 1.0);
            (s.pixel, plane.error(s, values) / (z * z))
        };
        plane.samples.iter().map(error).collect()
    };
    planes.iter().map(of).collect()
}

fn by_distance(planes: &[Plane<'_>], values: &Values) -> Vec<DistanceBias> {
    let mut steps: std::collections::BTreeMap<usize, (usize, Vec<[f64; 2]>)> = Default::default();
    let millimetres = Values::new(0.001, 0.0, 1.0, 0.0);
    for plane in planes {
        let mut touched = std::collections::BTreeSet::new();
        for sample in &plane.samples {
            let step = (plane.depth(sample, 1.0) / STEP).max(0.0) as usize;
            let entry = steps.entry(step).or_default();
            entry.0 += usize::from(touched.insert(step));
            entry.1.push([
                plane.error(sample, values),
                plane.error(sample, &millimetres),
            ]);
        }
    }
    let large = steps
        .into_iter()
        .filter(|(_, (_, errors))| errors.len() >= FEWEST_IN_STEP);
    large
        .map(|(step, (views, errors))| {
            let count = errors.len() as f64;
            let mean = |a: usize| errors.iter().map(|e| e[a]).sum::<f64>() / count;
            let (bias, bias_before) = (mean(0), mean(1));
            let variance = errors.iter().map(|e| (e[0] - bias).powi(2)).sum::<f64>() / count;
            DistanceBias {
                distance: (step as f64 + 0.5) * STEP,
                views,
                pixels: errors.len(),
                bias,
                bias_before,
                spread: variance.sqrt(),
            }
        })
        .collect()
}

//! What is given to a fit of planes: what a depth camera saw of a placement, and how to fit it. Nothing is fitted here.

use crate::image::Grid;
use crate::range;
use nalgebra::Isometry3;

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

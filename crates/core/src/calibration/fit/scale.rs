//! Compares the board's size, which sets the scale of all lengths, with independent measurements of a length: a depth
//! camera's slope, a ruler held against the printed ruler, the distance of two cameras. It says which of them
//! contradict the board's size; which side is wrong cannot be known.

use super::reason::{Reason, ReasonKind};
use super::result::Fit;
use super::verdict::Judgement;
use crate::calibration::{Board, CalibrationLevel};
use crate::frame::CameraId;
use crate::range;
use std::collections::BTreeMap;

/// The limits for witnesses of the scale.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct ScaleWitnessLimits {
    /// Metres per unit of depth cameras as the factory set them; 0 if that is not known.
    /// Default 0.001, range 0 to 1.
    #[serde(deserialize_with = "range::within::<_, _, 0, 1>")]
    pub nominal_slope: f64,
    /// Standard deviation of the factory's slope, as a share of it.
    /// Default 0.01, range 0.000001 to 1.
    #[serde(deserialize_with = "range::at_least_a_millionth::<_, _, 1>")]
    pub slope_deviation: f64,
    /// Share by which a witness and the board's size may differ, however sure the witness is.
    /// Default 0.01, range 0.000001 to 1.
    #[serde(deserialize_with = "range::at_least_a_millionth::<_, _, 1>")]
    pub tolerance: f64,
    /// Standard deviations by which they may differ.
    /// Default 2.5, range 0 to 1000.
    #[serde(deserialize_with = "range::within::<_, _, 0, 1000>")]
    pub deviations: f64,
}

impl Default for ScaleWitnessLimits {
    fn default() -> Self {
        Self {
            nominal_slope: 0.001,
            slope_deviation: 0.01,
            tolerance: 0.01,
            deviations: 2.5,
        }
    }
}

/// A slope that is more than this many times the nominal one, or less than its inverse, has another unit.
const SAME_UNIT: f64 = 1.5;

/// A length with its standard deviation, in metres.
#[derive(serde::Serialize, Clone, Copy, Debug, PartialEq)]
pub struct Length {
    /// The length.
    pub metres: f64,
    /// Its standard deviation.
    pub deviation: f64,
}

/// A reading of the ruler that is printed on the board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RulerReading {
    /// The nominal length, in metres.
    pub printed: f64,
    /// What was measured.
    pub measured: Length,
}

/// The distance of two cameras' optical centres, measured by hand.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraDistance {
    /// The cameras.
    pub cameras: [CameraId; 2],
    /// What was measured.
    pub measured: Length,
}

/// What was measured by hand.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeasuredLengths {
    /// Readings of the printed ruler.
    pub rulers: Vec<RulerReading>,
    /// Distances of cameras.
    pub distances: Vec<CameraDistance>,
}

/// The slope of a depth camera's response, and its standard deviation, in metres a unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slope {
    /// The slope.
    pub value: f64,
    /// Its standard deviation.
    pub deviation: f64,
}

/// The scale that a witness measured, compared with the board's.
#[derive(serde::Serialize, Clone, Debug, PartialEq)]
pub struct WitnessReading {
    /// By what part the calibration's lengths, which the board's size sets, are larger than the witness says.
    pub off: f64,
    /// Its standard deviation.
    pub deviation: f64,
    /// By what part they may differ.
    pub allowed: f64,
    /// Whether it contradicts the board's size.
    pub contradicts: bool,
    /// Both numbers and, where they contradict each other, both explanations.
    pub words: String,
}

/// Compares all witnesses of the scale with the board's size; `slopes` are those of depth cameras that the boards
/// determine. A distance to a camera that could not be fitted is ignored.
pub fn witnesses(
    fit: &Fit,
    slopes: &BTreeMap<CameraId, Slope>,
    measured: &MeasuredLengths,
    parameters: &ScaleWitnessLimits,
) -> Vec<WitnessReading> {
    let mut found = Vec::new();
    let of_slopes = slopes.iter();
    found.extend(of_slopes.filter_map(|(id, slope)| of_slope(fit, id, *slope, parameters)));
    let of_rulers = measured.rulers.iter();
    found.extend(of_rulers.map(|reading| of_ruler(&fit.board, reading, parameters)));
    let of_distances = measured.distances.iter();
    found.extend(of_distances.filter_map(|distance| of_distance(fit, distance, parameters)));
    found
}

/// The messages about the scale, one line each.
pub fn scale_words(readings: &[WitnessReading], board: &Board) -> Vec<String> {
    if readings.is_empty() {
        return vec![format!(
            "scale: nothing but the board's size ({} a square) sets it: a board that is 1 % larger makes every length 1 % \
             wrong, and nothing here shows it: check the scale with --measured or --distance",
            millimetres(board.square)
        )];
    }
    let words = readings.iter().map(|t| t.words.clone());
    words.collect()
}

impl Judgement {
    /// Adds the reasons that witnesses of the scale give.
    pub fn with_witnesses(mut self, readings: &[WitnessReading]) -> Self {
        for reading in readings.iter().filter(|t| t.contradicts) {
            let level = CalibrationLevel::Doubtful;
            self.level = self.level.max(level);
            let reason = Reason::new(level, ReasonKind::Scale, &reading.words);
            self.reasons.push(reason);
        }
        self
    }
}

impl ScaleWitnessLimits {
    fn reading(&self, off: f64, deviation: f64) -> WitnessReading {
        let allowed = self.tolerance.max(self.deviations * deviation);
        WitnessReading {
            off,
            deviation,
            allowed,
            contradicts: off.abs() > allowed,
            words: String::new(),
        }
    }
}

fn of_slope(
    fit: &Fit,
    id: &CameraId,
    slope: Slope,
    parameters: &ScaleWitnessLimits,
) -> Option<WitnessReading> {
    let nominal = parameters.nominal_slope;
    let ratio = slope.value / nominal;
    // Nothing is known of a camera that counts in another unit.
    if !(ratio.is_finite() && (1.0 / SAME_UNIT..=SAME_UNIT).contains(&ratio)) {
        return None;
    }
    let deviation = parameters
        .slope_deviation
        .hypot(slope.deviation / slope.value);
    let mut found = parameters.reading(ratio - 1.0, deviation);
    let numbers = format!(
        "scale: depth camera {id} has {:.6} m per unit; {nominal} ±{:.1} % is nominal",
        slope.value,
        100.0 * parameters.slope_deviation
    );
    found.words = match found.contradicts {
        true => format!(
            "{numbers}: {}, or the depth camera reads {:.1} % too {}",
            other_board(&fit.board, found.off),
            100.0 * (1.0 / ratio - 1.0).abs(),
            if ratio < 1.0 { "deep" } else { "near" },
        ),
        false => agrees(numbers, &found),
    };
    Some(found)
}

fn of_ruler(
    board: &Board,
    reading: &RulerReading,
    parameters: &ScaleWitnessLimits,
) -> WitnessReading {
    let RulerReading { printed, measured } = *reading;
    let ratio = measured.metres / printed;
    let mut found = parameters.reading(1.0 / ratio - 1.0, measured.deviation / measured.metres);
    let numbers = format!(
        "scale: the ruler that is printed as {} measures {} ±{}",
        millimetres(printed),
        millimetres(measured.metres),
        millimetres(measured.deviation)
    );
    let square = millimetres(board.square * ratio);
    found.words = match found.contradicts {
        true => format!(
            "{numbers}: the sheet was not printed at 100 %, and squares drawn with {} have {square} (if so, give --board \
             with that, without --measured), or the ruler was misread",
            millimetres(board.square)
        ),
        false => format!(
            "{}; squares drawn with {} would have {square}",
            agrees(numbers, &found),
            millimetres(board.square)
        ),
    };
    found
}

fn of_distance(
    fit: &Fit,
    distance: &CameraDistance,
    parameters: &ScaleWitnessLimits,
) -> Option<WitnessReading> {
    let find = |id: &CameraId| fit.cameras.iter().find(|c| c.camera.id == *id);
    let [a, b] = [find(&distance.cameras[0])?, find(&distance.cameras[1])?];
    let between = b.camera.center() - a.camera.center();
    let length = between.norm();
    // The errors of the two along the line between them are taken for independent.
    let along = between / length.max(1e-9);
    let [of_a, of_b] = [a, b].map(|c| c.uncertainty.position_along(&along));
    let measured = distance.measured;
    let deviation = of_a.hypot(of_b).hypot(measured.deviation);
    let mut found = parameters.reading(length / measured.metres - 1.0, deviation / measured.metres);
    let numbers = format!(
        "scale: cameras {} and {} are {} apart; measured: {} ±{}",
        a.camera.id,
        b.camera.id,
        millimetres(length),
        millimetres(measured.metres),
        millimetres(measured.deviation)
    );
    found.words = match found.contradicts {
        true => format!(
            "{numbers}: {}, or the distance was measured wrongly (it is that of the optical centres)",
            other_board(&fit.board, found.off)
        ),
        false => agrees(numbers, &found),
    };
    Some(found)
}

/// The board that would be right if the witness is.
fn other_board(board: &Board, off: f64) -> String {
    format!(
        "either the board's squares have {} and not {}",
        millimetres(board.square / (1.0 + off)),
        millimetres(board.square)
    )
}

fn agrees(numbers: String, found: &WitnessReading) -> String {
    format!(
        "{numbers}: they differ by {:+.2} %, within the allowed ±{:.2} %",
        100.0 * found.off,
        100.0 * found.allowed
    )
}

fn millimetres(metres: f64) -> String {
    format!("{} mm", (metres * 1e5).round() / 1e2)
}

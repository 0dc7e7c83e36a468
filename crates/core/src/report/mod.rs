//! What is said of a model to the person who made it: figures, a verdict in words, the report and one
//! picture of it all. It makes data and pictures; `output` and the commands make files of them.

mod calibration;
mod coarse;
mod document;
mod measure;
mod preview;
mod verdict;

pub use calibration::{CalibrationPage, calibration_page};
pub use document::{
    FailedCapture, Failure, Origin, Outcome, Report, StageTime, Timing, VERSION, to_json,
};
pub use measure::{
    ColorMeasures, Consistency, DepthMeasures, Measurements, ModelMeasures, Moved,
    ProvenanceMeasures, RegionMeasures, measure,
};
pub use preview::preview;
pub use verdict::{Code, Limits, Parameters, Reason, Verdict, judge};

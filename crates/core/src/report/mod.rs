//! Reports on a model to the person who made it: figures, a verdict with its reasons, the report and one picture of
//! it all. This room makes data and pictures; `output` and the commands write the files.

mod calibration;
mod coarse;
mod document;
mod measure;
mod preview;
mod verdict;

pub use calibration::{CalibrationPage, Found, ViewPicture, calibration_page};
pub use document::{
    FailedCapture, Failure, Origin, Report, ReportOutcome, StageTime, Timing, VERSION, to_json,
};
pub use measure::{
    AtlasMeasures, ColorMeasures, Consistency, DepthMeasures, Exchanged, Measurements,
    ModelMeasures, MovedCamera, ProvenanceMeasures, RegionMeasures, UnobservedMeasures, measure,
};
pub use preview::{CaptureViews, picture_of, preview, preview_object, stamp};
pub use verdict::{Limits, Parameters, Reason, ReasonCode, Verdict, judge};

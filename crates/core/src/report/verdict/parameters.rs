//! Where green ends and amber and red begin. `design/verdict.md` has the data that the defaults come from.

use super::Level;
use serde::de::{Deserializer, Error};
use serde::{Deserialize, Serialize, Serializer};

/// Two limits of one figure, in its unit. Any number is taken: beyond one that no figure reaches, such as `inf`,
/// nothing is a reason. A limit that is not given is the figure's default.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Beyond this it is amber.
    #[serde(default = "not_given")]
    pub amber: f64,
    /// Beyond this it is red; without it, it never is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub red: Option<f64>,
}

/// What stands for a limit until [`Parameters`] puts the figure's default in its place.
fn not_given() -> f64 {
    f64::NAN
}

impl Limits {
    const fn amber(amber: f64) -> Self {
        Self { amber, red: None }
    }

    const fn amber_red(amber: f64, red: f64) -> Self {
        Self {
            amber,
            red: Some(red),
        }
    }

    /// Puts the defaults in the place of what was not given.
    fn complete(&mut self, defaults: &Self) {
        if self.amber.is_nan() {
            self.amber = defaults.amber;
        }
        self.red = self.red.or(defaults.red);
    }
}

/// The limits of a verdict. A figure beyond its limit is a reason.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(remote = "Self", deny_unknown_fields, default)]
pub struct Parameters {
    /// Displacement of the silhouette of a camera that moved, as a share of the object's longest side. Default
    /// 0.005 and 0.03.
    pub displaced: Limits,
    /// Displacement of the silhouettes that half of the cameras exceed, as a share of the object's longest side, beyond
    /// which the calibration is not that of the recording: red. Default 0.006, range 0 to 1.
    #[serde(deserialize_with = "crate::range::within::<_, f64, 0, 1>")]
    pub common_shift: f64,
    /// Below so many pixels a displacement, of one camera or of most, counts as none: a shadow at the object's foot
    /// and a blurred edge bring it about in small pictures. Default 1.5, range 0 to 100.
    #[serde(deserialize_with = "crate::range::within::<_, f64, 0, 100>")]
    pub least_shift_px: f64,
    /// Share of a silhouette's area that the hull leaves uncovered although the contour is more than a few
    /// pixels away. Default 0.004 and 0.15.
    pub uncovered: Limits,
    /// Pixels at the frame's edge that are object, as a share of the object's longest side. Default 0.02.
    pub frame_cut: Limits,
    /// Share of the model's area, without the face on the table, that lies on a side or the top of the volume where no
    /// outline shows that the object ends. Default 0.005.
    pub volume_cut: Limits,
    /// Share of the object's pixels that are overexposed. Default 0.1.
    pub overexposed: Limits,
    /// Share of the object's pixels that are black. Default 0.5.
    pub underexposed: Limits,
    /// Standard deviation of the blur across the contour, in pixels. Default 4 and 10.
    pub blur_px: Limits,
    /// Share of the backdrop around the object that differs from the background picture. Default 0.35.
    pub backdrop_changed: Limits,
    /// Share of the object that, in a picture without colours, only its outline distinguishes from a shadow. Default
    /// 0.2.
    pub told_by_outline: Limits,
    /// Hours between the background and the capture. Default 24.
    pub background_age_h: Limits,
    /// Milliseconds between the first and the last colour camera. Default 10 and 100.
    pub skew_ms: Limits,
    /// Whether a model of silhouettes alone is what is wanted: then a rig without a depth camera, or a method that
    /// uses no depth, is a note, and so is what no depth camera looked into. Default false: it is amber, for the
    /// model's hollows are filled.
    pub hull_is_wanted: bool,
    /// Share of the model's area, without the face on the table, that faces up and that no depth camera read, although
    /// the rig has one. Default 0.045.
    pub lid_unread: Limits,
    /// Share of that area that is a guess, because no camera saw it, no depth camera read it, or a depth camera read
    /// something behind it. The last share is also held against `lid_unread`. Default 0.18.
    pub unobserved: Limits,
    /// Share of the concave regions' pixels without readings that count. Default 0.6.
    pub region_unread: Limits,
    /// Share of the model's area that bridges holes of the depth. Default 0.25.
    pub bridged: Limits,
    /// Mean of the model's expected errors over its surface, without the face on the table, in millimetres. Default
    /// 1.25.
    pub expected_mm: Limits,
    /// Share of the hull's front, as a depth camera sees it, that is restored from its depth. Default 0.95.
    pub region_share: Limits,
    /// Millimetres that nine in ten pixels of a concave region are within, between model and depth.
    /// Default 3 and 10.
    pub disagreement_mm: Limits,
    /// Bias of a depth camera over what its calibration leaves possible, in millimetres. Default 2 and 15.
    pub bias_excess_mm: Limits,
    /// Millimetres between the object's outline as a depth camera read it and that of the hull. Default 1.
    pub outline_mm: Limits,
    /// Millimetres by which a depth camera reads the object elsewhere than the hull, beyond what its bias may be: where
    /// the model is the hull, half of the readings behind it or a fifth in front of it; anywhere, half of those that
    /// are in front for certain. Default 0.8.
    pub elsewhere_mm: Limits,
    /// Bias in millimetres that a depth camera may have where its recording does not say. Default 10.
    #[serde(deserialize_with = "crate::range::within::<_, f64, 0, 1000000>")]
    pub unstated_uncertainty_mm: f64,
    /// Places where carving contradicted a colour camera and was undone; fewer are a note. Default 2000.
    pub openings_closed: Limits,
    /// Stray pieces dropped from the hull, or cut off by carving; fewer are a note. Default 100.
    pub dropped_pieces: Limits,
    /// Connected pieces of the model; a single object has one. Default 1.
    pub components: Limits,
    /// Handles of the model, of which perforations are made. Default 4.
    pub handles: Limits,
    /// Handles of the model that the plain hull has not: true openings that only the depth camera sees, or
    /// perforations. Default 0.
    pub handles_of_depth: Limits,
    /// Share of the model's area that no camera saw, whose colour is a guess. Default 0.45.
    pub unpainted: Limits,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            displaced: Limits::amber_red(0.005, 0.03),
            common_shift: 0.006,
            least_shift_px: 1.5,
            uncovered: Limits::amber_red(0.004, 0.15),
            frame_cut: Limits::amber(0.02),
            volume_cut: Limits::amber(0.005),
            overexposed: Limits::amber(0.1),
            underexposed: Limits::amber(0.5),
            blur_px: Limits::amber_red(4.0, 10.0),
            backdrop_changed: Limits::amber(0.35),
            told_by_outline: Limits::amber(0.2),
            background_age_h: Limits::amber(24.0),
            skew_ms: Limits::amber_red(10.0, 100.0),
            hull_is_wanted: false,
            lid_unread: Limits::amber(0.045),
            unobserved: Limits::amber(0.18),
            region_unread: Limits::amber(0.6),
            bridged: Limits::amber(0.25),
            expected_mm: Limits::amber(1.25),
            region_share: Limits::amber(0.95),
            disagreement_mm: Limits::amber_red(3.0, 10.0),
            bias_excess_mm: Limits::amber_red(2.0, 15.0),
            outline_mm: Limits::amber(1.0),
            elsewhere_mm: Limits::amber(0.8),
            unstated_uncertainty_mm: 10.0,
            openings_closed: Limits::amber(2000.0),
            dropped_pieces: Limits::amber(100.0),
            components: Limits::amber(1.0),
            handles: Limits::amber(4.0),
            handles_of_depth: Limits::amber(0.0),
            unpainted: Limits::amber(0.45),
        }
    }
}

impl Serialize for Parameters {
    fn serialize<S: Serializer>(&self, into: S) -> Result<S::Ok, S::Error> {
        Self::serialize(self, into)
    }
}

/// What is derived reads the fields; here are seen the limits that are not given, and those that contradict each other.
impl<'de> Deserialize<'de> for Parameters {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let mut read = Self::deserialize(from)?;
        let mut defaults = Self::default();
        for ((name, limits), (_, default)) in read.limits().into_iter().zip(defaults.limits()) {
            limits.complete(default);
            let Limits { amber, red } = *limits;
            if let Some(red) = red.filter(|red| *red < amber && amber.is_finite()) {
                return Err(D::Error::custom(format!(
                    "{name}.amber is {amber} and {name}.red is {red}, expected an amber limit that is not above the red \
                     one: give both"
                )));
            }
        }
        Ok(read)
    }
}

impl Parameters {
    /// All pairs of limits, with their names.
    fn limits(&mut self) -> [(&'static str, &mut Limits); 27] {
        [
            ("displaced", &mut self.displaced),
            ("uncovered", &mut self.uncovered),
            ("frame_cut", &mut self.frame_cut),
            ("volume_cut", &mut self.volume_cut),
            ("overexposed", &mut self.overexposed),
            ("underexposed", &mut self.underexposed),
            ("blur_px", &mut self.blur_px),
            ("backdrop_changed", &mut self.backdrop_changed),
            ("told_by_outline", &mut self.told_by_outline),
            ("background_age_h", &mut self.background_age_h),
            ("skew_ms", &mut self.skew_ms),
            ("lid_unread", &mut self.lid_unread),
            ("unobserved", &mut self.unobserved),
            ("region_unread", &mut self.region_unread),
            ("bridged", &mut self.bridged),
            ("expected_mm", &mut self.expected_mm),
            ("region_share", &mut self.region_share),
            ("disagreement_mm", &mut self.disagreement_mm),
            ("bias_excess_mm", &mut self.bias_excess_mm),
            ("outline_mm", &mut self.outline_mm),
            ("elsewhere_mm", &mut self.elsewhere_mm),
            ("openings_closed", &mut self.openings_closed),
            ("dropped_pieces", &mut self.dropped_pieces),
            ("components", &mut self.components),
            ("handles", &mut self.handles),
            ("handles_of_depth", &mut self.handles_of_depth),
            ("unpainted", &mut self.unpainted),
        ]
    }

    /// The level of what only silhouettes show: a note where they are all that is wanted.
    pub(super) fn unless_hull_is_wanted(&self, level: Level) -> Level {
        if self.hull_is_wanted {
            Level::Green
        } else {
            level
        }
    }
}

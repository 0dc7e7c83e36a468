//! What a calibration is worth, and why it is worth no more. Data that its file holds; it is judged in `fit`.

/// What a calibration is worth.
#[derive(
    serde::Serialize, serde::Deserialize, Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord,
)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// Nothing is amiss.
    Good,
    /// Good enough to work with.
    Accepted,
    /// To be used if there is no other.
    Doubtful,
    /// Not to be used.
    Refused,
}

impl Level {
    /// Its word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Accepted => "accepted",
            Self::Doubtful => "doubtful",
            Self::Refused => "refused",
        }
    }
}

/// A level with its reasons.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// What the calibration is worth.
    pub level: Level,
    /// Why it is not good.
    pub reasons: Vec<String>,
}

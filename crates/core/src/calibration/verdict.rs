//! The verdict of a calibration and its reasons, as the calibration's file and recordings have them. `fit` decides it.

use super::Error;
use std::collections::BTreeMap;

/// What a calibration is worth.
#[derive(
    serde::Serialize, serde::Deserialize, Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord,
)]
#[serde(rename_all = "lowercase")]
pub enum CalibrationLevel {
    /// Nothing is amiss.
    Good,
    /// Good enough to work with.
    Accepted,
    /// Use it only if there is no better one.
    Doubtful,
    /// Not to be used.
    Refused,
}

impl CalibrationLevel {
    /// All of them, the best first.
    const ALL: [Self; 4] = [Self::Good, Self::Accepted, Self::Doubtful, Self::Refused];

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
#[derive(serde::Serialize, Clone, Debug, PartialEq)]
pub struct CalibrationVerdict {
    /// What the calibration is worth.
    pub level: CalibrationLevel,
    /// Why it is not good.
    pub reasons: Vec<String>,
}

/// What a recording says of the calibration that it carries: its metadata record `calibration`.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationRecord {
    /// What the calibration is worth.
    pub verdict: CalibrationVerdict,
    /// SHA-256 of the calibration's file, as `sha256sum` prints it; `None` where the recording does not say it.
    pub file_sha256: Option<String>,
}

impl CalibrationRecord {
    /// The pairs of the metadata record: `verdict`, `reasons` (a line each) and `file_sha256`.
    pub fn pairs(&self) -> BTreeMap<String, String> {
        let one_line = |reason: &String| reason.split_whitespace().collect::<Vec<_>>().join(" ");
        let reasons: Vec<String> = self.verdict.reasons.iter().map(one_line).collect();
        let mut pairs = BTreeMap::from([
            ("verdict".to_owned(), self.verdict.level.name().to_owned()),
            ("reasons".to_owned(), reasons.join("\n")),
        ]);
        if let Some(sha256) = &self.file_sha256 {
            pairs.insert("file_sha256".to_owned(), sha256.clone());
        }
        pairs
    }

    /// Reads the pairs of the metadata record; `None` if they have no verdict. Pairs that it does not know are ignored.
    ///
    /// # Errors
    /// If the verdict is not one that a calibration can have.
    pub fn from_pairs(pairs: &BTreeMap<String, String>) -> Result<Option<Self>, Error> {
        let Some(verdict) = pairs.get("verdict").map(|v| v.trim()) else {
            return Ok(None);
        };
        let level = CalibrationLevel::ALL
            .into_iter()
            .find(|l| l.name() == verdict);
        let level = level.ok_or_else(|| Error::BadValue {
            what: "verdict",
            found: format!("{:?}", verdict.chars().take(40).collect::<String>()),
            expected: "good, accepted, doubtful or refused",
        })?;
        let lines = pairs.get("reasons").map_or("", String::as_str).lines();
        let reasons = lines.map(str::trim).filter(|line| !line.is_empty());
        Ok(Some(Self {
            verdict: CalibrationVerdict {
                level,
                reasons: reasons.map(str::to_owned).collect(),
            },
            file_sha256: pairs.get("file_sha256").cloned(),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_recording_says_of_its_calibration_is_read_back() {
        let record = CalibrationRecord {
            verdict: CalibrationVerdict {
                level: CalibrationLevel::Doubtful,
                reasons: vec!["camera c02 moved by 0.70°".into(), "two\nlines".into()],
            },
            file_sha256: Some("ab12".into()),
        };
        let read = CalibrationRecord::from_pairs(&record.pairs())
            .unwrap()
            .unwrap();
        assert_eq!(
            read.verdict.reasons,
            ["camera c02 moved by 0.70°", "two lines"]
        );
        assert_eq!(
            (read.verdict.level, read.file_sha256),
            (CalibrationLevel::Doubtful, record.file_sha256)
        );
        let unknown = BTreeMap::from([("file_sha256".to_owned(), "ab12".to_owned())]);
        assert_eq!(CalibrationRecord::from_pairs(&unknown), Ok(None));
        let fine = BTreeMap::from([("verdict".to_owned(), "fine".to_owned())]);
        let message = CalibrationRecord::from_pairs(&fine)
            .unwrap_err()
            .to_string();
        assert!(
            message.contains("\"fine\"") && message.contains("doubtful"),
            "{message}"
        );
    }
}

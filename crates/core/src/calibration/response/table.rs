//! Reads tables of measurements: a depth camera's readings of a target at distances that were measured by hand.

use super::ResponseError;
use crate::storage;
use std::path::Path;

/// A table, a measurement a distance.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DepthTable {
    /// Its rows.
    pub rows: Vec<Measurement>,
}

/// What a depth camera said at one distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measurement {
    /// True distance in metres.
    pub distance: f64,
    /// The reading there, in the sensor's own unit.
    pub depth: f64,
    /// The width that the target seemed to have, in any unit; NaN where the table has none.
    pub width: f64,
}

/// Longest table, in bytes.
const LONGEST: u64 = 1 << 20;
const COLUMNS: &str = "distance, depth and, if you like, width";

impl DepthTable {
    /// Reads a file of lines `distance, depth, width` (metres, raw readings, any unit; the width may be missing), with
    /// `#` before comments and, if you like, a line of headings first.
    ///
    /// # Errors
    /// If it cannot be read, or has a line of another form; the message names it.
    pub fn load(path: &Path) -> Result<Self, ResponseError> {
        let failed = |cause| ResponseError::Read {
            path: path.into(),
            cause,
        };
        Self::parse(&storage::read_text(path, LONGEST).map_err(failed)?, path)
    }

    fn parse(text: &str, path: &Path) -> Result<Self, ResponseError> {
        let mut rows = Vec::new();
        let mut is_first = true;
        for (k, line) in text.lines().enumerate() {
            let line = line.split('#').next().unwrap_or_default().trim();
            if line.is_empty() {
                continue;
            }
            let is_heading = is_first && line.starts_with(|c: char| c.is_ascii_alphabetic());
            is_first = false;
            if !is_heading {
                rows.push(row(line).map_err(|message| ResponseError::Table {
                    path: path.into(),
                    line: k + 1,
                    message,
                })?);
            }
        }
        let with_width = rows
            .iter()
            .filter(|r: &&Measurement| !r.width.is_nan())
            .count();
        if with_width != 0 && with_width != rows.len() {
            return Err(ResponseError::Table {
                path: path.into(),
                line: text.lines().count(),
                message: format!(
                    "{with_width} of {} rows have a width, expected all or none",
                    rows.len()
                ),
            });
        }
        Ok(Self { rows })
    }

    /// The columns distance, depth and width.
    pub(super) fn columns(&self) -> [Vec<f64>; 3] {
        let column = |pick: fn(&Measurement) -> f64| self.rows.iter().map(pick).collect();
        [
            column(|r| r.distance),
            column(|r| r.depth),
            column(|r| r.width),
        ]
    }
}

fn row(line: &str) -> Result<Measurement, String> {
    let parts = line
        .split([',', ';', '\t', ' '])
        .map(str::trim)
        .filter(|p| !p.is_empty());
    let parts: Vec<&str> = parts.collect();
    if !(2..=3).contains(&parts.len()) {
        let found = parts.len();
        return Err(format!(
            "the number of columns is {found}, expected {COLUMNS}"
        ));
    }
    let number = |k: usize, what: &str| {
        let Some(text) = parts.get(k) else {
            return Ok(f64::NAN);
        };
        let value = text
            .parse()
            .ok()
            .filter(|v: &f64| v.is_finite() && v.abs() < 1e6);
        value.ok_or_else(|| format!("{what} is {:.40?}, expected a number", text))
    };
    let measurement = Measurement {
        distance: number(0, "distance")?,
        depth: number(1, "depth")?,
        width: number(2, "width")?,
    };
    if measurement.distance <= 0.0 {
        return Err(format!(
            "distance is {} m, expected more than 0",
            measurement.distance
        ));
    }
    Ok(measurement)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<DepthTable, ResponseError> {
        DepthTable::parse(text, Path::new("table.csv"))
    }

    #[test]
    fn tables_are_read_with_and_without_headings_and_widths() {
        let table =
            parse("# the paper's\ndistance,depth,width\n0.9, 231, 152.67\n1.8\t208 76.8 # far\n\n")
                .unwrap();
        assert_eq!(table.rows.len(), 2);
        assert_eq!(table.rows[1].width, 76.8);
        let table = parse("0.9 900\n1.8 1800\n").unwrap();
        assert!(table.rows[0].width.is_nan());
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        for (text, named) in [
            ("0.9, 231\n1.8, x", "line 2: depth is \"x\""),
            (
                "0.9",
                "line 1: the number of columns is 1, expected distance",
            ),
            ("0.9, 1\n\n-1, 2", "line 3: distance is -1 m"),
            ("0.9, 1, 2\n1.8, 2", "1 of 2 rows have a width"),
            ("0.9, inf", "depth is \"inf\""),
        ] {
            let message = parse(text).unwrap_err().to_string();
            assert!(
                message.contains(named) && message.contains("table.csv"),
                "{message}"
            );
        }
    }
}

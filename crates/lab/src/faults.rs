//! What can go wrong from one capture of an object to the next, as options: something else is put on the table, a piece
//! breaks off, or something hides the object.

use super::Shape;
use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// A fault of one capture.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CaptureFault {
    /// The capture, from 0.
    pub capture: usize,
    /// How much, in the unit of the fault.
    pub amount: f64,
}

/// Something else on the table in one capture.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Exchange {
    /// The capture, from 0.
    pub capture: usize,
    /// The object that takes its place.
    pub with: OtherObject,
}

/// An object that takes the place of the simulated one.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(try_from = "String", into = "String")]
pub enum OtherObject {
    /// An object of another shape.
    Shape(Shape),
    /// A copy that is larger by this many per cent.
    Bigger(f64),
    /// A copy that is taller by this many per cent.
    Taller(f64),
    /// A mug whose handle is this many millimetres higher.
    HandleUp(f64),
}

impl fmt::Display for OtherObject {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Shape(shape) => match shape.to_possible_value() {
                Some(value) => write!(f, "{}", value.get_name()),
                None => write!(f, "{shape:?}"),
            },
            Self::Bigger(percent) => write!(f, "bigger:{percent}"),
            Self::Taller(percent) => write!(f, "taller:{percent}"),
            Self::HandleUp(mm) => write!(f, "handle-up:{mm}"),
        }
    }
}

impl FromStr for OtherObject {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let Some((word, amount)) = text.split_once(':') else {
            let shape = Shape::from_str(text, false);
            return shape.map(Self::Shape).map_err(|_| unknown(text));
        };
        let amount: f64 = amount.parse().map_err(|_| unknown(text))?;
        let within = |range: f64| match amount.abs() <= range {
            true => Ok(amount),
            false => Err(format!(
                "{amount} in {text:?} is not from -{range} to {range}"
            )),
        };
        match word {
            "bigger" => Ok(Self::Bigger(within(20.0)?)),
            "taller" => Ok(Self::Taller(within(20.0)?)),
            "handle-up" => Ok(Self::HandleUp(within(5.0)?)),
            _ => Err(unknown(text)),
        }
    }
}

fn unknown(text: &str) -> String {
    format!("{text:?} is neither a shape nor bigger:PERCENT, taller:PERCENT or handle-up:MM")
}

impl TryFrom<String> for OtherObject {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<OtherObject> for String {
    fn from(other: OtherObject) -> Self {
        other.to_string()
    }
}

impl CaptureFault {
    /// The amount of the fault of capture `index`.
    pub(super) fn of(list: &[Self], index: usize) -> Option<f64> {
        let found = list.iter().find(|fault| fault.capture == index);
        found.map(|fault| fault.amount)
    }

    /// The amount of the latest fault up to capture `index`: what broke stays broken.
    pub(super) fn up_to(list: &[Self], index: usize) -> Option<f64> {
        let before = list.iter().filter(|fault| fault.capture <= index);
        before
            .max_by_key(|fault| fault.capture)
            .map(|fault| fault.amount)
    }
}

//! The options of a simulated calibration session, in addition to those of its rig and sensors.

use scand_core::calibration::BoardShape;
use serde::{Deserialize, Serialize};

/// A board, how often it is shown, and what goes wrong.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct BoardOptions {
    /// The board that is shown, as [`scand_core::calibration::Board`] reads it. Default `checkerboard:9x6:25mm`.
    pub board: String,
    /// The board that the recording names, if it is another one.
    pub declared: Option<String>,
    /// Placements, the first of which lies flat on the table. Default 20.
    pub placements: usize,
    /// Millimetres that the print on the back is off its place, about. Default 1.
    pub misprint_mm: f64,
    /// Millimetres that the edges of the squares lie off the middle of the board: along the rows, and down the columns.
    /// Default 0, 0: a flat board.
    #[serde(skip_serializing_if = "is_zero")]
    pub bend_mm: [f64; 2],
    /// Per cent by which squares are longer along the rows than their mean, and shorter down the columns. Default 0.
    #[serde(skip_serializing_if = "is_zero")]
    pub stretch_percent: f64,
    /// What goes wrong.
    pub faults: BoardFaults,
}

/// Whether an option is left as it is: the recording of a flat board does not speak of bends.
fn is_zero<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

impl BoardOptions {
    /// The shape of the board's sheet.
    pub fn shape(&self) -> BoardShape {
        BoardShape {
            bend: self.bend_mm.map(|mm| 1e-3 * mm),
            stretch: 1e-2 * self.stretch_percent,
        }
    }
}

impl Default for BoardOptions {
    fn default() -> Self {
        Self {
            board: "checkerboard:9x6:25mm".to_owned(),
            declared: None,
            placements: 20,
            misprint_mm: 1.0,
            bend_mm: [0.0; 2],
            stretch_percent: 0.0,
            faults: BoardFaults::default(),
        }
    }
}

/// A fault of one placement.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct PlacementFault {
    /// Which, counted from 0.
    pub placement: usize,
    /// How much, in the unit of the fault.
    pub amount: f64,
}

/// What goes wrong in a calibration session; placements count from 0.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct BoardFaults {
    /// Placements during which the board moves by so many millimetres from the first camera's picture to the last
    /// one's.
    pub moved_mm: Vec<PlacementFault>,
    /// Placements out of focus, or shaken, by a point spread of so many more pixels.
    pub blurred_px: Vec<PlacementFault>,
    /// Placements at which the board lies where it lay at the one before.
    pub duplicate: Vec<usize>,
    /// Placements at which the board is turned by 180 degrees in its plane.
    pub turned_over: Vec<usize>,
    /// Cameras that never see the board.
    pub blind: Vec<String>,
}

impl BoardFaults {
    /// The amount of a fault that a placement has, 0 without.
    pub(super) fn amount(list: &[PlacementFault], placement: usize) -> f64 {
        let mut found = list.iter().filter(|fault| fault.placement == placement);
        found.next().map_or(0.0, |fault| fault.amount)
    }

    /// Every placement that a fault names.
    pub(super) fn placements(&self) -> impl Iterator<Item = usize> {
        let with_amount = self.moved_mm.iter().chain(&self.blurred_px);
        let without = self.duplicate.iter().chain(&self.turned_over);
        with_amount
            .map(|fault| fault.placement)
            .chain(without.copied())
    }
}

//! Finds whether boards whose readings contradict all others agree with each other. If consecutive ones do, no board
//! moved: the depth camera's readings changed during the session.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use std::ops::Range;

/// What a board's readings are off by, as the response to the boards that were kept turns them into depth.
#[derive(Clone, Copy, Debug)]
pub(super) struct BoardError<'a> {
    pub placement: &'a str,
    /// Mean distance in metres.
    pub distance: f64,
    /// Measured less true depth over the squared distance: what it would be at 1 m, in metres.
    pub at_1m: f64,
    pub is_left_out: bool,
}

/// Readings that are others from some placement on, or between two.
#[derive(serde::Serialize, Clone, Debug, PartialEq)]
pub struct ReadingChange {
    /// The last placement before the change, and the first one after it.
    pub between: [String; 2],
    /// The same for the change back, if there was one.
    pub back: Option<[String; 2]>,
    /// By how much deeper the camera read after the first of these changes.
    pub deeper: Deeper,
}

/// By how much deeper a camera reads; negative where it reads nearer.
#[derive(serde::Serialize, Clone, Copy, Debug, PartialEq)]
#[serde(rename_all = "snake_case")]
pub enum Deeper {
    /// By this share of each distance.
    Share(f64),
    /// By this many metres at each distance.
    Metres(f64),
    /// By an amount that depends on the distance otherwise; the mean is this many metres.
    OnAverage(f64),
}

/// Fewest boards that tell a change from boards that moved, and those that two terms are fitted to.
const FEWEST: usize = 3;
const FEWEST_FOR_LINE: usize = 4;
/// Part of the boards' errors that the change may leave.
const LEAVES: f64 = 0.3;
/// What keeps equations solvable that boards at one distance leave open; their other terms are about 1.
const RIDGE: f64 = 1e-9;

impl ReadingChange {
    /// Looks for it among the boards in their order; `limit` is by how many metres at 1 m a board may be off.
    pub(super) fn of(boards: &[BoardError<'_>], limit: f64) -> Option<Self> {
        let first = boards.iter().position(|b| b.is_left_out)?;
        let last = boards.iter().rposition(|b| b.is_left_out)?;
        let changed = &boards[first..=last];
        let is_run = changed.iter().all(|b| b.is_left_out);
        if !is_run || changed.len() < FEWEST || changed.len() == boards.len() {
            return None;
        }
        let deeper = Deeper::of(changed, limit)?;
        let names = |k: usize| [k - 1, k].map(|k| boards[k].placement.to_owned());
        let after = (last + 1 < boards.len()).then(|| names(last + 1));
        Some(match (first, after) {
            (0, Some(after)) => Self {
                between: after,
                back: None,
                deeper: deeper.reversed(),
            },
            (first, back) => Self {
                between: names(first),
                back,
                deeper,
            },
        })
    }

    /// What changed, in words.
    pub fn words(&self) -> String {
        let [before, after] = &self.between;
        let back = match &self.back {
            Some([before, after]) => format!(", and back between {before} and {after}"),
            None => String::new(),
        };
        format!(
            "its readings changed between {before} and {after} ({}){back}",
            self.deeper.words()
        )
    }
}

/// Looks for a change that leaves no majority: the boards before it or those after it, whichever are fewer, and of
/// equally many those before it. `least` is by how many metres at 1 m the readings must have changed, and by how many
/// a board may be off beside the change.
pub(super) fn smaller_part(boards: &[BoardError<'_>], least: f64) -> Option<Range<usize>> {
    let squares = |left: &[f64]| left.iter().map(|error| error * error).sum::<f64>();
    let count = boards.len();
    let whole = squares(&Step::of(boards, count, false)?.left);
    let splits = FEWEST..(count + 1).saturating_sub(FEWEST);
    let steps = splits.flat_map(|at| [(at, false), (at, true)]);
    let steps = steps.filter_map(|(at, grows)| Some((at, Step::of(boards, at, grows)?)));
    let (at, step) =
        steps.min_by(|(_, a), (_, b)| squares(&a.left).total_cmp(&squares(&b.left)))?;
    let is_change = step.changed.abs() > least
        && step.left.iter().all(|error| error.abs() <= least)
        && squares(&step.left) <= LEAVES.powi(2) * whole;
    is_change.then(|| if 2 * at <= count { 0..at } else { at..count })
}

/// What explains errors best that a line in the distance has together with one change.
struct Step {
    /// By how many metres at 1 m the readings change.
    changed: f64,
    /// What is left of each board's error at 1 m.
    left: Vec<f64>,
}

impl Step {
    /// With the change before the board of this index; without one if there is no such board. It grows with the
    /// distance, or is the same at each.
    fn of(boards: &[BoardError<'_>], at: usize, grows: bool) -> Option<Self> {
        let row = |(k, board): (usize, &BoardError<'_>)| {
            let changed = match (k < at, grows) {
                (true, _) => 0.0,
                (false, true) => board.distance,
                (false, false) => 1.0,
            };
            Vector3::new(board.distance, 1.0, changed) / board.distance.powi(2)
        };
        let rows: Vec<Vector3<f64>> = boards.iter().enumerate().map(row).collect();
        let (mut matrix, mut right) = (Matrix3::from_diagonal_element(RIDGE), Vector3::zeros());
        for (row, board) in rows.iter().zip(boards) {
            matrix += row * row.transpose();
            right += row * board.at_1m;
        }
        let found = matrix.cholesky()?.solve(&right);
        let left = |(row, board): (&Vector3<f64>, &BoardError<'_>)| board.at_1m - row.dot(&found);
        Some(Self {
            changed: found.z,
            left: rows.iter().zip(boards).map(left).collect(),
        })
    }
}

impl Deeper {
    /// The simplest change that explains the errors of all these boards.
    fn of(boards: &[BoardError<'_>], limit: f64) -> Option<Self> {
        let squares = |of: &dyn Fn(&BoardError<'_>) -> f64| -> f64 {
            boards.iter().map(|b| of(b).powi(2)).sum()
        };
        let whole = squares(&|b| b.at_1m);
        // What is left at 1 m of each board's error, given how deep a change makes it.
        let explains = |deeper: &dyn Fn(f64) -> f64| {
            let left = |b: &BoardError<'_>| b.at_1m - deeper(b.distance) / b.distance.powi(2);
            let is_small = boards.iter().all(|b| left(b).abs() <= limit);
            (is_small && squares(&left) <= LEAVES.powi(2) * whole).then(|| squares(&left))
        };
        let slope = least_squares(boards, |z| z);
        let offset = least_squares(boards, |_| 1.0);
        let by_slope = explains(&|z| slope * z);
        let by_offset = explains(&|_| offset);
        let line = line(boards).filter(|_| boards.len() >= FEWEST_FOR_LINE);
        match (by_slope, by_offset) {
            (Some(a), Some(b)) if b < a => Some(Self::Metres(offset)),
            (Some(_), _) => Some(Self::Share(slope)),
            (None, Some(_)) => Some(Self::Metres(offset)),
            (None, None) => {
                let [slope, offset] = line?;
                explains(&|z| slope * z + offset)?;
                let sum: f64 = boards.iter().map(|b| b.distance).sum();
                Some(Self::OnAverage(slope * sum / boards.len() as f64 + offset))
            }
        }
    }

    fn reversed(self) -> Self {
        match self {
            Self::Share(share) => Self::Share(-share),
            Self::Metres(metres) => Self::Metres(-metres),
            Self::OnAverage(metres) => Self::OnAverage(-metres),
        }
    }

    fn words(self) -> String {
        let side = |value: f64| if value > 0.0 { "deeper" } else { "nearer" };
        match self {
            Self::Share(share) => format!("{:.1} % {}", 100.0 * share.abs(), side(share)),
            Self::Metres(metres) => format!("{:.1} mm {}", 1e3 * metres.abs(), side(metres)),
            Self::OnAverage(metres) => {
                let found = 1e3 * metres.abs();
                format!("{found:.1} mm {} on average", side(metres))
            }
        }
    }
}

/// How often an error that grows with the distance as `term` does fits into the boards' errors; each counts as at 1 m.
fn least_squares(boards: &[BoardError<'_>], term: impl Fn(f64) -> f64) -> f64 {
    let (mut products, mut squares) = (0.0, 0.0);
    for board in boards {
        let at_1m = term(board.distance) / board.distance.powi(2);
        products += at_1m * board.at_1m;
        squares += at_1m * at_1m;
    }
    products / f64::max(squares, 1e-300)
}

/// Slope and offset in the distance that explain the errors best; `None` for boards at one distance.
fn line(boards: &[BoardError<'_>]) -> Option<[f64; 2]> {
    let (mut matrix, mut right) = (Matrix2::zeros(), Vector2::zeros());
    for board in boards {
        let row = Vector2::new(board.distance, 1.0) / board.distance.powi(2);
        matrix += row * row.transpose();
        right += row * board.at_1m;
    }
    let found = matrix.cholesky()?.solve(&right);
    Some([found.x, found.y])
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAMES: [&str; 9] = ["p0", "p1", "p2", "p3", "p4", "p5", "p6", "p7", "p8"];

    /// Boards from 0.7 to 1.3 m, here and there; those that are off were left out.
    fn boards(off: impl Fn(usize, f64) -> f64) -> Vec<BoardError<'static>> {
        let board = |(k, placement): (usize, &&'static str)| {
            let distance = 0.7 + 0.075 * ((k * 5) % 9) as f64;
            let off = off(k, distance);
            BoardError {
                placement,
                distance,
                at_1m: off / distance.powi(2) + 2e-4 * (k as f64 - 4.0) / 4.0,
                is_left_out: off != 0.0,
            }
        };
        NAMES.iter().enumerate().map(board).collect()
    }

    fn words(off: impl Fn(usize, f64) -> f64) -> Option<String> {
        ReadingChange::of(&boards(off), 4e-3).map(|change| change.words())
    }

    #[test]
    fn boards_that_agree_with_each_other_tell_when_the_readings_changed() {
        let told = words(|k, z| if k >= 5 { 0.03 * z } else { 0.0 }).unwrap();
        assert_eq!(
            told,
            "its readings changed between p4 and p5 (3.0 % deeper)"
        );
        let told = words(|k, _| if k < 3 { 0.012 } else { 0.0 }).unwrap();
        assert!(
            told.starts_with("its readings changed between p2 and p3 (1"),
            "{told}"
        );
        assert!(told.ends_with(" mm nearer)"), "{told}");
        let told = words(|k, z| if (3..6).contains(&k) { -0.02 * z } else { 0.0 }).unwrap();
        assert!(
            told.contains("between p2 and p3 (2.0 % nearer), and back between p5 and p6"),
            "{told}"
        );
        let told = words(|k, z| if k >= 4 { 0.1 * (z - 0.84) } else { 0.0 }).unwrap();
        assert!(told.contains("deeper on average"), "{told}");
    }

    #[test]
    fn boards_that_moved_are_not_taken_for_a_change() {
        let shifts = [0.0, 0.0, 0.0, 0.0, 0.0, 0.012, -0.02, 0.03, 0.008];
        assert_eq!(words(|k, _| shifts[k]), None);
        // Not one after the other.
        assert_eq!(words(|k, z| if k % 2 == 1 { 0.03 * z } else { 0.0 }), None);
        // Two may have moved alike.
        assert_eq!(words(|k, z| if k >= 7 { 0.03 * z } else { 0.0 }), None);
        assert_eq!(words(|_, _| 0.0), None);
    }
    #[test]
    fn of_a_change_that_leaves_no_majority_the_fewer_boards_are_found() {
        let found = |off: &dyn Fn(usize, f64) -> f64| smaller_part(&boards(off), 4e-3);
        let after = found(&|k, z| if k >= 5 { 0.03 * z } else { 0.0 });
        assert_eq!(after, Some(5..9));
        let before = found(&|k, _| if k < 4 { 0.012 } else { 0.0 });
        assert_eq!(before, Some(0..4));
        let little = found(&|k, _| if k >= 5 { 0.003 } else { 0.0 });
        assert_eq!(little, None);
        let shifts = [0.0, 0.0, 0.0, 0.0, 0.0, 0.012, -0.02, 0.03, 0.008];
        assert_eq!(found(&|k, _| shifts[k]), None);
        // The response is not linear, and that is no change.
        assert_eq!(found(&|_, z| 0.1 * (z - 1.0).powi(2)), None);
        // Too few on either side.
        let few = boards(|k, _| if k >= 3 { 0.02 } else { 0.0 });
        assert_eq!(smaller_part(&few[..5], 4e-3), None);
    }
}

//! Which boards agree: leaves out those that contradict the others, and says what these have in common.

use super::lateral::Lateral;
use super::plane_view::PlaneParameters;
use super::reading_change::{BoardError, ReadingChange, smaller_part};
use super::samples::{Plane, Sample, Values};
use super::solve::solve;
use super::{ResponseError, too_little};
use crate::statistics::upper_median;
use std::ops::Range;

/// A view is left out if it is off by more than this many deviations, and by this many metres at 1 m.
const VIEW_DEVIATIONS: f64 = 6.0;
const VIEW_OFF: f64 = 0.004;

/// A view that contradicts all others.
pub(super) struct Contradiction<'a> {
    /// Its place among the views with readings.
    order: usize,
    plane: Plane<'a>,
    /// Metres at 1 m by which it was off.
    off: f64,
}

impl Contradiction<'_> {
    /// The placement, and why it was left out: the readings changed, or perhaps the board moved.
    pub(super) fn told(&self, is_change: bool) -> (String, String) {
        let off = 1e3 * self.off;
        let reason = match is_change {
            true => format!(
                "its depth is {off:.1} mm off, like that of its neighbours: the readings changed"
            ),
            false => format!(
                "its depth is {off:.1} mm off what all other boards say: did the board move?"
            ),
        };
        (self.plane.placement.to_owned(), reason)
    }
}

/// Views that agree, and those that were left out so that they do.
pub(super) struct Consistent<'a> {
    pub planes: Vec<Plane<'a>>,
    /// The place of each among the views with readings.
    order: Vec<usize>,
    pub left_out: Vec<Contradiction<'a>>,
    /// What fits the views that agree, with all of the lateral scale.
    pub line: Values,
}

impl<'a> Consistent<'a> {
    /// Leaves out views that contradict the others, the worst first; if none does, the fewer ones of those before and
    /// after a change of the readings.
    ///
    /// # Errors
    /// If fewer than `min_views` are left: with what is amiss with the others.
    pub(super) fn of(
        planes: Vec<Plane<'a>>,
        unread: &[(String, String)],
        parameters: &PlaneParameters,
    ) -> Result<Self, ResponseError> {
        let (mut order, mut planes): (Vec<usize>, Vec<Plane<'a>>) =
            planes.into_iter().enumerate().unzip();
        let mut left_out: Vec<Contradiction<'a>> = Vec::new();
        loop {
            if planes.len() < parameters.min_views.max(1) {
                return too_few(&planes, unread, &left_out, parameters);
            }
            let line = solve(&planes, Lateral::Line, parameters);
            if let Some((k, off)) = worst(&planes, &line) {
                left_out.push(Contradiction {
                    order: order.remove(k),
                    plane: planes.remove(k),
                    off,
                });
                continue;
            }
            // No response fits most boards if the readings of half of them are others.
            let part = match left_out.is_empty() {
                true => changed_part(&planes, parameters),
                false => None,
            };
            let Some(part) = part else {
                return Ok(Self {
                    planes,
                    order,
                    left_out,
                    line,
                });
            };
            let orders = order.drain(part.clone());
            let changed: Vec<(usize, Plane<'a>)> = orders.zip(planes.drain(part)).collect();
            let line = solve(&planes, Lateral::Line, parameters);
            let contradictions = changed.into_iter().map(|(order, plane)| Contradiction {
                off: view_error(&plane, &line),
                order,
                plane,
            });
            left_out.extend(contradictions);
        }
    }

    /// What the views that were left out agree on, compared with the response to the others.
    pub(super) fn change(&self, values: &Values) -> Option<ReadingChange> {
        let kept = self.order.iter().zip(&self.planes);
        let kept = kept.map(|(order, plane)| (*order, plane, false));
        let others = self.left_out.iter().map(|c| (c.order, &c.plane, true));
        let mut all: Vec<(usize, &Plane<'a>, bool)> = kept.chain(others).collect();
        all.sort_by_key(|(order, _, _)| *order);
        let boards = all
            .iter()
            .map(|(_, plane, is_left_out)| board_error(plane, values, *is_left_out));
        let boards: Vec<BoardError<'_>> = boards.collect();
        ReadingChange::of(&boards, most_off(&self.planes, values)?)
    }
}

/// Says why no response can be fitted.
fn too_few<T>(
    planes: &[Plane<'_>],
    unread: &[(String, String)],
    left_out: &[Contradiction<'_>],
    parameters: &PlaneParameters,
) -> Result<T, ResponseError> {
    let told = left_out.iter().map(|c| c.told(false));
    let reasons = unread.iter().cloned().chain(told);
    let reasons = reasons.map(|(name, reason)| format!("; {name}: {reason}"));
    let found = format!(
        "{} usable views{}",
        planes.len(),
        reasons.collect::<String>()
    );
    let expected = format!(
        "{} or more of the board by the depth camera, near and far",
        parameters.min_views
    );
    too_little(found, expected)
}

/// Median of a view's errors over z².
fn view_error(plane: &Plane<'_>, values: &Values) -> f64 {
    let error = |s: &Sample| plane.error(s, values) / plane.depth(s, 1.0).powi(2);
    let mut errors: Vec<f64> = plane.samples.iter().map(error).collect();
    upper_median(&mut errors).unwrap_or(0.0)
}

/// What a view's readings are off by as a whole.
fn board_error<'a>(plane: &Plane<'a>, values: &Values, is_left_out: bool) -> BoardError<'a> {
    BoardError {
        placement: plane.placement,
        distance: plane.distance(),
        at_1m: view_error(plane, values),
        is_left_out,
    }
}

/// The views before or after a change of the readings, whichever are fewer, if there is such a change.
fn changed_part(planes: &[Plane<'_>], parameters: &PlaneParameters) -> Option<Range<usize>> {
    // A lateral scale would take a part of the change, and leave of it what no line and step explain.
    let line = solve(planes, Lateral::One, parameters);
    let boards = planes.iter().map(|plane| board_error(plane, &line, false));
    let boards: Vec<BoardError<'_>> = boards.collect();
    smaller_part(&boards, VIEW_OFF)
}

/// The view that disagrees with all others, if there is one, and by how much at 1 m.
fn worst(planes: &[Plane<'_>], values: &Values) -> Option<(usize, f64)> {
    if planes.len() < 5 {
        return None;
    }
    let limit = most_off(planes, values)?;
    let errors: Vec<f64> = planes.iter().map(|p| view_error(p, values)).collect();
    let (k, &error) = errors
        .iter()
        .enumerate()
        .max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
    (error.abs() > limit).then_some((k, error))
}

/// By how many metres at 1 m a view may be off what all others say; `None` without views.
fn most_off(planes: &[Plane<'_>], values: &Values) -> Option<f64> {
    let sizes = planes.iter().map(|p| view_error(p, values).abs());
    let mut sizes: Vec<f64> = sizes.collect();
    Some((VIEW_DEVIATIONS * 1.4826 * upper_median(&mut sizes)?).max(VIEW_OFF))
}

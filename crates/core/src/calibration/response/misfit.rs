//! Finds why readings do not fit a line in the distance: each cause leaves a pattern of its own on boards with
//! different tilts. The most likely cause is the one whose pattern best predicts boards to which it was not fitted.

use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;

/// A cause of depth that does not fit.
#[derive(serde::Serialize, Clone, Copy, Debug, PartialEq)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// The depth is displaced against the colour picture by this many pixels in x and y.
    Misregistered([f64; 2]),
    /// The picture's corners read this many metres deeper than its centre, at 1 m.
    Bowl(f64),
    /// Readings are not linear in the distance: they leave the line by at most this many metres where boards were.
    Curve(f64),
}

/// What boards leave that a line was fitted to, and what would explain it.
#[derive(serde::Serialize, Clone, Debug, PartialEq)]
pub struct Misfit {
    /// Root mean square error of boards that were held out, at 1 m, in metres.
    pub held_out: f64,
    /// The same with the most likely cause.
    pub explained: f64,
    /// The most likely cause first, then those that would do nearly as well.
    pub causes: Vec<Cause>,
    /// The part of the session that has the cause, if not all of it has.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub part: Option<SessionPart>,
}

/// A part of a session.
#[derive(serde::Serialize, Clone, Debug, PartialEq)]
#[serde(rename_all = "snake_case")]
pub enum SessionPart {
    /// From this placement on.
    From(String),
    /// Until this placement.
    Until(String),
}

impl Misfit {
    /// The causes in words.
    pub fn words(&self) -> String {
        let words: Vec<String> = self.causes.iter().map(Cause::words).collect();
        let part = match &self.part {
            None => String::new(),
            Some(SessionPart::From(placement)) => format!(" from {placement} on"),
            Some(SessionPart::Until(placement)) => format!(" until {placement}"),
        };
        let rest = 100.0 * (1.0 - self.explained / self.held_out);
        format!(
            "{}{part} would explain {rest:.0} % of what is left",
            words.join(", or ")
        )
    }
}

impl Cause {
    fn words(&self) -> String {
        match self {
            Self::Misregistered([x, y]) => format!(
                "depth that is displaced against its colour picture by {x:+.1} px in x and {y:+.1} px in y"
            ),
            Self::Bowl(metres) => format!(
                "an error that grows from the picture's middle to its corners, which are {:.1} mm {} at 1 m",
                1e3 * metres.abs(),
                if *metres > 0.0 { "deeper" } else { "nearer" }
            ),
            Self::Curve(metres) => format!(
                "a response that is not linear in the distance, by {:.1} mm from a line",
                1e3 * metres
            ),
        }
    }
}

/// Some neighbouring pixels of a board: what they are off, and what a cause would make of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patch {
    /// True depth in metres.
    pub depth: f64,
    /// Measured less true depth in metres.
    pub error: f64,
    /// By how much the true depth grows a pixel, in x and in y.
    pub gradient: [f64; 2],
    /// Squared distance from the picture's middle, 1 at its corner.
    pub radius_squared: f64,
}

/// Side in pixels of patches, and pixels that make one.
const SIDE: f64 = 16.0;
const FEWEST: usize = 64;

/// Means over patches of the picture; each pixel with its patch.
pub(super) fn patches(pixels: impl Iterator<Item = ([f64; 2], Patch)>) -> Vec<Patch> {
    let mut sums: BTreeMap<[usize; 2], (usize, Patch)> = BTreeMap::new();
    for (pixel, own) in pixels {
        let key = pixel.map(|v| (v / SIDE).max(0.0) as usize);
        let entry = sums.entry(key).or_insert((0, Patch::zero()));
        entry.0 += 1;
        entry.1.add(&own);
    }
    let full = sums.into_values().filter(|(count, _)| *count >= FEWEST);
    full.map(|(count, sum)| sum.over(count as f64)).collect()
}

impl Patch {
    fn zero() -> Self {
        Self {
            depth: 0.0,
            error: 0.0,
            gradient: [0.0; 2],
            radius_squared: 0.0,
        }
    }

    fn add(&mut self, other: &Self) {
        self.depth += other.depth;
        self.error += other.error;
        self.gradient = [0, 1].map(|k| self.gradient[k] + other.gradient[k]);
        self.radius_squared += other.radius_squared;
    }

    fn over(self, count: f64) -> Self {
        Self {
            depth: self.depth / count,
            error: self.error / count,
            gradient: self.gradient.map(|g| g / count),
            radius_squared: self.radius_squared / count,
        }
    }
}

/// Least error of boards held out, at 1 m, that is looked into, and the part of it that a cause must leave at most.
const LEAST_ERROR: f64 = 0.4e-3;
const EXPLAINS: f64 = 0.7;
/// Another cause is named too if it leaves at most this many times what the most likely one leaves.
const AS_WELL: f64 = 1.15;
/// Fewest boards that tell causes apart.
pub(super) const FEWEST_BOARDS: usize = 5;
/// Fewest boards on either side of where depth began or ceased to be displaced.
const FEWEST_IN_PART: usize = 3;
/// A displacement of a part of the session may leave at most this share of the error, and of what is left by a cause
/// that all boards have: of many places where it could have begun, one always fits somewhat better.
const PART_EXPLAINS: f64 = 0.5;

/// What a model adds to a line in the depth.
type Terms = fn(&Patch, f64) -> Vec<f64>;
/// The cause that coefficients of these terms mean.
type ToCause = fn(&[f64], &[&Vec<Patch>]) -> Cause;

fn line(_: &Patch, _: f64) -> Vec<f64> {
    Vec::new()
}

fn misregistered(patch: &Patch, _: f64) -> Vec<f64> {
    patch.gradient.to_vec()
}

fn bowl(patch: &Patch, _: f64) -> Vec<f64> {
    vec![patch.radius_squared * patch.depth.powi(2)]
}

fn curve(patch: &Patch, middle: f64) -> Vec<f64> {
    let z = patch.depth - middle;
    vec![z.powi(2), z.powi(3), z.powi(4)]
}

/// Looks for the cause of what a line leaves of these boards; `None` where little is left, or nothing explains it.
pub(super) fn explain(boards: &[Vec<Patch>]) -> Option<Misfit> {
    let boards: Vec<&Vec<Patch>> = boards.iter().filter(|b| !b.is_empty()).collect();
    if boards.len() < FEWEST_BOARDS {
        return None;
    }
    let held_out = held_out(&boards, line)?;
    if held_out < LEAST_ERROR {
        return None;
    }
    let models: [(Terms, ToCause); 3] = [
        (misregistered, |found, _| {
            Cause::Misregistered([found[0], found[1]])
        }),
        (bowl, |found, _| Cause::Bowl(found[0])),
        (curve, bend),
    ];
    let mut left: Vec<(f64, usize)> = Vec::new();
    for (index, (terms, _)) in models.iter().enumerate() {
        left.extend(self::held_out(&boards, *terms).map(|rms| (rms, index)));
    }
    left.sort_by(|a, b| a.0.total_cmp(&b.0));
    let explained = left.first()?.0;
    if explained > EXPLAINS * held_out {
        return None;
    }
    let likely = left.iter().filter(|(rms, _)| *rms <= AS_WELL * explained);
    let causes = likely.filter_map(|(_, index)| {
        let (terms, cause) = models[*index];
        Some(cause(&solved(&boards, None, terms)?[2..], &boards))
    });
    Some(Misfit {
        held_out,
        explained,
        causes: causes.collect(),
        part: None,
    })
}

/// Whether these boards would show depth that is displaced by this many pixels against its colour picture, in whichever
/// direction: whether that would leave more than `most` metres at 1 m on them, and be found. On boards that are seen
/// squarely it leaves nothing; on boards that all lie in one plane, an offset and a slope take it up.
pub(super) fn would_show_displacement(boards: &[Vec<Patch>], pixels: f64, most: f64) -> bool {
    const DIRECTIONS: usize = 4;
    (0..DIRECTIONS).all(|k| {
        let angle = std::f64::consts::PI * k as f64 / DIRECTIONS as f64;
        let displaced = displaced(boards, [pixels * angle.cos(), pixels * angle.sin()]);
        let displaced: Vec<&Vec<Patch>> = displaced.iter().filter(|b| !b.is_empty()).collect();
        let left = held_out(&displaced, line).unwrap_or(0.0);
        let explained = held_out(&displaced, misregistered).unwrap_or(f64::MAX);
        left > most && explained <= EXPLAINS * left
    })
}

/// The boards as if nothing were amiss but a displacement by so many pixels in x and y.
fn displaced(boards: &[Vec<Patch>], [x, y]: [f64; 2]) -> Vec<Vec<Patch>> {
    let own = |patch: &Patch| Patch {
        error: x * patch.gradient[0] + y * patch.gradient[1],
        ..*patch
    };
    let of_board = |board: &Vec<Patch>| board.iter().map(own).collect();
    boards.iter().map(of_board).collect()
}

/// Looks for the cause of what a line leaves of these boards, also for depth that is displaced in a part of the session
/// only, as after a driver began anew without registering it. The boards are in the order of their placements.
pub(super) fn explain_session(placements: &[&str], boards: &[Vec<Patch>]) -> Option<Misfit> {
    let whole = explain(boards);
    let most = whole
        .as_ref()
        .map_or(f64::MAX, |m| PART_EXPLAINS * m.explained);
    explain_part(placements, boards)
        .filter(|part| part.explained <= most)
        .or(whole)
}

/// Looks for depth that is displaced from one of these boards on, or until one.
fn explain_part(placements: &[&str], boards: &[Vec<Patch>]) -> Option<Misfit> {
    let named = placements.iter().copied().zip(boards);
    let (placements, boards): (Vec<&str>, Vec<&Vec<Patch>>) =
        named.filter(|(_, board)| !board.is_empty()).unzip();
    if boards.len() < 2 * FEWEST_IN_PART {
        return None;
    }
    let held_out = held_out(&boards, line)?;
    if held_out < LEAST_ERROR {
        return None;
    }
    let splits = FEWEST_IN_PART..=boards.len() - FEWEST_IN_PART;
    let parts = splits.flat_map(|at| [(at, true), (at, false)]);
    let tried = parts.filter_map(|(at, is_late)| {
        let part = displaced_in_part(&boards, at, is_late);
        let left = left(&part.iter().collect::<Vec<_>>(), misregistered)?;
        Some((left, part, at, is_late))
    });
    let (_, part, at, is_late) = tried.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let part: Vec<&Vec<Patch>> = part.iter().collect();
    let explained = self::held_out(&part, misregistered)?;
    if explained > PART_EXPLAINS * held_out {
        return None;
    }
    let found = solved(&part, None, misregistered)?;
    Some(Misfit {
        held_out,
        explained,
        causes: vec![Cause::Misregistered([found[2], found[3]])],
        part: Some(match is_late {
            true => SessionPart::From(placements[at].to_owned()),
            false => SessionPart::Until(placements[at - 1].to_owned()),
        }),
    })
}

/// The boards as a displacement would concern only those from this index on, or those before it.
fn displaced_in_part(boards: &[&Vec<Patch>], at: usize, is_late: bool) -> Vec<Vec<Patch>> {
    let of_board = |(index, board): (usize, &&Vec<Patch>)| {
        let is_displaced = (index >= at) == is_late;
        let own = |patch: &Patch| Patch {
            gradient: match is_displaced {
                true => patch.gradient,
                false => [0.0; 2],
            },
            ..*patch
        };
        board.iter().map(own).collect()
    };
    boards.iter().enumerate().map(of_board).collect()
}

/// How far the curve lies from the straight line that fits it best over the boards' distances.
fn bend(found: &[f64], boards: &[&Vec<Patch>]) -> Cause {
    let depths = boards.iter().flat_map(|b| b.iter().map(|p| p.depth));
    let (near, far) = depths.fold((f64::MAX, 0.0_f64), |(a, b), z| (a.min(z), b.max(z)));
    let middle = middle(boards);
    let at = |z: f64| {
        let z = z - middle;
        found[0] * z.powi(2) + found[1] * z.powi(3) + found[2] * z.powi(4)
    };
    const STEPS: usize = 20;
    let steps = (0..=STEPS).map(|k| near + (far - near) * k as f64 / STEPS as f64);
    let points: Vec<[f64; 2]> = steps.map(|z| [z, at(z)]).collect();
    let count = points.len() as f64;
    let mean = |a: usize| points.iter().map(|p| p[a]).sum::<f64>() / count;
    let (x, y) = (mean(0), mean(1));
    let slope = points.iter().map(|p| (p[0] - x) * (p[1] - y)).sum::<f64>()
        / points
            .iter()
            .map(|p| (p[0] - x).powi(2))
            .sum::<f64>()
            .max(1e-12);
    let off = points.iter().map(|p| (p[1] - y - slope * (p[0] - x)).abs());
    Cause::Curve(off.fold(0.0, f64::max))
}

/// Mean depth of all patches.
fn middle(boards: &[&Vec<Patch>]) -> f64 {
    let count: usize = boards.iter().map(|b| b.len()).sum();
    let sum: f64 = boards.iter().flat_map(|b| b.iter().map(|p| p.depth)).sum();
    sum / count.max(1) as f64
}

/// Root mean square error at 1 m of boards, each predicted from the others.
fn held_out(boards: &[&Vec<Patch>], terms: Terms) -> Option<f64> {
    let middle = middle(boards);
    let (mut squares, mut count) = (0.0, 0.0);
    for (index, board) in boards.iter().enumerate() {
        let found = solved(boards, Some(index), terms)?;
        for patch in *board {
            squares += off(patch, middle, terms, &found).powi(2);
            count += 1.0;
        }
    }
    Some((squares / f64::max(count, 1.0)).sqrt())
}

/// Sum of the boards' mean squared errors at 1 m to which these terms were fitted.
fn left(boards: &[&Vec<Patch>], terms: Terms) -> Option<f64> {
    let middle = middle(boards);
    let found = solved(boards, None, terms)?;
    let of_board = |board: &&Vec<Patch>| {
        let squares = board.iter().map(|p| off(p, middle, terms, &found).powi(2));
        squares.sum::<f64>() / board.len().max(1) as f64
    };
    Some(boards.iter().map(of_board).sum())
}

/// What coefficients of these terms leave of a patch's error, at 1 m.
fn off(patch: &Patch, middle: f64, terms: Terms, found: &[f64]) -> f64 {
    let row = row(patch, middle, terms);
    let predicted: f64 = row.iter().zip(found).map(|(t, c)| t * c).sum();
    patch.error / patch.depth.powi(2) - predicted
}

/// The terms of a patch at 1 m: noise grows with the square of the distance.
fn row(patch: &Patch, middle: f64, terms: Terms) -> Vec<f64> {
    let all = [1.0, patch.depth].into_iter().chain(terms(patch, middle));
    all.map(|term| term / patch.depth.powi(2)).collect()
}

/// Coefficients of offset, slope and terms, from all boards but one; each board counts as much as any other.
fn solved(boards: &[&Vec<Patch>], without: Option<usize>, terms: Terms) -> Option<Vec<f64>> {
    let middle = middle(boards);
    let used = boards
        .iter()
        .enumerate()
        .filter(|(index, _)| Some(*index) != without);
    let mut rows: Vec<Vec<f64>> = Vec::new();
    let mut errors: Vec<f64> = Vec::new();
    for (_, board) in used {
        let weight = (board.len() as f64).sqrt().recip();
        for patch in *board {
            rows.push(
                row(patch, middle, terms)
                    .iter()
                    .map(|t| t * weight)
                    .collect(),
            );
            errors.push(patch.error / patch.depth.powi(2) * weight);
        }
    }
    let columns = rows.first()?.len();
    let matrix = DMatrix::from_fn(rows.len(), columns, |i, k| rows[i][k]);
    let solution = matrix
        .svd(true, true)
        .solve(&DVector::from_vec(errors), 1e-12);
    solution.ok().map(|found| found.iter().copied().collect())
}

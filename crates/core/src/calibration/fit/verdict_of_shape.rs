//! The reasons that the board's shape gives for the verdict of a calibration.

use super::reason::{Reason, ReasonKind};
use super::result::{FittedShape, ShapeTerm, TermStatus};
use super::sheet_terms::FEWEST_TO_CHECK;
use crate::calibration::CalibrationLevel;

/// What is amiss with the board's shape: with a bend of more than `most_bent_mm`, and with squares that are longer in
/// one direction by more than `most_stretched_percent`, more than with others.
pub(super) fn of_shape(
    shape: &FittedShape,
    most_bent_mm: f64,
    most_stretched_percent: f64,
) -> Vec<Reason> {
    let bend = bent(shape, most_bent_mm).into_iter();
    let found = bend.chain(stretched(&shape.stretch, most_stretched_percent));
    let names: &[&str] = match shape.bends_differ {
        Some(_) => &["alike in both directions"],
        None => &["along its rows", "down its columns"],
    };
    let bends = shape.bend.iter().zip(names);
    let unheld = bends.filter_map(|(term, name)| {
        let words = halves(term, 1e3, "mm")?;
        let subject = format!("the board seems to be bent {name}, and was assumed to be flat");
        Some(not_held(format!("{subject}: {words}")))
    });
    let differ = (shape.bends_differ == Some(TermStatus::NotHeld)).then(|| {
        let subject = "the board seems to be bent more in one direction than in the other, and was assumed to be bent alike";
        not_held(format!("{subject}: {LOOKS_TURNED}"))
    });
    let stretch = match shape.bends_differ {
        Some(_) => (shape.stretch.fate == TermStatus::NotHeld).then(|| LOOKS_TURNED.to_owned()),
        None => halves(&shape.stretch, 2e2, "%"),
    };
    let stretch = stretch.map(|words| {
        let subject =
            "the board's squares seem to be longer in one direction, and were assumed to be equal";
        not_held(format!("{subject}: {words}"))
    });
    found.chain(unheld).chain(differ).chain(stretch).collect()
}

/// Why a term is not fitted that depends on the direction of the rows.
const LOOKS_TURNED: &str = "with equal numbers of squares in both directions it looks the same after a quarter turn, so it is \
                            not known in which direction; use a board with unequal numbers";

fn not_held(words: String) -> Reason {
    Reason::new(CalibrationLevel::Doubtful, ReasonKind::ShapeNotHeld, words)
}

fn bent(shape: &FittedShape, most_mm: f64) -> Option<Reason> {
    let (found, deviation) = (1e3 * shape.shape().depth(), 1e3 * shape.depth_deviation());
    let is_kept = shape.bend.iter().any(|term| term.fate == TermStatus::Kept);
    is_kept.then(|| match found > most_mm {
        true => Reason::new(
            CalibrationLevel::Doubtful,
            ReasonKind::Bent,
            format!(
                "the board is bent by {found:.2} ± {deviation:.3} mm, expected at most {most_mm}"
            ),
        ),
        false => Reason::new(
            CalibrationLevel::Accepted,
            ReasonKind::Bent,
            format!(
                "the board is bent by {found:.2} ± {deviation:.3} mm, which the fit allows for"
            ),
        ),
    })
}

/// Lengths along the rows over those down the columns.
fn stretched(stretch: &ShapeTerm, most_percent: f64) -> Option<Reason> {
    let percent = 2e2 * stretch.value;
    let longer = match percent < 0.0 {
        true => "down its columns than along its rows",
        false => "along its rows than down its columns",
    };
    let words = format!(
        "the board's squares are {:.2} ± {:.3} % longer {longer}",
        percent.abs(),
        2e2 * stretch.deviation
    );
    (stretch.fate == TermStatus::Kept).then(|| match percent.abs() > most_percent {
        true => Reason::new(
            CalibrationLevel::Doubtful,
            ReasonKind::Stretched,
            format!(
                "{words}, expected at most {most_percent} %; it is not known which of the two lengths is right"
            ),
        ),
        false => Reason::new(CalibrationLevel::Accepted, ReasonKind::Stretched, format!("{words}; the fit assumes that their mean is the stated length")),
    })
}

/// What two halves of the placements say of a term that was needed and not held.
fn halves(term: &ShapeTerm, scale: f64, unit: &str) -> Option<String> {
    let is_unheld = term.fate == TermStatus::NotHeld;
    is_unheld.then(|| match term.halves {
        Some([[first, a], [last, b]]) => {
            let [first, a, last, b] = [first, a, last, b].map(|v| scale * v);
            format!(
                "the first half of the placements says {first:+.2} ± {a:.2} {unit}, the last {last:+.2} ± {b:.2} {unit}"
            )
        }
        None => format!(
            "there are too few placements to check it, expected {FEWEST_TO_CHECK} or more: show the board at more places"
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kept(value: f64) -> ShapeTerm {
        ShapeTerm {
            value,
            deviation: 1e-5,
            fate: TermStatus::Kept,
            halves: None,
        }
    }

    fn words(shape: FittedShape) -> Vec<Reason> {
        of_shape(&shape, 1.0, 0.3)
    }

    #[test]
    fn a_bend_is_told_and_a_large_one_doubted() {
        assert_eq!(words(FittedShape::default()), []);
        let bend = |mm: f64| FittedShape {
            bend: [kept(1e-3 * mm), ShapeTerm::default()],
            ..FittedShape::default()
        };
        let told = "the board is bent by 0.40 ± 0.010 mm, which the fit allows for";
        assert_eq!(
            words(bend(-0.4)),
            [Reason::new(
                CalibrationLevel::Accepted,
                ReasonKind::Bent,
                told
            )]
        );
        let told = "the board is bent by 1.20 ± 0.010 mm, expected at most 1";
        assert_eq!(
            words(bend(1.2)),
            [Reason::new(
                CalibrationLevel::Doubtful,
                ReasonKind::Bent,
                told
            )]
        );
    }

    #[test]
    fn unequal_squares_are_told_and_doubted_beyond_their_limit() {
        let stretch = |part: f64| FittedShape {
            stretch: kept(part),
            ..FittedShape::default()
        };
        let [
            Reason {
                level, words: told, ..
            },
        ] = &words(stretch(-5e-4))[..]
        else {
            panic!("one reason")
        };
        assert_eq!(*level, CalibrationLevel::Accepted);
        assert!(
            told.contains("0.10 ± 0.002 % longer down its columns"),
            "{told}"
        );
        let [
            Reason {
                level, words: told, ..
            },
        ] = &words(stretch(2e-3))[..]
        else {
            panic!("one reason")
        };
        assert_eq!(*level, CalibrationLevel::Doubtful);
        assert!(
            told.contains("0.40 ± 0.002 % longer along its rows"),
            "{told}"
        );
        assert!(told.contains("is not known"), "{told}");
    }

    #[test]
    fn a_board_whose_directions_are_unknown_is_told_once_and_with_the_reason() {
        let shape = FittedShape {
            bend: [kept(2e-4); 2],
            stretch: ShapeTerm {
                fate: TermStatus::NotHeld,
                ..ShapeTerm::default()
            },
            bends_differ: Some(TermStatus::NotHeld),
        };
        let told: Vec<String> = words(shape).into_iter().map(|r| r.words).collect();
        assert_eq!(told.len(), 3, "{told:?}");
        assert!(told[0].contains("bent by 0.40 ± 0.020 mm"), "{told:?}");
        assert!(
            told[1].contains("more in one direction than in the other"),
            "{told:?}"
        );
        assert!(told[2].contains("longer in one direction"), "{told:?}");
        assert!(
            told[1..].iter().all(|w| w.contains("quarter turn")),
            "{told:?}"
        );
    }

    #[test]
    fn a_term_that_is_needed_and_not_held_is_doubted_with_what_each_half_says() {
        let unheld = ShapeTerm {
            fate: TermStatus::NotHeld,
            halves: Some([[4e-4, 5e-5], [-1e-4, 5e-5]]),
            ..ShapeTerm::default()
        };
        let shape = FittedShape {
            bend: [ShapeTerm::default(), unheld],
            ..FittedShape::default()
        };
        let told = "the board seems to be bent down its columns, and was assumed to be flat: the first half of the \
                    placements says +0.40 ± 0.05 mm, the last -0.10 ± 0.05 mm";
        assert_eq!(words(shape), [not_held(told.to_owned())]);
        let untold = FittedShape {
            stretch: ShapeTerm {
                halves: None,
                ..unheld
            },
            ..FittedShape::default()
        };
        let [
            Reason {
                level, words: told, ..
            },
        ] = &words(untold)[..]
        else {
            panic!("one reason")
        };
        assert_eq!(*level, CalibrationLevel::Doubtful);
        assert!(told.contains("too few placements"), "{told}");
    }
}

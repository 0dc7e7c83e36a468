//! Tests whether verdicts are true: many captures with and without faults are reconstructed and judged, and the models
//! compared with the truth. `make verdict-trial` runs 255 and prints a table, the tests a dozen.

mod cases;

use crate::verdict::facts;
use cases::Case;
use scand_core::evaluate::load::LoadedModel;
use scand_core::evaluate::{self, evaluate};
use scand_core::level::Level;
use scand_core::reconstruct::{self, NoProgress, Provenance, Reconstruction, reconstruct};
use scand_core::report::{Measurements, Parameters, Verdict, judge, measure};
use scand_lab::Simulation;

/// Cells along the object: fewer than by default, to save time.
const RESOLUTION: f64 = 120.0;

/// Millimetres of mean error beyond which no model may be green, and times its stated error.
const WRONG: (f64, f64) = (1.0, 3.0);
/// Up to which a model is good.
const GOOD: (f64, f64) = (0.5, 2.0);
/// Share of the good models that may be amber.
const MOST_AMBER: f64 = 0.15;

/// What a model is worth.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Worth {
    /// No fault, a depth camera that sees the hollow, and a small error that the model states.
    Good,
    /// Between the two: any verdict is right.
    Fair,
    /// Its error is large, or far larger than it states.
    Wrong,
}

/// How a capture came out; without a level there is no model.
struct Outcome {
    level: Option<Level>,
    worth: Worth,
    is_odd: bool,
    words: String,
}

/// The mean error in millimetres, and what it is over what the model states.
///
/// The error is the larger one of the model's distance to the truth and the truth's to the model, for a filled hollow
/// is near nothing that the model has.
fn errors(made: &Reconstruction, simulation: &Simulation) -> (f64, f64) {
    let model = LoadedModel {
        mesh: made.model.mesh.clone(),
        provenance: Some(made.model.provenance.clone()),
        expected_error: Some(made.model.expected_error.clone()),
        ..LoadedModel::default()
    };
    let parameters = evaluate::Parameters {
        samples: 10_000,
        ..evaluate::Parameters::default()
    };
    let found = evaluate(&model, simulation.truth(), &parameters)
        .unwrap()
        .whole;
    let mean = |summary: Option<evaluate::Summary>| summary.unwrap().mean_mm;
    let ratio = found.expected.unwrap().actual_over_expected.unwrap();
    (mean(found.accuracy).max(mean(found.completeness)), ratio)
}

fn try_case(number: usize) -> Outcome {
    let case = Case::new(number);
    let (scene, simulation) = case.scene();
    let mut parameters = reconstruct::Parameters {
        method: case.method,
        ..reconstruct::Parameters::default()
    };
    parameters.hull.resolution = RESOLUTION;
    let is_odd = number % 2 == 1;
    let made = match reconstruct(&scene, &parameters, &NoProgress) {
        Ok(made) => made,
        Err(error) => {
            return Outcome {
                level: None,
                worth: Worth::Fair,
                is_odd,
                words: format!("{}: no model: {error}", case.words()),
            };
        }
    };
    let measured = measure(&scene, &made, case.method);
    let verdict = judge(&measured, &facts(), &Parameters::default());
    let (mean, ratio) = errors(&made, &simulation);
    let worth = if mean > WRONG.0 || ratio > WRONG.1 {
        Worth::Wrong
    } else if case.is_sound && case.has_depth() && mean <= GOOD.0 && ratio <= GOOD.1 {
        Worth::Good
    } else {
        Worth::Fair
    };
    Outcome {
        level: Some(verdict.level),
        worth,
        is_odd,
        words: format!(
            "{}: {worth:?}: {mean:.2} mm, {ratio:.2} times stated; {}",
            case.words(),
            judged(&measured, &verdict)
        ),
    }
}

/// The verdict in a line, with the figures that limits may be chosen by.
fn judged(measured: &Measurements, verdict: &Verdict) -> String {
    let reasons = verdict.reasons.iter().filter(|r| r.level > Level::Green);
    let codes: Vec<String> = reasons.map(|r| format!("{:?}", r.code)).collect();
    let model = &measured.model;
    let unread = measured.depths.iter().filter_map(|d| d.regions.as_ref());
    let unread = unread.map(|r| 1.0 - r.coverage).fold(0.0, f64::max);
    let apart = measured
        .depths
        .iter()
        .filter_map(|d| Some(d.outline?.apart));
    let apart = 1e3 * apart.fold(0.0, f64::max);
    let elsewhere = measured
        .depths
        .iter()
        .filter_map(|d| Some(d.beside_regions?.contradiction()));
    let elsewhere = 1e3 * elsewhere.fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
    let ahead = measured.depths.iter().filter_map(|d| d.in_front_of_hull);
    let ahead = ahead.max_by_key(|found| found.pixels);
    let ahead = ahead.map_or((0, 0.0), |found| (found.pixels, 1e3 * found.median));
    let blur_px = measured.colors.iter().filter_map(|c| c.silhouette.blur_px);
    format!(
        "{:?} [{}]; stated {:.2} mm, guessed {:.3}, lids {:.3}, bridged {:.3}, unread {unread:.2}, blur {:.1} px, outline \
        {apart:.2} mm, elsewhere {elsewhere:.2} mm, in front {ahead:?}",
        verdict.level,
        codes.join(", "),
        1e3 * model.mean_expected_error,
        model.unobserved.guessed,
        model.unobserved.lids,
        model.share(Provenance::Bridged),
        blur_px.fold(0.0, f32::max)
    )
}

/// Tries captures and prints each.
fn tried(numbers: impl Iterator<Item = usize>) -> Vec<Outcome> {
    let each = numbers.map(|number| {
        let outcome = try_case(number);
        println!("shown: {}", outcome.words);
        outcome
    });
    each.collect()
}

/// The table of what models are worth and how they were judged.
fn table(outcomes: &[&Outcome]) -> String {
    let rows = [Worth::Good, Worth::Fair, Worth::Wrong].map(|worth| {
        let levels = [
            Some(Level::Green),
            Some(Level::Amber),
            Some(Level::Red),
            None,
        ]
        .map(|level| {
            let of_both = outcomes
                .iter()
                .filter(|o| (o.worth, o.level) == (worth, level));
            of_both.count().to_string()
        });
        format!("| {worth:?} | {} |\n", levels.join(" | "))
    });
    let head = "| model | green | amber | red | none |\n| --- | --- | --- | --- | --- |\n";
    format!("{head}{}", rows.concat())
}

/// No model that is wrong is green.
fn hold_greens(outcomes: &[Outcome]) {
    let is_lie = |o: &&Outcome| (o.worth, o.level) == (Worth::Wrong, Some(Level::Green));
    let lies: Vec<&str> = outcomes
        .iter()
        .filter(is_lie)
        .map(|o| o.words.as_str())
        .collect();
    assert!(lies.is_empty(), "{lies:#?}");
}

fn share_of_good(outcomes: &[&Outcome], level: Level) -> f64 {
    let good = || outcomes.iter().filter(|o| o.worth == Worth::Good);
    let of_level = good().filter(|o| o.level == Some(level));
    of_level.count() as f64 / good().count().max(1) as f64
}

/// All shapes with rigs and faults. Limits were set on odd numbers.
#[test]
#[ignore = "takes many minutes: make verdict-trial"]
fn verdict_trial() {
    let count = std::env::var("N").map_or(cases::ALL, |n| n.parse().unwrap());
    let outcomes = tried(0..count);
    let halves = [true, false]
        .map(|odd| -> Vec<&Outcome> { outcomes.iter().filter(|o| o.is_odd == odd).collect() });
    for (name, half) in ["odd (limits were set on them)", "even"]
        .iter()
        .zip(&halves)
    {
        println!("{name}\n\n{}", table(half));
    }
    hold_greens(&outcomes);
    for half in &halves {
        let amber = share_of_good(half, Level::Amber);
        assert!(
            amber <= MOST_AMBER,
            "{amber:.2} of the good models are amber"
        );
        assert_eq!(share_of_good(half, Level::Red), 0.0, "good models are red");
    }
}

/// Captures of many shapes and rounds: solids, vessels, no depth, turned and exchanged cameras, principal points that
/// are off, depth that is shifted.
const DOZEN: [usize; 12] = [3, 7, 9, 11, 14, 27, 77, 91, 118, 123, 177, 195];

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;

    #[test]
    fn a_dozen_verdicts_are_true() {
        let outcomes = tried(DOZEN.into_iter());
        hold_greens(&outcomes);
        let outcomes: Vec<&Outcome> = outcomes.iter().collect();
        assert!(
            share_of_good(&outcomes, Level::Green) >= 0.6,
            "{}",
            table(&outcomes)
        );
    }
}

//! Between the values of right pairs of captures and those of wrong ones lies each limit of `register`. The trial
//! prints the ends of these gaps, apart for the shapes that the limits were set on and for the others.

use super::Fused;
use scand_lab::Shape;
use serde_json::Value;

/// The shapes of the trial that limits were set on.
const SET_ON: [Shape; 5] = [
    Shape::Mug,
    Shape::Prism,
    Shape::Cup,
    Shape::Egg,
    Shape::Ashtray,
];

/// What the second capture of a session is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Second {
    /// The same object, in the pose that is stated if one is.
    Right,
    /// Another object, or the same one after it changed; or the pose that is stated is wrong.
    Wrong,
    /// The same object behind a prop, or without a piece of an outline.
    Faulty,
}

/// What a report says against a capture or its pose: a name, and the number, if there is one.
type Measure = (&'static str, fn(&Value, &Fused) -> Option<f64>);

/// The number of the measure that tells nothing of another object.
const OWN_NOISE: usize = 1;

const MEASURES: [Measure; 5] = [
    ("disagreement, times the own noise", |capture, fused| {
        Some(capture["disagreement_mm"].as_f64()? / fused.own_noise_mm())
    }),
    ("own noise, mm", |capture, _| {
        capture["own_noise_mm"].as_f64()
    }),
    ("worst stretch, square pixels", |capture, _| {
        let stretch = &capture["worst_stretch"];
        Some(stretch["length_px"].as_f64()? * stretch["miss_px"].as_f64()?)
    }),
    ("share of contradicting depth", |capture, _| {
        capture["depth"]["contradicting"].as_f64()
    }),
    ("all at once, times the own noise", |capture, fused| {
        Some(capture["all_at_once_mm"].as_f64()? / fused.own_noise_mm())
    }),
];

/// A value, and the session that had it.
type Extreme = Option<(f64, String)>;

/// The ends of one gap.
#[derive(Clone, Debug, Default)]
struct Gap {
    largest_right: Extreme,
    smallest_wrong: Extreme,
}

/// All gaps, of the shapes that limits were set on and of the others.
#[derive(Debug, Default)]
pub(super) struct Gaps([[Gap; MEASURES.len()]; 2]);

/// What the two groups of shapes are called.
pub(super) const GROUPS: [&str; 2] = ["shapes that limits were set on", "other shapes"];

/// The number of the group that a shape belongs to.
pub(super) fn group(shape: Shape) -> usize {
    usize::from(!SET_ON.contains(&shape))
}

impl Gaps {
    /// Adds what is said of the second capture of a session.
    pub(super) fn add(&mut self, name: &str, fused: &Fused, second_is: Second) {
        let captures = fused.captures();
        let Some(second) = captures.get(1) else {
            return;
        };
        let gaps = &mut self.0[group(fused.simulation.options().shape)];
        for (number, (gap, (_, measure))) in gaps.iter_mut().zip(MEASURES).enumerate() {
            let value = measure(second, fused).filter(|value| value.is_finite());
            let is_told = number != OWN_NOISE || second_is != Second::Wrong;
            let Some(value) = value.filter(|_| is_told) else {
                continue;
            };
            let (end, is_beyond): (&mut Extreme, fn(f64, f64) -> bool) = match second_is {
                Second::Right => (&mut gap.largest_right, |value, end| value > end),
                _ => (&mut gap.smallest_wrong, |value, end| value < end),
            };
            if end
                .as_ref()
                .is_none_or(|(known, _)| is_beyond(value, *known))
            {
                *end = Some((value, name.to_owned()));
            }
        }
    }

    pub(super) fn print(&self) {
        let told = |end: &Extreme| match end {
            Some((value, name)) => format!("{value:.3} ({name})"),
            None => "none".to_owned(),
        };
        for (group, gaps) in GROUPS.iter().zip(&self.0) {
            println!("{group}:");
            for ((name, _), gap) in MEASURES.iter().zip(gaps) {
                let (right, wrong) = (told(&gap.largest_right), told(&gap.smallest_wrong));
                println!("    {name}: largest when right {right}, smallest when wrong {wrong}");
            }
        }
    }
}

#[test]
fn a_gap_lies_between_the_largest_right_and_the_smallest_wrong_value() {
    let fused = |disagreement_mm: f64| {
        let capture = |id: &str, against: Option<f64>| serde_json::json!({"id": id, "own_noise_mm": 0.1, "disagreement_mm": against});
        let captures = [capture("a", None), capture("b", Some(disagreement_mm))];
        Fused::told(serde_json::json!({"fusion": {"captures": captures}}))
    };
    let mut gaps = Gaps::default();
    for (value, second_is) in [
        (0.1, Second::Right),
        (0.13, Second::Right),
        (0.5, Second::Wrong),
        (0.3, Second::Wrong),
    ] {
        gaps.add(&value.to_string(), &fused(value), second_is);
    }
    let [of_group, of_others] = [0, 1].map(|i| gaps.0[group(Shape::Mug) ^ i].clone());
    let ends = [&of_group[0].largest_right, &of_group[0].smallest_wrong];
    let [right, wrong] = ends.map(|end| end.clone().unwrap());
    assert!((right.0 - 1.3).abs() < 1e-9 && right.1 == "0.13");
    assert!((wrong.0 - 3.0).abs() < 1e-9 && wrong.1 == "0.3");
    // Another object may be seen well; and nothing is known of what the report does not say.
    assert!(of_group[OWN_NOISE].smallest_wrong.is_none());
    assert!(of_group[2].largest_right.is_none());
    assert!(of_others.iter().all(|gap| gap.largest_right.is_none()));
    assert_ne!(group(Shape::Mug), group(Shape::Box));
}

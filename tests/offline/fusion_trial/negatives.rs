//! What is not one object, or not whole, or hidden: none of it is fused.

use super::{Fused, fuse, is_wanted, session};
use scand_lab::{CaptureFault, Exchange, Options, OtherObject, Shape};

/// What is wrong with the second capture.
#[derive(Clone, Copy, Debug)]
enum Wrong {
    /// Something else is there.
    Exchanged(OtherObject),
    /// A ball of so many millimetres broke out of the rim.
    Chip(f64),
    /// A prop of so many millimetres hides a part.
    Prop(f64),
    /// So many millimetres of an outline are lost.
    LostPiece(f64),
}

const TABLE: [Wrong; 7] = [
    Wrong::Exchanged(OtherObject::Bigger(1.0)),
    Wrong::Exchanged(OtherObject::Taller(3.0)),
    Wrong::Exchanged(OtherObject::HandleUp(3.0)),
    Wrong::Exchanged(OtherObject::Shape(Shape::TwoPits)),
    Wrong::Chip(6.0),
    Wrong::Prop(25.0),
    Wrong::LostPiece(8.0),
];

fn with(wrong: Wrong, mut options: Options) -> Options {
    let fault = |amount| vec![CaptureFault { capture: 1, amount }];
    let faults = &mut options.faults;
    match wrong {
        Wrong::Exchanged(with) => faults.exchanged = vec![Exchange { capture: 1, with }],
        Wrong::Chip(mm) => faults.chip_mm = fault(mm),
        Wrong::Prop(mm) => faults.prop_mm = fault(mm),
        Wrong::LostPiece(mm) => faults.lost_piece_mm = fault(mm),
    }
    options
}

/// What silhouettes said against the second capture's pose, over the larger own noise, where it has figures.
fn ratio(fused: &Fused) -> f64 {
    let captures = fused.captures();
    let of = |i: usize, name: &str| captures.get(i).and_then(|c| c[name].as_f64());
    let own = [0, 1].map(|i| of(i, "own_noise_mm").unwrap_or(f64::NAN));
    of(1, "disagreement_mm").unwrap_or(f64::NAN) / own[0].max(own[1])
}

fn is_fused(fused: &Fused) -> bool {
    fused.has_model || fused.code == Some(0)
}

/// The whole table, on a mug at 1280x960, turned on the table and laid on its side; what was fused of it.
pub(super) fn trial() -> Vec<String> {
    let mut wrong = Vec::new();
    for kind in TABLE {
        for words in ["upright,turn:75", "upright,side:200"] {
            let name = format!("{kind:?} {words}");
            if !is_wanted(&name) {
                continue;
            }
            let fused = fuse(with(kind, session(Shape::Mug, false, 1280, words, 5)));
            let told = fused.words.lines().last().unwrap_or_default();
            let ratio = ratio(&fused);
            println!(
                "{name}: exit code {:?}, disagreement {ratio:.2} times the own noise: {told}",
                fused.code
            );
            if is_fused(&fused) {
                wrong.push(name);
            }
        }
    }
    let name = "a pit that no outline crosses";
    if is_wanted(name) {
        wrong.extend(pit(name));
    }
    println!("not as they must be: {wrong:?}");
    wrong
}

/// What no outline crosses cannot be told: a model, which says so. What is not so.
fn pit(name: &str) -> Vec<String> {
    let mut wrong = Vec::new();
    let mut unseen = session(Shape::Cup, true, 1280, "upright,turn:75", 5);
    unseen.faults.pit_mm = vec![CaptureFault {
        capture: 1,
        amount: 3.0,
    }];
    let fused = fuse(unseen);
    let told = fused.words.lines().last().unwrap_or_default();
    println!("{name}: exit code {:?}: {told}", fused.code);
    if !fused.has_model {
        wrong.push("a pit, because of which there is no model".to_owned());
    }
    if !fused.words.contains("not seen by outlines") {
        wrong.push("a pit, of which nothing is said".to_owned());
    }
    wrong
}

/// The same prop as in the table, but the recording says where it is.
#[test]
fn a_prop_that_is_ignored_does_not_hinder() {
    let mut options = with(
        TABLE[5],
        session(Shape::Mug, false, 640, "upright,turn:75", 5),
    );
    options.faults.props_ignored = true;
    let fused = fuse(options);
    assert_eq!(fused.code, Some(0), "{}", fused.words);
    assert!(fused.has_model);
}

#[test]
fn another_object_and_a_capture_that_contradicts_itself_are_not_fused() {
    for kind in [TABLE[3], TABLE[5]] {
        let fused = fuse(with(
            kind,
            session(Shape::Mug, false, 640, "upright,turn:75", 5),
        ));
        assert!(!is_fused(&fused), "{kind:?}: {}", fused.words);
        assert_eq!(fused.code, Some(1), "{kind:?}: {}", fused.words);
        assert!(fused.words.contains("mug-001"), "{kind:?}: {}", fused.words);
    }
}

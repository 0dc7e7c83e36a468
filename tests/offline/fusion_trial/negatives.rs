//! What is not one object, or not whole, or hidden: none of it is fused.

use super::gaps::{Gaps, Second};
use super::poses::OBJECTS;
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

/// What can be wrong with any shape.
const OF_ANY: [Wrong; 5] = [TABLE[0], TABLE[1], TABLE[4], TABLE[5], TABLE[6]];

impl Wrong {
    /// Whether the shape has what this needs: an egg has no edge of which a piece could break.
    fn is_possible(self, shape: Shape) -> bool {
        !matches!((self, shape), (Self::Chip(_), Shape::Egg))
    }

    /// What that makes of the second capture.
    fn second(self) -> Second {
        match self {
            Self::Exchanged(_) | Self::Chip(_) => Second::Wrong,
            Self::Prop(_) | Self::LostPiece(_) => Second::Faulty,
        }
    }
}

/// A session of the trial: what is wrong, the object, whether it has a pattern, and the poses.
type Row = (Wrong, Shape, bool, &'static str);

/// A mug, turned on the table and laid on its side, with all that can be wrong with it; then the other shapes, turned,
/// so that the same edges are seen in profile.
fn rows() -> Vec<Row> {
    let poses = ["upright,turn:75", "upright,side:200"];
    let of_mug = TABLE
        .into_iter()
        .flat_map(|kind| poses.map(|words| (kind, Shape::Mug, false, words)));
    let others = OBJECTS.iter().filter(|object| object.shape != Shape::Mug);
    let of_others = others.flat_map(|object| {
        let kinds = OF_ANY
            .into_iter()
            .filter(move |kind| kind.is_possible(object.shape));
        kinds.map(move |kind| (kind, object.shape, object.has_pattern, "upright,turn:75"))
    });
    of_mug.chain(of_others).collect()
}

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

fn is_fused(fused: &Fused) -> bool {
    fused.has_model || fused.code == Some(0)
}

/// The whole table, at 1280x960; what was fused of it.
pub(super) fn trial(gaps: &mut Gaps) -> Vec<String> {
    let mut wrong = Vec::new();
    for (kind, shape, has_pattern, words) in rows() {
        let name = format!("{kind:?} {shape:?} {words}");
        if !is_wanted(&name) {
            continue;
        }
        let fused = fuse(with(kind, session(shape, has_pattern, 1280, words, 5)));
        println!("{name}: exit code {:?}: {}", fused.code, fused.last_words());
        gaps.add(&name, &fused, kind.second());
        if is_fused(&fused) {
            wrong.push(name);
        }
    }
    let name = "a pit that no outline crosses";
    if is_wanted(name) {
        wrong.extend(pit(name, 1280));
    }
    wrong
}

/// What no outline crosses cannot be told: a model, which says so. What is not so.
fn pit(name: &str, width: usize) -> Vec<String> {
    let mut wrong = Vec::new();
    let mut unseen = session(Shape::Cup, true, width, "upright,turn:75", 5);
    unseen.faults.pit_mm = vec![CaptureFault {
        capture: 1,
        amount: 3.0,
    }];
    let fused = fuse(unseen);
    println!("{name}: exit code {:?}: {}", fused.code, fused.last_words());
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

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;

    #[test]
    fn a_pit_that_no_outline_crosses_is_no_obstacle_and_may_be_there() {
        let wrong = pit("a small pit", 640);
        assert!(wrong.is_empty(), "{wrong:?}");
    }

    #[test]
    fn a_capture_with_a_prop_is_left_out_by_name_and_the_others_are_fused() {
        let words = "upright,turn:75,flip";
        let fused = fuse(with(TABLE[5], session(Shape::Mug, false, 640, words, 5)));
        assert_eq!(fused.code, Some(3), "{}", fused.words);
        assert!(fused.has_model, "{}", fused.words);
        let captures = fused.captures();
        let are_fused: Vec<bool> = captures.iter().map(|c| c["is_fused"] == true).collect();
        assert_eq!(are_fused, [true, false, true], "{}", fused.words);
        assert!(fused.words.contains("mug-001: "), "{}", fused.words);
    }

    /// Copies and changes that are large enough for small pictures.
    #[test]
    fn a_copy_of_another_size_and_a_broken_one_are_not_fused() {
        for kind in [
            Wrong::Exchanged(OtherObject::Bigger(2.0)),
            Wrong::Chip(10.0),
        ] {
            let fused = fuse(with(
                kind,
                session(Shape::Mug, false, 640, "upright,turn:75", 5),
            ));
            assert!(!is_fused(&fused), "{kind:?}: {}", fused.words);
            assert!(fused.words.contains("mug-001"), "{kind:?}: {}", fused.words);
        }
    }
}

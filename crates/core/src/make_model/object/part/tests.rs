//! What is said of captures that were fused, or left out, and that the page for people and the schema know all of it.

use super::*;
use crate::register::{ContourStretch, Unseen};
use nalgebra::{Isometry3, UnitVector3, Vector3};

const POSES: [PoseEvidence; 5] = [
    PoseEvidence::Silhouettes,
    PoseEvidence::Colours,
    PoseEvidence::Depth,
    PoseEvidence::Nothing,
    PoseEvidence::Given,
];
const REFUSALS: [Refusal; 10] = [
    Refusal::Unusable,
    Refusal::ContradictsItself,
    Refusal::NoHull,
    Refusal::NoPose,
    Refusal::Scale,
    Refusal::Stretch,
    Refusal::DepthContradicts,
    Refusal::Undecided,
    Refusal::AllAtOnce,
    Refusal::NotCompared,
];

fn known(name: &str) -> Known {
    Known {
        recording: "pot.mcap".to_owned(),
        id: CaptureId::new(name).unwrap(),
        cameras: vec!["left".to_owned(), "right".to_owned()],
        placement: Some(format!("{name} is up")),
        problem: None,
    }
}

fn registered(verdict: Result<PoseEvidence, Refusal>) -> Registered {
    Registered {
        verdict,
        level: verdict.map_or(Level::Red, |_| Level::Green),
        rig_from_object: verdict.ok().map(|_| Isometry3::identity()),
        against: Some(0),
        sigma_deg: 0.1,
        sigma_mm: 0.1,
        free_axis: None,
        turns_with: None,
        own_noise_mm: 0.05,
        disagreement_mm: Some(0.06),
        accepted_mm: 0.08,
        worst_stretch: Some((
            1,
            ContourStretch {
                camera: 1,
                length_px: 40.0,
                miss_px: 3.0,
            },
        )),
        may_have_changed: false,
        depth: None,
        colours: None,
        larger_by: None,
        rivals: Vec::new(),
        all_at_once_mm: None,
    }
}

/// What is told of captures `a`, whose rig is the frame, `b` and so on.
fn fusion(others: &[Registered], is_given: bool) -> Fusion {
    let mut captures = vec![registered(Ok(PoseEvidence::Frame))];
    captures.extend(others.iter().cloned());
    let names = ["a", "b", "c", "d"].into_iter().take(captures.len());
    let known: Vec<Known> = names.map(known).collect();
    let found = Registration {
        frame_of: 0,
        captures,
        unseen: Unseen::default(),
    };
    Fusion::new("17", (&known, is_given), &found, Vec::new())
}

fn words(found: Registered, is_given: bool) -> String {
    fusion(&[found], is_given).captures[1].words.clone()
}

#[test]
fn of_each_pose_it_is_told_that_outlines_do_not_see_everything() {
    for held_by in POSES {
        let told = words(registered(Ok(held_by)), held_by == PoseEvidence::Given);
        assert!(told.contains("not seen by outlines"), "{held_by:?}: {told}");
        let fusion = fusion(&[registered(Ok(held_by))], false);
        let reasons = fusion.reasons();
        let [reason] = &reasons[..] else {
            panic!("{held_by:?} is no reason, or several");
        };
        assert!(reason.words.starts_with("capture b: "), "{reason:?}");
        let is_note = reason.level == Level::Green;
        assert_eq!(is_note, held_by != PoseEvidence::Nothing, "{reason:?}");
    }
}

#[test]
fn each_capture_says_how_the_object_lay_as_a_person_put_it() {
    let fusion = fusion(&[registered(Ok(PoseEvidence::Colours))], false);
    let told = serde_json::to_value(&fusion).unwrap();
    let words = |i: usize| told["captures"][i]["placement"].as_str();
    assert_eq!([words(0), words(1)], [Some("a is up"), Some("b is up")]);
}

#[test]
fn a_place_where_something_may_have_broken_off_is_told_with_a_camera() {
    let mut doubted = registered(Ok(PoseEvidence::Silhouettes));
    (doubted.level, doubted.may_have_changed) = (Level::Amber, true);
    let told = words(doubted, false);
    let place = "disagree a little at one place (worst in camera right of b: 40 px of contour";
    assert!(told.contains(place), "{told}");
    assert!(told.contains("broke off"), "{told}");
    let told = words(registered(Ok(PoseEvidence::Silhouettes)), false);
    assert!(!told.contains("broke off"), "{told}");
}

#[test]
fn an_amber_pose_says_why_also_where_nothing_but_outlines_is_to_blame() {
    for evidence in [PoseEvidence::Silhouettes, PoseEvidence::Colours] {
        let mut doubted = registered(Ok(evidence));
        doubted.level = Level::Amber;
        let told = words(doubted, false);
        let why =
            "outlines disagree more than is usual, by 0.06 mm in all (worst in camera right of b";
        assert!(told.contains(why), "{told}");
        let told = words(registered(Ok(evidence)), false);
        assert!(!told.contains("more than is usual"), "{told}");
    }
}

#[test]
fn a_capture_that_all_others_doubt_is_told_although_the_model_has_its_frame() {
    let mut frame = registered(Ok(PoseEvidence::Frame));
    frame.worst_stretch = None;
    frame.all_at_once_mm = Some(0.12);
    let told = |frame: &Registered| {
        let good = registered(Ok(PoseEvidence::Silhouettes));
        let found = Registration {
            frame_of: 0,
            captures: vec![frame.clone(), good.clone(), good],
            unseen: Unseen::default(),
        };
        let known = ["a", "b", "c"].map(known);
        let fusion = Fusion::new("17", (&known, false), &found, Vec::new());
        let words = fusion.captures[0].words.clone();
        (words, fusion.reasons())
    };
    let (words, reasons) = told(&frame);
    assert_eq!(words, "the model has the frame of its rig");
    assert_eq!(reasons.len(), 2, "{reasons:?}");
    frame.level = Level::Amber;
    let (words, reasons) = told(&frame);
    let why =
        "of its rig; outlines disagree more than is usual, by 0.12 mm from all others together:";
    assert!(words.contains(why), "{words}");
    let first = (reasons[0].level, reasons[0].code);
    assert_eq!(first, (Level::Amber, ReasonCode::PoseDoubtful));
    assert!(reasons[0].words.starts_with("capture a: "), "{reasons:?}");
}

#[test]
fn each_capture_that_is_refused_is_left_out_by_name_and_with_what_to_do() {
    for refusal in REFUSALS {
        let two = fusion(&[registered(Err(refusal))], false);
        let left_out: Vec<String> = two.left_out().collect();
        assert_eq!(left_out.len(), 1, "{refusal:?}: {left_out:?}");
        assert!(left_out[0].starts_with("b: "), "{left_out:?}");
        assert!(!left_out[0].contains("not seen by outlines"));
        // One capture that is left makes no model, and is not one that was left out.
        assert!(two.captures.iter().all(|c| !c.is_fused), "{refusal:?}");
        assert!(two.captures.iter().all(|c| c.used_for.is_empty()));
        // Of three, two make a model, which says so.
        let good = registered(Ok(PoseEvidence::Silhouettes));
        let three = fusion(&[registered(Err(refusal)), good], false);
        assert_eq!(
            three
                .captures
                .iter()
                .map(|c| c.is_fused)
                .collect::<Vec<_>>(),
            [true, false, true]
        );
        let reasons = three.reasons();
        let codes: Vec<_> = reasons.iter().map(|r| (r.level, r.code)).collect();
        let expected = [
            (Level::Amber, ReasonCode::CaptureLeftOut),
            (Level::Green, ReasonCode::PoseFound),
        ];
        assert_eq!(codes, expected, "{refusal:?}");
    }
    // What misses is named: the camera and its capture.
    for refusal in [
        Refusal::NoPose,
        Refusal::Stretch,
        Refusal::ContradictsItself,
    ] {
        let told = words(registered(Err(refusal)), false);
        let place = "(worst in camera right of b: 40 px of contour are off by 3.0 px)";
        assert!(told.contains(place), "{told}");
    }
}

#[test]
fn a_pose_that_was_given_is_called_so_whatever_is_found_of_it() {
    let given = || registered(Ok(PoseEvidence::Given));
    let told = words(given(), true);
    assert!(
        told.starts_with("its pose was given; silhouettes"),
        "{told}"
    );
    assert!(!told.contains("colours"), "{told}");
    // Nothing is known of how far it may be off.
    let fused = fusion(&[given()], true);
    let second = &fused.captures[1];
    assert_eq!((second.sigma_deg, second.sigma_mm), (None, None));
    assert_eq!(second.held_by, Some(PoseEvidence::Given));
    // A turn that the form leaves open is told, unless colours confirm it.
    let mut open = given();
    open.free_axis = Some(UnitVector3::new_normalize(Vector3::z()));
    let colours = |best: f64| ColorAgreement {
        best,
        next: 0.0,
        contrast: 0.3,
        points: 1000,
    };
    for (of, is_told) in [(None, true), (Some(0.2), true), (Some(0.7), false)] {
        open.colours = of.map(colours);
        let told = words(open.clone(), true);
        let open_turn = "silhouettes leave the turn about its axis open";
        assert_eq!(told.contains(open_turn), is_told, "{told}");
    }
    // A pose that was found is told of in other words.
    open.verdict = Ok(PoseEvidence::Colours);
    assert!(!words(open, false).contains("given"));
    for refusal in [Refusal::NoPose, Refusal::Stretch] {
        let told = words(registered(Err(refusal)), true);
        assert!(told.contains("in the pose that was given"), "{told}");
        assert!(!told.contains("in no pose"), "{told}");
    }
}

#[test]
fn captures_of_one_name_are_told_apart_by_their_recordings() {
    let other = Known {
        recording: "bowl.mcap".to_owned(),
        ..known("a")
    };
    let found = Registration {
        frame_of: 0,
        captures: vec![
            registered(Ok(PoseEvidence::Frame)),
            registered(Err(Refusal::NoPose)),
        ],
        unseen: Unseen::default(),
    };
    let fusion = Fusion::new("17", (&[known("a"), other], false), &found, Vec::new());
    let left_out: Vec<String> = fusion.left_out().collect();
    assert!(left_out[0].starts_with("a of bowl.mcap: "), "{left_out:?}");
    assert!(
        left_out[0].contains("those of a of pot.mcap"),
        "{left_out:?}"
    );
}

/// The words that `docs/operating.md` explains, each as the parts around what differs from case to case.
fn explained() -> Vec<Vec<&'static str>> {
    let page = include_str!("../../../../../../docs/operating.md");
    let (_, table) = page
        .split_once("| words | meaning | what to do |\n")
        .expect("the page has a table of words");
    let rows = table.lines().skip(1).take_while(|row| row.starts_with('|'));
    let words = rows.filter_map(|row| row.split('|').nth(1));
    words
        .map(|words| words.split('…').map(str::trim).collect())
        .collect()
}

/// Whether all parts stand in what is told, in their order.
fn is_told(parts: &[&str], told: &str) -> bool {
    let mut rest = told;
    parts.iter().all(|part| {
        let found = rest.split_once(part);
        rest = found.map_or("", |(_, after)| after);
        found.is_some()
    })
}

/// All that can be found of a capture, whether its pose was given, and how many of the explained words it takes.
fn all_findings() -> Vec<(Registered, bool, usize)> {
    let mut all = Vec::new();
    for held_by in POSES {
        all.push((registered(Ok(held_by)), held_by == PoseEvidence::Given, 2));
    }
    for refusal in REFUSALS {
        all.push((registered(Err(refusal)), false, 1));
    }
    for refusal in [Refusal::NoPose, Refusal::Stretch] {
        all.push((registered(Err(refusal)), true, 1));
    }
    let mut doubted = |held_by: PoseEvidence, doubt: fn(&mut Registered)| {
        let mut found = registered(Ok(held_by));
        doubt(&mut found);
        all.push((found, held_by == PoseEvidence::Given, 3));
    };
    let by_outlines = PoseEvidence::Silhouettes;
    doubted(by_outlines, |found| found.sigma_deg = 1.0);
    doubted(by_outlines, |found| found.may_have_changed = true);
    doubted(by_outlines, |found| found.larger_by = Some(0.004));
    doubted(by_outlines, |found| found.level = Level::Amber);
    doubted(by_outlines, |found| {
        found.colours = Some(ColorAgreement {
            best: 0.0,
            next: 0.0,
            contrast: 0.3,
            points: 1000,
        });
    });
    doubted(PoseEvidence::Nothing, |found| found.depth = None);
    doubted(PoseEvidence::Given, |found| {
        found.free_axis = Some(UnitVector3::new_normalize(Vector3::z()));
    });
    doubted(PoseEvidence::Given, |found| {
        let (contradicting, least) = (0.2, 0.01);
        found.depth = Some(DepthWitness {
            contradicting,
            least,
        });
    });
    let mut follows = registered(Ok(PoseEvidence::Nothing));
    follows.turns_with = Some(0);
    all.push((follows, false, 2));
    all
}

#[test]
fn the_page_for_people_explains_all_words_and_no_others() {
    let explained = explained();
    assert!(explained.len() > 20, "{explained:?}");
    let mut all_told: Vec<String> = Vec::new();
    for (found, is_given, least) in all_findings() {
        let finding = format!("{found:?}");
        let fusion = fusion(&[found], is_given);
        let told = &fusion.captures[1].words;
        let count = explained
            .iter()
            .filter(|parts| is_told(parts, told))
            .count();
        assert!(
            count >= least,
            "{count} of {least} are explained: {told} ({finding})"
        );
        let frame = &fusion.captures[0].words;
        let is_explained = explained.iter().any(|parts| is_told(parts, frame));
        assert!(is_explained, "{frame}");
        all_told.extend([told.clone(), frame.clone()]);
    }
    for parts in &explained {
        let is_said = all_told.iter().any(|told| is_told(parts, told));
        assert!(is_said, "{parts:?} is explained, and never said");
    }
}

#[test]
fn the_schema_of_the_report_knows_each_evidence_and_refusal_and_no_other() {
    let schema = include_str!("../../../../../../docs/report.schema.json");
    let schema: serde_json::Value = serde_json::from_str(schema).unwrap();
    let known = |member: &str| {
        let member = &schema["$defs"]["fused_capture"]["properties"][member];
        member["enum"].clone()
    };
    let mut evidence = vec![Some(PoseEvidence::Frame)];
    evidence.extend(POSES.map(Some));
    evidence.push(None);
    assert_eq!(known("held_by"), serde_json::json!(evidence));
    let mut refusals = REFUSALS.map(Some).to_vec();
    refusals.push(None);
    assert_eq!(known("refused"), serde_json::json!(refusals));
}

//! What presses are answered, across restarts.

use super::*;
use std::path::PathBuf;

fn accepted(capture: &str) -> Reply {
    Reply::Accepted {
        capture: capture.into(),
        source: None,
        press_id: None,
        subject: None,
    }
}

fn durable(capture: &str) -> Reply {
    Reply::Durable {
        capture: capture.into(),
        recording: "/r/a.mcap".into(),
    }
}

fn new(presses: &Presses, id: &str) -> Arc<Answers> {
    match presses.ask(Some(id)).unwrap() {
        Asked::New(answers) => answers,
        Asked::Known(following) => panic!("{:?}", following.borrow()),
    }
}

fn known(presses: &Presses, id: &str) -> Vec<Reply> {
    match presses.ask(Some(id)).unwrap() {
        Asked::Known(following) => following.borrow().clone(),
        Asked::New(_) => panic!("{id} is not known"),
    }
}

fn done(capture: &str) -> Event {
    Event::Done {
        capture: capture.into(),
        recording: Some(PathBuf::new()),
        verdict: crate::trigger::Verdict::Green,
        reasons: Vec::new(),
        model: "/m".into(),
    }
}

#[test]
fn the_same_name_is_the_same_press_also_after_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let presses = Presses::open(folder.path(), &[]);
    let press = new(&presses, "p-1");
    let early = press.follow();
    presses.tell(&press, accepted("a-0001"));
    presses.tell(&press, durable("a-0001"));
    let answers = [accepted("a-0001"), durable("a-0001")];
    assert_eq!(*early.borrow(), answers);
    assert_eq!(known(&presses, "p-1"), answers);
    drop(presses);
    let presses = Presses::open(folder.path(), &[]);
    assert_eq!(known(&presses, "p-1"), answers);
    // A model that is made after the restart is the press's, once.
    presses.witness(&done("a-0001"));
    presses.witness(&done("a-0001"));
    let presses = Presses::open(folder.path(), &[]);
    let answers = known(&presses, "p-1");
    assert_eq!(answers.len(), 3);
    assert!(answers[2].is_end(Until::Done), "{answers:?}");
}

#[test]
fn what_was_cut_short_has_failed_and_stays_so() {
    let folder = tempfile::tempdir().unwrap();
    let presses = Presses::open(folder.path(), &[]);
    let press = new(&presses, "p-1");
    presses.tell(&press, accepted("a-0001"));
    drop(presses);
    for _ in 0..3 {
        let presses = Presses::open(folder.path(), &[]);
        let answers = known(&presses, "p-1");
        assert_eq!(answers.len(), 2, "{answers:?}");
        let Reply::Failed { capture, reason } = &answers[1] else {
            panic!("{answers:?}");
        };
        assert!(
            capture == "a-0001" && reason.contains("ended before"),
            "{reason}"
        );
        // Nothing more is said of what has its end.
        presses.witness(&done("a-0001"));
        assert_eq!(known(&presses, "p-1").len(), 2);
    }
}

#[test]
fn a_name_for_which_nothing_was_begun_is_free_again() {
    let folder = tempfile::tempdir().unwrap();
    let presses = Presses::open(folder.path(), &[]);
    for reply in [
        Reply::Busy,
        Reply::Refused {
            reason: "no".into(),
        },
    ] {
        let press = new(&presses, "p-1");
        let also = press.follow();
        presses.tell(&press, reply.clone());
        assert_eq!(*also.borrow(), [reply]);
    }
    let press = new(&presses, "p-1");
    presses.tell(&press, accepted("a-0001"));
    assert_eq!(known(&presses, "p-1"), [accepted("a-0001")]);
}

#[test]
fn a_press_that_is_let_fall_has_an_end() {
    let folder = tempfile::tempdir().unwrap();
    let presses = Arc::new(Presses::open(folder.path(), &[]));
    let promised = |id: &str| {
        let answers = new(&presses, id);
        let following = answers.follow();
        let presses = presses.clone();
        (Promise { presses, answers }, following)
    };
    let (promise, following) = promised("p-1");
    drop(promise);
    assert!(matches!(following.borrow()[..], [Reply::Refused { .. }]));
    let (promise, following) = promised("p-1");
    promise.tell(accepted("a-0001"));
    drop(promise);
    let failed = matches!(following.borrow()[..], [_, Reply::Failed { .. }]);
    assert!(failed);
    let (promise, following) = promised("p-2");
    promise.tell(accepted("a-0002"));
    promise.tell(durable("a-0002"));
    drop(promise);
    assert_eq!(following.borrow().len(), 2);
}

#[test]
fn names_that_are_none_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let presses = Presses::open(folder.path(), &[]);
    for name in ["", "a\nb", &"x".repeat(65)] {
        let refused = presses.ask(Some(name)).err().unwrap();
        assert!(refused.contains("press_id"), "{refused}");
    }
    assert!(presses.ask(Some(&"ä".repeat(64))).is_ok());
}

#[test]
fn the_oldest_are_forgotten_but_for_those_that_somebody_follows() {
    let folder = tempfile::tempdir().unwrap();
    let presses = Presses::open(folder.path(), &[]);
    let followed = new(&presses, "followed");
    let following = followed.follow();
    presses.hear(&followed, accepted("f"));
    for i in 0..MOST + 5 {
        let press = new(&presses, &i.to_string());
        presses.hear(&press, accepted(&format!("a-{i}")));
    }
    assert_eq!(presses.known().accepted.len(), MOST);
    assert_eq!(presses.known().by_id.len(), MOST);
    assert_eq!(presses.known().by_capture.len(), MOST);
    new(&presses, "0");
    assert_eq!(known(&presses, "followed"), [accepted("f")]);
    drop(following);
}

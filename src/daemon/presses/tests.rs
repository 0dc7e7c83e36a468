//! Tests the presses with inputs in any order: each press gets one final answer and at most one capture with its
//! retries, and nothing is acknowledged before it has happened; also over a restart at any moment.

use super::recorded::Recorded;
use super::table::MOST_PRESSES;
use super::*;
use crate::level::Level;
use proptest::prelude::*;
use std::collections::BTreeSet;

fn presses() -> Presses {
    Presses::restore(Instant::now(), Vec::new(), &[]).0
}

fn press(id: Option<&str>) -> Press {
    Press {
        source: "test".into(),
        press_id: id.map(Into::into),
        subject: None,
        placement: None,
    }
}

fn accepted(capture: &str) -> Event {
    Event::Accepted {
        capture: capture.into(),
        source: None,
        press_id: None,
        subject: None,
    }
}

fn durable(capture: &str) -> Event {
    Event::Durable {
        capture: capture.into(),
        recording: "/r/a.mcap".into(),
    }
}

fn done(capture: &str) -> Event {
    Event::Done {
        capture: capture.into(),
        recording: Some("/r/a.mcap".into()),
        verdict: Level::Green,
        reasons: Vec::new(),
        model: "/m".into(),
    }
}

/// Something that happens to one of the presses or captures that there were, or to any other.
#[derive(Clone, Debug)]
enum Step {
    Ask(Option<u8>),
    Admit(usize, u32),
    Refuse(usize),
    Taken(usize, bool),
    Written(usize, bool),
    JobEnded(usize, bool),
    Abandon(usize),
    Leave(usize),
    Claim,
    Release,
}

fn step() -> impl Strategy<Value = Step> {
    // The last presses and captures are what most inputs are about.
    let back = || 0_usize..4;
    prop_oneof![
        3 => proptest::option::of(0_u8..4).prop_map(Step::Ask),
        3 => (back(), 0_u32..3).prop_map(|(p, retries)| Step::Admit(p, retries)),
        1 => back().prop_map(Step::Refuse),
        4 => (back(), any::<bool>()).prop_map(|(p, ok)| Step::Taken(p, ok)),
        4 => (back(), any::<bool>()).prop_map(|(c, ok)| Step::Written(c, ok)),
        2 => (back(), any::<bool>()).prop_map(|(c, ok)| Step::JobEnded(c, ok)),
        1 => back().prop_map(Step::Abandon),
        1 => back().prop_map(Step::Leave),
        1 => Just(Step::Claim),
        1 => Just(Step::Release),
    ]
}

/// The presses, and all that came of them.
struct Watched {
    presses: Presses,
    now: Instant,
    keys: Vec<PressKey>,
    ids: BTreeMap<String, PressKey>,
    replies: BTreeMap<PressKey, Vec<Event>>,
    /// Captures that were begun, and the presses they are of.
    shots: Vec<(String, PressKey)>,
    retries: BTreeMap<PressKey, u32>,
    followers: BTreeMap<PressKey, usize>,
    /// The press that the capture thread has.
    in_hand: Option<PressKey>,
    claimed: bool,
    journal: Vec<(String, Event)>,
    /// Lines of the journal that are on the disk.
    synced: usize,
    enqueued: BTreeSet<String>,
}

impl Watched {
    fn new() -> Self {
        Self {
            presses: presses(),
            now: Instant::now(),
            keys: Vec::new(),
            ids: BTreeMap::new(),
            replies: BTreeMap::new(),
            shots: Vec::new(),
            retries: BTreeMap::new(),
            followers: BTreeMap::new(),
            in_hand: None,
            claimed: false,
            journal: Vec::new(),
            synced: 0,
            enqueued: BTreeSet::new(),
        }
    }

    fn take(&mut self, step: Step) {
        self.now += Duration::from_millis(100);
        let press = |back: usize| self.keys.iter().rev().nth(back).copied();
        let capture = |back: usize| {
            let shot = self.shots.iter().rev().nth(back);
            shot.map_or_else(|| "another".to_owned(), |(capture, _)| capture.clone())
        };
        let result = |ok: bool| if ok { Ok(7) } else { Err("c03".to_owned()) };
        let input = match step {
            Step::Ask(id) => return self.ask(id),
            Step::Claim => return self.claim(),
            Step::Release => return self.release(),
            Step::Admit(back, retries) => press(back)
                .map(|press| Input::Admitted(press, format!("a-{:04}", self.shots.len()), retries)),
            Step::Refuse(back) => press(back).map(|press| Input::Refused(press, "no room".into())),
            Step::Taken(back, ok) => {
                press(back).map(|press| Input::Taken(press, Timestamp(5), result(ok)))
            }
            Step::Written(back, ok) => Some(Input::Written(
                capture(back),
                result(ok).map(|_| "/r/a.mcap".into()),
            )),
            Step::JobEnded(back, true) => Some(Input::JobEnded(done(&capture(back)))),
            Step::JobEnded(back, false) => Some(Input::JobEnded(Event::JobFailed {
                capture: capture(back),
                recording: None,
                reason: "no memory".into(),
            })),
            Step::Abandon(back) => press(back).map(Input::Abandoned),
            Step::Leave(back) => {
                let press = press(back).filter(|p| self.followers[p] > 0);
                press.map(Input::Left)
            }
        };
        if let Some(input) = input {
            self.give(input);
        }
    }

    fn ask(&mut self, id: Option<u8>) {
        let id = id.map(|id| format!("p-{id}"));
        let (key, effects) = self.presses.ask(self.now, press(id.as_deref()));
        *self.followers.entry(key).or_default() += 1;
        let known = id.as_ref().and_then(|id| self.ids.get(id)).copied();
        let was_rejected = |key| self.replies[&key].last().is_some_and(Event::is_rejection);
        match known.filter(|known| !self.replies.contains_key(known) || !was_rejected(*known)) {
            Some(known) => {
                assert_eq!((key, &effects[..]), (known, &[][..]), "another press");
            }
            None => {
                assert!(!self.keys.contains(&key));
                self.keys.push(key);
                if let Some(id) = id {
                    self.ids.insert(id, key);
                }
                let begins = effects.contains(&Effect::Begin(key));
                assert_eq!(begins, self.in_hand.is_none() && !self.claimed);
                if begins {
                    self.in_hand = Some(key);
                }
                self.watch(None, effects);
            }
        }
    }

    fn claim(&mut self) {
        let free = self.in_hand.is_none() && !self.claimed;
        assert_eq!(self.presses.claim(), free);
        self.claimed |= free;
    }

    fn release(&mut self) {
        if std::mem::take(&mut self.claimed) {
            self.presses.release();
        }
    }

    fn give(&mut self, input: Input) {
        if let Input::Admitted(press, _, retries) = &input {
            self.retries.entry(*press).or_insert(*retries);
        }
        if let Input::Left(press) = &input {
            *self.followers.get_mut(press).unwrap() -= 1;
        }
        let effects = self.presses.on(self.now, input.clone());
        let shoots = effects.iter().any(|e| matches!(e, Effect::Shoot(_)));
        let (Input::Taken(press, ..)
        | Input::Refused(press, _)
        | Input::Abandoned(press)
        | Input::Admitted(press, ..)) = &input
        else {
            return self.watch(Some(&input), effects);
        };
        let (press, was_shot) = (*press, self.shots.iter().any(|(_, of)| of == press));
        let is_over = match &input {
            Input::Taken(..) => was_shot && !shoots,
            Input::Abandoned(_) => true,
            _ => !was_shot && !shoots,
        };
        if is_over && self.in_hand == Some(press) {
            self.in_hand = None;
        }
        self.watch(Some(&input), effects);
    }

    /// Holds effects against what caused them.
    fn watch(&mut self, input: Option<&Input>, effects: Vec<Effect>) {
        for (i, effect) in effects.iter().enumerate() {
            match effect {
                Effect::Reply(press, event) => {
                    self.is_caused(input, event);
                    let named = self.ids.iter().find(|(_, key)| *key == press);
                    if let Some((id, _)) = named.filter(|_| !event.is_rejection()) {
                        let line = Effect::Journal {
                            press_id: id.clone(),
                            event: event.clone(),
                        };
                        assert_eq!(effects[i - 1], line, "heard before it was written");
                    }
                    self.replies.entry(*press).or_default().push(event.clone());
                    in_its_order(&self.replies[press]);
                }
                Effect::Publish(event) => self.is_caused(input, event),
                Effect::Journal { press_id, event } => {
                    self.journal.push((press_id.clone(), event.clone()));
                }
                Effect::SyncJournal => self.synced = self.journal.len(),
                Effect::Shoot(id) => {
                    let press = self.in_hand.expect("a shot of no press");
                    let same = |(capture, _): &&(String, PressKey)| capture == id.as_str();
                    assert!(self.shots.iter().find(same).is_none(), "{id} twice");
                    self.shots.push((id.to_string(), press));
                    let own = self.shots.iter().filter(|(_, of)| *of == press).count();
                    assert!(own as u32 <= 1 + self.retries[&press], "too many captures");
                }
                Effect::Enqueue { capture, .. } => {
                    assert!(self.enqueued.insert(capture.clone()), "{capture} twice");
                    assert_eq!(effects[i - 1], Effect::Publish(durable(capture)));
                }
                Effect::Begin(_) | Effect::LogUnwritten { .. } | Effect::Forget(_) => {}
            }
        }
    }

    /// Nothing is acknowledged but by the input that it acknowledges.
    fn is_caused(&self, input: Option<&Input>, event: &Event) {
        let caused = match (event, input) {
            (Event::Busy, None) => true,
            (Event::Refused { .. }, Some(Input::Refused(..) | Input::Abandoned(_))) => true,
            (Event::Accepted { .. }, Some(Input::Admitted(..))) => true,
            (Event::Accepted { .. } | Event::Retried { .. }, Some(Input::Taken(_, _, Err(_)))) => {
                true
            }
            (Event::Captured { skew_ns, .. }, Some(Input::Taken(_, _, result))) => {
                *result == Ok(*skew_ns)
            }
            (Event::Durable { capture, recording }, Some(Input::Written(written, Ok(path)))) => {
                (capture, recording) == (written, path)
            }
            (Event::Failed { .. }, Some(Input::Written(..) | Input::Abandoned(_))) => true,
            (Event::Done { .. } | Event::JobFailed { .. }, Some(Input::JobEnded(ended))) => {
                event == ended
            }
            _ => false,
        };
        assert!(caused, "{event:?} by {input:?}");
    }

    /// All threads come to their ends.
    fn settle(&mut self) {
        for press in self.keys.clone() {
            self.give(Input::Abandoned(press));
        }
        for (capture, _) in self.shots.clone() {
            self.give(Input::Written(capture, Ok("/r/a.mcap".into())));
        }
        self.release();
    }
}

/// (busy | refused) | accepted (retried accepted)* (failed | captured (failed | durable (done | job_failed)?)?)?
fn in_its_order(replies: &[Event]) {
    use Event::*;
    for pair in replies.windows(2) {
        let follows = matches!(
            pair,
            [
                Accepted { .. },
                Retried { .. } | Captured { .. } | Failed { .. }
            ] | [Retried { .. }, Accepted { .. } | Failed { .. }]
                | [Captured { .. }, Durable { .. } | Failed { .. }]
                | [Durable { .. }, Done { .. } | JobFailed { .. }]
        );
        assert!(follows, "{replies:?}");
        // The daemon may end before a retry is accepted. A retry is another capture; everything else is of the same.
        let same = pair[0].capture() == pair[1].capture();
        let is_another = matches!(pair, [Retried { .. }, Accepted { .. }]);
        assert_eq!(same, !is_another, "{replies:?}");
    }
    let first = replies.first().unwrap();
    assert!(
        matches!(first, Accepted { .. }) || first.is_rejection(),
        "{replies:?}"
    );
}

fn ends(replies: &[Event]) -> usize {
    let is_end = |event: &&Event| {
        event.is_end(Until::Durable)
            && !matches!(event, Event::Done { .. } | Event::JobFailed { .. })
    };
    replies.iter().filter(is_end).count()
}

proptest! {
    #[test]
    fn any_order_of_inputs_gives_each_press_one_end_one_capture_and_no_word_before_its_cause(
        steps in proptest::collection::vec(step(), 0..60),
    ) {
        let mut watched = Watched::new();
        steps.into_iter().for_each(|step| watched.take(step));
        watched.settle();
        for key in &watched.keys {
            let replies = &watched.replies[key];
            prop_assert_eq!(ends(replies), 1, "{:?}", replies);
        }
        prop_assert!(watched.presses.is_idle());
        // Each durable capture, and no other, had its job.
        let told = watched.replies.values().flatten();
        let durable = told.filter(|event| matches!(event, Event::Durable { .. }));
        let durable: BTreeSet<_> = durable.map(|e| e.capture().unwrap().to_owned()).collect();
        prop_assert_eq!(&durable, &watched.enqueued);
        let figures = watched.presses.figures();
        prop_assert_eq!(figures.complete as usize, durable.len());
    }

    #[test]
    fn a_restart_at_any_moment_keeps_what_was_told_and_ends_the_rest(
        steps in proptest::collection::vec(step(), 0..60),
        lost in 0_usize..10,
        on_disk in any::<u64>(),
    ) {
        let mut watched = Watched::new();
        steps.into_iter().for_each(|step| watched.take(step));
        // A power cut takes lines that were not brought to the disk, and captures that no client knows of.
        let kept = watched.synced.max(watched.journal.len().saturating_sub(lost));
        let journal = watched.journal[..kept].to_vec();
        let recorded: Vec<Recorded> = watched.shots.iter().enumerate().filter_map(|(i, (capture, press))| {
            let replies = &watched.replies[press];
            let of_this = || replies.iter().filter(|e| e.capture() == Some(capture));
            let captured = of_this().any(|e| matches!(e, Event::Captured { .. }));
            let durable = of_this().any(|e| matches!(e, Event::Durable { .. }));
            let failed = of_this().any(|e| matches!(e, Event::Failed { .. }));
            let press_id = watched.ids.iter().find(|(_, key)| *key == press).map(|(id, _)| id.clone());
            let end = if captured { Ok((7, "/r/a.mcap".into())) } else { Err("c03".into()) };
            (durable || (!failed && on_disk >> (i % 64) & 1 == 1)).then_some(Recorded { capture: capture.clone(), press_id, end })
        }).collect();
        let before = told(&journal);
        let (presses, effects) = Presses::restore(Instant::now(), journal.clone(), &recorded);
        prop_assert!(presses.is_idle());
        let mut journal = journal;
        for effect in &effects {
            prop_assert!(!matches!(effect, Effect::Publish(_) | Effect::Shoot(_) | Effect::Begin(_)));
            if let Effect::Journal { press_id, event } = effect {
                journal.push((press_id.clone(), event.clone()));
            }
        }
        let after = told(&journal);
        for (id, replies) in &after {
            in_its_order(replies);
            prop_assert_eq!(ends(replies), 1, "{}: {:?}", id, replies);
            let before = before.get(id).map_or(&[][..], |before| before);
            prop_assert!(replies.starts_with(before), "{}: {:?}, {:?}", id, before, replies);
            for event in &replies[before.len()..] {
                let complete = |r: &Recorded| Some(&r.capture[..]) == event.capture() && r.end.is_ok();
                if matches!(event, Event::Durable { .. }) {
                    prop_assert!(recorded.iter().any(complete), "{}: {:?}", id, replies);
                }
            }
        }
        // Another restart changes nothing.
        let (mut presses, again) = Presses::restore(Instant::now(), journal, &recorded);
        prop_assert!(again.iter().all(|effect| matches!(effect, Effect::Reply(..))));
        for id in after.keys() {
            let (_, effects) = presses.ask(Instant::now(), press(Some(id)));
            prop_assert_eq!(effects, [], "{} is known", id);
        }
    }
}

/// The answers of each press, from the lines of the journal. Those of a name that was used again follow each other.
fn told(journal: &[(String, Event)]) -> BTreeMap<String, Vec<Event>> {
    let mut told = BTreeMap::<String, Vec<Event>>::new();
    for (id, event) in journal {
        told.entry(id.clone()).or_default().push(event.clone());
    }
    told
}

fn begin(presses: &mut Presses, id: Option<&str>, capture: &str) -> PressKey {
    let (key, effects) = presses.ask(Instant::now(), press(id));
    assert_eq!(effects.last(), Some(&Effect::Begin(key)));
    let effects = presses.on(Instant::now(), Input::Admitted(key, capture.into(), 1));
    assert!(
        matches!(effects.last(), Some(Effect::Shoot(_))),
        "{effects:?}"
    );
    key
}

fn taken(presses: &mut Presses, press: PressKey, result: Result<u64, String>) -> Vec<Effect> {
    presses.on(Instant::now(), Input::Taken(press, Timestamp(5), result))
}

#[test]
fn a_name_that_a_retry_would_be_too_long_for_ends_the_attempts() {
    let mut presses = presses();
    let name = "a".repeat(62);
    let press = begin(&mut presses, None, &name);
    assert_eq!(taken(&mut presses, press, Err("c03".into())), []);
    assert!(!presses.is_busy() && !presses.is_idle());
    let key = presses.ask(Instant::now(), self::press(None)).0;
    let admitted = Input::Admitted(key, "a".repeat(65), 0);
    let refused = presses.on(Instant::now(), admitted);
    assert!(
        matches!(&refused[0], Effect::Reply(_, Event::Refused { reason }) if reason.contains("too long")),
        "{refused:?}"
    );
}

#[test]
fn why_an_attempt_that_was_taken_once_more_could_not_be_written_is_logged() {
    let mut presses = presses();
    let press = begin(&mut presses, None, "a-0001");
    taken(&mut presses, press, Err("c03".into()));
    let written = |result| Input::Written("a-0001".into(), result);
    let kept = presses.on(Instant::now(), written(Ok("/r/a.mcap".into())));
    assert_eq!(kept, []);
    let lost = presses.on(Instant::now(), written(Err("/r/a.mcap: it is full".into())));
    let logged = Effect::LogUnwritten {
        capture: "a-0001".into(),
        problem: "/r/a.mcap: it is full".into(),
    };
    assert_eq!(lost, [logged]);
}

#[test]
fn everybody_hears_of_one_refusal_a_second_and_its_client_of_each() {
    let (mut presses, begin) = (presses(), Instant::now());
    let mut published = 0;
    for ms in [0, 10, 900, 1000, 1500, 2100] {
        let now = begin + Duration::from_millis(ms);
        let (press, _) = presses.ask(now, press(None));
        let effects = presses.on(now, Input::Refused(press, "no room".into()));
        assert!(matches!(effects[0], Effect::Reply(..)));
        published += usize::from(matches!(effects.last(), Some(Effect::Publish(_))));
    }
    assert_eq!((published, presses.figures().refused), (3, 6));
}

#[test]
fn names_that_are_none_are_refused() {
    let mut presses = presses();
    for name in ["", "a\nb", &"x".repeat(65)] {
        let (_, effects) = presses.ask(Instant::now(), press(Some(name)));
        let [
            Effect::Reply(_, Event::Refused { reason }),
            Effect::Forget(_),
        ] = &effects[..]
        else {
            panic!("{effects:?}");
        };
        assert!(reason.contains("press_id"), "{reason}");
    }
    let (key, effects) = presses.ask(Instant::now(), press(Some(&"ä".repeat(64))));
    assert_eq!(effects, [Effect::Begin(key)]);
}

#[test]
fn what_was_cut_short_has_failed_and_stays_so() {
    let line = |event: Event| ("p-1".to_owned(), event);
    let (_, effects) = Presses::restore(Instant::now(), [line(accepted("a-0001"))], &[]);
    let [
        Effect::Reply(..),
        Effect::Journal { event, .. },
        Effect::Reply(..),
        Effect::SyncJournal,
    ] = &effects[..]
    else {
        panic!("{effects:?}");
    };
    assert!(
        matches!(event, Event::Failed { capture, reason } if capture == "a-0001" && reason.contains("ended before")),
        "{event:?}"
    );
    let lines = [accepted("a-0001"), event.clone(), done("a-0001")].map(line);
    let (mut presses, effects) = Presses::restore(Instant::now(), lines, &[]);
    // A press that has its final answer gets no more; only listeners to events are still told.
    assert_eq!(effects.len(), 2, "{effects:?}");
    let ended = presses.on(Instant::now(), Input::JobEnded(done("a-0001")));
    assert_eq!(ended, [Effect::Publish(done("a-0001"))]);
}

#[test]
fn a_model_that_is_made_after_a_restart_answers_its_press_once() {
    let lines = [accepted("a-0001"), durable("a-0001")].map(|e| ("p-1".to_owned(), e));
    let (mut presses, _) = Presses::restore(Instant::now(), lines, &[]);
    for replies in [1, 0] {
        let effects = presses.on(Instant::now(), Input::JobEnded(done("a-0001")));
        let told = effects.iter().filter(|e| matches!(e, Effect::Reply(..)));
        assert_eq!(told.count(), replies, "{effects:?}");
    }
}

#[test]
fn the_oldest_are_forgotten_but_for_those_that_somebody_follows() {
    let mut presses = presses();
    let end = |presses: &mut Presses, id: &str, capture: String| {
        let press = begin(presses, Some(id), &capture);
        taken(presses, press, Ok(1));
        let written = Input::Written(capture, Ok("/r/a.mcap".into()));
        presses.on(Instant::now(), written);
        press
    };
    let followed = end(&mut presses, "followed", "f".into());
    for i in 0..MOST_PRESSES + 5 {
        let press = end(&mut presses, &i.to_string(), format!("a-{i}"));
        presses.on(Instant::now(), Input::Left(press));
    }
    let sizes = [
        presses.presses.len(),
        presses.by_id.len(),
        presses.by_capture.len(),
    ];
    assert_eq!(sizes, [MOST_PRESSES; 3]);
    let (again, effects) = presses.ask(Instant::now(), press(Some("followed")));
    assert_eq!((again, &effects[..]), (followed, &[][..]));
    let (new, effects) = presses.ask(Instant::now(), press(Some("0")));
    assert!(effects.contains(&Effect::Begin(new)), "{effects:?}");
}

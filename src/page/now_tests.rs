//! What the sign says, from the daemon's events and status, over a time that the tests choose.

use super::*;

fn status(state: &str) -> Value {
    json!({ "cameras": { "c00": { "state": state, "words": "no answer" } },
        "captures_left": 7, "capture_bytes": 100 })
}

fn heard(now: &mut Now, line: &str, at: Instant) {
    now.hear(&serde_json::from_str(line).unwrap(), at);
}

fn ready(at: Instant) -> Now {
    let mut now = Now::default();
    now.set_listening(true);
    now.set_status(Some(status("ready")), at);
    now
}

#[test]
fn nothing_old_is_ready() {
    let begin = Instant::now();
    let mut now = Now::default();
    assert_eq!(now.sign(begin).0, Sign::Away);
    now.set_status(Some(status("ready")), begin);
    assert_eq!(now.sign(begin).0, Sign::Away, "events do not arrive");
    now.set_listening(true);
    assert_eq!(now.sign(begin).0, Sign::Ready);
    assert_eq!(now.sign(begin + FRESH).0, Sign::Away);
    now.set_status(Some(status("ready")), begin + FRESH);
    assert_eq!(now.sign(begin + FRESH).0, Sign::Ready);
    now.set_listening(false);
    assert_eq!(now.sign(begin + FRESH).0, Sign::Away);
}

#[test]
fn a_press_goes_through_its_signs_and_the_rig_is_ready_again() {
    let at = Instant::now();
    let mut now = ready(at);
    for (line, sign) in [
        (
            r#"{"type":"accepted","capture":"a-0001","subject":"7"}"#,
            Sign::Capturing,
        ),
        (
            r#"{"type":"captured","capture":"a-0001","skew_ns":1}"#,
            Sign::HandsMayMove,
        ),
        (
            r#"{"type":"durable","capture":"a-0001","recording":"/r/a.mcap"}"#,
            Sign::Safe,
        ),
        (
            r#"{"type":"done","capture":"a-0001","recording":"/r/a.mcap","verdict":"amber","reasons":["x"],"model":"/m/a/a-0001"}"#,
            Sign::Amber,
        ),
    ] {
        heard(&mut now, line, at);
        assert_eq!(now.sign(at).0, sign);
    }
    let snapshot = now.snapshot(at);
    assert_eq!(snapshot["reasons"][0], "x");
    assert_eq!(snapshot["recording"], "a", "where its report is");
    assert_eq!(snapshot["last"]["recording"], "a");
    assert_eq!(snapshot["last"]["subject"], "7");
    assert!(snapshot["last"]["decision"].is_null());
    for (kind, decision) in [
        ("reject", "rejected".into()),
        ("clear", serde_json::Value::Null),
    ] {
        let line = format!(r#"{{"type":"note","capture":"a-0001","kind":"{kind}"}}"#);
        heard(&mut now, &line, at);
        assert_eq!(now.snapshot(at)["last"]["decision"], decision);
    }
    let later = at + Duration::from_secs(30);
    now.set_status(Some(status("ready")), later);
    assert_eq!(now.sign(later).0, Sign::Ready);
    now.set_status(Some(status("away")), later);
    assert_eq!(now.sign(later).0, Sign::NotReady);
    assert_eq!(now.sign(later).2, ["c00: no answer"]);
}

#[test]
fn an_earlier_model_does_not_hide_a_capture_and_a_lost_daemon_ends_it() {
    let at = Instant::now();
    let mut now = ready(at);
    heard(&mut now, r#"{"type":"accepted","capture":"a-0002"}"#, at);
    let done = r#"{"type":"done","capture":"a-0001","verdict":"green","model":"/m/a/a-0001"}"#;
    heard(&mut now, done, at);
    assert_eq!(now.sign(at).0, Sign::Capturing);
    now.set_listening(false);
    now.set_listening(true);
    assert_eq!(now.sign(at).0, Sign::Ready);
    heard(&mut now, r#"{"type":"ending"}"#, at);
    assert_eq!(now.sign(at).0, Sign::Away);
}

#[test]
fn cameras_that_are_away_are_named_even_where_a_capture_is_taken_without_them() {
    let at = Instant::now();
    let mut now = ready(at);
    let mut told = |ready: bool, goes_on: bool, state: &str| {
        let mut status = status(state);
        status["ready"] = ready.into();
        status["goes_on_without_missing"] = goes_on.into();
        now.set_status(Some(status), at);
        now.sign(at)
    };
    assert_eq!(told(true, true, "ready").0, Sign::Ready);
    let without = told(true, true, "away");
    assert_eq!(without.0, Sign::ReadyWithout);
    assert_eq!(without.2, ["c00: no answer"]);
    assert_eq!(told(true, false, "away").0, Sign::NotReady);
    assert_eq!(told(false, true, "away").0, Sign::NotReady);
    assert_eq!(told(false, true, "ready").0, Sign::NotReady);
}

#[test]
fn a_full_disk_is_said_and_memory_is_bounded() {
    let at = Instant::now();
    let mut now = ready(at);
    let mut full = status("ready");
    full["captures_left"] = 0.into();
    now.set_status(Some(full), at);
    assert_eq!(now.sign(at).0, Sign::DiskFull);
    assert_eq!(now.snapshot(at)["daemon"]["captures_left"], 0);
    let mut unknown = status("ready");
    unknown["captures_left"] = 0.into();
    unknown["capture_bytes"] = 0.into();
    now.set_status(Some(unknown), at);
    assert_eq!(now.sign(at).0, Sign::Ready);
    assert!(now.snapshot(at)["daemon"]["captures_left"].is_null());
    for n in 0..3 * MOST_CAPTURES {
        let line = format!(r#"{{"type":"accepted","capture":"a-{n:04}"}}"#);
        heard(&mut now, &line, at);
    }
    assert_eq!(now.captures().count(), MOST_CAPTURES);
}

#[test]
fn what_becomes_known_of_an_earlier_capture_does_not_hide_the_one_that_is_exposing() {
    let begin = Instant::now();
    let mut now = ready(begin);
    let mut at = begin;
    let mut after = |now: &mut Now, line: &str| {
        at += Duration::from_millis(100);
        heard(now, line, at);
        (now.sign(at).0, now.sign(at).1)
    };
    after(&mut now, r#"{"type":"accepted","capture":"a-0001"}"#);
    after(
        &mut now,
        r#"{"type":"captured","capture":"a-0001","skew_ns":1}"#,
    );
    after(&mut now, r#"{"type":"accepted","capture":"a-0002"}"#);
    let durable = r#"{"type":"durable","capture":"a-0001","recording":"/r/a.mcap"}"#;
    let of_second = |sign| (sign, "a-0002".to_owned());
    assert_eq!(after(&mut now, durable), of_second(Sign::Capturing));
    assert_eq!(now.captures().next().unwrap().sign, Sign::Safe);
    // A failure is shown when the capture in progress has ended.
    let failed = r#"{"type":"failed","capture":"a-0001","reason":"the disk"}"#;
    assert_eq!(after(&mut now, failed), of_second(Sign::Capturing));
    let captured = r#"{"type":"captured","capture":"a-0002","skew_ns":1}"#;
    assert_eq!(after(&mut now, captured), of_second(Sign::HandsMayMove));
    let durable = r#"{"type":"durable","capture":"a-0002","recording":"/r/a.mcap"}"#;
    let of_first = |sign| (sign, "a-0001".to_owned());
    assert_eq!(after(&mut now, durable), of_first(Sign::Failed));
    let done = r#"{"type":"done","capture":"a-0002","verdict":"green","model":"/m/a/a-0002"}"#;
    assert_eq!(after(&mut now, done), of_second(Sign::Green));
}

#[test]
fn an_earlier_capture_does_not_answer_a_press_that_was_refused() {
    let begin = Instant::now();
    let mut now = ready(begin);
    heard(&mut now, r#"{"type":"accepted","capture":"a-0001"}"#, begin);
    let at = begin + Duration::from_millis(100);
    heard(&mut now, r#"{"type":"refused","reason":"full"}"#, at);
    let durable = r#"{"type":"durable","capture":"a-0001","recording":"/r/a.mcap"}"#;
    heard(&mut now, durable, at + Duration::from_millis(100));
    assert_eq!(now.sign(at + Duration::from_millis(100)).0, Sign::Failed);
}

#[test]
fn a_second_press_that_is_refused_is_other_news_than_the_first() {
    let begin = Instant::now();
    let mut now = ready(begin);
    assert!(now.snapshot(begin)["news"].is_null());
    let refused = r#"{"type":"refused","reason":"full"}"#;
    heard(&mut now, refused, begin);
    let first = now.snapshot(begin)["news"].clone();
    let at = begin + Duration::from_secs(1);
    assert_eq!(now.snapshot(at)["news"], first);
    heard(&mut now, refused, at);
    let second = now.snapshot(at)["news"].clone();
    assert!(first.is_u64() && second.is_u64() && first != second);
    let later = at + Sign::Failed.stays();
    now.set_status(Some(status("ready")), later);
    assert!(now.snapshot(later)["news"].is_null());
}

#[test]
fn nobody_is_told_to_press_again_where_no_press_can_succeed() {
    let at = Instant::now();
    let mut now = ready(at);
    heard(&mut now, r#"{"type":"accepted","capture":"a-0001"}"#, at);
    let failed = r#"{"type":"failed","capture":"a-0001","reason":"c00 sent nothing"}"#;
    heard(&mut now, failed, at);
    assert_eq!(now.sign(at).0, Sign::Failed);
    now.set_status(Some(status("away")), at);
    assert_eq!(now.sign(at).0, Sign::NotReady);
    let mut full = status("ready");
    full["captures_left"] = 0.into();
    now.set_status(Some(full), at);
    assert_eq!(now.sign(at).0, Sign::DiskFull);
    assert_eq!(now.snapshot(at)["last"]["reasons"][0], "c00 sent nothing");
}

#[test]
fn while_the_daemon_carries_out_an_order_it_is_not_ready() {
    let begin = Instant::now();
    let mut now = ready(begin);
    let mut busy = status("ready");
    busy["busy"] = true.into();
    now.set_status(Some(busy), begin);
    assert_eq!(now.sign(begin).0, Sign::Busy);
    // What was told before a capture ended says nothing of the time after it.
    let at = begin + Duration::from_millis(100);
    heard(&mut now, r#"{"type":"refused","reason":"full"}"#, at);
    assert_eq!(now.sign(at).0, Sign::Failed);
}

#[test]
fn an_attempt_that_was_taken_once_more_and_one_whose_end_was_not_heard_are_not_in_progress() {
    let at = Instant::now();
    let mut now = ready(at);
    heard(&mut now, r#"{"type":"accepted","capture":"a-0001"}"#, at);
    let retried = r#"{"type":"retried","capture":"a-0001","reason":"c00 lost data"}"#;
    heard(&mut now, retried, at);
    assert_eq!(now.sign(at).0, Sign::Capturing);
    heard(&mut now, r#"{"type":"accepted","capture":"a-0002"}"#, at);
    let signs = |now: &Now| now.captures().map(|seen| seen.sign).collect::<Vec<_>>();
    assert_eq!(signs(&now), [Sign::Retried, Sign::Capturing]);
    assert_eq!(now.captures().next().unwrap().reasons, ["c00 lost data"]);
    now.set_listening(false);
    assert_eq!(signs(&now), [Sign::Retried, Sign::OutcomeUnknown]);
}

#[test]
fn a_note_on_a_capture_makes_what_was_told_of_its_object_old() {
    let at = Instant::now();
    let later = at + Duration::from_secs(1);
    let mut now = ready(at);
    for line in [
        r#"{"type":"accepted","capture":"a-0001","subject":"7"}"#,
        r#"{"type":"durable","capture":"a-0001","recording":"/r/a.mcap"}"#,
        r#"{"type":"accepted","capture":"a-0002","subject":"7"}"#,
        r#"{"type":"durable","capture":"a-0002","recording":"/r/a.mcap"}"#,
        r#"{"type":"fused","subject":"7","capture":"a-0002","verdict":"green","reasons":[],"left_out":[],
            "model":"/m/a/7.object"}"#,
    ] {
        heard(&mut now, line, at);
    }
    let is_old = |now: &Now| now.snapshot(later)["object"]["fused"]["is_old"] == true;
    assert!(!is_old(&now));
    // Words change nothing; a reject does.
    let note =
        |kind: &str| format!(r#"{{"type":"note","capture":"a-0001","kind":"{kind}","text":"x"}}"#);
    heard(&mut now, &note("text"), later);
    assert!(!is_old(&now));
    heard(&mut now, &note("reject"), later);
    assert!(is_old(&now));
}

#[test]
fn captures_are_kept_for_a_later_process_and_none_is_shown_as_if_it_were_so_now() {
    let at = Instant::now() + OLDEST;
    let mut now = ready(at);
    for line in [
        r#"{"type":"accepted","capture":"a-0001","subject":"7"}"#,
        r#"{"type":"durable","capture":"a-0001","recording":"/r/a.mcap"}"#,
        r#"{"type":"note","capture":"a-0001","kind":"reject","text":""}"#,
        r#"{"type":"accepted","capture":"a-0002"}"#,
    ] {
        heard(&mut now, line, at);
    }
    let later = at + Duration::from_secs(10);
    let kept = serde_json::to_string(&now.kept(later)).unwrap();
    let restored = |ago: Duration| {
        let mut again = ready(later);
        again.restore(serde_json::from_str(&kept).unwrap(), ago, later);
        again
    };
    let again = restored(Duration::from_secs(5));
    assert_eq!(again.sign(later).0, Sign::Ready);
    let known: Vec<_> = again
        .captures()
        .map(|c| (c.capture.as_str(), c.recording.as_deref(), c.sign))
        .collect();
    assert_eq!(
        known,
        [
            ("a-0001", Some("a"), Sign::Safe),
            ("a-0002", None, Sign::OutcomeUnknown),
        ]
    );
    // Whoever took the reject back meanwhile was not heard.
    assert!(again.captures().all(|c| c.decision.is_none()));
    assert_eq!(again.snapshot(later)["last"]["age_ms"], 15_000);
    assert_eq!(restored(OLDEST).captures().count(), 0);
}

#[test]
fn what_was_missed_is_told_neither_as_the_last_capture_nor_as_a_decision() {
    let at = Instant::now();
    let mut now = ready(at);
    for line in [
        r#"{"type":"accepted","capture":"a-0001"}"#,
        r#"{"type":"durable","capture":"a-0001","recording":"/r/a.mcap"}"#,
        r#"{"type":"note","capture":"a-0001","kind":"accept","text":""}"#,
    ] {
        heard(&mut now, line, at);
    }
    let last = |now: &Now| {
        let snapshot = now.snapshot(at);
        let last = &snapshot["last"];
        json!([last["is_last"], last["decision"]])
    };
    assert_eq!(last(&now), json!([true, "accepted"]));
    now.set_listening(false);
    now.set_listening(true);
    assert_eq!(last(&now), json!([false, null]));
    // A capture whose beginning was missed is not in the list.
    let done = r#"{"type":"done","capture":"a-0002","verdict":"green","model":"/m/a/a-0002"}"#;
    heard(&mut now, done, at);
    assert_eq!(last(&now)[0], false);
    heard(&mut now, r#"{"type":"accepted","capture":"a-0003"}"#, at);
    assert_eq!(last(&now)[0], true);
    let kept = now.kept(at);
    let mut again = ready(at);
    again.restore(kept, Duration::ZERO, at);
    assert_eq!(last(&again)[0], false);
}

#[test]
fn what_models_are_made_with_reaches_browsers() {
    let at = Instant::now();
    let mut now = ready(at);
    let mut told = status("ready");
    told["models"] = json!({ "waiting": 0, "settings": { "hull.resolution": 80.0 } });
    now.set_status(Some(told), at);
    let shown = now.snapshot(at);
    let settings = &shown["daemon"]["models"]["settings"];
    assert_eq!(settings["hull.resolution"], 80.0);
}

//! Tests taking backgrounds of the empty rig: where they are kept, and what becomes of cameras that give none.

use super::capturing::Order;
use super::scripted::{Behaviour, recordings, start, start_in};
use crate::frame::CameraId;
use crate::recording::{ColorPart, Topic};
use crate::trigger::Reply;

#[test]
fn backgrounds_are_kept_known_after_a_restart_and_in_every_recording() {
    let stand = start(|_| ());
    assert_eq!(stand.capturing.status().plates_age_h, None);
    let words = stand.ask(Order::Background).unwrap();
    assert!(words.contains("3 background pictures"), "{words}");
    stand.behaviour("c00", Behaviour::Loses);
    let refused = stand.ask(Order::Background).unwrap_err();
    assert!(refused.contains("c00"), "{refused}");
    let (folder, _) = stand.stop();
    let stand = start_in(folder, 4_000_000, |_| ());
    stand.until(|s| s.plates_age_h.is_some_and(|age| (0.0..0.1).contains(&age)));
    assert!(matches!(stand.press().last(), Some(Reply::Durable { .. })));
    let (folder, _) = stand.stop();
    let found = &recordings(folder.path())[0];
    for name in ["c00", "c01", "c02"] {
        let topic = Topic::Color(CameraId::new(name).unwrap(), ColorPart::Background);
        let message = found.messages(&topic)[0];
        assert!(message.log_time() < found.messages(&Topic::Trigger)[0].log_time());
        found.picture(&topic, &message).unwrap();
    }
}

#[test]
fn where_captures_go_on_without_a_camera_its_earlier_background_stays() {
    let stand = start(|plan| plan.sync.go_on_without_missing = true);
    let words = stand.ask(Order::Background).unwrap();
    assert!(!words.contains("no new picture"), "{words}");
    stand.behaviour("c00", Behaviour::Loses);
    let words = stand.ask(Order::Background).unwrap();
    assert!(words.contains("2 background pictures"), "{words}");
    assert!(
        words.ends_with("; there is no new picture of c00"),
        "{words}"
    );
    stand.until(|s| s.plates_age_h.is_some());
    for name in ["c01", "c02"] {
        stand.behaviour(name, Behaviour::Loses);
    }
    let refused = stand.ask(Order::Background).unwrap_err();
    assert!(
        refused.contains("no colour camera gave a picture"),
        "{refused}"
    );
    for name in ["c00", "c01", "c02"] {
        stand.behaviour(name, Behaviour::Sound);
    }
    assert!(matches!(stand.press().last(), Some(Reply::Durable { .. })));
    let (folder, _) = stand.stop();
    let found = &recordings(folder.path())[0];
    for name in ["c00", "c01", "c02"] {
        let topic = Topic::Color(CameraId::new(name).unwrap(), ColorPart::Background);
        assert_eq!(found.messages(&topic).len(), 1, "{name}");
    }
}

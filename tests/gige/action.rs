//! Scheduled action commands: a small camera of the test's own stands in front of the simulator's, forwards its
//! control protocol, and does what the simulator cannot do.

use crate::description::{self, LISTENING, PTP_ENABLE, PTP_STATUS, SLAVE};
use crate::network::alone_without_raw_sockets;
use crate::stand::{Stand, id, milliseconds_after};
use scand::drivers::aravis::{Acknowledgement, ActionCommand, Message, Parameters, TriggerMode};
use scand_lab::serve::ColorOptions;
use std::collections::HashMap;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

const AT: Ipv4Addr = Ipv4Addr::new(127, 0, 1, 100);

/// Passes control on to camera `c00`, and obeys action commands in its place.
struct Relay<'a> {
    stand: &'a Stand,
    socket: UdpSocket,
    ended: AtomicBool,
    obeyed: Mutex<Vec<ActionCommand>>,
}

impl Relay<'_> {
    fn run(&self) {
        let socket = &self.socket;
        let patience = Some(Duration::from_millis(50));
        socket.set_read_timeout(patience).unwrap();
        let mut clients: HashMap<SocketAddr, UdpSocket> = HashMap::new();
        let mut packet = [0; 2048];
        std::thread::scope(|scope| {
            while !self.ended.load(Ordering::Relaxed) {
                let Ok((length, from)) = socket.recv_from(&mut packet) else {
                    continue;
                };
                let message = Message::decode(&packet[..length]);
                if let Some((message, command)) =
                    message.and_then(|m| ActionCommand::of_message(&m).map(|c| (m, c)))
                {
                    let answer = Acknowledgement {
                        status: 0,
                        command: message.command + 1,
                        request: message.request,
                        payload: Vec::new(),
                    };
                    socket.send_to(&answer.encode(), from).unwrap();
                    self.obeyed.lock().unwrap().push(command);
                    scope.spawn(move || self.expose(command));
                    continue;
                }
                let camera = clients.entry(from).or_insert_with(|| {
                    let camera = UdpSocket::bind((AT, 0)).unwrap();
                    camera.connect(("127.0.1.1", 3956)).unwrap();
                    camera
                        .set_read_timeout(Some(Duration::from_millis(300)))
                        .unwrap();
                    camera
                });
                camera.send(&packet[..length]).unwrap();
                if let Ok(length) = camera.recv(&mut packet) {
                    socket.send_to(&packet[..length], from).unwrap();
                }
            }
        });
    }

    /// Exposes at the time of the camera's clock.
    fn expose(&self, command: ActionCommand) {
        let now = self.stand.rig.clock_ns(&id("c00")).unwrap();
        let left = command
            .at_ns
            .unwrap()
            .checked_sub(now)
            .expect("not too late");
        std::thread::sleep(Duration::from_nanos(left));
        assert!(self.stand.rig.pulse_line(&id("c00")));
    }
}

/// Ends the relay, also when the test fails.
struct End<'a>(&'a AtomicBool);

impl Drop for End<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[test]
fn cameras_expose_at_the_time_that_they_were_told() {
    alone_without_raw_sockets(
        "action::cameras_expose_at_the_time_that_they_were_told",
        || {
            let folder = tempfile::tempdir().unwrap();
            let options = ColorOptions {
                features: Some(description::write(folder.path())),
                ..ColorOptions::default()
            };
            let stand = Stand::with([64, 48], options);
            stand.rig.set_register(&id("c00"), PTP_STATUS, LISTENING);
            let relay = Relay {
                stand: &stand,
                socket: UdpSocket::bind((AT, 3956)).unwrap(),
                ended: AtomicBool::new(false),
                obeyed: Mutex::default(),
            };
            std::thread::scope(|scope| {
                let _end = End(&relay.ended);
                scope.spawn(|| relay.run());
                shoot_at_times(&relay);
            });
        },
    );
}

fn shoot_at_times(relay: &Relay<'_>) {
    let stand = relay.stand;
    let camera = id("c00");
    let parameters = Parameters {
        address: Some(AT),
        trigger: Some(TriggerMode::Action),
        action_device_key: Some(0x1234),
        action_group_key: Some(7),
        action_group_mask: Some(2),
        action_lead: Some(0.2),
        packet_size: Some(8000),
        ..Parameters::default()
    };
    let mut device = stand.open("c00", parameters).unwrap();
    assert_eq!(stand.rig.register(&camera, PTP_ENABLE), Some(1));
    for (register, value) in [
        (description::ACTION_DEVICE_KEY, 0x1234),
        (description::ACTION_GROUP_KEY, 7),
        (description::ACTION_GROUP_MASK, 2),
    ] {
        assert_eq!(stand.rig.register(&camera, register), Some(value));
    }
    // Its clock does not follow the network's yet: nothing can be scheduled.
    let (_, frames, stats) = stand.shoot(device.as_mut(), 1);
    let stats = stats.unwrap();
    assert!(
        frames.is_empty() && stats.lost[0].contains("Listening"),
        "{stats:?}"
    );
    assert!(relay.obeyed.lock().unwrap().is_empty());
    stand.rig.set_register(&camera, PTP_STATUS, SLAVE);
    for number in 2..5 {
        let (shot, frames, stats) = stand.shoot(device.as_mut(), number);
        assert_eq!(frames.len(), 1, "{stats:?}");
        assert!(stand.is_picture(&frames[0], 0, number as usize - 2));
        let after = milliseconds_after(&shot, &frames[0]);
        assert!(
            (198.0..350.0).contains(&after),
            "exposed {after} ms after the trigger"
        );
        assert_eq!(stats.unwrap().remarks, ["PTP: Slave, 0 ns from its master"]);
    }
    // The upper half of 41.5 as it lies in a register of eight bytes.
    let upper = (41.5_f64.to_bits() >> 32) as u32;
    stand
        .rig
        .set_register(&camera, description::TEMPERATURE, upper);
    let told = [
        ["temperature", "41.5 °C"],
        ["PTP", "Slave, 0 ns from its master"],
    ];
    assert_eq!(device.health(), told);
    stand
        .rig
        .set_register(&camera, description::PTP_OFFSET, -200_000_i32 as u32);
    let (_, frames, stats) = stand.shoot(device.as_mut(), 5);
    assert!(frames.is_empty() && stats.unwrap().lost[0].contains("-200000 ns"));
    let obeyed = relay.obeyed.lock().unwrap();
    assert_eq!(obeyed.len(), 3);
    assert!(
        obeyed
            .iter()
            .all(|c| (c.device_key, c.group_key, c.group_mask) == (0x1234, 7, 2))
    );
}

//! Action commands (GigE Vision 2.0, 14.3.1 and 16.4.1), which mean "expose at this time of our common clock". Aravis
//! cannot send them, so this file makes the packet. It also chooses the time for all cameras of one group.

use super::gvcp::{self, Acknowledgement, Message};
use parking_lot::Mutex;
use std::io;
use std::net::SocketAddrV4;
use std::sync::Arc;
use std::time::{Duration, Instant};

const ACTION: u16 = 0x0100;
const SCHEDULED: u8 = 0x80;
/// The status of a command whose time has passed, and of one that finds the camera's queue full. After a repetition,
/// the command before it may be what it is late for, or what fills the queue.
const AFTER_REPETITION: [u16; 2] = [0x8016, 0x8015];

/// What makes cameras expose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ActionCommand {
    /// Only cameras with this key obey.
    pub device_key: u32,
    /// Of those the ones whose action has this key,
    pub group_key: u32,
    /// and whose mask has a bit of this one.
    pub group_mask: u32,
    /// When, in nanoseconds of the cameras' clock; `None` is at once.
    pub at_ns: Option<u64>,
}

impl ActionCommand {
    /// Its packet.
    pub fn message(&self, request: u16) -> Message {
        let mut payload = Vec::with_capacity(20);
        for word in [self.device_key, self.group_key, self.group_mask] {
            payload.extend(word.to_be_bytes());
        }
        payload.extend(self.at_ns.iter().flat_map(|ns| ns.to_be_bytes()));
        Message {
            flags: if self.at_ns.is_some() { SCHEDULED } else { 0 },
            command: ACTION,
            request,
            payload,
        }
    }

    /// Reads a packet; `None` if it is another command.
    pub fn of_message(message: &Message) -> Option<Self> {
        let scheduled = message.flags & SCHEDULED != 0;
        let expected = if scheduled { 20 } else { 12 };
        if message.command != ACTION || message.payload.len() != expected {
            return None;
        }
        let word = |at: usize| {
            let bytes = message.payload[at..].first_chunk::<4>();
            bytes.map(|b| u32::from_be_bytes(*b))
        };
        let time = message.payload.get(12..).and_then(<[u8]>::first_chunk::<8>);
        Some(Self {
            device_key: word(0)?,
            group_key: word(4)?,
            group_mask: word(8)?,
            at_ns: time.map(|b| u64::from_be_bytes(*b)),
        })
    }
}

/// How long one attempt waits for its acknowledgement, if the action is `lead` ahead: so short that the attempts after
/// it come before the action, and long enough for a camera to answer.
pub fn attempt_patience(lead: Duration) -> Duration {
    (lead / 4).clamp(Duration::from_millis(2), Duration::from_millis(50))
}

/// Sends an action command to one camera and waits for its acknowledgement, three times for `patience` at most. Where
/// one may have been lost, the camera may obey all the same: returns why that is not known.
///
/// # Errors
/// In words, if the camera declines.
pub fn send_action(
    to: SocketAddrV4,
    command: &ActionCommand,
    request: u16,
    patience: Duration,
) -> Result<Option<String>, String> {
    let begin = Instant::now();
    match gvcp::ask(to, &command.message(request), patience) {
        Ok(Acknowledgement { status: 0, .. }) => Ok(None),
        Ok(answer) => {
            let words = format!(
                "it declined the action command with {}",
                gvcp::status_words(answer.status)
            );
            let was_repeated = begin.elapsed() >= patience;
            match AFTER_REPETITION.contains(&answer.status) && was_repeated {
                true => Ok(Some(words)),
                false => Err(words),
            }
        }
        Err(e) if e.kind() == io::ErrorKind::TimedOut => {
            Ok(Some("it did not acknowledge the action command".into()))
        }
        Err(e) => Err(format!("the action command could not be sent: {e}")),
    }
}

/// The time that the cameras of a group have agreed on for a shot; clones share it.
#[derive(Debug, Clone, Default)]
pub struct ActionGroup {
    agreed: Arc<Mutex<Option<(u64, u64)>>>,
}

impl ActionGroup {
    /// The time of a shot in nanoseconds of the cameras' clock: what the first camera that asks proposes.
    pub fn agree(&self, shot: u64, proposed_ns: u64) -> u64 {
        let mut agreed = self.agreed.lock();
        match *agreed {
            Some((number, at)) if number == shot => at,
            _ => {
                *agreed = Some((shot, proposed_ns));
                proposed_ns
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
    use std::thread::JoinHandle;

    const COMMAND: ActionCommand = ActionCommand {
        device_key: 0x0102_0304,
        group_key: 5,
        group_mask: 0xffff_0000,
        at_ns: Some(0x1122_3344_5566_7788),
    };

    #[test]
    fn the_packet_is_the_standards() {
        let packet = COMMAND.message(9).encode();
        let header = [0x42, 0x81, 0x01, 0x00, 0, 20, 0, 9];
        let keys = [1, 2, 3, 4, 0, 0, 0, 5, 0xff, 0xff, 0, 0];
        let time = [0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77, 0x88];
        assert_eq!(packet, [&header[..], &keys, &time].concat());
        let read = Message::decode(&packet).unwrap();
        assert_eq!(ActionCommand::of_message(&read), Some(COMMAND));
        let at_once = ActionCommand {
            at_ns: None,
            ..COMMAND
        };
        let packet = at_once.message(1).encode();
        assert_eq!((packet.len(), packet[1]), (20, 0x01));
        assert_eq!(
            ActionCommand::of_message(&Message::decode(&packet).unwrap()),
            Some(at_once)
        );
    }

    /// A camera that hears `deaf` packets not, then answers with `status`; what it was told.
    fn peer(deaf: usize, status: u16) -> (SocketAddrV4, JoinHandle<Vec<ActionCommand>>) {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let SocketAddr::V4(address) = socket.local_addr().unwrap() else {
            panic!("an IPv4 socket has an IPv4 address")
        };
        let thread = std::thread::spawn(move || {
            let mut heard = Vec::new();
            let mut packet = [0; 64];
            loop {
                let (length, from) = socket.recv_from(&mut packet).unwrap();
                let message = Message::decode(&packet[..length]).unwrap();
                heard.push(ActionCommand::of_message(&message).unwrap());
                if heard.len() > deaf {
                    let mut answer = Acknowledgement {
                        status,
                        command: ACTION + 1,
                        request: message.request + 1,
                        payload: Vec::new(),
                    };
                    // An answer to something else comes first.
                    socket.send_to(&answer.encode(), from).unwrap();
                    answer.request = message.request;
                    socket.send_to(&answer.encode(), from).unwrap();
                    return heard;
                }
            }
        });
        (address, thread)
    }

    const PATIENCE: Duration = Duration::from_millis(50);
    const TOO_LATE: u16 = AFTER_REPETITION[0];
    const QUEUE_FULL: u16 = AFTER_REPETITION[1];

    #[test]
    fn a_command_is_sent_again_until_it_is_acknowledged() {
        let (address, thread) = peer(2, 0);
        assert_eq!(send_action(address, &COMMAND, 3, PATIENCE), Ok(None));
        assert_eq!(thread.join().unwrap(), [COMMAND; 3]);
    }

    #[test]
    fn attempts_come_before_the_action() {
        for (lead_ms, expected_ms) in [(20, 5), (100, 25), (1000, 50), (1, 2)] {
            let patience = attempt_patience(Duration::from_millis(lead_ms));
            assert_eq!(patience, Duration::from_millis(expected_ms));
        }
    }

    #[test]
    fn what_the_camera_answers_is_told() {
        // A patience that a busy machine does not use up.
        let long = Duration::from_secs(10);
        let (address, thread) = peer(0, TOO_LATE);
        let why = send_action(address, &COMMAND, 3, long).unwrap_err();
        assert!(why.contains("too late"), "{why}");
        thread.join().unwrap();
    }

    #[test]
    fn a_camera_may_have_obeyed_where_an_acknowledgement_may_be_lost() {
        for (status, words) in [(TOO_LATE, "too late"), (QUEUE_FULL, "full")] {
            let (address, thread) = peer(1, status);
            let doubt = send_action(address, &COMMAND, 3, PATIENCE).unwrap();
            let doubt = doubt.unwrap();
            assert!(doubt.contains(words), "{doubt}");
            assert_eq!(thread.join().unwrap(), [COMMAND; 2]);
        }
        let silent = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let SocketAddr::V4(address) = silent.local_addr().unwrap() else {
            panic!("an IPv4 socket has an IPv4 address")
        };
        let doubt = send_action(address, &COMMAND, 4, PATIENCE).unwrap();
        assert!(doubt.unwrap().contains("did not acknowledge"));
    }

    #[test]
    fn cameras_of_a_group_agree_on_one_time() {
        let group = ActionGroup::default();
        let other = group.clone();
        assert_eq!(group.agree(1, 500), 500);
        assert_eq!(other.agree(1, 700), 500);
        assert_eq!(other.agree(2, 900), 900);
        assert_eq!(group.agree(2, 950), 900);
    }
}

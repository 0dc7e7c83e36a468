//! The few messages of the GigE Vision control protocol (GVCP, GigE Vision 2.0, chapters 14 to 16) that the library
//! does not send for us: discovery and the action command. Packs and parses their bytes, and does one exchange over
//! UDP with a deadline.

use std::io;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::time::{Duration, Instant};

/// Every GigE Vision camera listens here.
pub(super) const PORT: u16 = 3956;

const KEY: u8 = 0x42;
const ACKNOWLEDGE: u8 = 0x01;
const DISCOVERY: u16 = 0x0002;

/// A command, as it is sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// Flags of the command in addition to "acknowledge", which is always set.
    pub flags: u8,
    /// Which command.
    pub command: u16,
    /// The number of the request, from 1.
    pub request: u16,
    /// What follows the header.
    pub payload: Vec<u8>,
}

/// An acknowledgement.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Acknowledgement {
    /// 0 is success.
    pub status: u16,
    /// The command's number plus 1.
    pub command: u16,
    /// The request that is answered.
    pub request: u16,
    /// What follows the header.
    pub payload: Vec<u8>,
}

impl Message {
    /// The bytes of its packet.
    pub fn encode(&self) -> Vec<u8> {
        let head = [KEY, self.flags | ACKNOWLEDGE];
        packet(head, self.command, self.request, &self.payload)
    }

    /// Parses a packet; `None` if it is not a command.
    pub fn decode(packet: &[u8]) -> Option<Self> {
        let ([key, flags], command, request, payload) = parts(packet)?;
        (key == KEY).then(|| Self {
            flags: flags & !ACKNOWLEDGE,
            command,
            request,
            payload: payload.to_vec(),
        })
    }
}

impl Acknowledgement {
    /// The bytes of its packet.
    pub fn encode(&self) -> Vec<u8> {
        let head = self.status.to_be_bytes();
        packet(head, self.command, self.request, &self.payload)
    }

    /// Parses a packet; `None` if it is not an acknowledgement.
    pub fn decode(packet: &[u8]) -> Option<Self> {
        let (head, command, request, payload) = parts(packet)?;
        Some(Self {
            status: u16::from_be_bytes(head),
            command,
            request,
            payload: payload.to_vec(),
        })
    }
}

/// A packet: two bytes, by which commands and acknowledgements differ, the command, the payload's length, the request's
/// number and the payload.
fn packet(head: [u8; 2], command: u16, request: u16, payload: &[u8]) -> Vec<u8> {
    let words = [command, payload.len() as u16, request].map(u16::to_be_bytes);
    [&head, words.as_flattened(), payload].concat()
}

/// What a packet consists of, but for its length; `None` if it is not as long as it says.
fn parts(packet: &[u8]) -> Option<([u8; 2], u16, u16, &[u8])> {
    let (header, payload) = packet.split_first_chunk::<8>()?;
    let word = |at: usize| u16::from_be_bytes([header[at], header[at + 1]]);
    let whole = usize::from(word(4)) == payload.len();
    whole.then_some(([header[0], header[1]], word(2), word(6), payload))
}

/// What a status means (GigE Vision 2.0, table 19-1).
pub(super) fn status_words(status: u16) -> String {
    let words = match status {
        0x0000 => "success",
        0x8001 => "not implemented",
        0x8002 => "invalid parameter",
        0x8003 => "invalid address",
        0x8004 => "write protected",
        0x8006 => "access denied",
        0x8007 => "busy",
        0x8013 => "the camera has no reference time",
        0x8015 => "its queue of actions is full",
        0x8016 => "the action came too late",
        _ => return format!("status 0x{status:04x}"),
    };
    format!("status 0x{status:04x}: {words}")
}

/// Sends a command and waits for its answer; sent again twice when none comes.
///
/// # Errors
/// If the network refuses, or no answer comes within three times `patience`.
pub(super) fn ask(
    to: SocketAddrV4,
    message: &Message,
    patience: Duration,
) -> io::Result<Acknowledgement> {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
    socket.connect(to)?;
    let packet = message.encode();
    for _ in 0..3 {
        socket.send(&packet)?;
        if let Some(answer) = receive(&socket, message, patience)? {
            return Ok(answer);
        }
    }
    Err(io::ErrorKind::TimedOut.into())
}

/// The answer to `message`, if it comes in time; what is something else is passed over.
fn receive(
    socket: &UdpSocket,
    message: &Message,
    patience: Duration,
) -> io::Result<Option<Acknowledgement>> {
    let until = Instant::now() + patience;
    let mut packet = [0; 1024];
    loop {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Ok(None);
        }
        socket.set_read_timeout(Some(left))?;
        let length = match socket.recv(&mut packet) {
            Ok(length) => length,
            Err(e)
                if matches!(
                    e.kind(),
                    io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut
                ) =>
            {
                return Ok(None);
            }
            Err(e) => return Err(e),
        };
        let answer = Acknowledgement::decode(&packet[..length]);
        let matching =
            answer.filter(|a| a.request == message.request && a.command == message.command + 1);
        if matching.is_some() {
            return Ok(matching);
        }
    }
}

/// Who a camera is, as it says itself.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Identity {
    /// Who made it.
    pub vendor: String,
    /// Its model.
    pub model: String,
    /// Version of its firmware.
    pub version: String,
    /// Its serial number.
    pub serial: String,
    /// The name that a user gave it.
    pub name: String,
}

impl Identity {
    /// Reads the payload of a discovery's answer: the first bootstrap registers.
    pub fn decode(payload: &[u8]) -> Option<Self> {
        let text = |at: usize, length: usize| {
            let bytes = payload.get(at..at + length)?;
            let end = bytes.iter().position(|&b| b == 0).unwrap_or(length);
            Some(String::from_utf8_lossy(&bytes[..end]).trim().to_owned())
        };
        Some(Self {
            vendor: text(0x48, 32)?,
            model: text(0x68, 32)?,
            version: text(0x88, 32)?,
            serial: text(0xd8, 16)?,
            name: text(0xe8, 16)?,
        })
    }
}

/// Asks the camera at an address to identify itself.
///
/// # Errors
/// If there is no answer within about half a second, or one that makes no sense.
pub fn identify(address: Ipv4Addr) -> io::Result<Identity> {
    let message = Message {
        flags: 0,
        command: DISCOVERY,
        request: 1,
        payload: Vec::new(),
    };
    let answer = ask(
        SocketAddrV4::new(address, PORT),
        &message,
        Duration::from_millis(170),
    )?;
    Identity::decode(&answer.payload).ok_or_else(|| io::ErrorKind::InvalidData.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn packets_survive_the_wire(
            flags in any::<u8>(), command: u16, request: u16, payload: Vec<u8>,
        ) {
            let flags = flags & !ACKNOWLEDGE;
            let message = Message { flags, command, request, payload: payload.clone() };
            prop_assert_eq!(Message::decode(&message.encode()), Some(message));
            let answer = Acknowledgement { status: request, command, request, payload };
            prop_assert_eq!(Acknowledgement::decode(&answer.encode()), Some(answer));
        }

        #[test]
        fn any_bytes_are_read_without_harm(bytes: Vec<u8>) {
            let _ = Message::decode(&bytes);
            let _ = Acknowledgement::decode(&bytes);
            let _ = Identity::decode(&bytes);
        }
    }

    #[test]
    fn a_discovery_looks_as_the_standard_wants_it() {
        let message = Message {
            flags: 0,
            command: DISCOVERY,
            request: 1,
            payload: Vec::new(),
        };
        assert_eq!(message.encode(), [0x42, 0x01, 0, 2, 0, 0, 0, 1]);
    }
}

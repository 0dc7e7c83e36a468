//! The address of a fleet's server, in a configuration and on a command line. It has no user and no password: those are
//! in files of their own, because each recording carries the configuration of its rig.

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::net::IpAddr;
use std::str::FromStr;

/// Where a NATS server listens.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FleetAddress {
    encrypted: bool,
    host: String,
    port: u16,
}

/// Why an address is refused. Never quotes it, because it may hold a password.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AddressError {
    /// It has a user or a password.
    #[error(
        "the address has a user or a password in it, which every recording would carry: put them into a file \
         (--credentials), and give nats://HOST:PORT"
    )]
    Secret,
    /// It is not an address of a server.
    #[error("expected nats://HOST or tls://HOST, with :PORT if it is not 4222")]
    Form,
}

impl FleetAddress {
    /// The port of a server that was told none.
    const PORT: u16 = 4222;

    /// Whether it asks for TLS.
    pub fn is_encrypted(&self) -> bool {
        self.encrypted
    }

    /// Whether it is this machine's own.
    pub fn is_loopback(&self) -> bool {
        let host = self.host.trim_start_matches('[').trim_end_matches(']');
        let address: Option<IpAddr> = host.parse().ok();
        host == "localhost" || address.is_some_and(|address| address.is_loopback())
    }
}

impl FromStr for FleetAddress {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        let (scheme, rest) = text.split_once("://").unwrap_or(("", text));
        if rest.contains('@') {
            return Err(AddressError::Secret);
        }
        let encrypted = match scheme {
            "nats" => false,
            "tls" => true,
            _ => return Err(AddressError::Form),
        };
        let bracketed = rest.find(']').map_or(0, |end| end + 1);
        let (host, port) = match rest[bracketed..].rfind(':') {
            Some(colon) => rest.split_at(bracketed + colon),
            None => (rest, ""),
        };
        let port = match port.strip_prefix(':') {
            Some(port) => port.parse().map_err(|_| AddressError::Form)?,
            None => Self::PORT,
        };
        let inner = host.strip_prefix('[').and_then(|h| h.strip_suffix(']'));
        let is_name = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_');
        let is_good = match inner {
            Some(inner) => inner.parse::<std::net::Ipv6Addr>().is_ok(),
            None => !host.is_empty() && host.chars().all(is_name),
        };
        is_good
            .then(|| Self {
                encrypted,
                host: host.to_owned(),
                port,
            })
            .ok_or(AddressError::Form)
    }
}

impl fmt::Display for FleetAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = if self.encrypted { "tls" } else { "nats" };
        write!(f, "{scheme}://{}:{}", self.host, self.port)
    }
}

impl<'de> Deserialize<'de> for FleetAddress {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let text = String::deserialize(from)?;
        text.parse().map_err(serde::de::Error::custom)
    }
}

impl Serialize for FleetAddress {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.collect_str(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_has_a_host_and_no_secret() {
        let show = |text: &str| text.parse::<FleetAddress>().unwrap().to_string();
        assert_eq!(
            show("nats://fleet.museum.example"),
            "nats://fleet.museum.example:4222"
        );
        assert_eq!(show("tls://10.0.0.7:5222"), "tls://10.0.0.7:5222");
        assert_eq!(show("nats://[::1]:9"), "nats://[::1]:9");
        for text in [
            "nats://me:secret@host",
            "tls://token@host:1",
            "me:secret@host",
        ] {
            let error = text.parse::<FleetAddress>().unwrap_err();
            assert_eq!(error, AddressError::Secret);
            assert!(!error.to_string().contains("secret"));
        }
        for text in [
            "",
            "host",
            "http://host",
            "nats://",
            "nats://a b",
            "nats://h:x",
            "nats://[::1",
            "nats://h/p",
        ] {
            assert_eq!(
                text.parse::<FleetAddress>(),
                Err(AddressError::Form),
                "{text}"
            );
        }
    }

    #[test]
    fn this_machine_is_known_by_its_names() {
        let local = |text: &str| text.parse::<FleetAddress>().unwrap().is_loopback();
        for text in [
            "nats://localhost",
            "nats://127.0.0.1:1",
            "nats://127.3.2.1",
            "tls://[::1]:4222",
        ] {
            assert!(local(text), "{text}");
        }
        for text in [
            "nats://10.0.0.1",
            "nats://localhost.example",
            "nats://[fe80::1]",
        ] {
            assert!(!local(text), "{text}");
        }
    }
}

//! What an administrator can configure of the page, read from a file of its own: a recording carries a copy of the
//! rig's configuration, and a recording must not say who may look at a page.

use super::origin::Origins;
use super::tls::TlsParameters;
use crate::{range, storage};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Where the configuration of an installed page lies. Without this file the defaults hold.
pub const DEFAULT_CONFIGURATION: &str = "/etc/scand/page.toml";

/// Largest file that is read, in bytes.
const LARGEST_FILE: u64 = 64 << 10;

/// The page's configuration; config/page.toml shows it.
#[derive(Clone, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// The address and port that the page listens on; one of loopback without `tls`. Default `127.0.0.1:8437`.
    pub listen: SocketAddr,
    /// The administrator's certificate. Default none: the page without TLS.
    pub tls: Option<TlsParameters>,
    /// How browsers reach the page, such as `https://rig.example`. Default none: under `localhost` and the address of
    /// `listen`.
    pub origins: Vec<String>,
    /// The addresses of reverse proxies in front of the page, or `localhost`. `X-Forwarded-For` counts from these
    /// alone. Default none.
    pub proxy: Vec<String>,
    /// What the page calls the rig. Default empty.
    pub rig: String,
    /// The daemon's socket. Default `/run/scand/scand.sock`.
    pub socket: PathBuf,
    /// The folder of models. Default `/var/lib/scand/models`.
    pub models: PathBuf,
    /// The folder of recordings, for the photographs of captures. Default `/var/lib/scand/recordings`.
    pub recordings: PathBuf,
    /// The folder of the page's own state, which only its user can read. Default `/var/lib/scand-page`.
    pub state: PathBuf,
    /// The folder of small forms of models' files, which may be removed at any time. Default `/var/cache/scand-page`.
    pub cache: PathBuf,
    /// The socket on which `scand page pair` and `revoke` ask. Default `/run/scand-page/control.sock`.
    pub control: PathBuf,
    /// How long an operator's session lasts, in hours, 1 to 744. Default 12.
    #[serde(deserialize_with = "range::count::<_, _, 1, 744>")]
    pub operator_hours: u32,
    /// How long a viewer's session lasts, in hours, 1 to 8784. Default 720.
    #[serde(deserialize_with = "range::count::<_, _, 1, 8784>")]
    pub viewer_hours: u32,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 8437)),
            tls: None,
            origins: Vec::new(),
            proxy: Vec::new(),
            rig: String::new(),
            socket: crate::trigger::SOCKET.into(),
            models: "/var/lib/scand/models".into(),
            recordings: "/var/lib/scand/recordings".into(),
            state: "/var/lib/scand-page".into(),
            cache: "/var/cache/scand-page".into(),
            control: "/run/scand-page/control.sock".into(),
            operator_hours: 12,
            viewer_hours: 720,
        }
    }
}

/// Why a configuration is refused.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Error {
    /// The file cannot be read.
    #[error("configuration {}: {cause}", path.display())]
    Read {
        path: PathBuf,
        cause: std::io::Error,
    },
    /// It is not what it should be.
    #[error("configuration {}: {cause}", path.display())]
    Parse {
        path: PathBuf,
        cause: toml::de::Error,
    },
    /// The address is one of the network.
    #[error(
        "listen is {0}, expected an address of loopback, such as 127.0.0.1:8437: from other computers the page is reached \
         with TLS, by a certificate (`tls`) or through a reverse proxy (docs/page.md)"
    )]
    NotLoopback(SocketAddr),
    /// TLS under a name that browsers do not know.
    #[error(
        "origins is empty, expected the names of the certificate, such as https://rig.example, because `tls` is set"
    )]
    NoOrigin,
    /// TLS and an origin without.
    #[error("origins: {0:?} is http, expected https, because `tls` is set")]
    NoTls(String),
    /// A proxy that is not named by its address.
    #[error(
        "proxy is {0:?}, expected an address, such as 127.0.0.1, or localhost: a computer that another name leads to could \
         pretend to be the proxy, and name any client it likes"
    )]
    Proxy(String),
    /// An origin that is refused.
    #[error("origins: {0}")]
    Origin(String),
}

impl Parameters {
    /// Reads the configuration of a file, or the default one without a file.
    ///
    /// # Errors
    /// If the file cannot be read, has an unknown key, or a value that is refused.
    pub fn load(path: Option<&Path>) -> Result<Self, Error> {
        let parameters = match path {
            Some(path) => Self::read(path)?,
            None => Self::default(),
        };
        parameters.check()?;
        Ok(parameters)
    }

    fn read(path: &Path) -> Result<Self, Error> {
        let failed = |cause| Error::Read {
            path: path.into(),
            cause,
        };
        let text = storage::read_text(path, LARGEST_FILE).map_err(failed)?;
        toml::from_str(&text).map_err(|cause| Error::Parse {
            path: path.into(),
            cause,
        })
    }

    fn check(&self) -> Result<(), Error> {
        match &self.tls {
            None if !self.listen.ip().is_loopback() => return Err(Error::NotLoopback(self.listen)),
            Some(_) if self.origins.is_empty() => return Err(Error::NoOrigin),
            Some(_) => {
                let plain = self
                    .origins
                    .iter()
                    .find(|origin| origin.starts_with("http:"));
                plain.map_or(Ok(()), |origin| Err(Error::NoTls(origin.clone())))?;
            }
            None => {}
        }
        self.proxies()?;
        self.origins().map(|_| ())
    }

    /// The addresses of reverse proxies.
    ///
    /// # Errors
    /// If one is named in another way.
    pub(super) fn proxies(&self) -> Result<Arc<[IpAddr]>, Error> {
        let mut found = Vec::new();
        for name in &self.proxy {
            if name == "localhost" {
                found.extend([
                    IpAddr::from(Ipv4Addr::LOCALHOST),
                    Ipv6Addr::LOCALHOST.into(),
                ]);
            } else {
                let address = name.parse::<IpAddr>();
                let address = address.map_err(|_| Error::Proxy(name.clone()))?;
                found.push(address.to_canonical());
            }
        }
        Ok(found.into())
    }

    /// The origins under which browsers reach the page.
    ///
    /// # Errors
    /// If one is not an origin, or is one of the network without TLS.
    pub(super) fn origins(&self) -> Result<Origins, Error> {
        if !self.origins.is_empty() {
            return Origins::parse(&self.origins).map_err(Error::Origin);
        }
        let port = self.listen.port();
        let own = [
            format!("http://{}", self.listen),
            format!("http://localhost:{port}"),
        ];
        Origins::parse(&own).map_err(Error::Origin)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_file_shows_every_default() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/page.toml");
        assert_eq!(
            Parameters::load(Some(&path)).unwrap(),
            Parameters::default()
        );
    }

    #[test]
    fn hours_have_a_range() {
        for (refused, range) in [
            ("operator_hours = 745", "expected 1 to 744"),
            ("viewer_hours = 0", "expected 1 to 8784"),
        ] {
            let words = toml::from_str::<Parameters>(refused)
                .unwrap_err()
                .to_string();
            assert!(words.contains(range), "{words}");
        }
    }

    #[test]
    fn a_proxy_is_named_by_its_address() {
        let of = |names: &[&str]| {
            let proxy = names.iter().map(|&name| name.into()).collect();
            let parameters = Parameters {
                proxy,
                ..Parameters::default()
            };
            parameters.check()?;
            parameters.proxies()
        };
        assert!(of(&[]).unwrap().is_empty());
        let found = of(&["localhost", "::ffff:10.0.0.1"]).unwrap();
        let found: Vec<String> = found.iter().map(ToString::to_string).collect();
        assert_eq!(found, ["127.0.0.1", "::1", "10.0.0.1"]);
        for refused in ["proxy.example", "127.0.0.1:80", "10.0.0.0/8", ""] {
            assert!(matches!(of(&[refused]), Err(Error::Proxy(_))), "{refused}");
        }
    }

    #[test]
    fn what_opens_the_page_to_a_network_is_refused() {
        let of = |change: &dyn Fn(&mut Parameters)| {
            let mut parameters = Parameters::default();
            change(&mut parameters);
            parameters.check()
        };
        let open = of(&|p| p.listen = SocketAddr::from(([0, 0, 0, 0], 80)));
        assert!(matches!(open, Err(Error::NotLoopback(_))));
        let plain = of(&|p| p.origins = vec!["http://rig.example".into()]);
        assert!(plain.unwrap_err().to_string().contains("has no TLS"));
        for bad in [
            "rig.example",
            "https://",
            "https://a/b",
            "ftp://a",
            "https://a b",
        ] {
            let found = of(&|p| p.origins = vec![bad.into()]);
            let words = found.unwrap_err().to_string();
            assert!(words.contains("expected a scheme and a host"), "{words}");
        }
        of(&|p| p.origins = vec!["https://rig.example".into()]).unwrap();
        let with_tls = |origins: &[&str]| {
            of(&|p| {
                p.listen = SocketAddr::from(([0, 0, 0, 0], 8443));
                p.origins = origins.iter().map(|&origin| origin.into()).collect();
                p.tls = Some(TlsParameters {
                    certificate: "a".into(),
                    key: "b".into(),
                });
            })
        };
        with_tls(&["https://rig.example:8443"]).unwrap();
        assert!(matches!(with_tls(&[]), Err(Error::NoOrigin)));
        let mixed = with_tls(&["https://rig.example:8443", "http://localhost"]);
        assert!(matches!(mixed, Err(Error::NoTls(_))));
    }
}

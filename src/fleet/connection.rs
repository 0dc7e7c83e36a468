//! The connection to the server: its address, its credentials, and what is refused before anything is sent. Says in the
//! log when the server goes and comes.

use super::subjects::{InvalidName, token};
use crate::log;
use crate::storage;
use crate::workers::FleetAddress;
use async_nats::jetstream::{self, Context};
use async_nats::{Client, ConnectOptions, Event};
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::Semaphore;

/// Bytes of the longest credentials.
const LONGEST_CREDENTIALS: u64 = 64 << 10;
/// Bytes of the longest file of authorities: those of a system take 200 kB.
const LONGEST_AUTHORITY: u64 = 4 << 20;
/// What systemd calls the credentials of our units, below `$CREDENTIALS_DIRECTORY`.
const CREDENTIAL: &str = "fleet";

/// What a process does in a fleet; the server's permissions are by role.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Offers captures and takes results in: a rig, or the replay of an archive.
    Rig,
    /// Does jobs.
    Worker,
    /// Looks.
    Viewer,
}

impl Role {
    fn name(self) -> &'static str {
        match self {
            Self::Rig => "rig",
            Self::Worker => "worker",
            Self::Viewer => "viewer",
        }
    }
}

/// How to reach the server, and as whom.
#[derive(Clone, Debug)]
pub struct Access {
    /// Where it is.
    pub address: FleetAddress,
    /// The role.
    pub role: Role,
    /// The name of this rig, worker or viewer; permissions may be for it alone.
    pub name: String,
    /// A `.creds` file, or the seed of an nkey; none where the server lets everybody in.
    pub credentials: Option<PathBuf>,
    /// The certificates of the authorities that may vouch for the server; those of the system if none.
    pub authority: Option<PathBuf>,
    /// Whether pictures may cross a network unencrypted.
    pub plain_text: bool,
}

/// Why there is no connection.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum AccessError {
    /// A name that cannot be one.
    #[error(transparent)]
    Name(#[from] InvalidName),
    /// Pictures would cross a network unencrypted.
    #[error(
        "{0}: pictures, models and credentials would cross the network unencrypted: give tls://…, or --plain-text if the \
         network is yours alone"
    )]
    PlainText(FleetAddress),
    /// The file of credentials cannot be read.
    #[error("credentials {}: {cause}", path.display())]
    Credentials {
        path: PathBuf,
        cause: std::io::Error,
    },
    /// Others can read the file of credentials.
    #[error(
        "credentials {}: other users can read the file (mode {mode:o}): run chmod 600 on it, and make a new key if somebody may have read this one",
        .path.display()
    )]
    Readable { path: PathBuf, mode: u32 },
    /// The file of credentials holds none.
    #[error("credentials {}: expected a .creds file or the seed of an nkey", .0.display())]
    NoCredentials(PathBuf),
    /// The file of the authorities cannot be read.
    #[error("authority {}: {cause}", path.display())]
    Authority {
        path: PathBuf,
        cause: std::io::Error,
    },
    /// The file of the authorities has no certificate.
    #[error("authority {}: it has no certificate, expected one or more in PEM", .0.display())]
    NoAuthority(PathBuf),
    /// The server refuses.
    #[error("{address}: {cause}")]
    Refused {
        address: FleetAddress,
        cause: async_nats::ConnectError,
    },
}

/// A connection that comes back by itself.
#[derive(Clone)]
pub struct FleetClient {
    pub(super) client: Client,
    pub(super) context: Context,
    /// The name of this rig, worker or viewer.
    pub(super) name: String,
    /// How often it was made.
    connections: Arc<AtomicU64>,
    /// Lets one file be sent, and one be received, at a time: the first of many arrives early, and what is in memory is
    /// bounded.
    pub(super) uploads: Arc<Semaphore>,
    pub(super) downloads: Arc<Semaphore>,
    /// Bytes that each stream may hold.
    pub(super) capacities: Arc<Mutex<BTreeMap<String, u64>>>,
}

impl FleetClient {
    /// Connects. A server that is away is waited for in the background.
    ///
    /// # Errors
    /// If the access is refused, here or by the server.
    pub async fn connect(access: &Access) -> Result<Self, AccessError> {
        let name = token(&access.name)?;
        let connections = Arc::new(AtomicU64::new(0));
        let options = options(access, &name)?.event_callback({
            let (address, connections) = (access.address.clone(), connections.clone());
            move |event| {
                let (address, connections) = (address.clone(), connections.clone());
                async move { log_connection(&address, &event, &connections) }
            }
        });
        let client = options
            .connect(access.address.to_string())
            .await
            .map_err(|cause| AccessError::Refused {
                address: access.address.clone(),
                cause,
            })?;
        let mut context = jetstream::new(client.clone());
        context.set_timeout(Duration::from_secs(5));
        Ok(Self {
            client,
            context,
            name,
            connections,
            uploads: Arc::new(Semaphore::new(1)),
            downloads: Arc::new(Semaphore::new(1)),
            capacities: Arc::default(),
        })
    }

    /// Whether the server is there.
    pub(super) fn is_connected(&self) -> bool {
        self.client.connection_state() == async_nats::connection::State::Connected
    }

    /// How often the connection was made; another number than before means that something may have been missed.
    pub(super) fn connections(&self) -> u64 {
        self.connections.load(Ordering::Acquire)
    }
}

fn options(access: &Access, name: &str) -> Result<ConnectOptions, AccessError> {
    let Access { address, role, .. } = access;
    let is_plain = !address.is_encrypted() && !address.is_loopback();
    if is_plain && !access.plain_text {
        return Err(AccessError::PlainText(address.clone()));
    }
    let role = role.name();
    let mut options = ConnectOptions::new()
        .name(format!("scand {role} {name}"))
        // Answers to one must not be seen by others, whose permissions end at their own.
        .custom_inbox_prefix(format!("_INBOX_{role}_{name}"))
        .require_tls(address.is_encrypted())
        .retry_on_initial_connect()
        .ping_interval(Duration::from_secs(5))
        .connection_timeout(Duration::from_secs(5))
        .request_timeout(Some(Duration::from_secs(5)))
        .reconnect_delay_callback(|attempts| Duration::from_millis(100 << attempts.min(4)))
        .ignore_discovered_servers();
    if let Some(authority) = &access.authority {
        check_authority(authority)?;
        options = options.add_root_certificates(authority.clone());
    }
    let lent = std::env::var_os("CREDENTIALS_DIRECTORY");
    let lent = lent.map(|folder| Path::new(&folder).join(CREDENTIAL));
    let path = access.credentials.clone();
    match path.or_else(|| lent.filter(|path| path.exists())) {
        Some(path) => with_credentials(options, &path),
        None => Ok(options),
    }
}

/// Finds out at once what the client would only say at each try to connect.
fn check_authority(path: &Path) -> Result<(), AccessError> {
    let text = storage::read_text(path, LONGEST_AUTHORITY);
    let text = text.map_err(|cause| AccessError::Authority {
        path: path.to_owned(),
        cause,
    })?;
    if text.contains("-----BEGIN CERTIFICATE-----") {
        Ok(())
    } else {
        Err(AccessError::NoAuthority(path.to_owned()))
    }
}

fn with_credentials(options: ConnectOptions, path: &Path) -> Result<ConnectOptions, AccessError> {
    let io = |cause| AccessError::Credentials {
        path: path.to_owned(),
        cause,
    };
    let none = || AccessError::NoCredentials(path.to_owned());
    let metadata = std::fs::metadata(path).map_err(io)?;
    if metadata.mode() & 0o007 != 0 {
        let mode = metadata.mode() & 0o777;
        let path = path.to_owned();
        return Err(AccessError::Readable { path, mode });
    }
    if metadata.len() > LONGEST_CREDENTIALS {
        return Err(none());
    }
    let text = std::fs::read_to_string(path).map_err(io)?;
    let seed = text
        .lines()
        .map(str::trim)
        .find(|line| line.starts_with("SU"));
    if text.contains("BEGIN NATS USER JWT") {
        // Its own message may quote the file.
        options.credentials(&text).map_err(|_| none())
    } else if let Some(seed) = seed {
        nkeys::KeyPair::from_seed(seed).map_err(|_| none())?;
        Ok(options.nkey(seed.to_owned()))
    } else {
        Err(none())
    }
}

/// Makes the seed of a new user, and the public key that the server's configuration names: (seed, public key).
pub fn new_key() -> Option<(String, String)> {
    let pair = nkeys::KeyPair::new_user();
    Some((pair.seed().ok()?, pair.public_key()))
}

fn log_connection(address: &FleetAddress, event: &Event, connections: &AtomicU64) {
    match event {
        Event::Connected => {
            connections.fetch_add(1, Ordering::AcqRel);
            log::notice!("{address}: connected");
        }
        Event::Disconnected => log::warning!(
            "{address}: the connection to the server is lost; scand keeps trying to reconnect"
        ),
        Event::ServerError(error) => log::error!("{address}: {error}"),
        Event::ClientError(error) => log::error!("{address}: {error}"),
        Event::SlowConsumer(_) => log::warning!(
            "{address}: messages arrived faster than scand read them, and the client dropped some"
        ),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    fn access(address: &str) -> Access {
        Access {
            address: address.parse().unwrap(),
            role: Role::Rig,
            name: "hall".into(),
            credentials: None,
            authority: None,
            plain_text: false,
        }
    }

    #[test]
    fn nothing_crosses_a_network_unencrypted_unless_that_is_asked_for() {
        let refused = options(&access("nats://10.0.0.1"), "hall").err().unwrap();
        assert!(refused.to_string().contains("--plain-text"), "{refused}");
        for address in ["nats://127.0.0.1", "tls://10.0.0.1"] {
            options(&access(address), "hall").unwrap();
        }
        let asked = Access {
            plain_text: true,
            ..access("nats://10.0.0.1")
        };
        options(&asked, "hall").unwrap();
    }

    #[test]
    fn a_file_of_authorities_without_a_certificate_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("authority.pem");
        let with = || {
            let access = Access {
                authority: Some(path.clone()),
                ..access("tls://10.0.0.1")
            };
            options(&access, "hall")
                .err()
                .map(|error| error.to_string())
        };
        let missing = with().unwrap();
        assert!(missing.contains("authority.pem"), "{missing}");
        std::fs::write(&path, "no certificate").unwrap();
        let empty = with().unwrap();
        assert!(
            empty.contains("authority.pem") && empty.contains("PEM"),
            "{empty}"
        );
        std::fs::write(
            &path,
            include_str!("../../tests/support/page-certificate.pem"),
        )
        .unwrap();
        assert_eq!(with(), None);
    }

    #[test]
    fn credentials_are_their_owners_alone_and_no_message_quotes_them() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("key");
        let with = |text: &str, mode: u32| {
            std::fs::write(&path, text).unwrap();
            std::fs::set_permissions(&path, PermissionsExt::from_mode(mode)).unwrap();
            with_credentials(ConnectOptions::new(), &path)
        };
        let (seed, public) = new_key().unwrap();
        assert!(seed.starts_with("SU") && public.starts_with('U'));
        with(&format!("# the hall's\n{seed}\n"), 0o600).unwrap();
        let open = with(&seed, 0o644).err().unwrap().to_string();
        assert!(open.contains("other users can read"), "{open}");
        let jwt = "-----BEGIN NATS USER JWT-----\nsecret\n";
        for text in ["", "secret", jwt, &format!("{seed}secret"), "SUsecret"] {
            let error = with(text, 0o600).err().unwrap().to_string();
            assert!(error.contains("expected a .creds file"), "{error}");
            assert!(!error.contains("secret"), "{error}");
        }
    }
}

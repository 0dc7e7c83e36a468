//! TLS with the administrator's certificate, for browsers on other computers. A certificate that was renewed is taken
//! up within a minute, and one that cannot be read leaves the earlier one in use.

use crate::log;
use crate::storage;
use parking_lot::Mutex;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};

/// How often the files are looked at.
const EVERY: Duration = Duration::from_secs(60);
/// Largest file, in bytes.
const LARGEST: u64 = 1 << 20;

/// Where certificate and key are.
#[derive(Clone, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TlsParameters {
    /// The certificate and those that it rests on, in PEM, the page's own first.
    pub certificate: PathBuf,
    /// Its private key in PEM, which others than its owner and group cannot read.
    pub key: PathBuf,
}

/// What tells one state of a file from another, also where it was put in another's place with an earlier time: device
/// and inode, size, and when its content and its inode changed, in seconds and nanoseconds.
type FileState = [i128; 7];

/// What was read last.
struct Known {
    files: [Option<FileState>; 2],
    was_read: bool,
}

/// The certificate that is in use.
pub(super) struct Tls {
    parameters: TlsParameters,
    acceptor: Mutex<TlsAcceptor>,
}

impl Tls {
    /// Reads certificate and key.
    ///
    /// # Errors
    /// In words, if a file cannot be read, the key is open to everybody, or the two do not belong together.
    pub(super) fn open(parameters: &TlsParameters) -> Result<Arc<Self>, String> {
        Ok(Arc::new(Self {
            acceptor: Mutex::new(acceptor(parameters)?),
            parameters: parameters.clone(),
        }))
    }

    pub(super) fn acceptor(&self) -> TlsAcceptor {
        self.acceptor.lock().clone()
    }

    /// Takes up what was renewed, for ever.
    pub(super) async fn renew(&self) {
        let mut known = Known {
            files: self.files(),
            was_read: true,
        };
        loop {
            tokio::time::sleep(EVERY).await;
            self.look(&mut known);
        }
    }

    /// Reads the files again if they changed, or could not be read the last time. Why they cannot be read is logged
    /// once.
    fn look(&self, known: &mut Known) {
        let files = self.files();
        let has_changed = files != known.files;
        if !has_changed && known.was_read {
            return;
        }
        let read = acceptor(&self.parameters);
        *known = Known {
            files,
            was_read: read.is_ok(),
        };
        match read {
            Ok(acceptor) => {
                *self.acceptor.lock() = acceptor;
                log::notice!("the renewed certificate is in use");
            }
            Err(why) if has_changed => log::error!("the earlier certificate stays in use: {why}"),
            Err(_) => {}
        }
    }

    fn files(&self) -> [Option<FileState>; 2] {
        let state = |path: &PathBuf| {
            let found = path.metadata().ok()?;
            let times = [
                found.mtime(),
                found.mtime_nsec(),
                found.ctime(),
                found.ctime_nsec(),
            ];
            let [mtime, mtime_ns, ctime, ctime_ns] = times.map(i128::from);
            let [device, inode, size] = [found.dev(), found.ino(), found.size()].map(i128::from);
            Some([device, inode, size, mtime, mtime_ns, ctime, ctime_ns])
        };
        [&self.parameters.certificate, &self.parameters.key].map(state)
    }
}

fn acceptor(parameters: &TlsParameters) -> Result<TlsAcceptor, String> {
    let TlsParameters { certificate, key } = parameters;
    let chain = read(certificate)?;
    let chain: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(chain.as_bytes()).collect();
    let chain = chain.map_err(|error| format!("{}: {error}", certificate.display()))?;
    if chain.is_empty() {
        return Err(format!(
            "{}: it has no certificate in PEM",
            certificate.display()
        ));
    }
    check_is_closed(key)?;
    let secret = PrivateKeyDer::from_pem_slice(read(key)?.as_bytes());
    let secret = secret.map_err(|error| format!("{}: {error}", key.display()))?;
    let config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|error| error.to_string())?
        .with_no_client_auth()
        .with_single_cert(chain, secret)
        .map_err(|error| format!("{} and {}: {error}", certificate.display(), key.display()))?;
    Ok(TlsAcceptor::from(Arc::new(config)))
}

fn read(path: &Path) -> Result<String, String> {
    storage::read_text(path, LARGEST).map_err(|error| format!("{}: {error}", path.display()))
}

fn check_is_closed(key: &Path) -> Result<(), String> {
    let found = key
        .metadata()
        .map_err(|error| format!("{}: {error}", key.display()))?;
    if found.mode() & 0o007 != 0 {
        return Err(format!(
            "{}: every user of this computer may read the private key: run chmod o= {0}",
            key.display()
        ));
    }
    Ok(())
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    /// A certificate for `localhost` and its key, which tests alone use.
    pub(in crate::page) const CERTIFICATE: &str =
        include_str!("../../tests/support/page-certificate.pem");
    pub(in crate::page) const KEY: &str = include_str!("../../tests/support/page-key.pem");

    /// Both as files.
    pub(in crate::page) fn files(folder: &Path) -> TlsParameters {
        let parameters = TlsParameters {
            certificate: folder.join("certificate.pem"),
            key: folder.join("key.pem"),
        };
        std::fs::write(&parameters.certificate, CERTIFICATE).unwrap();
        std::fs::write(&parameters.key, KEY).unwrap();
        close(&parameters.key, 0o600);
        parameters
    }

    fn close(path: &Path, mode: u32) {
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).unwrap();
    }

    #[test]
    fn what_is_no_certificate_and_a_key_that_is_open_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let good = files(folder.path());
        Tls::open(&good).unwrap();
        close(&good.key, 0o644);
        let refused = |parameters: &TlsParameters| Tls::open(parameters).err().unwrap();
        assert!(refused(&good).contains("chmod o="));
        close(&good.key, 0o640);
        let swapped = TlsParameters {
            certificate: good.key.clone(),
            ..good.clone()
        };
        assert!(refused(&swapped).contains("no certificate in PEM"));
        for text in [
            "",
            "-----BEGIN PRIVATE KEY-----\nAAAA\n-----END PRIVATE KEY-----\n",
        ] {
            std::fs::write(&good.key, text).unwrap();
            assert!(refused(&good).contains("key.pem"), "{text}");
        }
        let missing = TlsParameters {
            certificate: folder.path().join("missing.pem"),
            ..good
        };
        assert!(refused(&missing).contains("missing.pem"));
    }

    #[test]
    fn a_renewed_certificate_that_cannot_be_read_leaves_the_earlier_one() {
        let folder = tempfile::tempdir().unwrap();
        let parameters = files(folder.path());
        let tls = Tls::open(&parameters).unwrap();
        let config = |tls: &Tls| Arc::as_ptr(tls.acceptor().config());
        let before = config(&tls);
        let mut known = Known {
            files: tls.files(),
            was_read: true,
        };
        tls.look(&mut known);
        assert_eq!(config(&tls), before);
        std::fs::write(&parameters.certificate, "half").unwrap();
        tls.look(&mut known);
        assert_eq!(config(&tls), before);
        std::fs::write(&parameters.certificate, CERTIFICATE).unwrap();
        tls.look(&mut known);
        assert_ne!(config(&tls), before);
    }

    #[test]
    fn a_certificate_with_an_earlier_time_and_one_that_could_not_be_read_once_are_taken_up() {
        let folder = tempfile::tempdir().unwrap();
        let parameters = files(folder.path());
        let tls = Tls::open(&parameters).unwrap();
        let config = |tls: &Tls| Arc::as_ptr(tls.acceptor().config());
        let mut known = Known {
            files: tls.files(),
            was_read: true,
        };
        // As `cp --preserve` and a link that leads elsewhere do it.
        let before = config(&tls);
        let changed = parameters.certificate.metadata().unwrap().modified();
        let renewed = folder.path().join("renewed.pem");
        std::fs::write(&renewed, CERTIFICATE).unwrap();
        let file = std::fs::File::options().write(true).open(&renewed).unwrap();
        file.set_modified(changed.unwrap()).unwrap();
        std::fs::rename(&renewed, &parameters.certificate).unwrap();
        tls.look(&mut known);
        assert_ne!(config(&tls), before);
        // What hinders is not always seen in the files.
        known.was_read = false;
        let before = config(&tls);
        tls.look(&mut known);
        assert_ne!(config(&tls), before);
        assert!(known.was_read);
    }
}

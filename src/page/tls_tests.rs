//! The page with a certificate of its own: what comes over TLS is answered, and nothing else.

use super::serve::HEADERS;
use super::sessions::Role;
use super::testing::Page;
use super::tls::tests::{CERTIFICATE, files};
use std::io::{Read, Write};
use std::sync::Arc;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::CertificateDer;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};

/// What the page answers to a request over TLS.
fn ask(page: &Page, request: &str) -> String {
    let mut roots = RootCertStore::empty();
    let own = CertificateDer::from_pem_slice(CERTIFICATE.as_bytes()).unwrap();
    roots.add(own).unwrap();
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots)
        .with_no_client_auth();
    let name = "localhost".try_into().unwrap();
    let client = ClientConnection::new(Arc::new(config), name).unwrap();
    let mut stream = StreamOwned::new(client, page.connect());
    stream.write_all(request.as_bytes()).unwrap();
    let mut found = Vec::new();
    // A server need not say that it closes the connection.
    let _ = stream.read_to_end(&mut found);
    String::from_utf8_lossy(&found).into_owned()
}

#[test]
fn what_comes_over_tls_is_answered_and_plain_requests_and_other_names_are_not() {
    let folder = tempfile::tempdir().unwrap();
    let page = Page::start_with(Some(files(folder.path())), HEADERS);
    let port = page.address.port();
    let get = |host: &str, headers: &str| {
        format!("GET /api/me HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{headers}\r\n")
    };
    let own = format!("localhost:{port}");
    assert!(ask(&page, &get(&own, "")).starts_with("HTTP/1.1 401"));
    assert!(ask(&page, &get("rig.evil.example", "")).starts_with("HTTP/1.1 421"));
    let viewer = page.session(Role::Viewer);
    // The name says that the cookie was set over TLS, for this host alone.
    let cookie = format!("Cookie: __Host-scand={viewer}\r\n");
    assert!(ask(&page, &get(&own, &cookie)).starts_with("HTTP/1.1 200"));
    let plain = format!("Cookie: scand={viewer}\r\n");
    assert!(ask(&page, &get(&own, &plain)).starts_with("HTTP/1.1 401"));
    let answer = page.raw(get(&own, &cookie).as_bytes());
    assert_eq!((answer.status, answer.body.as_str()), (0, ""));
    // It goes on after what was no greeting.
    assert!(ask(&page, &get(&own, &cookie)).starts_with("HTTP/1.1 200"));
}

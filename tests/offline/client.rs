//! Clients of the daemon, which the test plays itself: what they print, and how they end.

use crate::support::program::scand;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::process::Stdio;
use std::thread::JoinHandle;
use std::time::Duration;

/// A daemon that tells its first client of events until the client is gone; whether it went within half a minute.
fn teller(listener: UnixListener) -> JoinHandle<bool> {
    let tell = |mut stream: UnixStream| {
        stream.write_all(b"{\"type\":\"listening\"}\n").unwrap();
        (0..300).any(|_| {
            std::thread::sleep(Duration::from_millis(100));
            stream.write_all(b"{\"type\":\"busy\"}\n").is_err()
        })
    };
    std::thread::spawn(move || {
        let (stream, _) = listener.accept().unwrap();
        let mut request = String::new();
        BufReader::new(&stream).read_line(&mut request).unwrap();
        tell(stream)
    })
}

#[test]
fn events_end_when_nobody_reads_them() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("scand.sock");
    let daemon = teller(UnixListener::bind(&socket).unwrap());
    let mut client = scand()
        .args(["events", "--socket"])
        .arg(&socket)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut first = String::new();
    let mut output = BufReader::new(client.stdout.take().unwrap());
    output.read_line(&mut first).unwrap();
    assert!(first.starts_with("busy"), "{first}");
    drop(output);
    assert!(client.wait().unwrap().success());
    assert!(daemon.join().unwrap());
}

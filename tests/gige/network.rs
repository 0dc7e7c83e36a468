//! A network namespace for each test, without root: the test runs itself again inside.

use std::process::Command;

const INSIDE: &str = "SCAND_TEST_NETWORK";

/// Runs `body` in a network that nobody else is in, with loopback addresses 127.0.1.1 to 127.0.1.12 and 127.0.1.100.
/// `name` is the test's own, with its module.
pub fn alone(name: &str, body: impl FnOnce()) {
    if std::env::var_os(INSIDE).is_some() {
        return body();
    }
    inside(name, "exec \"$0\" \"$@\"");
}

/// The same without the right to raw sockets, as an unprivileged daemon is.
pub fn alone_without_raw_sockets(name: &str, body: impl FnOnce()) {
    if std::env::var_os(INSIDE).is_some() {
        return body();
    }
    inside(name, "exec setpriv --bounding-set=-net_raw \"$0\" \"$@\"");
}

fn inside(name: &str, run: &str) {
    let script = format!(
        "ip link set lo up || exit 1\n\
         for i in 1 2 3 4 5 6 7 8 9 10 11 12 100; do ip address add 127.0.1.$i/8 dev lo || exit 1; done\n{run}"
    );
    let output = Command::new("unshare")
        .args(["-Urnm", "sh", "-c", &script])
        .arg(std::env::current_exe().unwrap())
        .args(["--exact", name, "--nocapture", "--test-threads=1"])
        .env(INSIDE, "1")
        .output()
        .expect("unshare (package util-linux) gives the test a network of its own");
    let words = format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
    assert!(
        output.status.success() && words.contains("1 passed"),
        "{name} in a network of its own (this needs user namespaces: kernel.unprivileged_userns_clone=1):\n{words}"
    );
    print!("{words}");
}

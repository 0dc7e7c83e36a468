//! The environment variables in which systemd talks to a service. Children must not inherit them, because they
//! would take them as meant for themselves.

use std::process::Command;

/// The variables of systemd's protocols for readiness, watchdogs and sockets (sd_notify(3), sd_watchdog_enabled(3),
/// sd_listen_fds(3)).
const OF_SYSTEMD: [&str; 6] = [
    "NOTIFY_SOCKET",
    "WATCHDOG_PID",
    "WATCHDOG_USEC",
    "LISTEN_PID",
    "LISTEN_FDS",
    "LISTEN_FDNAMES",
];

/// Keeps a child from inheriting the variables that systemd set for this process.
pub(super) fn remove_from(command: &mut Command) {
    for name in OF_SYSTEMD {
        command.env_remove(name);
    }
}

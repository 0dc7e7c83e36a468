//! The daemon's log: one line for each message on standard error, with a level, in journald's format if standard
//! error goes to the journal. What a command prints for its user does not go through here.

use std::fmt::{Arguments, Write as _};
use std::io::Write as _;
use std::sync::LazyLock;

/// How much a message matters; the numbers are syslog's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Priority {
    /// Data was lost, a capture failed, or something will not work until a person fixes it.
    Error = 3,
    /// It works, but something is not as it should be.
    Warning = 4,
    /// What an operator did and what became of it.
    Notice = 5,
    /// Everything else worth a line.
    Info = 6,
}

/// Logs an error, in the form of `format!`.
macro_rules! error {
    ($($words:tt)*) => { $crate::log::write($crate::log::Priority::Error, format_args!($($words)*)) };
}
/// Logs a warning, in the form of `format!`.
macro_rules! warning {
    ($($words:tt)*) => { $crate::log::write($crate::log::Priority::Warning, format_args!($($words)*)) };
}
/// Logs a notice, in the form of `format!`.
macro_rules! notice {
    ($($words:tt)*) => { $crate::log::write($crate::log::Priority::Notice, format_args!($($words)*)) };
}
/// Logs something worth a line, in the form of `format!`.
#[cfg(feature = "live")]
macro_rules! info {
    ($($words:tt)*) => { $crate::log::write($crate::log::Priority::Info, format_args!($($words)*)) };
}
#[cfg(feature = "live")]
pub(crate) use info;
pub(crate) use {error, notice, warning};

/// Writes a message. The daemon goes on if the log cannot be written.
pub fn write(level: Priority, words: Arguments<'_>) {
    static JOURNAL: LazyLock<bool> = LazyLock::new(goes_to_journal);
    let text = text(level, &words.to_string(), *JOURNAL);
    let _ = std::io::stderr().lock().write_all(text.as_bytes());
}

/// Whether standard error is the stream that systemd named; a child process's may be redirected.
fn goes_to_journal() -> bool {
    let named = std::env::var("JOURNAL_STREAM").unwrap_or_default();
    let found = rustix::fs::fstat(std::io::stderr());
    found.is_ok_and(|stat| named == format!("{}:{}", stat.st_dev, stat.st_ino))
}

/// A message as it is written. The journal takes each line as a separate message, so each line has the level.
fn text(level: Priority, words: &str, journal: bool) -> String {
    if !journal {
        let name = match level {
            Priority::Error => "error: ",
            Priority::Warning => "warning: ",
            Priority::Notice | Priority::Info => "",
        };
        return format!("scand: {name}{words}\n");
    }
    words.lines().fold(String::new(), |mut text, line| {
        let _ = writeln!(text, "<{}>{line}", level as u8);
        text
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_journal_hears_levels_and_a_terminal_words() {
        let told = text(Priority::Error, "a frame is lost\nand another", true);
        assert_eq!(told, "<3>a frame is lost\n<3>and another\n");
        let told = text(Priority::Error, "a frame is lost", false);
        assert_eq!(told, "scand: error: a frame is lost\n");
        assert_eq!(text(Priority::Info, "listening", true), "<6>listening\n");
        assert_eq!(text(Priority::Notice, "ready", false), "scand: ready\n");
    }
}

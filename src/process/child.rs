//! A process that does a job: started, listened to, waited for, and killed when its time is over or nobody wants its
//! work any more.

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, PidfdFlags, pidfd_open};
use std::io::{self, Read};
use std::os::fd::OwnedFd;
use std::os::unix::process::CommandExt;
use std::process::{Command, ExitStatus, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How much of what a process says is kept: the last of it, in bytes.
const MOST_WORDS: usize = 16 << 10;
/// How often is asked whether its work is still wanted.
const ASKED: Duration = Duration::from_millis(100);

/// How a process came to its end.
pub enum End {
    /// By itself, or by a signal.
    Ended(ExitStatus),
    /// It took too long.
    TimedOut,
    /// Nobody wants its work any more.
    Cancelled,
}

/// A process that runs. It ends at the latest with the thread that started it.
pub struct Child {
    process: std::process::Child,
    handle: OwnedFd,
    words: JoinHandle<Vec<u8>>,
}

impl Child {
    /// Starts it, in a group of its own: an interrupt from the keyboard is the daemon's to hear.
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn start(command: &mut Command) -> io::Result<Self> {
        let mut process = command
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .process_group(0)
            .spawn()?;
        let stderr = process.stderr.take();
        let words = std::thread::spawn(move || stderr.map(last_words).unwrap_or_default());
        let pid = Pid::from_raw(process.id() as i32).ok_or(io::ErrorKind::NotFound)?;
        match pidfd_open(pid, PidfdFlags::empty()) {
            Ok(handle) => Ok(Self {
                process,
                handle,
                words,
            }),
            Err(error) => {
                let _ = process.kill();
                let _ = process.wait();
                Err(error.into())
            }
        }
    }

    /// Waits for its end, which comes after `limit` at the latest; also its last words.
    ///
    /// # Errors
    /// If the system cannot tell.
    pub fn wait(
        mut self,
        limit: Duration,
        cancelled: impl Fn() -> bool,
    ) -> io::Result<(End, String)> {
        let begun = Instant::now();
        let end = loop {
            if let Some(status) = self.process.try_wait()? {
                break End::Ended(status);
            }
            let left = limit.saturating_sub(begun.elapsed());
            if left.is_zero() {
                break End::TimedOut;
            }
            if cancelled() {
                break End::Cancelled;
            }
            wait_for(&self.handle, left.min(ASKED))?;
        };
        if !matches!(end, End::Ended(_)) {
            self.process.kill()?;
            self.process.wait()?;
        }
        let words = self.words.join().unwrap_or_default();
        Ok((end, String::from_utf8_lossy(&words).into_owned()))
    }
}

/// Waits until a process ends, or the time is over.
fn wait_for(handle: &OwnedFd, time: Duration) -> io::Result<()> {
    let time = Timespec {
        tv_sec: time.as_secs() as i64,
        tv_nsec: time.subsec_nanos().into(),
    };
    match poll(&mut [PollFd::new(handle, PollFlags::IN)], Some(&time)) {
        Ok(_) | Err(rustix::io::Errno::INTR) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

/// Reads to the end and keeps the last of it.
fn last_words(mut from: impl Read) -> Vec<u8> {
    let mut words = Vec::new();
    let mut piece = [0; 4096];
    loop {
        match from.read(&mut piece) {
            Ok(0) => return words,
            Ok(length) => words.extend_from_slice(&piece[..length]),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(_) => return words,
        }
        if words.len() > 2 * MOST_WORDS {
            words.drain(..words.len() - MOST_WORDS);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(script: &str) -> Command {
        let mut command = Command::new("/bin/sh");
        command.args(["-c", script]);
        command
    }

    #[test]
    fn the_last_of_what_it_says_is_kept() {
        let script = "i=0; while [ $i -lt 9000 ]; do echo $i >&2; i=$((i+1)); done; exit 3";
        let child = Child::start(&mut shell(script)).unwrap();
        let (end, words) = child.wait(Duration::from_secs(60), || false).unwrap();
        assert!(matches!(end, End::Ended(status) if status.code() == Some(3)));
        assert!(words.ends_with("8998\n8999\n"), "{words}");
        assert!(words.len() <= 3 * MOST_WORDS, "{}", words.len());
    }

    #[test]
    fn one_that_hangs_and_one_that_nobody_wants_are_killed() {
        let child = Child::start(&mut shell("echo begun >&2; exec sleep 1000")).unwrap();
        let (end, _) = child.wait(Duration::from_millis(300), || false).unwrap();
        assert!(matches!(end, End::TimedOut));
        let child = Child::start(&mut shell("exec sleep 1000")).unwrap();
        let (end, _) = child.wait(Duration::from_secs(60), || true).unwrap();
        assert!(matches!(end, End::Cancelled));
    }
}

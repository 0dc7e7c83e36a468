//! A child process: starts it, reads its output, waits for it, and kills it with all its own children when it
//! exceeds its time or its work is no longer needed.

use super::cancel::Cancel;
use super::inherited;
use crate::clock::Clock;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{OFlags, fcntl_setfl};
use rustix::process::{Pid, PidfdFlags, Signal, kill_process_group, pidfd_open};
use std::io::{self, Read};
use std::os::fd::OwnedFd;
use std::os::unix::process::CommandExt;
use std::process::{ChildStderr, Command, ExitStatus, Stdio};
use std::time::Duration;

/// How much of what a process says is kept: the last of it, in bytes.
const MOST_WORDS: usize = 16 << 10;
/// Bytes that are read at once.
const PIECE: usize = 4096;
/// Pieces that are read once a process has ended: as many as a pipe holds. Something that it left behind may go on
/// talking.
const LAST_PIECES: usize = 16;

/// Characters of a line that a process said as it ended that are passed on.
const LONGEST_LINE: usize = 300;

/// The last line of what a process said that is not empty, cut to 300 characters: its reason for ending.
pub fn last_line(said: &str) -> String {
    let lines = said.lines().map(str::trim);
    let last = lines.rev().find(|line| !line.is_empty());
    last.unwrap_or_default()
        .chars()
        .take(LONGEST_LINE)
        .collect()
}

/// How a process came to its end.
#[derive(Debug)]
pub enum ChildExit {
    /// By itself, or by a signal.
    Ended(ExitStatus),
    /// It took too long.
    TimedOut,
    /// Nobody wants its work any more.
    Cancelled,
}

/// A process that runs.
pub struct Child {
    process: std::process::Child,
    handle: OwnedFd,
    words: OutputTail,
}

impl Child {
    /// Starts it in its own process group, so that an interrupt from the keyboard reaches only this process. Its
    /// standard error is read, its standard input and output are closed, and it does not get systemd's variables.
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn start(command: &mut Command) -> io::Result<Self> {
        Self::start_between(command, Stdio::null(), Stdio::null())
    }

    /// Starts it as [`Self::start`] does, with a standard input and output of its own.
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn start_between(
        command: &mut Command,
        input: impl Into<Stdio>,
        output: impl Into<Stdio>,
    ) -> io::Result<Self> {
        inherited::remove_from(command);
        let mut process = command
            .stdin(input)
            .stdout(output)
            .stderr(Stdio::piped())
            .process_group(0)
            .spawn()?;
        let listen = |process: &mut std::process::Child| -> io::Result<(OwnedFd, OutputTail)> {
            let words = OutputTail::new(process.stderr.take())?;
            Ok((pidfd_open(pid(process)?, PidfdFlags::empty())?, words))
        };
        match listen(&mut process) {
            Ok((handle, words)) => Ok(Self {
                process,
                handle,
                words,
            }),
            Err(error) => {
                let _ = process.kill();
                let _ = process.wait();
                Err(error)
            }
        }
    }

    /// Waits for its end, which comes after `limit` of `clock` at the latest; also the last of what it said. What it
    /// started and left in its group ends with it.
    ///
    /// # Errors
    /// If the system cannot tell.
    pub fn wait(
        mut self,
        limit: Duration,
        clock: Clock,
        cancel: &Cancel,
    ) -> io::Result<(ChildExit, String)> {
        let woken = self.listen(limit, clock, cancel);
        // The number is still its own and its group's, as nobody has waited for it.
        let _ = pid(&self.process).map(|pid| kill_process_group(pid, Signal::KILL));
        if !matches!(woken, Ok(WaitEnd::Ended)) {
            self.process.kill()?;
        }
        let status = self.process.wait()?;
        self.words.read(LAST_PIECES);
        let end = match woken? {
            WaitEnd::Ended => ChildExit::Ended(status),
            WaitEnd::TimedOut => ChildExit::TimedOut,
            WaitEnd::Cancelled => ChildExit::Cancelled,
        };
        Ok((end, self.words.text()))
    }

    /// Reads what it says until something ends it.
    fn listen(&mut self, limit: Duration, clock: Clock, cancel: &Cancel) -> io::Result<WaitEnd> {
        let deadline = clock.now() + limit;
        loop {
            let left = clock.until(deadline);
            if left.is_zero() {
                return Ok(WaitEnd::TimedOut);
            }
            let mut files = vec![
                PollFd::new(&self.handle, PollFlags::IN),
                PollFd::new(cancel, PollFlags::IN),
            ];
            let pipe = self.words.pipe.as_ref();
            files.extend(pipe.map(|pipe| PollFd::new(pipe, PollFlags::IN)));
            match poll(&mut files, Some(&timespec(clock.wait_at_most(left)))) {
                Ok(_) | Err(rustix::io::Errno::INTR) => {}
                Err(error) => return Err(error.into()),
            }
            let [ended, cancelled] = [0, 1].map(|i: usize| !files[i].revents().is_empty());
            if ended {
                return Ok(WaitEnd::Ended);
            }
            if cancelled {
                return Ok(WaitEnd::Cancelled);
            }
            self.words.read(1);
        }
    }
}

/// Why nothing is waited for any longer.
enum WaitEnd {
    Ended,
    TimedOut,
    Cancelled,
}

fn pid(process: &std::process::Child) -> io::Result<Pid> {
    Pid::from_raw(process.id() as i32).ok_or_else(|| io::ErrorKind::NotFound.into())
}

fn timespec(time: Duration) -> Timespec {
    Timespec {
        tv_sec: time.as_secs() as i64,
        tv_nsec: time.subsec_nanos().into(),
    }
}

/// The last of what a process says.
struct OutputTail {
    /// `None` if no more can come.
    pipe: Option<ChildStderr>,
    bytes: Vec<u8>,
}

impl OutputTail {
    fn new(pipe: Option<ChildStderr>) -> io::Result<Self> {
        if let Some(pipe) = &pipe {
            fcntl_setfl(pipe, OFlags::NONBLOCK)?;
        }
        Ok(Self {
            pipe,
            bytes: Vec::new(),
        })
    }

    /// Reads what is available, in at most this many pieces.
    fn read(&mut self, pieces: usize) {
        let mut piece = [0; PIECE];
        for _ in 0..pieces {
            match self.pipe.as_mut().map(|pipe| pipe.read(&mut piece)) {
                Some(Ok(length)) if length > 0 => self.bytes.extend_from_slice(&piece[..length]),
                Some(Err(error)) if error.kind() == io::ErrorKind::WouldBlock => return,
                Some(Err(error)) if error.kind() == io::ErrorKind::Interrupted => {}
                _ => self.pipe = None,
            }
        }
        if self.bytes.len() > 2 * MOST_WORDS {
            self.bytes.drain(..self.bytes.len() - MOST_WORDS);
        }
    }

    fn text(&self) -> String {
        let before = self.bytes.len().saturating_sub(MOST_WORDS);
        String::from_utf8_lossy(&self.bytes[before..]).into_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Timestamp;

    const LONG: Duration = Duration::from_secs(60);

    fn shell(script: &str) -> Command {
        let mut command = Command::new("/bin/sh");
        command.args(["-c", script]);
        command
    }

    fn run(command: &mut Command, limit: Duration) -> (ChildExit, String) {
        let child = Child::start(command).unwrap();
        let cancel = Cancel::new().unwrap();
        child.wait(limit, Clock::system(), &cancel).unwrap()
    }

    #[test]
    fn the_last_of_what_it_says_is_kept() {
        let script = "i=0; while [ $i -lt 9000 ]; do echo $i >&2; i=$((i+1)); done; exit 3";
        let (end, words) = run(&mut shell(script), LONG);
        assert!(matches!(end, ChildExit::Ended(status) if status.code() == Some(3)));
        assert!(words.ends_with("8998\n8999\n"), "{words}");
        assert!(words.len() <= MOST_WORDS, "{}", words.len());
    }

    #[test]
    fn its_last_line_is_short_and_says_something() {
        assert_eq!(last_line("a\nb \n\n"), "b");
        assert_eq!(last_line(""), "");
        assert_eq!(last_line(&"é".repeat(1000)).chars().count(), LONGEST_LINE);
    }

    #[test]
    fn one_that_hangs_and_one_that_nobody_wants_are_killed() {
        let cancel = Cancel::new().unwrap();
        let clock = Clock::by_hand(Timestamp(0));
        let hangs = Child::start(&mut shell("exec sleep 1000")).unwrap();
        let thread = std::thread::spawn(move || hangs.wait(LONG, clock, &cancel).unwrap().0);
        // It takes no time from the clock that the thread reads first, whenever that is.
        while !thread.is_finished() {
            clock.advance(LONG);
            std::thread::yield_now();
        }
        assert!(matches!(thread.join().unwrap(), ChildExit::TimedOut));
        let cancel = Cancel::new().unwrap();
        let child = Child::start(&mut shell("exec sleep 1000")).unwrap();
        let others = cancel.clone();
        let thread = std::thread::spawn(move || others.cancel());
        let (end, _) = child.wait(LONG, Clock::system(), &cancel).unwrap();
        assert!(matches!(end, ChildExit::Cancelled));
        thread.join().unwrap();
        // Once said, it stays said.
        let child = Child::start(&mut shell("exec sleep 1000")).unwrap();
        let (end, _) = child.wait(LONG, Clock::system(), &cancel).unwrap();
        assert!(matches!(end, ChildExit::Cancelled));
    }

    #[test]
    fn one_that_closes_its_words_early_is_waited_for_all_the_same() {
        let (end, words) = run(&mut shell("echo a >&2; exec 2>&-; sleep 0.2; exit 4"), LONG);
        assert!(matches!(end, ChildExit::Ended(status) if status.code() == Some(4)));
        assert_eq!(words, "a\n");
    }

    #[test]
    fn what_left_its_group_and_holds_its_words_keeps_nobody_waiting() {
        let script = "setsid sleep 1000 & echo $! >&2";
        let (end, words) = run(&mut shell(script), LONG);
        assert!(matches!(end, ChildExit::Ended(status) if status.success()));
        let left: i32 = words.trim().parse().unwrap();
        let left = Pid::from_raw(left).unwrap();
        let _ = rustix::process::kill_process(left, Signal::KILL);
    }

    #[test]
    fn it_sees_nothing_of_what_systemd_told_this_process() {
        let told = [
            "NOTIFY_SOCKET",
            "WATCHDOG_PID",
            "WATCHDOG_USEC",
            "LISTEN_PID",
            "LISTEN_FDS",
            "LISTEN_FDNAMES",
        ];
        let mut command = shell("env >&2");
        command.env("KEPT", "1").envs(told.map(|name| (name, "1")));
        let (_, words) = run(&mut command, LONG);
        let seen: Vec<&str> = words
            .lines()
            .filter_map(|l| Some(l.split_once('=')?.0))
            .collect();
        assert!(seen.contains(&"KEPT"), "{words}");
        assert!(!seen.iter().any(|name| told.contains(name)), "{words}");
    }
}

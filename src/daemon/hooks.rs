//! Runs the operator's own commands when something happens: a beep, a lamp. Hooks follow the events like any other
//! client, so they can neither delay nor break a capture. A command that exceeds its time limit is killed with all its
//! children.

use super::HooksParameters;
use super::events::{Event, Events, Subscription};
use crate::clock::Clock;
use crate::log;
use crate::process::{Cancel, Child, ChildExit, last_line};
use std::process::Command;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::sync::Notify;
use tokio::task::JoinSet;

/// How long commands may still run after the end was told of, all of them together.
const AFTER_THE_END: Duration = Duration::from_secs(2);

/// The thread that runs commands.
pub struct Hooks {
    stop: Arc<Notify>,
    thread: JoinHandle<()>,
}

impl Hooks {
    /// Starts the thread; `None` if no command is configured. Commands have their time of `clock`.
    ///
    /// # Errors
    /// If the system has no thread left.
    pub fn start(
        parameters: &HooksParameters,
        events: &Events,
        clock: Clock,
    ) -> std::io::Result<Option<Self>> {
        if parameters.each().all(|(_, command)| command.is_empty()) {
            return Ok(None);
        }
        let mut running = Running {
            parameters: parameters.clone(),
            clock,
            hooks: JoinSet::new(),
            cancel: Cancel::new()?,
        };
        let mut heard = events.subscribe();
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_time()
            .build()?;
        let stop = Arc::new(Notify::new());
        let stopped = stop.clone();
        let thread = std::thread::Builder::new()
            .name("hooks".into())
            .spawn(move || runtime.block_on(running.serve(&mut heard, &stopped)))?;
        Ok(Some(Self { stop, thread }))
    }

    /// Stops the thread. The commands of what was published before are still run, and are killed after two seconds.
    pub fn stop(self) {
        self.stop.notify_one();
        let _ = self.thread.join();
    }
}

struct Running {
    parameters: HooksParameters,
    clock: Clock,
    /// A thread waits for each command.
    hooks: JoinSet<()>,
    cancel: Cancel,
}

impl Running {
    async fn serve(&mut self, events: &mut Subscription, stop: &Notify) {
        loop {
            // While as many run as may run, events wait in the subscription, which drops the oldest first.
            let has_room = self.has_room();
            tokio::select! {
                () = stop.notified() => break,
                event = events.next(), if has_room => match event {
                    Some(event) => self.take(&event),
                    None => break,
                },
                Some(_) = self.hooks.join_next(), if !self.hooks.is_empty() => {}
            }
        }
        self.finish(events).await;
        self.cancel.cancel();
        while self.hooks.join_next().await.is_some() {}
    }

    fn has_room(&self) -> bool {
        self.hooks.len() < self.parameters.at_most
    }

    /// Runs what is left, until all has ended or it has taken too long.
    async fn finish(&mut self, events: &mut Subscription) {
        let begin = self.clock.now();
        loop {
            while self.has_room()
                && let Some(event) = events.try_next()
            {
                self.take(&event);
            }
            let left = AFTER_THE_END.saturating_sub(self.clock.elapsed(begin));
            let ended = self.hooks.join_next();
            let ended = tokio::time::timeout(self.clock.wait_at_most(left), ended).await;
            if left.is_zero() || matches!(ended, Ok(None)) {
                return;
            }
        }
    }

    fn take(&mut self, event: &Event) {
        let Some((name, command)) = command(&self.parameters, event) else {
            return;
        };
        let Some((program, arguments)) = command.split_first() else {
            return;
        };
        let mut command = Command::new(program);
        command.args(arguments).envs(environment(event));
        match Child::start(&mut command) {
            Ok(child) => {
                let limit = Duration::from_millis(self.parameters.timeout_ms);
                let (clock, cancel) = (self.clock, self.cancel.clone());
                self.hooks
                    .spawn_blocking(move || log_ending(name, child.wait(limit, clock, &cancel)));
            }
            Err(error) => log::warning!("hooks.{name}: cannot run {program}: {error}"),
        }
    }
}

/// Tells the log how a command ended, if not well.
fn log_ending(name: &str, ended: std::io::Result<(ChildExit, String)>) {
    match ended {
        Ok((ChildExit::Ended(status), _)) if status.success() => {}
        Ok((ChildExit::Ended(status), words)) => {
            log::warning!("hooks.{name}: {status}: {}", last_line(&words));
        }
        Ok((ChildExit::TimedOut, _)) => log::warning!(
            "hooks.{name}: the command was killed, because it \
            took longer than hooks.timeout_ms"
        ),
        Ok((ChildExit::Cancelled, _)) => {}
        Err(error) => log::warning!("hooks.{name}: {error}"),
    }
}

/// The name of an event's hook, and its command, which may be empty.
fn command<'a>(
    parameters: &'a HooksParameters,
    event: &Event,
) -> Option<(&'static str, &'a [String])> {
    let hook = match event {
        Event::Accepted { .. } => "accepted",
        Event::Captured { .. } => "captured",
        Event::Durable { .. } => "durable",
        Event::Failed { .. } | Event::Refused { .. } | Event::JobFailed { .. } => "failed",
        Event::Done { verdict, .. } => verdict.name(),
        _ => return None,
    };
    parameters.each().find(|(name, _)| *name == hook)
}

/// An event's members as `SCAND_CAPTURE` and so on; `SCAND_EVENT` is what happened. Words of clients have no control
/// characters there.
fn environment(event: &Event) -> Vec<(String, String)> {
    let Ok(serde_json::Value::Object(members)) = serde_json::to_value(event) else {
        return Vec::new();
    };
    let variable = |(name, value): (String, serde_json::Value)| {
        let name = if name == "type" { "event".into() } else { name };
        let text = match value {
            serde_json::Value::String(text) => text,
            serde_json::Value::Array(all) => {
                let texts: Vec<&str> = all.iter().filter_map(|v| v.as_str()).collect();
                texts.join("; ")
            }
            other => other.to_string(),
        };
        let text = text.replace(char::is_control, " ");
        (format!("SCAND_{}", name.to_uppercase()), text)
    };
    members.into_iter().map(variable).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Timestamp;
    use crate::level::Level;
    use crate::support::wait::until;
    use std::path::Path;

    fn shell(script: &str) -> Vec<String> {
        ["sh", "-c", script].map(Into::into).into()
    }

    fn start(parameters: &HooksParameters, events: &Events, clock: Clock) -> Hooks {
        Hooks::start(parameters, events, clock).unwrap().unwrap()
    }

    fn accepted(capture: &str) -> Event {
        Event::Accepted {
            capture: capture.into(),
            source: Some("pedal".into()),
            press_id: Some("p\0\n$(rm)".into()),
            subject: None,
        }
    }

    fn done(verdict: Level) -> Event {
        Event::Done {
            capture: "a-0001".into(),
            recording: Some("/r/a.mcap".into()),
            verdict,
            reasons: vec!["few views".into(), "thin".into()],
            model: "/m/a-0001".into(),
        }
    }

    fn text(path: &Path) -> String {
        std::fs::read_to_string(path).unwrap_or_default()
    }

    #[test]
    fn each_event_runs_its_command_and_tells_it_what_happened() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| folder.path().join(name);
        let write = |name: &str, what: &str| {
            let path = file(name);
            shell(&format!(
                "echo \"{what}\" > {0}.new && mv {0}.new {0}",
                path.display()
            ))
        };
        let parameters = HooksParameters {
            accepted: write(
                "accepted",
                "$SCAND_EVENT $SCAND_CAPTURE $SCAND_SOURCE [$SCAND_PRESS_ID]",
            ),
            amber: write(
                "amber",
                "$SCAND_VERDICT $SCAND_REASONS $SCAND_MODEL $SCAND_RECORDING",
            ),
            failed: write("failed", "$SCAND_EVENT $SCAND_REASON"),
            ..HooksParameters::default()
        };
        let events = Events::default();
        let hooks = start(&parameters, &events, Clock::system());
        events.publish(done(Level::Green));
        events.publish(accepted("a-0001"));
        events.publish(done(Level::Amber));
        events.publish(Event::Refused {
            reason: "no room".into(),
        });
        for (name, words) in [
            ("accepted", "accepted a-0001 pedal [p  $(rm)]\n"),
            ("amber", "amber few views; thin /m/a-0001 /r/a.mcap\n"),
            ("failed", "refused no room\n"),
        ] {
            until(name, || file(name).exists());
            assert_eq!(text(&file(name)), words);
        }
        hooks.stop();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3);
    }

    fn is_running(pid: &str) -> bool {
        let stat = text(Path::new(&format!("/proc/{}/stat", pid.trim())));
        // A zombie is dead: only its parent has not waited for it yet.
        !stat.is_empty() && !stat.contains(") Z ")
    }

    #[test]
    fn one_that_hangs_is_killed_with_its_children_and_keeps_nobody_waiting() {
        let folder = tempfile::tempdir().unwrap();
        let pids = folder.path().join("pids");
        let hang = format!("sleep 1000 & echo $! >> {}; sleep 1001", pids.display());
        let beeps = folder.path().join("beeps");
        let parameters = HooksParameters {
            accepted: shell(&hang),
            durable: shell(&format!("echo beep >> {}", beeps.display())),
            timeout_ms: 1000,
            at_most: 2,
            ..HooksParameters::default()
        };
        let events = Events::default();
        let clock = Clock::by_hand(Timestamp(0));
        let begin = clock.now();
        let hooks = start(&parameters, &events, clock);
        for i in 0..4 {
            events.publish(accepted(&format!("a-{i}")));
        }
        events.publish(Event::Durable {
            capture: "a-3".into(),
            recording: "/r".into(),
        });
        until("two run", || text(&pids).lines().count() == 2);
        assert_eq!(text(&beeps), "");
        until("the beep", || {
            clock.advance(Duration::from_millis(100));
            text(&beeps) == "beep\n"
        });
        // Never more than two at a time: two times two had their time before.
        assert!(clock.elapsed(begin) >= Duration::from_millis(2000));
        assert_eq!(text(&pids).lines().count(), 4);
        until("children are killed", || {
            !text(&pids).lines().any(is_running)
        });
        hooks.stop();
    }

    #[test]
    fn what_was_published_before_the_end_is_still_run() {
        let folder = tempfile::tempdir().unwrap();
        let marks = folder.path().join("marks");
        let parameters = HooksParameters {
            durable: shell(&format!("echo mark >> {}", marks.display())),
            at_most: 2,
            ..HooksParameters::default()
        };
        let events = Events::default();
        let hooks = start(&parameters, &events, Clock::by_hand(Timestamp(0)));
        for i in 0..8 {
            events.publish(Event::Durable {
                capture: format!("a-{i}"),
                recording: "/r".into(),
            });
        }
        hooks.stop();
        assert_eq!(text(&marks), "mark\n".repeat(8));
    }

    #[test]
    fn what_still_runs_at_the_end_is_killed_and_what_is_not_there_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let pids = folder.path().join("pids");
        let parameters = HooksParameters {
            timeout_ms: 1_000_000_000,
            accepted: shell(&format!("echo $$ >> {}; sleep 1000", pids.display())),
            durable: vec!["/nonexistent/beep".into()],
            ..HooksParameters::default()
        };
        let events = Events::default();
        let clock = Clock::by_hand(Timestamp(0));
        let hooks = start(&parameters, &events, clock);
        events.publish(Event::Durable {
            capture: "a".into(),
            recording: "/r".into(),
        });
        events.publish(accepted("a"));
        until("it runs", || text(&pids).ends_with('\n'));
        std::thread::scope(|scope| {
            let stops = scope.spawn(move || hooks.stop());
            // From when on the end is waited for is not known here.
            until("the end", || {
                clock.advance(AFTER_THE_END);
                stops.is_finished()
            });
        });
        until("it is killed", || !is_running(&text(&pids)));
        let none = Hooks::start(&HooksParameters::default(), &events, Clock::system()).unwrap();
        assert!(none.is_none());
    }
}

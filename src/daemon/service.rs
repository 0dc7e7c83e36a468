//! The daemon as a service: reports when it is ready and what its state is, shows that its socket is served, and
//! reloads its configuration on request. It runs beside the socket, on the same thread, with tokio's timers: a `Clock`
//! wakes no task. How long the daemon has run, it reads from its `Clock`.

use super::capturing::{Capturing, Order, ReloadedSettings};
use super::parameters::ServiceParameters;
use super::readiness::readiness;
use super::systemd::{Heartbeat, Notifier, Watchdog};
use crate::clock::Clock;
use crate::log;
use std::sync::Arc;
use std::time::Instant;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::oneshot;

/// Reads the parameters again, as far as they may change; else says what is in the way.
pub(super) type ReloadSettings =
    Box<dyn Fn() -> Result<(ReloadedSettings, ServiceParameters), String>>;

/// What the daemon is to systemd.
pub struct Service {
    notifier: Arc<Notifier>,
    heartbeat: Heartbeat,
    policy: ServiceParameters,
    reload: ReloadSettings,
    clock: Clock,
    begin: Instant,
    ready: bool,
    /// The last line of status.
    said: String,
}

impl Service {
    /// Not ready yet.
    pub fn new(
        notifier: Arc<Notifier>,
        watchdog: &Watchdog,
        policy: ServiceParameters,
        reload: ReloadSettings,
        clock: Clock,
    ) -> Self {
        Self {
            notifier,
            heartbeat: watchdog.heartbeat("socket"),
            policy,
            reload,
            clock,
            begin: clock.now(),
            ready: false,
            said: String::new(),
        }
    }

    /// Says how the daemon is, twice a second, and reads parameters again at SIGHUP; never ends.
    pub(super) async fn attend(&mut self, capturing: &Capturing) {
        let mut ticks = tokio::time::interval(Heartbeat::INTERVAL);
        let Ok(mut hangups) = signal(SignalKind::hangup()) else {
            log::error!("the daemon cannot receive SIGHUP: restart it to change its configuration");
            return std::future::pending().await;
        };
        loop {
            tokio::select! {
                _ = ticks.tick() => self.say(capturing),
                _ = hangups.recv() => self.read_again(capturing).await,
            }
        }
    }

    fn say(&mut self, capturing: &Capturing) {
        self.heartbeat.tick();
        let now = readiness(
            &capturing.status(),
            self.clock.elapsed(self.begin),
            &self.policy,
        );
        capturing.set_ready(now.ready);
        if now.ready && !self.ready {
            log::notice!("{}", now.words);
            self.notifier.notify("READY=1");
            self.ready = true;
        }
        if now.words != self.said {
            self.notifier.notify(&format!("STATUS={}", now.words));
            self.said = now.words;
        }
    }

    async fn read_again(&mut self, capturing: &Capturing) {
        self.notifier.notify("RELOADING=1");
        let end = match (self.reload)() {
            Ok((settings, policy)) => {
                self.policy = policy;
                self.hand_over(capturing, settings).await
            }
            Err(reason) => Err(reason),
        };
        match end {
            Ok(words) => log::notice!("{words}"),
            Err(reason) => log::error!(
                "the configuration was not reloaded, and nothing changed: \
                {reason}"
            ),
        }
        if self.ready {
            self.notifier.notify("READY=1");
        }
    }

    /// Gives the parameters to the capturing thread, once it has no capture in hand.
    async fn hand_over(
        &self,
        capturing: &Capturing,
        settings: ReloadedSettings,
    ) -> Result<String, String> {
        while capturing.is_busy() {
            self.heartbeat.tick();
            tokio::time::sleep(Heartbeat::INTERVAL / 50).await;
        }
        let (told, answer) = oneshot::channel();
        let tell = move |result| drop(told.send(result));
        capturing.order(Order::Reload(Box::new(settings), Box::new(tell)));
        answer
            .await
            .unwrap_or_else(|_| Err("the daemon is ending".into()))
    }

    /// Says that the daemon is ending.
    pub fn ending(&self) {
        self.notifier
            .notify("STOPPING=1\nSTATUS=ending: the capture in progress is finished first");
    }
}

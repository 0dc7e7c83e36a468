//! Publishes the daemon's events to all listeners. Publishing never waits: a listener that is slow loses the oldest
//! events that it has not read, and is told how many.

use tokio::sync::broadcast;
use tokio::sync::broadcast::error::{RecvError, TryRecvError};

pub use crate::trigger::Event;

/// Events that are kept for slow listeners, all of them together.
const KEPT: usize = 1024;

/// The publisher of events; clones publish to the same listeners.
#[derive(Clone)]
pub struct Events {
    listeners: broadcast::Sender<Event>,
}

impl Default for Events {
    fn default() -> Self {
        Self {
            listeners: broadcast::Sender::new(KEPT),
        }
    }
}

impl Events {
    /// Publishes an event to all present listeners. Never waits for one of them.
    pub fn publish(&self, event: Event) {
        // Nobody may be listening.
        let _ = self.listeners.send(event);
    }

    /// Listens from now on.
    pub fn subscribe(&self) -> Subscription {
        Subscription(self.listeners.subscribe())
    }
}

/// A listener.
pub struct Subscription(broadcast::Receiver<Event>);

impl Subscription {
    /// The next event, or [`Event::Lost`] in place of those for which this listener was too slow. `None` if no more
    /// events can come.
    pub async fn next(&mut self) -> Option<Event> {
        heard(self.0.recv().await)
    }

    /// The same for a thread, which waits.
    pub fn wait(&mut self) -> Option<Event> {
        heard(self.0.blocking_recv())
    }

    /// The next one that is there already.
    pub(super) fn try_next(&mut self) -> Option<Event> {
        match self.0.try_recv() {
            Ok(event) => Some(event),
            Err(TryRecvError::Lagged(events)) => Some(Event::Lost { events }),
            Err(TryRecvError::Empty | TryRecvError::Closed) => None,
        }
    }
}

fn heard(received: Result<Event, RecvError>) -> Option<Event> {
    match received {
        Ok(event) => Some(event),
        Err(RecvError::Lagged(events)) => Some(Event::Lost { events }),
        Err(RecvError::Closed) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(number: usize) -> Event {
        Event::Refused {
            reason: number.to_string(),
        }
    }

    #[test]
    fn each_listener_hears_everything_in_its_order() {
        let events = Events::default();
        let (mut one, mut two) = (events.subscribe(), events.subscribe());
        let others = events.clone();
        (0..10).for_each(|i| others.publish(refused(i)));
        drop((events, others));
        for listener in [&mut one, &mut two] {
            let heard: Vec<_> = std::iter::from_fn(|| listener.wait()).collect();
            assert_eq!(heard, (0..10).map(refused).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_slow_listener_loses_the_oldest_and_hears_how_many() {
        let events = Events::default();
        let mut slow = events.subscribe();
        (0..KEPT + 100).for_each(|i| events.publish(refused(i)));
        assert_eq!(slow.wait(), Some(Event::Lost { events: 100 }));
        for i in 100..KEPT + 100 {
            assert_eq!(slow.wait(), Some(refused(i)));
        }
    }
}

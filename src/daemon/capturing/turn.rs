//! The turn of the one order that is carried out, and when it ends: before its answer is heard, so that who hears it
//! and asks again at once finds the daemon free.

use super::{Answer, Order};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// An order's turn, which keeps others waiting until it ends; it ends once, so that it cannot end another's.
#[derive(Clone)]
pub(super) struct Turn {
    busy: Arc<AtomicBool>,
    is_over: Arc<AtomicBool>,
}

impl Turn {
    /// The turn that `busy` stands for, which whoever gave the order has set.
    pub(super) fn of(busy: &Arc<AtomicBool>) -> Self {
        Self {
            busy: busy.clone(),
            is_over: Arc::default(),
        }
    }

    pub(super) fn end(&self) {
        if !self.is_over.swap(true, Ordering::AcqRel) {
            self.busy.store(false, Ordering::Release);
        }
    }

    /// The order, whose answer ends the turn before it is given. A press has many replies and keeps its turn.
    pub(super) fn ended_by_answer_to(&self, order: Order) -> Order {
        match order {
            Order::Press(press) => Order::Press(press),
            Order::Background(answer) => Order::Background(self.ended_by(answer)),
            Order::Begin(name, about, answer) => Order::Begin(name, about, self.ended_by(answer)),
            Order::Note(note, answer) => Order::Note(note, self.ended_by(answer)),
            Order::Close(answer) => Order::Close(self.ended_by(answer)),
            Order::Reread(reread, answer) => Order::Reread(reread, self.ended_by(answer)),
        }
    }

    fn ended_by(&self, answer: Answer) -> Answer {
        let turn = self.clone();
        Box::new(move |words| {
            turn.end();
            answer(words);
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crossbeam_channel::bounded;

    #[test]
    fn an_answer_is_heard_when_the_turn_is_over_and_ends_no_later_one() {
        let busy = Arc::new(AtomicBool::new(true));
        let turn = Turn::of(&busy);
        let (sender, heard) = bounded(1);
        let seen = busy.clone();
        let order = Order::Close(Box::new(move |_| {
            sender.send(seen.load(Ordering::Acquire)).unwrap();
        }));
        let Order::Close(answer) = turn.ended_by_answer_to(order) else {
            panic!("another order");
        };
        answer(Ok(String::new()));
        assert_eq!(heard.recv(), Ok(false));
        // The next order has begun when this one's thread comes to its end.
        busy.store(true, Ordering::Release);
        turn.end();
        assert!(busy.load(Ordering::Acquire));
    }
}

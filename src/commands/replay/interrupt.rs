//! Prints how far a replay got when a person stops it with Ctrl-C. The model that is being made then is left out, as if
//! the process had been killed: folders get their names only when they are complete.

use crate::words::count;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Captures of this process that have a model.
static DONE: AtomicUsize = AtomicUsize::new(0);

/// The exit code of a process that a person stopped, as shells have it (128 and the signal's number).
const EXIT_STOPPED: i32 = 130;

/// Another capture has its model.
pub(super) fn done() {
    DONE.fetch_add(1, Ordering::Relaxed);
}

/// From now on Ctrl-C prints how many models are done and how to go on. If no handler can be set, it prints nothing.
pub(super) fn explain() {
    let _ = ctrlc::set_handler(|| {
        eprintln!(
            "\nscand: stopped after {}; run the same command again to go on with the others",
            count(DONE.load(Ordering::Relaxed), "capture")
        );
        std::process::exit(EXIT_STOPPED);
    });
}

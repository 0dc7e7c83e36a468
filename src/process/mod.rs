//! Processes of the operating system: one that is started, listened to and ended at its time, and how much this one
//! takes of what all share. Knows nothing of what a process is for.

mod cancel;
mod child;
mod inherited;
mod priority;
mod system;

pub use cancel::Cancel;
pub use child::{Child, End};
pub use priority::{come_last, thread_comes_last};
pub use system::close_inherited;

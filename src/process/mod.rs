//! Processes of the operating system: starts a child, reads its output and ends it at its time limit; lowers this
//! process's own priority, and confines it to its own files. Knows nothing of what a process is for.

mod cancel;
mod child;
mod confine;
mod inherited;
mod priority;
mod system;

pub use cancel::Cancel;
pub use child::{Child, ChildExit, last_line};
pub use confine::{ConfineError, Limits, bind_to_parent, confine};
pub use priority::{lower_priority, lower_thread_priority};
pub use system::close_inherited;

//! System calls that no safe library has: they close the files that a process inherited, and lower its priority. Each
//! affects only the calling process.
#![allow(
    unsafe_code,
    reason = "close_range, sched_setscheduler and ioprio_set have no safe form"
)]

use std::io::{Error, Result};

/// Closes all files except the three standard ones: a child must not inherit what the cameras' SDKs hold open.
///
/// Called at the very start of a process, before anything is opened.
///
/// # Errors
/// If the system refuses.
pub fn close_inherited() -> Result<()> {
    // SAFETY: the process has just begun and holds no file but the standard ones, which stay.
    let closed = unsafe { libc::syscall(libc::SYS_close_range, 3u32, u32::MAX, 0u32) };
    done(closed)
}

/// Puts the process into the scheduler's batch class, so that it never preempts another one when it wakes up.
pub(super) fn schedule_as_batch() -> Result<()> {
    // SAFETY: all zeros are a valid value of a plain C structure, and the call only reads it.
    let changed = unsafe {
        let priority: libc::sched_param = std::mem::zeroed();
        libc::sched_setscheduler(0, libc::SCHED_BATCH, &raw const priority)
    };
    done(libc::c_long::from(changed))
}

/// Puts the process into the disk's idle class: the disk serves it only when no other process needs it.
pub(super) fn use_idle_disk() -> Result<()> {
    const WHO_PROCESS: i32 = 1;
    const CLASS_IDLE: i32 = 3;
    const CLASS_SHIFT: i32 = 13;
    // SAFETY: plain numbers; 0 is the calling process.
    let changed = unsafe {
        let class = CLASS_IDLE << CLASS_SHIFT;
        libc::syscall(libc::SYS_ioprio_set, WHO_PROCESS, 0, class)
    };
    done(changed)
}

fn done(returned: libc::c_long) -> Result<()> {
    if returned < 0 {
        Err(Error::last_os_error())
    } else {
        Ok(())
    }
}

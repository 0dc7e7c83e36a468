//! Lowers the priority of this process, or of one of its threads, below that of all others.

use super::system;

/// Gives this process the lowest priority for the processors, the disk and memory. Returns what the system refused, and
/// why.
pub fn lower_priority(nice: u32) -> Vec<String> {
    let mut missing = lower_thread_priority(nice);
    if let Err(error) = std::fs::write("/proc/self/oom_score_adj", "1000") {
        missing.push(format!(
            "that it is ended first when memory runs out: {error}"
        ));
    }
    missing
}

/// Gives this thread the lowest priority for the processors and the disk. Returns what the system refused, and why.
pub fn lower_thread_priority(nice: u32) -> Vec<String> {
    let niced = rustix::process::setpriority_process(None, nice as i32).map_err(Into::into);
    let steps = [
        ("nice", niced),
        ("the scheduler's batch class", system::schedule_as_batch()),
        ("the disk's idle class", system::use_idle_disk()),
    ];
    let failed = steps
        .into_iter()
        .filter_map(|(what, done)| Some(format!("{what}: {}", done.err()?)));
    failed.collect()
}

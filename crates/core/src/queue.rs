//! Runs jobs, one or a number of them on a number of threads; a job that panics does not affect the others. Knows
//! nothing of scanning.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};

/// A job panicked; its panic message.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("scand has a bug and stopped this job ({0}): please report it with the recording")]
pub struct Panicked(pub String);

/// Runs one job.
///
/// # Errors
/// If it panics. What it shares with others must bear that it was left at any place.
pub fn guarded<R>(job: impl FnOnce() -> R) -> Result<R, Panicked> {
    catch_unwind(AssertUnwindSafe(job)).map_err(|cause| Panicked(last_words(&*cause)))
}

/// Runs jobs 0 to `count` - 1 on `workers` threads and returns their results in order. A job that panics
/// fails alone. A single worker is the calling thread itself.
pub fn run<R: Send>(
    workers: usize,
    count: usize,
    job: impl Fn(usize) -> R + Sync,
) -> Vec<Result<R, Panicked>> {
    let job = |i| guarded(|| job(i));
    if workers <= 1 {
        return (0..count).map(job).collect();
    }
    let next = AtomicUsize::new(0);
    let work = || {
        let mine = std::iter::repeat_with(|| next.fetch_add(1, Ordering::Relaxed));
        mine.take_while(|&i| i < count)
            .map(|i| (i, job(i)))
            .collect::<Vec<_>>()
    };
    let mut done: Vec<(usize, Result<R, Panicked>)> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..workers.min(count)).map(|_| scope.spawn(work)).collect();
        // A worker cannot panic: it catches the panics of its jobs.
        threads
            .into_iter()
            .filter_map(|t| t.join().ok())
            .flatten()
            .collect()
    });
    done.sort_by_key(|(i, _)| *i);
    done.into_iter().map(|(_, result)| result).collect()
}

fn last_words(cause: &(dyn std::any::Any + Send)) -> String {
    let text = cause.downcast_ref::<&str>().map(ToString::to_string);
    text.or_else(|| cause.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "no message".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_come_in_order_and_a_panic_fails_alone() {
        for workers in [1, 3, 20] {
            let results = run(workers, 12, |i| {
                assert!(i != 5, "job {i} broke");
                i * i
            });
            for (i, result) in results.iter().enumerate() {
                match result {
                    Ok(square) => assert_eq!(*square, i * i),
                    Err(panicked) => assert!(i == 5 && panicked.0.contains("job 5 broke")),
                }
            }
            assert_eq!(results.len(), 12);
        }
    }
}

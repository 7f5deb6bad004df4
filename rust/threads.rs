//! The library's own pool of threads: how many, and what happens in a forked child.
//!
//! Kernels use rayon's ordinary parallel iterators, so a Rust program may call them on any pool of its own.
//! [`run`] runs a closure on this library's pool, whose size is [`set_num_threads`] or the environment variable
//! `BELTRAMI_NUM_THREADS`. A forked child has none of its parent's threads; the pool is then built anew.

use crate::error::{Error, Result};
use rayon::{Scope, ThreadPool, ThreadPoolBuilder};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::Duration;

struct Pool {
    process: u32,
    threads: Arc<ThreadPool>,
}

static POOLS: [Mutex<Option<Pool>>; 2] = [const { Mutex::new(None) }; 2];
static PLACE: AtomicUsize = AtomicUsize::new(0);
/// What [`set_num_threads`] was told; 0 before.
static WANTED: AtomicUsize = AtomicUsize::new(0);

/// Where the pool is kept. It is locked for moments only, never while threads start: if it stays locked, a thread of the parent held it
/// when this child was forked, and nobody will ever unlock it here; then the other place serves.
fn kept() -> MutexGuard<'static, Option<Pool>> {
    for _ in 0..500 {
        if PLACE.load(Ordering::Relaxed) > 0 {
            break;
        }
        match POOLS[0].try_lock() {
            Ok(guard) => return guard,
            Err(TryLockError::Poisoned(guard)) => return guard.into_inner(),
            Err(TryLockError::WouldBlock) => std::thread::sleep(Duration::from_millis(1)),
        }
    }
    PLACE.store(1, Ordering::Relaxed);
    POOLS[1].lock().unwrap_or_else(PoisonError::into_inner)
}

/// Keeps a pool and lets go of the one before, whose threads live in the parent only if a parent made it: then joining them would wait for ever.
fn keep(pool: Pool) {
    let process = pool.process;
    let old = kept().replace(pool);
    if let Some(parents) = old.filter(|old| old.process != process) {
        std::mem::forget(parents);
    }
}

fn build(count: usize) -> Result<Arc<ThreadPool>> {
    ThreadPoolBuilder::new()
        .num_threads(count)
        .thread_name(|index| format!("beltrami-{index}"))
        .stack_size(16 << 20)
        .build()
        .map(Arc::new)
        .map_err(|error| Error::input(format!("{count} threads cannot be started: {error}; ask for fewer with set_num_threads")))
}

fn wanted() -> Result<usize> {
    let count = WANTED.load(Ordering::Relaxed);
    if count > 0 {
        return Ok(count);
    }
    match std::env::var("BELTRAMI_NUM_THREADS") {
        Ok(text) if !text.trim().is_empty() => text
            .trim()
            .parse()
            .ok()
            .filter(|count| (1..=4096).contains(count))
            .ok_or_else(|| Error::input(format!("BELTRAMI_NUM_THREADS is {text:?}; it must be a whole number from 1 to 4096"))),
        _ => Ok(std::thread::available_parallelism().map_or(1, usize::from)),
    }
}

fn pool() -> Result<Arc<ThreadPool>> {
    let process = std::process::id();
    let made = || kept().as_ref().filter(|pool| pool.process == process).map(|pool| pool.threads.clone());
    if let Some(threads) = made() {
        return Ok(threads);
    }
    let threads = build(wanted()?)?;
    // what another thread made meanwhile goes first
    if let Some(threads) = made() {
        return Ok(threads);
    }
    keep(Pool { process, threads: threads.clone() });
    Ok(threads)
}

/// How many threads [`run`] uses; see [`set_num_threads`] for an example.
///
/// # Errors
/// [`Error::Input`] if `BELTRAMI_NUM_THREADS` is no whole number from 1 to 4096, or the threads cannot be started.
pub fn num_threads() -> Result<usize> {
    pool().map(|pool| pool.current_num_threads())
}

/// Sets how many threads [`run`] uses from now on.
///
/// ```
/// beltrami::threads::set_num_threads(2)?;
/// assert_eq!(beltrami::threads::num_threads()?, 2);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if `count` is not from 1 to 4096 or the threads cannot be started.
pub fn set_num_threads(count: usize) -> Result<()> {
    if !(1..=4096).contains(&count) {
        return Err(Error::input(format!("{count} threads; choose from 1 to 4096")));
    }
    let threads = build(count)?;
    WANTED.store(count, Ordering::Relaxed);
    keep(Pool { process: std::process::id(), threads });
    Ok(())
}

/// Runs `work` on the library's pool and waits for it.
///
/// ```
/// use beltrami::{Control, near::KdTree, threads};
/// let points = [0.0, 1.0, 4.0];
/// let tree = threads::run(|| KdTree::new(&points, 1, &Control::default()))?;
/// assert_eq!(tree.len(), 3);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// Those of `work`, and those of [`num_threads`].
pub fn run<T: Send>(work: impl FnOnce() -> Result<T> + Send) -> Result<T> {
    pool()?.install(work)
}

/// Runs `wait` on the calling thread; what it spawns in the scope runs on the library's pool.
///
/// ```
/// use beltrami::{Control, near::KdTree, threads};
/// let (points, control) = (vec![0.5; 3000], Control::default());
/// let mut tree = None;
/// threads::scope(|scope| {
///     scope.spawn(|_| tree = Some(KdTree::new(&points, 3, &control)));
///     control.done() // meanwhile: how far it is
/// })?;
/// assert!(tree.is_some_and(|tree| tree.is_ok()));
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// Those of [`num_threads`].
pub fn scope<'scope, T>(wait: impl FnOnce(&Scope<'scope>) -> T) -> Result<T> {
    Ok(pool()?.in_place_scope(wait))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As in a child that was forked while a thread of its parent held the lock.
    #[test]
    fn a_lock_that_nobody_will_open() {
        let guard = kept();
        assert_eq!(run(|| Ok(6 * 7)).unwrap(), 42);
        assert_eq!(PLACE.load(Ordering::Relaxed), 1);
        drop(guard);
        PLACE.store(0, Ordering::Relaxed);
    }
}

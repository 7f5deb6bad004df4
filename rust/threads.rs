//! The library's own pool of threads: how many, and what happens in a forked child.
//!
//! Kernels use rayon's ordinary parallel iterators, so a Rust program may call them on any pool of its own.
//! [`run`] runs a closure on this library's pool, whose size is [`set_num_threads`] or the environment variable
//! `BELTRAMI_NUM_THREADS`. A forked child has none of its parent's threads; the pool is then built anew.

use crate::error::{Error, Result};
use rayon::{Scope, ThreadPool, ThreadPoolBuilder};
use std::sync::{Arc, Mutex, PoisonError};

struct Pool {
    process: u32,
    threads: Arc<ThreadPool>,
}

static POOL: Mutex<Option<Pool>> = Mutex::new(None);
static WANTED: Mutex<Option<usize>> = Mutex::new(None);

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
    if let Some(count) = *WANTED.lock().unwrap_or_else(PoisonError::into_inner) {
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
    let mut guard = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(pool) = guard.as_ref().filter(|pool| pool.process == process) {
        return Ok(pool.threads.clone());
    }
    let threads = build(wanted()?)?;
    if let Some(parents) = guard.replace(Pool { process, threads: threads.clone() }) {
        std::mem::forget(parents); // its threads live in the parent only: joining them would wait for ever
    }
    Ok(threads)
}

/// How many threads [`run`] uses.
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
    *WANTED.lock().unwrap_or_else(PoisonError::into_inner) = Some(count);
    let process = std::process::id();
    let old = POOL.lock().unwrap_or_else(PoisonError::into_inner).replace(Pool { process, threads });
    if let Some(old) = old.filter(|old| old.process != process) {
        std::mem::forget(old);
    }
    Ok(())
}

/// Runs `work` on the library's pool and waits for it.
///
/// # Errors
/// Those of `work`, and those of [`num_threads`].
pub fn run<T: Send>(work: impl FnOnce() -> Result<T> + Send) -> Result<T> {
    pool()?.install(work)
}

/// Runs `wait` on the calling thread; what it spawns in the scope runs on the library's pool.
///
/// # Errors
/// Those of [`num_threads`].
pub fn scope<'scope, T>(wait: impl FnOnce(&Scope<'scope>) -> T) -> Result<T> {
    Ok(pool()?.in_place_scope(wait))
}

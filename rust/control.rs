//! How a caller watches long work and stops it.

use crate::error::{Error, Result};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Shared between the thread that works and the one that waits: the share of work done, and a request to stop.
///
/// Long kernels take `&Control` and call [`Control::report`] at least every few hundredths of a second.
///
/// ```
/// let control = beltrami::Control::default();
/// assert!(control.report(0.5).is_ok());
/// control.stop();
/// assert_eq!(control.report(0.6), Err(beltrami::Error::Cancelled));
/// assert_eq!(control.done(), 0.6);
/// ```
#[derive(Debug, Default)]
pub struct Control {
    stopped: AtomicBool,
    done: AtomicU64,
}

impl Control {
    /// Says that `share` (0 to 1) of the work is done; an [`Error::Cancelled`] if the caller wants to stop.
    pub fn report(&self, share: f64) -> Result<()> {
        self.done.store(share.to_bits(), Ordering::Relaxed);
        self.check()
    }

    /// An [`Error::Cancelled`] if the caller wants to stop.
    pub fn check(&self) -> Result<()> {
        if self.stopped.load(Ordering::Relaxed) { Err(Error::Cancelled) } else { Ok(()) }
    }

    /// Asks the work to stop; it ends with [`Error::Cancelled`] at its next report.
    pub fn stop(&self) {
        self.stopped.store(true, Ordering::Relaxed);
    }

    /// The share of work done that was last reported.
    pub fn done(&self) -> f64 {
        f64::from_bits(self.done.load(Ordering::Relaxed))
    }
}

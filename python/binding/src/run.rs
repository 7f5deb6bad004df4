//! Every call into the core goes through here: the GIL is released, Ctrl-C and progress are served, a panic becomes an error.

use crate::error;
use beltrami::{Control, Result, threads};
use pyo3::prelude::*;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

const GLANCE: Duration = Duration::from_millis(40); // between looks at Ctrl-C and calls of progress

/// Runs long work on the library's threads. `progress` is called with the share of work done (0 to 1); if it returns
/// False the work stops with `beltrami.Cancelled`.
pub fn watched<T: Send>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&Control) -> Result<T> + Send,
) -> PyResult<T> {
    let control = Control::default();
    let progress = progress.filter(|p| !p.is_none()).map(|p| p.clone().unbind());
    let mut interruption = None;
    let outcome = py.detach(|| {
        let (control, interruption, progress) = (&control, &mut interruption, &progress);
        let (send, receive) = channel();
        threads::scope(move |scope| {
            scope.spawn(move |_| {
                let _ = send.send(catch_unwind(AssertUnwindSafe(|| work(control))));
            });
            loop {
                match receive.recv_timeout(GLANCE) {
                    Ok(outcome) => return Some(outcome),
                    Err(RecvTimeoutError::Disconnected) => return None,
                    Err(RecvTimeoutError::Timeout) if interruption.is_none() => {
                        if let Err(error) = Python::attach(|py| glance(py, progress.as_ref(), control.done())) {
                            *interruption = Some(error);
                            control.stop();
                        }
                    }
                    Err(RecvTimeoutError::Timeout) => {}
                }
            }
        })
    });
    if let Some(error) = interruption {
        return Err(error);
    }
    match outcome.map_err(|error| error::convert(py, error))? {
        Some(Ok(Ok(answer))) => {
            if let Some(progress) = &progress {
                progress.call1(py, (1.0,))?;
            }
            Ok(answer)
        }
        Some(Ok(Err(error))) => Err(error::convert(py, error)),
        Some(Err(panic)) => Err(bug(py, &*panic)),
        None => Err(error::raise(py, "InternalError", "the work ended without an answer".into())),
    }
}

/// Runs brief work (well below a tenth of a second) on the library's threads.
pub fn brief<T: Send>(py: Python<'_>, work: impl FnOnce() -> Result<T> + Send) -> PyResult<T> {
    match py.detach(|| catch_unwind(AssertUnwindSafe(|| threads::run(work)))) {
        Ok(outcome) => outcome.map_err(|error| error::convert(py, error)),
        Err(panic) => Err(bug(py, &*panic)),
    }
}

fn glance(py: Python<'_>, progress: Option<&Py<PyAny>>, done: f64) -> PyResult<()> {
    py.check_signals()?;
    if let Some(progress) = progress {
        let answer = progress.call1(py, (done,))?;
        if answer.bind(py).is(pyo3::types::PyBool::new(py, false)) {
            return Err(error::convert(py, beltrami::Error::Cancelled));
        }
    }
    Ok(())
}

fn bug(py: Python<'_>, panic: &(dyn std::any::Any + Send)) -> PyErr {
    let text =
        panic.downcast_ref::<&str>().map(ToString::to_string).or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
    error::raise(py, "InternalError", format!("this is a bug in beltrami, please report it with what you called: {text}"))
}

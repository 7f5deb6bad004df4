//! Core errors become the exception classes of `beltrami.errors`.

use beltrami::Error;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyModule;

static CLASSES: PyOnceLock<Py<PyModule>> = PyOnceLock::new();

/// An exception of the class `name` of `beltrami.errors`.
pub fn raise(py: Python<'_>, name: &str, text: String) -> PyErr {
    let made = CLASSES
        .get_or_try_init(py, || PyModule::import(py, "beltrami.errors").map(Bound::unbind))
        .and_then(|module| module.bind(py).getattr(name))
        .and_then(|class| class.call1((text,)));
    match made {
        Ok(exception) => PyErr::from_value(exception),
        Err(error) => error,
    }
}

/// A bad argument.
pub fn input(py: Python<'_>, text: impl Into<String>) -> PyErr {
    raise(py, "InputError", text.into())
}

/// The exception for an error of the core.
pub fn convert(py: Python<'_>, error: Error) -> PyErr {
    let name = match &error {
        Error::Input(_) => "InputError",
        Error::Topology(_) => "TopologyError",
        Error::File { .. } => "FileError",
        Error::Numerical(_) => "NumericalError",
        Error::NotConverged(_) => "ConvergenceError",
        Error::Cancelled => "Cancelled",
        _ => "Error",
    };
    raise(py, name, error.to_string())
}

//! One error type for the whole crate. A message says what is wrong, where, the value, and what to do about it.

use std::fmt;
use std::path::PathBuf;

/// `Result` with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

/// Where in a file something is wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// Line of a text file, counted from 1.
    Line(usize),
    /// Offset into a binary file, counted from 0.
    Byte(usize),
    /// The file as a whole.
    Whole,
}

/// Everything that can go wrong.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Error {
    /// An argument cannot be used; the text names what, where, the value and the remedy.
    Input(String),
    /// The shape's topology does not allow what was asked (not closed, not manifold, wrong genus ...).
    Topology(String),
    /// A file cannot be read or written.
    File {
        /// The file, as it was named.
        path: PathBuf,
        /// Where in it.
        place: Place,
        /// What is wrong there.
        cause: String,
    },
    /// Arithmetic broke down: a matrix is not positive definite, a number overflowed.
    Numerical(String),
    /// An iteration ended before it reached its tolerance.
    NotConverged(String),
    /// The caller asked for the work to stop.
    Cancelled,
}

impl Error {
    /// An [`Error::Input`] from any text.
    pub fn input(text: impl Into<String>) -> Self {
        Error::Input(text.into())
    }

    /// An [`Error::Numerical`] from any text.
    pub fn numerical(text: impl Into<String>) -> Self {
        Error::Numerical(text.into())
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Error::Input(text) | Error::Topology(text) | Error::Numerical(text) | Error::NotConverged(text) => f.write_str(text),
            Error::File { path, place, cause } => match place {
                Place::Line(line) => write!(f, "{}, line {line}: {cause}", path.display()),
                Place::Byte(byte) => write!(f, "{}, byte {byte}: {cause}", path.display()),
                Place::Whole => write!(f, "{}: {cause}", path.display()),
            },
            Error::Cancelled => f.write_str("stopped on request before the work was done"),
        }
    }
}

impl std::error::Error for Error {}

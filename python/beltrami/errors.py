"""Errors. Every error of the library is an :class:`Error`, and also the built-in exception that one would expect."""

from __future__ import annotations

__all__ = [
    "Cancelled",
    "ConvergenceError",
    "DependencyError",
    "Error",
    "FileError",
    "InputError",
    "InternalError",
    "NumericalError",
    "TopologyError",
]


class Error(Exception):
    """Base class of all errors of beltrami. The message says what is wrong, where, the value, and what to do."""


class InputError(Error, ValueError):
    """An argument cannot be used: its type, its shape, its range, or a number in it that is not finite."""


class TopologyError(InputError):
    """The shape's topology does not allow what was asked: not closed, not manifold, of the wrong genus, in several pieces."""


class FileError(Error, OSError):
    """A file cannot be read or written; the message names the file, the line or byte, and the cause."""


class NumericalError(Error, ArithmeticError):
    """Arithmetic broke down: a matrix is not positive definite, numbers overflow or vanish."""


class ConvergenceError(Error, RuntimeError):
    """An iteration ended before it reached its tolerance, without a usable answer."""


class Cancelled(Error, RuntimeError):
    """``progress`` returned False."""


class DependencyError(Error, ImportError):
    """An optional package is missing; the message names the extra to install."""


class InternalError(Error, RuntimeError):
    """A bug in beltrami."""

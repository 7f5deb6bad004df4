"""The number of threads of the compiled core; results are bit-for-bit the same with any number."""

from __future__ import annotations

from . import _core, arrays

__all__ = ["num_threads", "set_num_threads"]


def num_threads() -> int:
    """The number of threads in use: that of the last :func:`set_num_threads`, or of the environment variable ``BELTRAMI_NUM_THREADS``,
    or one per processor.

    Returns
    -------
    int

    Raises
    ------
    InputError
        ``BELTRAMI_NUM_THREADS`` is no whole number from 1 to 4096.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.num_threads() >= 1
    True
    """
    return _core.num_threads()


def set_num_threads(count: int) -> None:
    """Set the number of threads that are used from now on.

    Parameters
    ----------
    count : int
        From 1 to 4096.

    Raises
    ------
    InputError
        The count is out of range or not whole.

    Examples
    --------
    >>> import beltrami as bt
    >>> before = bt.num_threads()
    >>> bt.set_num_threads(1)
    >>> bt.num_threads()
    1
    >>> bt.set_num_threads(before)
    """
    _core.set_num_threads(arrays.whole(count, "count", 1, 4096))

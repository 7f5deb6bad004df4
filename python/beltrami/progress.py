"""Progress of long computations: what users pass (nothing, True or a callable) becomes what the core calls."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from typing import TextIO

from .errors import Cancelled, InputError

Progress = bool | Callable[[float], object] | None


class Bar:
    """A plain bar on standard error, redrawn at most ten times a second; silent for work shorter than ``patience`` seconds."""

    def __init__(self, label: str = "", *, stream: TextIO | None = None, patience: float = 0.3) -> None:
        self.label = label
        self._stream = stream or sys.stderr
        self._start = time.monotonic()
        self._patience = patience
        self._shown = -1.0
        self._last = 0.0

    def __call__(self, share: float) -> None:
        now = time.monotonic()
        done = share >= 1.0
        if (now - self._start < self._patience) or (self._shown < 0 and done) or (not done and now - self._last < 0.1):
            return
        live = self._stream.isatty()
        if not live and not done and share - self._shown < 0.25:
            return  # a log gets a few lines, not hundreds
        self._shown, self._last = share, now
        filled = round(24 * min(max(share, 0.0), 1.0))
        bar = "█" * filled + "·" * (24 - filled)
        text = f"{self.label} [{bar}] {100 * share:3.0f} %  {now - self._start:.1f} s".lstrip()
        try:
            self._stream.write(f"\r\x1b[2K{text}" + ("\n" if done else "") if live else text + "\n")
        except UnicodeEncodeError:
            text = text.replace("█", "#").replace("·", ".")
            self._stream.write(f"\r\x1b[2K{text}" + ("\n" if done else "") if live else text + "\n")
        self._stream.flush()


def reporter(progress: Progress, label: str = "") -> Callable[[float], object] | None:
    """What the core takes: None, or a callable of the share done (0 to 1) that returns False to stop.

    Raises
    ------
    InputError
        ``progress`` is neither None, a bool, nor callable.

    Examples
    --------
    >>> from beltrami.progress import reporter
    >>> reporter(None) is None
    True
    >>> reporter(print) is print
    True
    """
    if progress is None or progress is False:
        return None
    if progress is True:
        return Bar(label)
    if callable(progress):
        return progress
    raise InputError(f"progress is {progress!r}; give True for a bar, or a callable of the share done")


def part(report: Callable[[float], object] | None, start: float, end: float) -> Callable[[float], object] | None:
    """The reporter of a step that takes the share ``start`` to ``end`` of the whole work."""
    if report is None:
        return None
    return lambda share: report(start + (end - start) * share)


def teller(report: Callable[[float], object] | None) -> Callable[[float], None]:
    """Tells the share done between the steps of a method; raises :class:`Cancelled` where the answer is False."""

    def tell(share: float) -> None:
        if report is not None and report(share) is False:
            raise Cancelled("stopped on request before the work was done")

    return tell


class GapWatch:
    """Progress of an iteration by the logarithm of its gap, from the first one to the tolerance."""

    def __init__(self, progress: Progress, label: str, tolerance: float) -> None:
        self.report, self.tolerance, self.first, self.share = reporter(progress, label), tolerance, 0.0, 0.0

    def __call__(self, gap: float, done: float) -> None:
        if self.report is None:
            return
        gap = max(gap, 1e-300)
        self.first = self.first or max(gap, 10 * self.tolerance)
        self.share = max(self.share, done, min(math.log(self.first / gap) / math.log(self.first / self.tolerance), 1.0))
        if self.report(float(self.share)) is False:
            raise Cancelled("stopped on request before the gap was reached")

"""The gallery: the main results on real shapes, as one page that opens from disk without a network.

A section is a function that fills a :class:`Sheet`; :func:`section` registers it. To add one for a new method, write a module in this
folder with a function and name the module in ``_MODULES``. A section that fails is shown with its error, and the others still run."""

from __future__ import annotations

import html
import importlib
import os
import re
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .. import __version__, _core, view
from ..errors import FileError, InputError

__all__ = ["Outcome", "Sheet", "run", "section", "titles"]

_MODULES = (
    "foundation",
    "spectra",
    "clouds",
    "segmentation",
    "sphere",
    "transport",
    "registration",
    "conformal_registration",
    "skeleton",
    "committor",
)

SECTIONS: dict[str, Callable[[Sheet], None]] = {}


def research_data(*names: str) -> list[Path] | None:
    """Files below the folder that the environment variable ``BELTRAMI_DATA`` names; None if one of them is absent. They hold data that may
    not be distributed with the package."""
    folder = os.environ.get("BELTRAMI_DATA")
    files = [Path(folder, name) for name in names] if folder else []
    return files if files and all(file.is_file() for file in files) else None


def section(title: str) -> Callable[[Callable[[Sheet], None]], Callable[[Sheet], None]]:
    """Registers a section under a title; sections appear in the order in which they are registered."""

    def register(fill: Callable[[Sheet], None]) -> Callable[[Sheet], None]:
        SECTIONS[title] = fill
        return fill

    return register


@dataclass(frozen=True)
class Outcome:
    """How a section went: its title, its seconds, what went wrong (one line) or None, and the files it wrote."""

    title: str
    seconds: float
    error: str | None
    files: tuple[Path, ...]


class Sheet:
    """What a section writes on: paragraphs, figures, tables, code, pictures and interactive pages, in order."""

    def __init__(self, folder: Path, name: str) -> None:
        self._folder = folder
        self._name = name
        self._parts: list[str] = []
        self.files: list[Path] = []

    def text(self, text: str) -> None:
        """A paragraph; `words` in backticks are code."""
        self._parts.append(f"<p>{_inline(text)}</p>")

    def figures(self, figures: Mapping[str, object]) -> None:
        """Certified numbers, large, with what they are."""
        items = "".join(f"<div><dt>{_inline(name)}</dt><dd>{_inline(_figure(value))}</dd></div>" for name, value in figures.items())
        self._parts.append(f'<dl class="figures">{items}</dl>')

    def table(self, header: Sequence[str], rows: Sequence[Sequence[object]], caption: str = "") -> None:
        """A table; numbers stand to the right."""

        def cell(value: object) -> str:
            numeric = isinstance(value, int | float) and not isinstance(value, bool)
            return f'<td class="number">{_figure(value)}</td>' if numeric else f"<td>{_inline(_figure(value))}</td>"

        numeric = [
            bool(rows) and all(isinstance(row[at], int | float) and not isinstance(row[at], bool) for row in rows)
            for at in range(len(header))
        ]
        classes = [' class="number"' if right else "" for right in numeric]
        head = "".join(f'<th scope="col"{kind}>{_inline(name)}</th>' for name, kind in zip(header, classes, strict=True))
        body = "".join("<tr>" + "".join(cell(value) for value in row) + "</tr>" for row in rows)
        title = f"<caption>{_inline(caption)}</caption>" if caption else ""
        self._parts.append(f'<div class="scroll"><table>{title}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>')

    def code(self, code: str) -> None:
        """The lines that do it."""
        self._parts.append(f"<pre><code>{html.escape(code.strip())}</code></pre>")

    def picture(self, shape: Any, values: Any = None, *, caption: str = "", interactive: bool = False, **options: Any) -> None:
        """A picture made by :func:`beltrami.plot`, and with ``interactive`` a page of the same beside it."""
        stem = f"{self._name}-{sum(file.suffix == '.png' for file in self.files) + 1}"
        painted = view.plot(shape, values, path=self._folder / f"{stem}.png", **options)
        assert isinstance(painted, view.Picture)
        self.files.append(self._folder / f"{stem}.png")
        height, width = painted.pixels.shape[:2]
        image = (
            f'<a href="{stem}.png"><img src="{stem}.png" alt="{html.escape(painted.description)}" width="{width}" height="{height}" '
            'loading="lazy"></a>'
        )
        link = ""
        if interactive:
            view.plot(shape, values, path=self._folder / f"{stem}.html", **options)
            self.files.append(self._folder / f"{stem}.html")
            link = f' <a class="open" href="{stem}.html">Interactive page</a>'
        self._parts.append(f"<figure>{image}<figcaption>{_inline(caption)}{link}</figcaption></figure>")

    def page(self, page: view.Page, caption: str) -> None:
        """An interactive page of its own, as a link."""
        name = f"{self._name}-{sum(file.suffix == '.html' for file in self.files) + 1}-page.html"
        page.save(self._folder / name)
        self.files.append(self._folder / name)
        self._parts.append(f'<p><a class="open" href="{name}">{_inline(caption)}</a></p>')

    def html(self) -> str:
        """What was written so far."""
        return "\n".join(self._parts)


def _inline(text: str) -> str:
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(text))


def _figure(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}".replace("-", "−")
    if isinstance(value, float):
        text = f"{value:.4g}"
        if "e" in text:
            mantissa, exponent = text.split("e")
            text = f"{mantissa}·10" + str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
        return text.replace("-", "−")
    return str(value)


def _load() -> None:
    for module in _MODULES:
        importlib.import_module(f"{__name__}.{module}")


def titles() -> list[str]:
    """Titles of all sections."""
    _load()
    return list(SECTIONS)


def _slug(title: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def _filled(folder: Path, title: str) -> tuple[Outcome, str]:
    """A section: how it went, and its part of the page."""
    sheet, start, failure = Sheet(folder, _slug(title)), time.perf_counter(), None
    try:
        SECTIONS[title](sheet)
    except Exception as error:  # one section must not stop the others
        failure = f"{type(error).__name__}: {' '.join(str(error).split())}"
        trace = html.escape("".join(traceback.format_exception(error, limit=-4)))
        body = f'{sheet.html()}<div class="error" role="alert"><strong>{html.escape(failure)}</strong><pre>{trace}</pre></div>'
    else:
        body = sheet.html()
    seconds = time.perf_counter() - start
    body = (
        f'<section id="{_slug(title)}"><h2>{html.escape(title)}</h2>{body}<p class="time">{seconds:.2f} s, pictures included, beside '
        "other sections</p></section>"
    )
    return Outcome(title, seconds, failure, tuple(sheet.files)), body


def run(
    folder: str | os.PathLike[str], *, only: Sequence[str] | None = None, progress: Callable[[str], object] | None = None
) -> list[Outcome]:
    """Writes the gallery: ``index.html``, a PNG for each picture, an HTML file for each interactive page.

    Parameters
    ----------
    folder : path
        Created if it is missing. Files of the same names are replaced, others are left alone.
    only : list of str, optional
        Only the sections with one of these words in their title.
    progress : callable, optional
        Called with a line of text before and after each section, from the thread it runs on: as many sections run side by side as
        :func:`beltrami.num_threads` says.

    Returns
    -------
    list of Outcome
        One per section; those with an ``error`` failed, and the page shows it.

    Raises
    ------
    InputError
        No title has the words.
    FileError
        The folder cannot be written.
    """
    folder = Path(folder)
    chosen = [title for title in titles() if not only or any(word.lower() in title.lower() for word in only)]
    if not chosen:
        raise InputError(f"no section has {' or '.join(only or [])} in its title; there are: {'; '.join(SECTIONS)}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{folder} cannot be made: {error.strerror}") from None
    waiting = deque(chosen)
    done: dict[str, tuple[Outcome, str]] = {}
    faults: list[BaseException] = []  # of `progress`

    def work() -> None:
        while waiting and not faults:
            try:
                title = waiting.popleft()
            except IndexError:  # another took the last one
                return
            try:
                if progress:
                    progress(f"{title} ...")
                done[title] = outcome, _ = _filled(folder, title)
                if progress:
                    progress(f"{title}: {outcome.error or 'done'} ({outcome.seconds:.1f} s)")
            except BaseException as fault:
                faults.append(fault)

    # much of a section is the work of one thread; daemons, so that Ctrl-C waits for none
    start = time.perf_counter()
    workers = [threading.Thread(target=work, daemon=True) for _ in range(min(_core.num_threads(), len(chosen)))]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    if faults:
        raise faults[0]
    elapsed = time.perf_counter() - start
    outcomes, bodies = [done[title][0] for title in chosen], [done[title][1] for title in chosen]
    template = Path(__file__).with_name("page.html").read_text(encoding="utf-8")
    contents = "".join(f'<li><a href="#{_slug(o.title)}">{html.escape(o.title)}</a></li>' for o in outcomes)
    failed = sum(outcome.error is not None for outcome in outcomes)
    summary = f"{len(outcomes)} sections in {elapsed:.1f} s" + (f", {failed} failed" if failed else "")
    for mark, text in (("__CONTENTS__", contents), ("__SUMMARY__", summary), ("__VERSION__", __version__), ("__BODY__", "\n".join(bodies))):
        template = template.replace(mark, text)
    try:
        (folder / "index.html").write_text(template, encoding="utf-8")
    except OSError as error:
        raise FileError(f"{folder / 'index.html'} cannot be written: {error.strerror}") from None
    return outcomes

"""The results of painting: a picture, or an interactive page."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from .. import _core, arrays
from ..files import written


@dataclass(frozen=True, eq=False)
class Picture:
    """A painted picture.

    Attributes
    ----------
    pixels : ndarray (height, width, 3) of uint8
    description : str
        What the picture shows, in words, for those who cannot see it.
    path : Path or None
        Where it was saved.
    """

    pixels: npt.NDArray[np.uint8]
    description: str = ""
    path: Path | None = None

    def __repr__(self) -> str:
        return f"Picture({self.pixels.shape[1]} x {self.pixels.shape[0]} pixels: {self.description})"

    def png(self) -> bytes:
        """The picture as a PNG file."""
        return _core.png(self.pixels)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes a PNG file.

        Raises
        ------
        FileError
            It cannot be written.
        """
        return write_bytes(path, self.png())

    def _repr_png_(self) -> bytes:
        return self.png()


@dataclass(frozen=True, eq=False)
class Page:
    """An interactive page in one file: it opens from disk and needs no network.

    Attributes
    ----------
    html : str
    description : str
    path : Path or None
        Where it was saved.
    """

    html: str = field(repr=False)
    description: str = ""
    path: Path | None = None

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes the page.

        Raises
        ------
        FileError
            It cannot be written.
        """
        return write_bytes(path, self.html.encode())

    def _repr_html_(self) -> str:
        import html

        look, title = "width:100%;height:560px;border:0", html.escape(self.description)
        return f'<iframe srcdoc="{html.escape(self.html)}" style="{look}" title="{title}"></iframe>'


def write_bytes(path: str | os.PathLike[str], content: bytes) -> Path:
    return written(arrays.file(path, "path"), lambda stream: stream.write(content))

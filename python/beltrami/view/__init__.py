"""Pictures of shapes without a display, and interactive pages in one file.

Everything is painted by the compiled core (perspective, depth, soft light, a colour computed for each pixel) and lettered by
:mod:`beltrami.view.lettering`: no window system, no OpenGL and no plotting package is needed."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import arrays
from ..errors import InputError
from ..progress import Progress, reporter
from . import colors, page
from .fields import PLAIN, Field, Levels, field_of
from .panels import Drawing, paint
from .picture import Page, Picture, write_bytes
from .scene import Axis, Geometry, View, camera_of, each_colour, geometry_of, marks_of, named_views, polylines_of, radius_of

__all__ = ["Page", "Picture", "plot"]


def plot(
    shape: Any,
    values: Any = None,
    *,
    path: str | os.PathLike[str] | None = None,
    views: View | Sequence[View] | Mapping[str, View] | None = None,
    up: Axis = "y",
    title: str | None = None,
    label: str | None = None,
    colormap: Any = None,
    limits: tuple[float, float] | None = None,
    contours: Levels = None,
    labels: Mapping[int, str] | Sequence[str] | None = None,
    color_bar: bool = True,
    color: Any = None,
    lines: Any = None,
    line_color: Any = None,
    line_width: float = 4.0,
    points: Any = None,
    point_color: Any = None,
    point_size: float = 16.0,
    radius: float | None = None,
    transparency: float = 0.0,
    edges: bool = False,
    smooth: bool = True,
    shading: bool = True,
    perspective: bool = True,
    background: Any = "#ffffff",
    size: tuple[int, int] = (1600, 1000),
    samples: int = 3,
    description: str | None = None,
    progress: Progress = None,
) -> Picture | Page:
    """Draw a picture of a shape, or make an interactive page; no display is needed.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud, tuple of (vertices, faces), or ndarray (n, D)
        For D = 2 it is drawn in the plane; for D > 3 it is projected on its three principal axes, and the picture says so.
    values : array_like or mapping of str to array_like, optional
        What to colour it by: (n,) numbers; (n, 3) or (n, 4) colours from 0 to 1 or integers from 0 to 255; (n,) integers or booleans as
        labels (negative: no label); or any of these for the m faces. A mapping of names to values gives one panel each (on an
        interactive page, a menu). Numbers that are not finite count as missing: they are drawn grey, and the picture gives their number.
    path : path, optional
        ``.png`` for a picture, ``.html`` for an interactive page in one file. Without it the picture is only returned.
    views : view, list of views, or mapping of names to views, optional
        Directions of view: 'front', 'back', 'left', 'right', 'top', 'bottom', 'three-quarter', 'three-quarter right', 'three-quarter back';
        (azimuth, elevation) in radians; or a direction (x, y, z) towards the eye. Several are drawn side by side with
        their names below; ``{"lateral": "left", "medial": "right"}`` gives them other names.
    up : {'y', 'z', 'x'}
        Which axis of the shape points upwards.
    title, label : str, optional
        Title of the picture; name and unit of the quantity on the colour bar.
    colormap : str or list of colours, optional
        A name of :func:`beltrami.view.colors.table`; by default 'viridis', or 'balance' around zero for numbers of both signs.
    limits : (low, high), optional
        Numbers at the ends of the colour bar.
    contours : bool, int or array_like, optional
        Contour lines of the numbers: how many, or at which levels.
    labels : mapping or sequence, optional
        Names of the labels.
    color_bar : bool
        Whether a colour bar or a legend is drawn.
    color : colour, optional
        Colour of a shape without values.
    lines : array_like (k, D) or list of them, optional
        Polylines, hidden where the surface is in front; ``line_color`` is one colour or one for each, ``line_width`` is in pixels.
    points : array_like (k, D) or of vertex numbers, optional
        Marked points; ``point_color`` is one colour or one for each, ``point_size`` is in pixels.
    radius : float, optional
        Radius of the points of a cloud as a length; by default so that neighbours touch.
    transparency : float
        From 0 (opaque) to 1 (invisible), to show lines and points inside.
    edges, smooth, shading, perspective : bool
        Whether to draw the edges of the mesh; to interpolate light over triangles; to use light at all (without it colours are exactly
        those of the bar); to draw in perspective.
    background : colour
        '#rrggbb', or three numbers from 0 to 1; text is light on dark backgrounds. For pictures; a page follows the reader's settings.
    size : (width, height)
        In pixels.
    samples : int
        Rows and columns of samples per pixel, from 1 to 8.
    description : str, optional
        Text for those who cannot see the picture; by default it is generated.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    Picture or Page
        Jupyter displays either.

    Raises
    ------
    InputError
        The shape is empty, values do not fit it, or an option cannot be used.
    FileError
        The file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> import beltrami as bt
    >>> mesh = bt.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> bt.plot(mesh, np.array([0.0, 1.0, 2.0]), size=(320, 200)).pixels.shape
    (200, 320, 3)
    """
    if path is not None and arrays.file(path, "path").suffix.lower() not in (".png", ".html", ".htm"):
        raise InputError(f"{path}: a picture ends in .png, an interactive page in .html")
    if np.shape(size) != (2,):
        raise InputError(f"size is {size!r}; give (width, height) in pixels")
    width, height = (arrays.whole(side, "size", 16, 20000) for side in size)
    for name, text in (("title", title), ("label", label), ("description", description)):
        if text is not None and not isinstance(text, str):
            raise InputError(f"{name} is {text!r}; a str is needed")
    transparency = arrays.number(transparency, "transparency", least=0)
    if transparency > 1:
        raise InputError(f"transparency is {transparency:g}; it must be from 0 to 1")
    geometry = geometry_of(shape)
    given = dict(values) if isinstance(values, Mapping) else {label or "": values}
    if not given:
        raise InputError("values is an empty mapping; give at least one field, or None")
    counts = geometry.count, len(geometry.faces)
    look = {"colormap": colormap, "limits": limits, "contours": contours, "names": labels, "color": color}
    fields = [field_of(numbers, str(name), *counts, **look) for name, numbers in given.items()]
    chosen = named_views(views)
    cameras = [camera_of(view, up, geometry.flat) for _, view in (chosen[:1] if geometry.flat else chosen)]
    cameras = [(axes, given or name) for (given, _), (axes, name) in zip(chosen, cameras, strict=False)]
    polylines, marks = polylines_of(lines, geometry), marks_of(points, geometry)
    drawing = Drawing(
        geometry,
        fields,
        cameras,
        colormap,
        limits,
        marks,
        each_colour(point_color, len(marks), (0.89, 0.34, 0.18), "point_color"),
        arrays.number(point_size, "point_size", above=0),
        polylines,
        each_colour(line_color, len(polylines), (0.82, 0.16, 0.20), "line_color"),
        arrays.number(line_width, "line_width", above=0),
        radius_of(radius, geometry),
        transparency,
        bool(edges),
        bool(smooth),
        bool(shading) and not geometry.flat,
    )
    said = description or _describe(geometry, fields, [name for _, name in cameras], title)
    report = reporter(progress, "painting")
    if path is not None and Path(path).suffix.lower() != ".png":
        plain = colors.color(color) if color is not None else PLAIN
        html = page.build(drawing, title=title or "", description=said, up=up, plain=plain, color_bar=bool(color_bar))
        if report is not None:
            report(1.0)
        return Page(html, said, write_bytes(path, html.encode()))
    pixels = paint(
        drawing,
        size=(width, height),
        title=title,
        background=background,
        samples=arrays.whole(samples, "samples", 1, 8),
        perspective=perspective,
        color_bar=color_bar,
        report=report,
    )
    picture = Picture(pixels, said)
    return picture if path is None else Picture(pixels, said, picture.save(path))


def _describe(geometry: Geometry, fields: list[Field], views: list[str], title: str | None) -> str:
    what = f"a surface of {len(geometry.faces):,} triangles" if len(geometry.faces) else f"{geometry.count:,} points"
    colour = []
    for shown in fields:
        name = shown.name or ("values" if shown.bar else "labels")
        if shown.bar:
            colour.append(f"{name} from {shown.span[0]:.4g} to {shown.span[1]:.4g}")
        elif shown.legend:
            colour.append(f"{name}: {len(shown.legend)} regions")
    text = f"{title}: " if title else ""
    text += what + (", coloured by " + "; ".join(colour) if colour else "")
    named = [view for view in views if view]
    return text + (f", seen from {' and '.join(named)}" if named else "") + (f" ({geometry.note})" if geometry.note else "")

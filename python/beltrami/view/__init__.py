"""Pictures of shapes without a display, and interactive pages in one file.

Everything is painted by the compiled core (perspective, depth, soft light, a colour computed for each pixel) and lettered by
:mod:`beltrami.view.lettering`: no window system, no OpenGL and no plotting package is needed."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import _core, arrays
from ..errors import InputError
from ..progress import Progress, part, reporter
from . import colors, page
from .canvas import Canvas, draw_bar, draw_legend, fitted, legend_width
from .fields import MISSING, PLAIN, Field, Levels, field_of, ramp_of, tick_texts, ticks_of
from .picture import Page, Picture, write_bytes
from .scene import Axis, Geometry, View, camera_of, each_colour, geometry_of, marks_of, named_views, polylines_of, touching_radius

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
    line_colours = each_colour(line_color, len(polylines), (0.82, 0.16, 0.20), "line_color")
    mark_colours = each_colour(point_color, len(marks), (0.89, 0.34, 0.18), "point_color")
    said = description or _describe(geometry, fields, [name for _, name in cameras], title)
    report = reporter(progress, "painting")
    if path is not None and Path(path).suffix.lower() != ".png":
        html = page.build(
            geometry.vertices,
            geometry.faces,
            geometry.normals,
            [page.field_data(f, *_ramp_and_ticks(f, colormap, limits)) for f in fields],
            title=title or "",
            description=said,
            marks=marks,
            mark_colours=mark_colours,
            lines=polylines,
            radius=0.0 if len(geometry.faces) else touching_radius(geometry) if radius is None else radius,
            axes=cameras[0][0],
            up=[float(axis == up) for axis in "xyz"],
            flat=geometry.flat,
            lit=bool(shading) and not geometry.flat,
            note=geometry.note,
            plain=colors.color(color) if color is not None else PLAIN,
            missing=MISSING,
            markSize=arrays.number(point_size, "point_size", above=0) * 0.75,
            lineWidth=arrays.number(line_width, "line_width", above=0),
            lineColours=line_colours,
            transparency=transparency,
            edges=bool(edges),
            contours=any(len(f.levels) for f in fields),
            colourBar=bool(color_bar),
        )
        if report is not None:
            report(1.0)
        return Page(html, said, write_bytes(path, html.encode()))
    reach = np.concatenate([geometry.vertices, marks, *polylines])
    centre = 0.5 * (reach.min(axis=0) + reach.max(axis=0))
    largest = max(float(np.abs(reach - centre).max()), 1e-150)
    extent = largest * max(float(np.linalg.norm((reach - centre) / largest, axis=1).max()), 1.0)  # squares of 1e300 would overflow
    distance = math.inf if geometry.flat or not perspective else 4.2 * extent
    ball = 0.0 if len(geometry.faces) else (touching_radius(geometry) if radius is None else arrays.number(radius, "radius", above=0))
    behind = colors.color(background)
    dark = 0.3 * behind[0] + 0.59 * behind[1] + 0.11 * behind[2] < 0.45
    ink = (0.93, 0.94, 0.96) if dark else (0.12, 0.14, 0.19)
    canvas = Canvas(np.empty((height, width, 3), np.uint8), ink)
    canvas.pixels[:] = np.round(255 * np.array(behind)).astype(np.uint8)

    # Room for words: the unit is the size of ordinary text.
    size_ = max(min(9.0, 0.06 * min(width, height)), 0.0205 * math.sqrt(width * height))
    pad = 0.9 * size_
    top, bottom, left, right = pad, pad, pad, pad
    if title:
        canvas.text(fitted(title, 1.35 * size_, width - 2 * pad), pad + 0.2 * size_, pad + 1.3 * size_, 1.35 * size_, bold=True)
        top += 2.3 * size_
    missing = max(f.missing for f in fields)
    total = max(fields, key=lambda f: f.missing)
    total_count = len(geometry.faces) if total.kind == "faces" else geometry.count
    notes = [geometry.note, f"grey: no data at {missing:,} of {total_count:,}" if missing else ""]
    note = " · ".join(n for n in notes if n)
    if note:
        canvas.text(fitted(note, 0.78 * size_, width - 2 * pad), pad + 0.2 * size_, height - pad, 0.78 * size_, strength=0.75)
        bottom += 1.5 * size_
    panels = [(f, axes, name) for f in fields for axes, name in cameras]
    alone = len(fields) == 1 or (limits is not None and all(f.bar and f.kind == "scalars" for f in fields))
    first = fields[0]
    bar_room = legend_width(first, size_, width) if color_bar and alone else 0.0
    inside = (width - left - right - bar_room, height - top - bottom)
    several = len(panels) > 1
    own_bar = color_bar and not alone
    named = several and (len(fields) > 1 or any(name for _, _, name in panels))
    under = (1.7 * size_ if named else 0.0) + (2.4 * size_ if own_bar else 0.0)

    # Projected extents at one pixel a unit; one scale for all panels, so that views compare.
    boxes = []
    for axes, _ in cameras:
        q = (reach - centre) @ np.array(axes).T
        if math.isfinite(distance):
            q = q / (1 - q[:, 2:] / distance)
        boxes.append((q[:, :2].min(axis=0) - ball, q[:, :2].max(axis=0) + ball))
    sizes = [np.maximum(high - low, 1e-3 * extent) for low, high in boxes] * len(fields)
    gap = (1.2 * size_, 0.8 * size_)
    scale, columns, shares = _arranged(sizes, inside, gap, under)
    if scale <= 0 or not math.isfinite(scale):
        raise InputError(f"size {width} x {height} leaves no room for {len(panels)} panels; make it larger")
    rows = math.ceil(len(panels) / columns)
    lowest = 0.5 * scale * max(float(box[1]) for box in sizes)
    for at, (shown, axes, view_name) in enumerate(panels):
        row = at // columns
        before = float(shares[row * columns : at].sum())
        x0, x1 = (round(left + inside[0] * share) for share in (before, before + float(shares[at])))
        y0, y1 = (round(top + inside[1] * r / rows) for r in (row, row + 1))
        y1 -= round(under)
        low, high = boxes[at % len(cameras)]
        middle = [0.5 * (x1 - x0) - 0.5 * scale * float(low[0] + high[0]), 0.5 * (y1 - y0) + 0.5 * scale * float(low[1] + high[1])]
        camera = {"axes": axes, "centre": centre.tolist(), "middle": middle, "scale": scale, "distance": distance}
        frame = {
            "width": max(x1 - x0, 1),
            "height": max(y1 - y0, 1),
            "samples": arrays.whole(samples, "samples", 1, 8),
            "background": behind,
            "lit": bool(shading) and not geometry.flat,
            "hollows": 0.16 * extent,
        }
        surface = None
        balls = []
        if len(geometry.faces):
            surface = {
                "vertices": geometry.vertices,
                "faces": geometry.faces,
                "kind": shown.kind,
                "scalars": shown.scalars,
                "span": shown.span,
                "labels": shown.labels,
                "colours": shown.colours,
                "missing": MISSING,
                "levels": shown.levels,
                "level_colour": (0.07, 0.07, 0.10, 0.72),
                "level_width": max(1.2, 0.075 * size_),
                "edge_colour": (0.10, 0.12, 0.18, 0.55),
                "edge_width": 1.0 if edges else 0.0,
                "transparency": transparency,
                "smooth": bool(smooth),
            }
        else:
            rgba = shown.each(geometry.count).copy()
            rgba[:, 3] *= 1 - transparency
            balls.append((geometry.vertices, np.full(geometry.count, ball), rgba, geometry.normals))
        if len(marks):
            rgba = np.ones((len(marks), 4), np.float32)
            rgba[:, :3] = mark_colours
            half = 0.5 * arrays.number(point_size, "point_size", above=0) / scale
            balls.append((marks, np.full(len(marks), half), rgba, np.zeros((0, 3))))
        ropes = None
        if polylines:
            starts = np.concatenate([[0], np.cumsum([len(line) for line in polylines])]).tolist()
            thick = [arrays.number(line_width, "line_width", above=0)] * len(polylines)
            ropes = (np.ascontiguousarray(np.concatenate(polylines)), starts, thick, [(*c, 1.0) for c in line_colours])
        painted = _core.paint(frame, camera, surface, balls, ropes, part(report, at / len(panels), (at + 1) / len(panels)))
        canvas.pixels[y0:y1, x0:x1] = painted[: y1 - y0, : x1 - x0]
        if several:
            names = [shown.name if len(fields) > 1 else "", view_name if len(cameras) > 1 else ""]
            words = fitted(" · ".join(n for n in names if n), 0.9 * size_, x1 - x0 - size_)
            foot = min(float(y1), 0.5 * (y0 + y1) + lowest + 0.5 * size_)
            canvas.text(words, 0.5 * (x0 + x1), foot + 1.1 * size_, 0.9 * size_, align="middle", strength=0.85)
        if own_bar and shown.bar:
            long = min(0.6 * (x1 - x0), 14 * size_)
            draw_bar(canvas, shown, 0.5 * (x0 + x1 - long), y1 + 1.75 * size_, long, 0.45 * size_, 0.72 * size_, False)
    if bar_room:
        x = width - right - bar_room + 0.8 * size_
        if first.bar:
            table = first if first.kind == "scalars" else ramp_of(first, colormap, limits)
            tall = min(inside[1] * 0.72, 22 * size_)
            y = top + 0.5 * (inside[1] - tall)
            draw_bar(canvas, table, x, y, 0.8 * size_, tall, 0.85 * size_, True)
            if first.name and len(fields) == 1:
                canvas.text(fitted(first.name, 0.9 * size_, 0.25 * width), width - right, y - 1.1 * size_, 0.9 * size_, align="right")
        else:
            draw_legend(canvas, first, x, top, inside[1], size_, 0.24 * width)
    picture = Picture(canvas.done(), said)
    return picture if path is None else Picture(picture.pixels, said, picture.save(path))


def _arranged(
    sizes: list[npt.NDArray[np.float64]], inside: tuple[float, float], gap: tuple[float, float], under: float
) -> tuple[float, int, npt.NDArray[np.float64]]:
    """Pixels a unit, as many as panels of these sizes leave room for; how many panels stand in a row; the share of the row of each."""
    count = len(sizes)
    scale, columns = 0.0, 1
    for some in range(1, count + 1):
        room = inside[0] / some - gap[0], inside[1] / math.ceil(count / some) - under - gap[1]
        fit = min(min(room[0] / float(box[0]), room[1] / float(box[1])) for box in sizes)
        if fit > scale * 1.0001:
            scale, columns = fit, some
    # In a single row narrow views leave their room to wide ones.
    widths = np.array([float(box[0]) for box in sizes])
    in_a_row = min((inside[0] - count * gap[0]) / widths.sum(), (inside[1] - under - gap[1]) / max(float(box[1]) for box in sizes))
    if in_a_row > scale:
        return in_a_row, count, (widths * in_a_row + gap[0]) / (widths * in_a_row + gap[0]).sum()
    return scale, columns, np.full(count, 1 / columns)


def _ramp_and_ticks(
    shown: Field, colormap: Any, limits: tuple[float, float] | None
) -> tuple[npt.NDArray[Any] | None, list[tuple[float, str]]]:
    """The colours of a page's colour bar, and its ticks by their shares of it; none where no numbers belong to the colours."""
    if not shown.bar:
        return None, []
    table = shown if shown.kind == "scalars" else ramp_of(shown, colormap, limits)
    low, high = shown.span
    ticks = ticks_of(low, high)
    places = [float((tick - low) / (high - low)) if high > low else 0.5 for tick in ticks]
    return table.colours[:, :3], list(zip(places, tick_texts(ticks), strict=True))


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

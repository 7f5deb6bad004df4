"""Distances between all pairs of a collection: on one machine or on a cluster, resumable, the same bits everywhere.

The work is cut into tasks: one per shape (its eigenmap or spectrum, kept on disk), then one per tile of pairs. Any executor with
``submit`` runs them: ``concurrent.futures``, ``dask.distributed.Client``, ``mpi4py.futures``, ``loky``. Finished tasks are files; a run
that was killed goes on where it was. A shape that cannot be read is a row of the report.
"""

from __future__ import annotations

import hashlib
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
import numpy.typing as npt

from . import arrays
from .arrays import Floats
from .errors import DependencyError, FileError, InputError
from .files import load, stored, written
from .progress import Progress, reporter, teller
from .register.eigenmaps import Eigenmap, align_eigenmaps, eigenmap, settle
from .register.sides import prepare
from .results import save_arrays, save_result
from .shapes import PointCloud, Shape, TriangleMesh, no_shape
from .threads import set_num_threads

__all__ = ["DistanceMatrix", "distance_matrix"]

Member = Shape | str | os.PathLike[str]
Method = Literal["rswd", "shape_dna"] | Callable[[Shape, Shape], float]
Pairs = list[tuple[int, int]]

_LEVELS = [5, 10, 20]  # modes that eigenmaps are compared by, coarse to fine
_POINTS = 300
_WINDOW = 64  # tasks handed out before the first of them is waited for
_VERSION = "1"  # of what is kept on disk


class _Executor(Protocol):
    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Any: ...


@dataclass(frozen=True, eq=False, repr=False)
class DistanceMatrix:
    """Distances between all shapes of a collection, returned by :func:`distance_matrix`. NumPy functions accept it as its matrix.

    Attributes
    ----------
    matrix : (k, k) array
        Symmetric, 0 on the diagonal; ``inf`` in the rows of shapes that failed.
    failures : dict of int to str
        What was wrong, by the index of the shape; a pair that failed is listed under the first of the two.
    labels : tuple of str
        Names of the shapes.
    method : str
        The method that was used.
    """

    matrix: Floats
    failures: dict[int, str]
    labels: tuple[str, ...]
    method: str

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        return np.array(self.matrix, dtype=dtype) if copy is not False else np.asarray(self.matrix, dtype=dtype)

    def __getitem__(self, key: Any) -> Any:
        return self.matrix[key]

    def __len__(self) -> int:
        return len(self.matrix)

    @property
    def shape(self) -> tuple[int, int]:
        """(k, k)"""
        return (len(self.matrix), len(self.matrix))

    def __repr__(self) -> str:
        failed = f", {len(self.failures)} failed" if self.failures else ""
        return f"DistanceMatrix({len(self.matrix)} shapes by {self.method}{failed})"

    @property
    def _good(self) -> npt.NDArray[np.int64]:
        """Shapes with all distances to one another: those that have the most gaps are left out one by one."""
        keep = np.ones(len(self.matrix), bool)
        while True:
            gaps = (~np.isfinite(self.matrix[np.ix_(keep, keep)])).sum(1)
            if not gaps.any():
                return np.flatnonzero(keep)
            keep[np.flatnonzero(keep)[gaps.argmax()]] = False

    def nearest(self, k: int = 1) -> npt.NDArray[np.int64]:
        """The k nearest other shapes of each, (k_shapes, k); -1 where there are not as many.

        Examples
        --------
        >>> import beltrami as bt
        >>> shapes = [bt.shapes.ellipsoid(1.0, 0.8, c, level=2) for c in (0.5, 0.52, 1.5)]
        >>> bt.distance_matrix(shapes, method="shape_dna").nearest()[:, 0].tolist()
        [1, 0, 1]
        """
        k = arrays.whole(k, "k", 1)
        others = self.matrix + np.where(np.eye(len(self.matrix), dtype=bool), np.inf, 0.0)
        order = np.argsort(others, axis=1, kind="stable")[:, :k].astype(np.int64)
        order[~np.isfinite(np.take_along_axis(others, order, 1))] = -1
        return order

    def embed(self, dimension: int = 2) -> Floats:
        """Points of R^dimension whose distances are close to the matrix: classical multidimensional scaling, (k, dimension).

        Shapes that failed are put at the origin. Signs: the entry of largest size of each column is positive.

        Raises
        ------
        InputError
            There are fewer than two shapes.

        Examples
        --------
        >>> import numpy as np, beltrami as bt
        >>> shapes = [bt.shapes.ellipsoid(1.0, 1.0, c, level=2) for c in (1.0, 1.5, 2.0)]
        >>> bt.distance_matrix(shapes, method="shape_dna").embed(1).shape
        (3, 1)
        """
        dimension = arrays.whole(dimension, "dimension", 1)
        arrays.room(2.0 * dimension * len(self.matrix), f"dimension = {dimension}", "as many dimensions as shapes hold all there is")
        good = self._good
        if len(good) < 2:
            raise InputError(f"{len(good)} shapes have distances to one another; two at least are needed")
        squares = self.matrix[np.ix_(good, good)] ** 2
        centred = -0.5 * (squares - squares.mean(0) - squares.mean(1)[:, None] + squares.mean())
        values, vectors = np.linalg.eigh(centred)
        count = min(dimension, len(good))
        values, vectors = values[::-1][:count], vectors[:, ::-1][:, :count]
        largest = vectors[np.abs(vectors).argmax(0), np.arange(count)]
        places = np.zeros((len(self.matrix), dimension))
        places[good, :count] = vectors * np.sign(largest) * np.sqrt(np.maximum(values, 0.0))
        return places

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes matrix and labels to ``.npz`` or ``.csv``, the map to ``.png``.

        Raises
        ------
        InputError
            The suffix is none of these.
        FileError
            The file cannot be written.
        """
        archive = {"distances": self.matrix, "labels": np.array(self.labels, str)}
        kinds = {".npz": lambda file: save_arrays(file, archive), ".csv": self._save_table}
        return save_result(self, path, "distances are", kinds, pictures=(".png",))

    def _save_table(self, path: Path) -> Path:
        table = {"fmt": "%.10g", "delimiter": ",", "header": ",".join(self.labels), "comments": "", "encoding": "utf-8"}
        return written(path, lambda stream: np.savetxt(stream, self.matrix, **table))

    def plot(
        self,
        kind: Literal["map", "matrix", "dendrogram", "nearest"] = "map",
        *,
        path: str | os.PathLike[str] | None = None,
        classes: Sequence[Any] | None = None,
    ) -> Any:
        """A picture with matplotlib (an extra): returns its figure, and writes it if ``path`` is given.

        Parameters
        ----------
        kind : {"map", "matrix", "dendrogram", "nearest"}
            The embedding into the plane; the matrix; a tree by average linkage; the embedding with arrows to nearest neighbours.
        path : path, optional
        classes : sequence, optional
            One per shape: its colour.

        Raises
        ------
        InputError
            ``kind`` is not known, or there are not as many classes as shapes.
        DependencyError
            matplotlib is missing.
        """
        arrays.word(kind, "kind", ("map", "matrix", "dendrogram", "nearest"))
        if classes is not None and len(classes) != len(self.matrix):
            raise InputError(f"{len(classes)} classes for {len(self.matrix)} shapes")
        try:
            from matplotlib.backends.backend_agg import FigureCanvasAgg
            from matplotlib.figure import Figure
        except ImportError:
            raise DependencyError("matplotlib is missing; pip install 'beltrami[plot]'") from None
        figure = Figure(figsize=(7, 6), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots()
        good = self._good
        if kind == "matrix":
            image = axes.imshow(np.where(np.isfinite(self.matrix), self.matrix, np.nan), cmap="viridis")
            figure.colorbar(image, ax=axes, label="distance")
            axes.set_xticks(range(len(self.labels)), self.labels, rotation=90, fontsize=8)
            axes.set_yticks(range(len(self.labels)), self.labels, fontsize=8)
        elif kind == "dendrogram":
            from scipy.cluster.hierarchy import dendrogram, linkage
            from scipy.spatial.distance import squareform

            tree = linkage(squareform(self.matrix[np.ix_(good, good)], checks=False), "average")
            dendrogram(tree, labels=[self.labels[index] for index in good], orientation="left", ax=axes)
            axes.set_xlabel("distance")
        else:
            places = self.embed(2)
            names, numbers = np.unique([str(c) for c in classes] if classes is not None else [""] * len(self), return_inverse=True)
            for number, name in enumerate(names):
                chosen = good[numbers[good] == number]
                axes.scatter(places[chosen, 0], places[chosen, 1], s=50, label=name or None, zorder=2)
            for index in good:
                axes.annotate(self.labels[index], places[index], xytext=(4, 4), textcoords="offset points", fontsize=8)
            if kind == "nearest":
                for index in good:
                    near = int(self.nearest()[index, 0])
                    if near >= 0:
                        arrow = {"arrowstyle": "->", "color": "0.6", "shrinkA": 4, "shrinkB": 4}
                        axes.annotate("", places[near], xytext=places[index], arrowprops=arrow, zorder=1)
            if classes is not None:
                axes.legend(frameon=False)
            axes.set_aspect("equal", adjustable="datalim")
            axes.set_xticks([])
            axes.set_yticks([])
        if path is not None:
            file = arrays.file(path, "path")
            written(file, lambda stream: figure.savefig(stream, dpi=150, format=file.suffix[1:] or "png"))
        return figure


# --- tasks: module-level functions of plain arguments, so that any executor can carry them -----------------------------------------


def _limit(parent: int, threads: int) -> None:
    """In a worker process: how many threads a task may take. Results do not depend on it."""
    if os.getpid() != parent:
        set_num_threads(threads)


def _read(member: Member) -> Shape:
    return member if isinstance(member, TriangleMesh | PointCloud) else load(os.fspath(member))


def _describe_shape(member: Member, modes: int, parent: int, threads: int) -> tuple[dict[str, Any] | None, str]:
    """The eigenmap of one shape as plain arrays, or what is wrong with it."""
    _limit(parent, threads)
    try:
        side = prepare(_read(member), modes=modes, samples=_POINTS, extrinsic=False)
        if side.modes < _LEVELS[0]:
            return None, f"the shape has {side.modes} eigenfunctions; {_LEVELS[0]} are needed"
        found = eigenmap(side, _POINTS, modes)
        return {"values": found.values, "rows": found.rows, "masses": found.masses, "dimension": np.array(found.dimension)}, ""
    except Exception as error:  # belongs to the report: one bad shape is not the end of the run
        return None, f"{type(error).__name__}: {error}"


def _eigenmap(parts: dict[str, Any]) -> Eigenmap:
    return Eigenmap(parts["values"], parts["rows"], parts["masses"], int(parts["dimension"]))


def _rswd_distance(first: Eigenmap, second: Eigenmap, seed: int) -> float:
    """The rotation-invariant sliced Wasserstein distance of two eigenmaps. Which of the two is turned does not depend on their order."""
    if first.dimension != second.dimension:
        raise InputError(f"intrinsic dimensions {first.dimension} and {second.dimension} cannot be compared")
    a, b = sorted((first, second), key=lambda one: (one.values.tolist(), one.masses.tolist()))
    modes = min(len(a.values), len(b.values))
    levels = [level for level in _LEVELS if level <= modes]
    runs, _ = align_eigenmaps(a, b, levels, seed, width=4)
    return settle(a, b, runs[0].rotation, seed)[1]


def _measure(
    method: Method, pairs: list[tuple[int, int]], members: dict[int, Any], seed: int, parent: int, threads: int
) -> list[tuple[float, str]]:
    """The distances of a tile's pairs, each a number and what went wrong."""
    _limit(parent, threads)
    return [_pair(method, members[i], members[j], seed) for i, j in pairs]


def _pair(method: Method, first: Any, second: Any, seed: int) -> tuple[float, str]:
    try:
        if method == "rswd":
            value = _rswd_distance(_eigenmap(first), _eigenmap(second), seed)
        elif callable(method):
            value = float(method(_read(first), _read(second)))
        else:
            a, b = first["values"], second["values"]
            count = min(len(a), len(b))
            value = float(np.linalg.norm(a[:count] - b[:count]))
        if not np.isfinite(value):
            raise InputError(f"the distance is {value}")
    except Exception as error:  # belongs to the report
        return np.inf, f"{type(error).__name__}: {error}"
    return value, ""


# --- what is kept on disk -----------------------------------------------------------------------------------------------------------


def _fingerprint(member: Member) -> str:
    """Of what a shape is: its numbers, or its file's bytes. The path where the file cannot be read."""
    digest = hashlib.sha256()
    if isinstance(member, TriangleMesh):
        digest.update(b"mesh" + member.vertices.tobytes() + member.faces.tobytes() + str(member.vertices.shape).encode())
    elif isinstance(member, PointCloud):
        digest.update(b"cloud" + member.points.tobytes() + str((member.points.shape, member.dimension)).encode())
        for more in (member.weights, member.normals):  # normals keep the sides of thin parts apart
            digest.update(b"none" if more is None else more.tobytes())
    else:
        try:
            digest.update(Path(member).read_bytes())
        except OSError:
            digest.update(os.fspath(member).encode())
    return digest.hexdigest()


def _store(path: Path, content: dict[str, Any]) -> None:
    """Writes arrays so that a kill leaves either the whole file or none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(f".{os.getpid()}.part")
    with draft.open("wb") as file:
        np.savez(file, **content)
    os.replace(draft, path)


def _recall(path: Path | None) -> dict[str, Any] | None:
    """What was stored, or None where there is nothing or it cannot be read."""
    if path is None or not path.exists():
        return None
    try:
        return stored(path)
    except FileError:  # a broken file is made again
        return None


class _Local:
    """Runs a task when its result is asked for."""

    class Future:
        def __init__(self, call: Callable[[], Any]) -> None:
            self.result = call

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        return self.Future(lambda: fn(*args, **kwargs))


def _run(executor: _Executor, tasks: Iterator[tuple[Any, tuple[Any, ...]]]) -> Iterator[tuple[Any, Any]]:
    """Results of ``(key, (function, *arguments))`` in order, a window of tasks at work at any time."""
    waiting: deque[tuple[Any, Any]] = deque()
    try:
        for key, (function, *arguments) in tasks:
            waiting.append((key, executor.submit(function, *arguments)))
            if len(waiting) >= (1 if isinstance(executor, _Local) else _WINDOW):
                first, future = waiting.popleft()
                yield first, future.result()
        while waiting:
            first, future = waiting.popleft()
            yield first, future.result()
    finally:
        for _, future in waiting:
            if hasattr(future, "cancel"):
                future.cancel()


def _tiles(count: int) -> Iterator[list[tuple[int, int]]]:
    """Pairs i < j, in blocks that need few shapes each."""
    side = max(1, min(16, count // 8))
    for top in range(0, count, side):
        for left in range(top, count, side):
            pairs = [(i, j) for i in range(top, min(top + side, count)) for j in range(max(left, i + 1), min(left + side, count))]
            if pairs:
                yield pairs


def _name(member: Member, index: int) -> str:
    return str(index) if isinstance(member, TriangleMesh | PointCloud) else Path(member).stem


def distance_matrix(
    shapes: Sequence[Member],
    *,
    method: Method = "rswd",
    executor: Any = None,
    checkpoint: str | os.PathLike[str] | None = None,
    cache: str | os.PathLike[str] | None = None,
    labels: Sequence[str] | None = None,
    threads: int = 1,
    rng: int = 0,
    progress: Progress = None,
) -> DistanceMatrix:
    """Compute the distances between all pairs of shapes.

    Parameters
    ----------
    shapes : sequence of TriangleMesh, PointCloud or path
        Files are read by the worker that needs them.
    method : {"rswd", "shape_dna"} or callable
        ``"rswd"``: the rotation-invariant sliced Wasserstein distance of the eigenmaps ``λ_k^(-d/4) φ_k`` of unit area, k up to 20, at 300
        farthest points: neither bending nor reflection changes it. ``"shape_dna"``: Euclidean distance of the first 50 eigenvalues times
        area; faster, but some different shapes have the same. Or ``method(first, second)``, a function of two shapes that can be pickled.
    executor : object with ``submit(fn, *args)``, optional
        ``concurrent.futures``, ``dask.distributed.Client``, ``mpi4py.futures.MPIPoolExecutor``, ``loky``. None: in this process.
    checkpoint : path, optional
        A folder for finished work. A call with the same shapes and options reads it and computes only the rest. A callable is
        identified by its module and name: clear the folder when you change it.
    cache : path, optional
        A folder for eigenmaps that collections can share; by default within the checkpoint.
    labels : sequence of str, optional
        Names of the shapes; by default those of the files, or numbers.
    threads : int
        How many threads each task may use in a worker process.
    rng : int
        Seed of the directions.
    progress : callable or True, optional
        Called with the share of work done; returning False stops with :class:`Cancelled`, and what is done stays in the checkpoint.

    Returns
    -------
    DistanceMatrix
        ``np.asarray`` of it is the (k, k) array. Each pair's distance depends on these two shapes alone: not on the others, on their
        order, on the executor or the number of threads.

    Raises
    ------
    InputError
        Options do not fit. A shape that cannot be used is not an error: it is listed in ``failures``, and its distances are ``inf``.
    Cancelled
        If ``progress`` returned False.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> shapes = [bt.shapes.ellipsoid(1.0, 0.8, c, level=2) for c in (0.5, 0.52, 1.5)]
    >>> found = bt.distance_matrix(shapes)
    >>> bool(found[0, 1] < found[0, 2]), np.asarray(found).shape
    (True, (3, 3))
    """
    if isinstance(shapes, str | os.PathLike) or not isinstance(shapes, Iterable):
        raise InputError(f"shapes is {shapes!r}; a list of shapes or paths is needed")
    if isinstance(shapes, Mapping):
        raise InputError("shapes is a mapping; give list(shapes.values()), and labels=list(shapes)")
    members = list(shapes)
    count = len(members)
    for index, member in enumerate(members):
        if not isinstance(member, TriangleMesh | PointCloud | str | os.PathLike):
            raise no_shape(member, f"shapes[{index}]", "a TriangleMesh, a PointCloud or a path")
    if not callable(method) and method not in ("rswd", "shape_dna"):
        raise InputError(f"method is {method!r}; choose 'rswd' or 'shape_dna', or give a function of two shapes")
    if executor is not None and not hasattr(executor, "submit"):
        raise InputError(f"executor is a {type(executor).__name__}; an object with submit(fn, *args) is needed")
    if labels is not None and (isinstance(labels, str) or not isinstance(labels, Iterable)):
        raise InputError(f"labels is {labels!r}; a list of names is needed, one per shape")
    names = tuple(str(label) for label in labels) if labels is not None else tuple(_name(m, i) for i, m in enumerate(members))
    if len(names) != count:
        raise InputError(f"{len(names)} labels for {count} shapes")
    folder = None if checkpoint is None else arrays.file(checkpoint, "checkpoint")
    work = _Work(
        members,
        names,
        method,
        seed=arrays.whole(0 if rng is None else rng, "rng", 0),
        threads=arrays.whole(threads, "threads", 1, 4096),
        runner=_Local() if executor is None else executor,
        folder=folder,
        shelf=arrays.file(cache, "cache") if cache is not None else None if folder is None else folder / "eigenmaps",
        report=teller(reporter(progress, "distances")),
    )
    described = work.describe()
    matrix = work.measure(described)
    return DistanceMatrix(matrix, dict(sorted(work.failures.items())), names, work.known)


class _Work:
    """The tasks of one collection: each shape is described, then each tile of pairs is measured. What a folder holds is not done again."""

    def __init__(
        self,
        members: list[Member],
        names: tuple[str, ...],
        method: Method,
        *,
        seed: int,
        threads: int,
        runner: _Executor,
        folder: Path | None,
        shelf: Path | None,
        report: Callable[[float], None],
    ) -> None:
        self.members, self.names, self.method, self.seed, self.threads = members, names, method, seed, threads
        self.runner, self.folder, self.shelf, self.report = runner, folder, shelf, report
        self.known = method if isinstance(method, str) else f"{method.__module__}.{getattr(method, '__qualname__', type(method).__name__)}"
        self.modes = 50 if method == "shape_dna" else _LEVELS[-1]
        self.prints = [_fingerprint(member) if folder is not None or shelf is not None else "" for member in members]
        self.tiles = list(_tiles(len(members)))
        self.failures: dict[int, str] = {}
        self.parent = os.getpid()
        self.total, self.done = (0 if callable(method) else len(members)) + len(self.tiles), 0

    def _tell(self) -> None:
        """One task more is done."""
        self.done += 1
        self.report(self.done / max(self.total, 1))

    def describe(self) -> dict[int, Any]:
        """What is compared of each shape: its eigenmap, its spectrum or itself. Shapes that fail are left out, and noted."""
        if callable(self.method):
            return dict(enumerate(self.members))
        described: dict[int, Any] = {}
        for index, (found, wrong) in _run(self.runner, self._undescribed(described)):
            place = self._eigenmap(index)
            if found is None:
                self.failures[index] = wrong
            else:
                described[index] = found
                if place is not None:
                    _store(place, found)
            self._tell()
        return described

    def _undescribed(self, described: dict[int, Any]) -> Iterator[tuple[int, tuple[Any, ...]]]:
        """A task for each shape that is not on disk; the others go to ``described`` at once."""
        for index, member in enumerate(self.members):
            kept = _recall(self._eigenmap(index))
            if kept is None:
                yield index, (_describe_shape, member, self.modes, self.parent, self.threads)
            else:
                described[index] = kept
                self._tell()

    def measure(self, described: dict[int, Any]) -> Floats:
        """The matrix of distances; infinite for shapes that could not be described."""
        count = len(self.members)
        matrix = np.zeros((count, count))
        for pairs, values in _run(self.runner, self._unmeasured(described, matrix)):
            self._enter(matrix, pairs, values)
            place = self._tile(pairs)
            if place is not None and not any(wrong for _, wrong in values):
                _store(place, {"values": np.array([value for value, _ in values])})
            self._tell()
        for index in set(range(count)) - set(described):
            matrix[index] = matrix[:, index] = np.inf
            matrix[index, index] = 0.0
        return matrix

    def _unmeasured(self, described: dict[int, Any], matrix: Floats) -> Iterator[tuple[Pairs, tuple[Any, ...]]]:
        """A task for each tile that is not on disk; the others go to the ``matrix`` at once."""
        for tile in self.tiles:
            pairs = [(i, j) for i, j in tile if i in described and j in described]
            kept = _recall(self._tile(pairs))
            if kept is not None and len(kept["values"]) == len(pairs):
                self._enter(matrix, pairs, [(float(value), "") for value in kept["values"]])
                self._tell()
            elif pairs:
                needed = {index: described[index] for index in sorted({index for pair in pairs for index in pair})}
                yield pairs, (_measure, self.method, pairs, needed, self.seed, self.parent, self.threads)
            else:
                self._tell()

    def _enter(self, matrix: Floats, pairs: Pairs, values: list[tuple[float, str]]) -> None:
        """Distances of pairs, or what went wrong with them."""
        for (i, j), (value, wrong) in zip(pairs, values, strict=True):
            matrix[i, j] = matrix[j, i] = value
            if wrong:
                self.failures.setdefault(i, f"with {self.names[j]}: {wrong}")

    def _eigenmap(self, index: int) -> Path | None:
        """The file of a shape's eigenmap or spectrum."""
        return None if self.shelf is None else self.shelf / f"{self.prints[index]}-{self.modes}-{_POINTS}-{_VERSION}.npz"

    def _tile(self, pairs: Pairs) -> Path | None:
        """The file of a tile: it is named by the method, its options and the shapes themselves."""
        if self.folder is None:
            return None
        prints = (f"{self.prints[i]},{self.prints[j]}" for i, j in pairs)
        key = "|".join([self.known, str(self.seed), str(self.modes), str(_POINTS), _VERSION, *prints])
        return self.folder / "tiles" / f"{hashlib.sha256(key.encode()).hexdigest()}.npz"

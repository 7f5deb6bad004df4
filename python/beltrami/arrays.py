"""The gate of every array from a user. It may have any dtype, order, stride or byte order, and leaves in C order with the exact type, or an
error names the offending element. Inputs are never changed, and never kept unless nobody can change them any more."""

from __future__ import annotations

import contextlib
import operator
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import scipy

from .errors import InputError

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]
_A = TypeVar("_A", bound=npt.NDArray[Any])
CsrArrays = tuple[int, int, npt.NDArray[np.int64], Ints, Floats]


def anything(value: Any, name: str) -> npt.NDArray[Any]:
    """An array of any type and shape; rows of different lengths make none."""
    try:
        return np.asarray(value)
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{name} cannot be read as an array: {error}") from None


def _array(value: Any, name: str) -> npt.NDArray[Any]:
    array = anything(value, name)
    if array.dtype.kind not in "buif":
        raise InputError(f"{name} has dtype {array.dtype} ({type(value).__name__}); real numbers are needed")
    return array


def floats(value: Any, name: str, shape: tuple[int | None, ...], *, finite: bool = True) -> Floats:
    """A float64 array in C order; ``None`` in ``shape`` allows any length there."""
    array = _array(value, name)
    if array.ndim != len(shape) or any(want is not None and want != got for want, got in zip(shape, array.shape, strict=True)):
        wanted = "(" + ", ".join("any" if s is None else str(s) for s in shape) + ("," if len(shape) == 1 else "") + ")"
        raise InputError(f"{name} has shape {array.shape}, {wanted} is needed")
    with np.errstate(over="ignore"):
        result = np.require(array, np.float64, ["C", "A"])
    if finite and not np.isfinite(result).all():
        where = np.argwhere(~np.isfinite(result))[0]
        place = int(where[0]) if result.ndim == 1 else tuple(int(w) for w in where)
        raise InputError(f"{name}[{place}] is {result[tuple(where)]}; replace or remove it")
    return result


def points(value: Any, name: str, least: int = 1) -> Floats:
    """(n, D) float64, D >= ``least``. An empty list counts as no points of R^3."""
    array = _array(value, name)
    if array.size == 0 and array.ndim < 2:
        return np.zeros((0, 3))
    if array.ndim != 2 or array.shape[1] < least:
        remedy = f"; of one point write [{name}]" if array.ndim == 1 else ""
        raise InputError(f"{name} has shape {array.shape}, (n, D) with D >= {least} is needed{remedy}")
    return floats(array, name, (None, None), finite=False)


def unit_vectors(value: Any, name: str) -> Floats:
    """(n, 3) float64 of length 1: lengths up to 1e-6 off are put right, others refused."""
    found = floats(value, name, (None, 3))
    lengths = np.sqrt((found * found).sum(1))
    if (np.abs(lengths - 1) > 1e-6).any():
        at = int(np.argmax(np.abs(lengths - 1)))
        raise InputError(f"{name}[{at}] has length {lengths[at]:.6g}; unit vectors are needed")
    unit: Floats = found / lengths[:, None]
    return unit


def triangles(value: Any, name: str, count: int) -> Ints:
    """(m, 3) int32, each from 0 to ``count`` - 1. An empty list counts as no triangles."""
    array = _array(value, name)
    if array.size == 0 and (array.ndim < 2 or array.shape[1:] == (3,)):
        return np.zeros((0, 3), np.int32)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"{name} has shape {array.shape}, (m, 3) is needed; split polygons into triangles first")
    if array.dtype.kind == "b":
        raise InputError(f"{name} has dtype bool; vertex numbers are needed")
    wrong = ~((array >= 0) & (array < count))
    if array.dtype.kind == "f":
        wrong |= array != np.floor(array)
    if wrong.any():
        face, corner = np.argwhere(wrong)[0]
        remedy = "numbers are whole and start at 0"
        if array.min() == 1 and array.max() == count:
            remedy += "; these start at 1: subtract 1"
        elif count <= 3:
            remedy += "; are the vertices transposed? They are (n, D)"
        raise InputError(f"face {face} refers to vertex {array[face, corner]}, the mesh has {count} vertices ({remedy})")
    return np.require(array, np.int32, ["C", "A"])


def whole(value: Any, name: str, least: int | None = None, most: int | None = None) -> int:
    """A whole number in a range; numpy's integers count, bool and floats do not."""
    try:
        if isinstance(value, bool | np.bool_):
            raise TypeError
        number = operator.index(value)
    except TypeError:
        raise InputError(f"{name} is {value!r}; a whole number is needed") from None
    if (least is not None and number < least) or (most is not None and number > most):
        span = f"at least {least}" if most is None else f"at most {most}" if least is None else f"from {least} to {most}"
        raise InputError(f"{name} is {number if abs(number) < 1 << 64 else 'beyond 64 bits'}; it must be {span}")
    return number


# Where Linux tells how much a container may have: control groups of version 2, which may say "max", and of version 1.
_GROUPS = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"))


def memory() -> int:
    """Bytes that this process may have: the machine's, or as few as a limit of the process or of its container leaves it."""
    try:
        import resource

        most = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    except (ImportError, OSError, ValueError):
        return 1 << 36  # where the system does not tell: 64 GiB
    if limit != resource.RLIM_INFINITY:
        most = min(most, limit)
    for group in _GROUPS:
        with contextlib.suppress(OSError, ValueError):  # no such group, or no limit in it
            most = min(most, int(group.read_text()))
    return most


def room(numbers: float, what: str, remedy: str) -> None:
    """Refuses, before it is tried, what needs more ``numbers`` of 8 bytes than there is memory for."""
    needed, there = 8.0 * numbers, memory()
    if needed > there:
        raise InputError(f"{what} would take {needed / 2**30:.3g} GiB of memory and there are {there / 2**30:.3g}; {remedy}")


def number(value: Any, name: str, above: float | None = None, least: float | None = None) -> float:
    """A finite real number, above or at least a bound."""
    try:
        if isinstance(value, str | bytes) or np.iscomplexobj(value) or np.ndim(value) > 0:
            raise TypeError
        result = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{name} is {value!r}; a number is needed") from None
    except OverflowError:
        raise InputError(f"{name} is beyond the range of float64; give a smaller number") from None
    if not np.isfinite(result) or (above is not None and result <= above) or (least is not None and result < least):
        bounds = [] if np.isfinite(result) else ["finite"]
        bounds += [] if above is None else [f"above {above:g}"]
        bounds += [] if least is None else [f"at least {least:g}"]
        raise InputError(f"{name} is {result:g}; it must be {' and '.join(bounds)}")
    return result


def word(value: Any, name: str, choices: Sequence[str]) -> str:
    """One of some words."""
    if not isinstance(value, str) or value not in choices:
        *others, last = map(repr, choices)
        raise InputError(f"{name} is {value!r}; choose {', '.join(others)} or {last}")
    return value


def generator(value: Any, name: str = "rng") -> np.random.Generator:
    """What random numbers are drawn with: the generator that is given, or one from a seed; None is seed 0."""
    if isinstance(value, np.random.Generator):
        return value
    return np.random.default_rng(0 if value is None else whole(value, name, 0))


def file(value: Any, name: str) -> Path:
    """A path."""
    if not isinstance(value, str | os.PathLike):
        raise InputError(f"{name} is {value!r}; a str or PathLike is needed")
    return Path(value)


def indices(value: Any, name: str, count: int, *, empty: bool = False) -> npt.NDArray[np.int64]:
    """Indices from 0 to ``count`` - 1 (one number, a list, or a mask of ``count`` booleans)."""
    array = np.atleast_1d(_array(value, name)) if not (isinstance(value, list | tuple) and len(value) == 0) else np.zeros(0, np.int64)
    if array.ndim != 1:
        raise InputError(f"{name} has shape {array.shape}; a list of indices is needed")
    if array.dtype.kind == "b":
        if len(array) != count:
            raise InputError(f"{name} is a mask of {len(array)}, the shape has {count} vertices")
        array = np.flatnonzero(array)
    elif array.size and array.dtype.kind == "f":
        raise InputError(f"{name} holds {array[0]:g}; whole numbers are needed")
    if array.size == 0 and not empty:
        raise InputError(f"{name} is empty; name at least one vertex")
    wrong = (array < 0) | (array >= count)
    if wrong.any():
        at = int(np.flatnonzero(wrong)[0])
        raise InputError(f"{name}[{at}] is {array[at]}; the shape has {count} vertices, numbered from 0")
    return array.astype(np.int64)


def pairs(value: Any, name: str, count: int, other: int) -> npt.NDArray[np.int64]:
    """(k, 2): numbers of vertices of a source with ``count`` and of a target with ``other`` vertices."""
    table = anything(value, name)
    if table.size == 0:
        return np.zeros((0, 2), np.int64)
    if table.ndim != 2 or table.shape[1] != 2:
        raise InputError(f"{name} has shape {table.shape}; (k, 2) vertex numbers are needed, of the source and of the target in each row")
    return np.stack([indices(table[:, side], f"{name}[:, {side}]", n) for side, n in enumerate((count, other))], 1)


def some(numbers: npt.NDArray[Any]) -> str:
    """The first of some numbers, and how many more there are, for a message."""
    text = ", ".join(map(str, numbers[:8].tolist()))
    return f"{text} and {len(numbers) - 8} more" if len(numbers) > 8 else text


def frozen(array: npt.NDArray[Any], given: Any) -> npt.NDArray[Any]:
    """The array, read-only; a copy if it may still share memory with what was given."""
    if array is given or not array.flags.owndata or (isinstance(given, np.ndarray) and np.may_share_memory(array, given)):
        array = array.copy()
    array.flags.writeable = False
    return array


def read_only(array: _A) -> _A:
    """The array itself, read-only: for what is kept and handed out more than once."""
    array.flags.writeable = False
    return array


def csr_in(matrix: Any, name: str) -> CsrArrays:
    """A scipy sparse matrix (any format) or a dense square array, as the core takes it: sorted, entries added up, finite."""
    if not scipy.sparse.issparse(matrix):
        matrix = floats(matrix, name, (None, None))
    if matrix.dtype.kind not in "buif":
        raise InputError(f"{name} has dtype {matrix.dtype}; real numbers are needed")
    if matrix.ndim != 2:
        raise InputError(f"{name} has shape {matrix.shape}; a matrix has two dimensions")
    if max(matrix.shape) > np.iinfo(np.int32).max:
        raise InputError(f"{name} has shape {matrix.shape}; rows and columns are up to 2^31 - 1")
    csr = scipy.sparse.csr_array(matrix, dtype=np.float64)
    if not csr.has_canonical_format:
        csr = csr.copy()
        csr.sum_duplicates()
    rows, columns = csr.shape
    starts, indices = np.require(csr.indptr, np.int64, ["C", "A"]), np.require(csr.indices, np.int32, ["C", "A"])
    return rows, columns, starts, indices, np.require(csr.data, np.float64, ["C", "A"])


def csr_out(parts: tuple[Floats, npt.NDArray[Any], npt.NDArray[Any]], shape: tuple[int, int]) -> scipy.sparse.csr_array:
    """The core's matrix as a scipy array, without a copy; its values are read-only, because most are kept and handed out again."""
    matrix = scipy.sparse.csr_array(shape)
    matrix.data, matrix.indices, matrix.indptr = read_only(parts[0]), *parts[1:]
    matrix.has_sorted_indices = True
    matrix.has_canonical_format = True
    return matrix

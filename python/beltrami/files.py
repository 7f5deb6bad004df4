"""Loading and saving: files of many formats, and the shapes of other packages."""

from __future__ import annotations

import contextlib
import gzip
import os
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from . import _core, arrays
from .arrays import Floats, Ints
from .errors import DependencyError, FileError, InputError
from .progress import Progress, reporter
from .shapes import PointCloud, TriangleMesh

__all__ = ["load", "load_values", "save", "to_pyvista", "to_trimesh"]

Fields = list[tuple[str, npt.NDArray[Any]]]
Format = Literal["obj", "ply", "stl", "off", "xyz", "pts", "csv"]
Reporter = Callable[[float], object] | None

_OWN = {".obj", ".ply", ".stl", ".off", ".coff", ".noff", ".cnoff", ".xyz", ".xyzn", ".xyzrgb", ".asc", ".txt", ".pts", ".csv", ".tsv"}
_FREESURFER = (b"\xff\xff\xfe", b"\xff\xff\xff", b"\xff\xff\xfd")  # triangles, quadrangles, quadrangles of the newer kind
_CURV = b"\xff\xff\xff"  # numbers at vertices: the number of quadrangles, too, but of another length
_NO_FACES = np.zeros((0, 3), np.int32)


def load(
    source: Any, *, weld: bool | None = None, format: Format | None = None, dimension: int = 2, progress: Progress = None
) -> TriangleMesh | PointCloud:
    """Load a surface or a point cloud from a file, or convert an object of another package.

    Vertices keep their order and are never merged unless asked. Polygons become triangles, n - 2 each, in order; faces of
    fewer than three corners are skipped. Without any triangle the result is a :class:`PointCloud`.

    Parameters
    ----------
    source : str, PathLike, binary file, or object
        OBJ, PLY (ASCII, little- and big-endian), STL, OFF / COFF / NOFF, XYZ, PTS, CSV, each also as gzip, are read by this
        library; GIFTI and FreeSurfer surfaces through nibabel (``pip install 'beltrami[neuro]'``); glTF, 3MF and whatever else
        trimesh reads through trimesh. Objects of trimesh, pyvista, open3d and meshio are accepted too, and so are
        a pair (vertices, faces) and an array of points (n, D).
    weld : bool, optional
        Whether vertices at equal positions are merged (the first is kept, with its data). By default only for STL files, which
        have no shared vertices.
    format : {"obj", "ply", "stl", "off", "xyz", "pts", "csv"}, optional
        The format, if the file's name does not tell it.
    dimension : int
        Intrinsic dimension of a cloud, for :class:`PointCloud`.
    progress : callable or True, optional
        Called with the share of the file that is read, 0 to 1; returning False stops. True draws a bar.

    Returns
    -------
    TriangleMesh or PointCloud
        ``.data`` holds the numbers of each vertex as the file has them, in its own types: colours as ``colors`` (n, 3) or (n, 4),
        normals as ``normals`` (n, 3), texture coordinates as ``uv`` (n, 2; on a seam those of the first face), every other property
        under its name. Reals of text files are doubles. Finite normals of a cloud also become its ``normals``, positive ``weights``
        its weights.

    Raises
    ------
    FileError
        The file is missing, broken, or of no known format; the message names the file, the line or byte, and the cause.
    InputError
        The object is of no known kind, or its arrays are wrong.
    DependencyError
        A package is needed and missing.
    Cancelled
        ``progress`` returned False.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.load(([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))
    TriangleMesh(3 vertices in R^3, 1 faces)
    """
    if not (weld is None or isinstance(weld, bool | np.bool_)):
        raise InputError(f"weld is {weld!r}; choose True, False or None (STL files only)")
    weld = None if weld is None else bool(weld)
    _check_format(format)
    if isinstance(source, TriangleMesh | PointCloud):
        if not weld:
            return source
        vertices, faces, fields = _parts(source)
        return _shape(*_core.weld(vertices, faces, _storable(fields)[0]), dimension)
    if isinstance(source, str | os.PathLike):
        loaded = _from_path(os.fspath(source), format, weld, reporter(progress, "load"))
    elif _known_package(source) is None and callable(getattr(source, "read", None)):
        loaded = _from_stream(source, format, weld, reporter(progress, "load"))
    else:
        loaded = _from_object(source)
        if weld:
            loaded = _core.weld(loaded[0], loaded[1], _storable(loaded[2])[0])
    return _shape(*loaded, dimension)


def load_values(path: str | os.PathLike[str]) -> npt.NDArray[Any]:
    """Read values of vertices from a file, in its order, for a shape that comes from another file.

    Parameters
    ----------
    path : path
        ``.npy``; ``.npz`` with one array; text with a row per vertex (``.csv`` with commas, others with spaces; a first line of words is a
        heading); curv files of FreeSurfer (``lh.sulc``, ``lh.thickness`` ...); GIFTI, FreeSurfer's ``.annot``, ``.mgh`` and ``.mgz``
        through nibabel (``pip install 'beltrami[neuro]'``).

    Returns
    -------
    ndarray (n,) or (n, k)
        Numbers with the file's type; labels (``.annot``) are integers, -1 where there is none.

    Raises
    ------
    FileError
        The file is missing, broken, or holds no numbers of vertices.
    DependencyError
        nibabel is needed and missing.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> import beltrami as bt
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.savetxt(f"{folder}/depth.txt", [0.5, -1.0, 2.0])
    ...     bt.load_values(f"{folder}/depth.txt").tolist()
    [0.5, -1.0, 2.0]
    """
    path = arrays.file(path, "path")
    suffix = _suffix(str(path))
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:  # a zero byte in the name
        raise FileError(f"{path}: cannot be read: {error}") from None
    if suffix in (".npy", ".npz"):
        fields = stored(path)
        if len(fields) != 1:
            raise FileError(f"{path} holds {len(fields)} arrays ({', '.join(fields) or 'none'}); one is needed")
        return next(iter(fields.values()))
    if suffix in (".gii", ".annot", ".mgh", ".mgz"):
        return _values_by_nibabel(path, suffix)
    if content[:3] == _CURV:
        count = int.from_bytes(content[3:7], "big")
        if len(content) != 15 + 4 * count:
            raise FileError(f"{path}: no curv file of FreeSurfer: {len(content)} bytes where {count} vertices need {15 + 4 * count}")
        return np.frombuffer(content, ">f4", offset=15).astype(np.float32)
    try:
        lines = content.decode("utf-8-sig").splitlines()
        if not any(line.strip() for line in lines):
            raise FileError(f"{path} is empty; a row per vertex is needed")
        separator = "," if suffix == ".csv" else None
        rows = np.loadtxt(lines, delimiter=separator, skiprows=int(_is_heading(lines[0], separator)))
    except ValueError as error:
        raise FileError(f"{path} cannot be read as numbers: {error}") from None
    return np.atleast_1d(rows)


def _is_heading(line: str, separator: str | None) -> bool:
    try:
        for word in line.split(separator):
            float(word)
    except ValueError:
        return True
    return False


def _values_by_nibabel(path: Path, suffix: str) -> npt.NDArray[Any]:
    nibabel = _nibabel(str(path))
    try:
        if suffix == ".annot":
            return np.asarray(nibabel.freesurfer.read_annot(str(path))[0])
        if suffix == ".gii":
            geometry = [nibabel.nifti1.intent_codes[f"NIFTI_INTENT_{name}"] for name in ("POINTSET", "TRIANGLE")]
            columns = [np.asarray(array.data) for array in _gifti(nibabel, str(path)).darrays if array.intent not in geometry]
            if not columns:
                raise FileError(f"{path}: holds a surface and no numbers of its vertices")
            return columns[0] if len(columns) == 1 else np.column_stack(columns)
        return np.squeeze(np.asarray(nibabel.load(str(path)).dataobj))
    except FileError:
        raise
    except Exception as error:
        raise FileError(f"{path}: nibabel cannot read it: {type(error).__name__}: {error}") from error


def save(shape: Any, path: str | os.PathLike[str], *, format: Format | None = None, ascii: bool = False, progress: Progress = None) -> None:
    """Write a surface or a point cloud to a file; the suffix gives the format, and a final ``.gz`` compresses it.

    PLY stores everything: coordinates of any dimension, and every array of ``.data`` with its type. OBJ holds colours (as shares
    of 1), texture coordinates and normals; OFF colours and normals; XYZ normals; PTS colours; CSV columns. What a format has no
    place for is left out with a warning that names it. Reals are written so that they read back as the same bits; binary STL alone
    has single precision. Plane shapes get height 0 in formats of three dimensions. A missing folder is created.

    Parameters
    ----------
    shape : TriangleMesh or PointCloud, or anything :func:`load` takes
    path : str or PathLike
        Ends in .ply, .obj, .off, .stl, or for clouds also .xyz, .pts, .csv; each may be followed by .gz.
    format : {"obj", "ply", "stl", "off", "xyz", "pts", "csv"}, optional
        The format, if the name does not tell it.
    ascii : bool
        Text also for PLY and STL, which are binary by default.
    progress : callable or True, optional
        Called with the share that is written, 0 to 1; returning False stops. True draws a bar.

    Raises
    ------
    FileError
        The format is not known or cannot hold such a shape, or the file cannot be written.
    Cancelled
        ``progress`` returned False; the file is not complete.

    Examples
    --------
    >>> import beltrami as bt, pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "sphere.ply.gz"
    >>> bt.save(bt.shapes.sphere(3), path)
    >>> bt.load(path).genus
    0
    """
    _check_format(format)
    try:
        name = os.fsdecode(path)
    except TypeError:
        raise InputError(f"path is {path!r}; a str or PathLike is needed") from None
    if not isinstance(shape, TriangleMesh | PointCloud):
        shape = load(shape)
    vertices, faces, fields = _parts(shape)
    kept, lost = _storable(fields)
    made = _make_folder(Path(name))
    try:
        lost += _core.save_file(name, vertices, faces, kept, format, bool(ascii), reporter(progress, "save"))
    except Exception:  # a refusal leaves no folders behind
        with contextlib.suppress(OSError):  # a part of the file is in it
            for folder in made:
                folder.rmdir()
        raise
    if lost:
        warnings.warn(f"{name} has no place for data {', '.join(map(repr, lost))}; .ply keeps numbers of any type", stacklevel=2)


def _make_folder(path: Path) -> list[Path]:
    """Makes the folder that a file is to lie in, so that no long computation is lost for the want of it: what was made, deepest first."""
    try:
        missing = [folder for folder in path.parents if not folder.exists()]
        path.parent.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise _unwritten(path, error) from None
    return missing


def _unwritten(path: Path, error: OSError | ValueError) -> FileError:  # ValueError: a null character in the name
    return FileError(f"{path} cannot be written: {getattr(error, 'strerror', None) or error}")


def written(path: Path, fill: Callable[[Any], object]) -> Path:
    """A file that ``fill`` writes to a stream of bytes, in a folder that is made where it is missing.

    What the system says against it is a :class:`FileError`.
    """
    _make_folder(path)
    try:
        stream = path.open("wb")
    except (OSError, ValueError) as error:
        raise _unwritten(path, error) from None
    try:
        with stream:
            fill(stream)
    except OSError as error:
        raise _unwritten(path, error) from None
    return path


def stored(path: Path) -> dict[str, npt.NDArray[Any]]:
    """The arrays of an ``.npz`` file by their names; that of an ``.npy`` file by the file's.

    Raises
    ------
    FileError
        The file is missing, broken, or holds objects of Python.
    """
    try:
        found = np.load(path, allow_pickle=False)
        if isinstance(found, np.ndarray):
            return {path.stem: found}
        with found:
            return {name: np.asarray(found[name]) for name in found.files}
    except Exception as error:  # numpy, zipfile and zlib each say it in their own way; a shape that lies asks for all memory
        said = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise FileError(f"{path} cannot be read: {said}") from None


def columns(values: Mapping[str, Any]) -> dict[str, npt.NDArray[Any]]:
    """Each column of tables by itself, as ``name_0``, ``name_1`` ...; of an array with one column by its name."""
    found: dict[str, npt.NDArray[Any]] = {}
    for name, array in values.items():
        rows = np.atleast_2d(array.T)
        found |= {name if len(rows) == 1 else f"{name}_{at}": np.ascontiguousarray(row) for at, row in enumerate(rows)}
    return found


def save_with(shape: Any, values: Mapping[str, Any], path: Path) -> Path:
    """The shape with more values at its vertices; of tables each column by itself, as ``name_0``, ``name_1`` ..."""
    data = {**shape.data, **columns(values)}
    if isinstance(shape, PointCloud):
        save(PointCloud(shape.points, dimension=shape.dimension, normals=shape.normals, weights=shape.weights, data=data), path)
    else:
        save(TriangleMesh(shape.vertices, shape.faces, data=data), path)
    return path


def _check_format(format: Any) -> None:
    if not (format is None or isinstance(format, str)):
        raise InputError(f"format is {format!r}; name one of {', '.join(get_args(Format))}")


def _parts(shape: TriangleMesh | PointCloud) -> tuple[Floats, Ints, Fields]:
    """Arrays of a shape; normals and weights of a cloud among its data."""
    fields = dict(shape.data)
    if isinstance(shape, TriangleMesh):
        return shape.vertices, shape.faces, list(fields.items())
    for name, array in (("normals", shape.normals), ("weights", shape.weights)):
        if array is not None and not (name in fields and np.array_equal(fields[name], array)):
            fields[name] = array
    return shape.points, _NO_FACES, list(fields.items())


def _storable(fields: Fields) -> tuple[Fields, list[str]]:
    """Fields as the core takes them, and the names of those it cannot."""
    kept, lost = [], []
    for name, array in fields:
        if array.dtype == np.float16:
            array = array.astype(np.float32)
        if array.ndim in (1, 2) and array.dtype.kind in "buif" and array.dtype.itemsize <= 8:
            kept.append((name, np.require(array, array.dtype.newbyteorder("="), ["C", "A"])))
        else:
            lost.append(name)
    return kept, lost


def _shape(vertices: Floats, faces: Ints, fields: Fields, dimension: int) -> TriangleMesh | PointCloud:
    """The shape of arrays that are nobody else's and checked: they are not copied."""
    data = dict(fields)
    vertices.flags.writeable = faces.flags.writeable = False
    for array in data.values():
        array.flags.writeable = False
    if len(faces):
        return TriangleMesh._trusted(vertices, faces, data)
    normals, weights = data.get("normals"), data.get("weights")
    if normals is not None and (normals.shape != vertices.shape or not np.isfinite(normals).all()):
        normals = None
    if weights is not None and not (weights.shape == (len(vertices),) and np.isfinite(weights).all() and (weights > 0).all()):
        weights = None
    return PointCloud(vertices, dimension=dimension, normals=normals, weights=weights, data=data)


# ---- files -----------------------------------------------------------------------------------------------------------------------------
def _suffix(path: str) -> str:
    name = Path(path).name.lower()
    return Path(name.removesuffix(".gz")).suffix


def _from_path(path: str | bytes, format: str | None, weld: bool | None, progress: Reporter) -> tuple[Floats, Ints, Fields]:
    path = os.fsdecode(path)
    suffix = _suffix(path)
    if format is not None or suffix in _OWN:
        return _core.load_file(path, format, weld, progress)
    try:
        with open(path, "rb") as handle:
            head = handle.read(16)
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:  # a zero byte in the name
        raise FileError(f"{path!r}: cannot be read: {error}") from None
    if suffix == ".gii":
        loaded = _from_gifti(path)
    elif head[:3] in _FREESURFER:
        loaded = _from_freesurfer(path)
    elif suffix and not head.startswith((b"ply", b"OFF", b"COFF", b"NOFF", b"solid")) and suffix[1:] in _trimesh(path).available_formats():
        loaded = _through_trimesh(path)
    else:
        return _core.load_file(path, None, weld, progress)
    return _core.weld(loaded[0], loaded[1], _storable(loaded[2])[0]) if weld else loaded


def _from_stream(stream: Any, format: str | None, weld: bool | None, progress: Reporter) -> tuple[Floats, Ints, Fields]:
    name = getattr(stream, "name", None)
    name = os.fsdecode(name) if isinstance(name, str | bytes) else f"<{type(stream).__name__}>"
    content = stream.read()
    if isinstance(content, str):
        content = content.encode()
    if not isinstance(content, bytes):
        raise InputError(f"{name}.read() gives {type(content).__name__}; open the file in binary mode")
    return _core.load_bytes(content, name, format, weld, progress)


def _trimesh(what: str) -> Any:
    try:
        import trimesh
    except ImportError:
        raise DependencyError(f"{what} needs the package trimesh: pip install trimesh") from None
    return trimesh


def _nibabel(path: str) -> Any:
    try:
        import nibabel
    except ImportError:
        raise DependencyError(f"{path} is read through nibabel, which is missing: pip install 'beltrami[neuro]'") from None
    return nibabel


def _through_trimesh(path: str) -> tuple[Floats, Ints, Fields]:
    trimesh = _trimesh(path)
    try:
        found = trimesh.load(path, process=False)
    except Exception as error:
        raise FileError(f"{path}: trimesh cannot read it: {type(error).__name__}: {error}") from error
    return _named(path, lambda: _from_trimesh(found))


def _gifti(nibabel: Any, path: str) -> Any:
    try:
        content = Path(path).read_bytes()
        return nibabel.GiftiImage.from_bytes(gzip.decompress(content) if content[:2] == b"\x1f\x8b" else content)
    except Exception as error:
        raise FileError(f"{path}: no GIFTI file: {type(error).__name__}: {error}") from error


def _from_gifti(path: str) -> tuple[Floats, Ints, Fields]:
    nibabel = _nibabel(path)
    image = _gifti(nibabel, path)
    codes = nibabel.nifti1.intent_codes
    points, faces, others = None, None, []
    for array in image.darrays:
        intent = codes.niistring.get(array.intent, f"intent_{array.intent}")
        if intent == "NIFTI_INTENT_POINTSET" and points is None:
            points = array.data
        elif intent == "NIFTI_INTENT_TRIANGLE" and faces is None:
            faces = array.data
        else:
            others.append((str((array.meta or {}).get("Name") or intent.removeprefix("NIFTI_INTENT_").lower()), array.data))
    if points is None:
        raise FileError(f"{path}: holds no surface (no array of points); load the surface it belongs to, and this by load_values")
    return _named(path, lambda: _checked(points, faces, dict(others)))


def _from_freesurfer(path: str) -> tuple[Floats, Ints, Fields]:
    with open(path, "rb") as stream:
        head = stream.read(7)
    if head[:3] == _CURV and os.path.getsize(path) == 15 + 4 * int.from_bytes(head[3:], "big"):
        raise FileError(f"{path}: holds numbers of vertices and no surface; load the surface it belongs to, and this by load_values")
    nibabel = _nibabel(path)
    try:
        points, faces = nibabel.freesurfer.read_geometry(path)
    except Exception as error:
        raise FileError(f"{path}: no FreeSurfer surface: {type(error).__name__}: {error}") from error
    return _named(path, lambda: _checked(points, faces, {}))


def _named(path: str, make: Callable[[], tuple[Floats, Ints, Fields]]) -> tuple[Floats, Ints, Fields]:
    try:
        return make()
    except InputError as error:
        raise FileError(f"{path}: {error}") from error


# ---- objects ---------------------------------------------------------------------------------------------------------------------------
def _checked(points: Any, faces: Any, data: Mapping[str, Any]) -> tuple[Floats, Ints, Fields]:
    """Arrays of our own of what somebody else holds; data of another length than the vertices are not the vertices'."""
    vertices = arrays.floats(arrays.points(points, "vertices", least=2), "vertices", (None, None))
    triangles = _NO_FACES if faces is None else arrays.triangles(faces, "faces", len(vertices))
    fields = []
    for name, values in data.items():
        array = np.asarray(values)
        if array.dtype.kind in "buif" and array.ndim in (1, 2) and len(array) == len(vertices):
            fields.append((str(name), np.array(array, order="C")))
    return np.array(vertices, order="C"), np.array(triangles, order="C"), fields


def _cut(points: Any, sizes: npt.NDArray[Any], corners: npt.NDArray[Any], data: Mapping[str, Any]) -> tuple[Floats, Ints, Fields]:
    """Of polygons, given by their sizes and the numbers of their corners one after the other."""
    vertices, _, fields = _checked(points, None, data)
    wrong = np.flatnonzero((corners < 0) | (corners >= len(vertices)))
    if len(wrong):
        raise InputError(f"a face refers to vertex {corners[wrong[0]]}, the mesh has {len(vertices)} vertices")
    faces = _core.triangulate(vertices, np.require(sizes, np.int64, ["C", "A"]), np.require(corners, np.int32, ["C", "A"]))
    return vertices, faces, fields


def _known_package(source: Any) -> str | None:
    """The package that a class comes from, which is thereby not imported."""
    packages = {kind.__module__.split(".")[0] for kind in type(source).__mro__}
    return next((package for package in ("trimesh", "pyvista", "open3d", "meshio") if package in packages), None)


def _from_object(source: Any) -> tuple[Floats, Ints, Fields]:
    takers = {"trimesh": _from_trimesh, "pyvista": _from_pyvista, "open3d": _from_open3d, "meshio": _from_meshio}
    package = None if isinstance(source, np.ndarray) else _known_package(source)  # trimesh has arrays of its own
    if package is not None:
        return takers[package](source)
    if isinstance(source, tuple | list) and len(source) == 2 and np.ndim(source[0]) == 2:
        return _checked(source[0], source[1], {})
    if isinstance(source, np.ndarray):
        return _checked(source, None, {})
    if hasattr(source, "vertices") and hasattr(source, "faces"):
        return _checked(source.vertices, source.faces, {})
    raise InputError(
        f"a {type(source).__module__}.{type(source).__name__} cannot be loaded; give a path, an object of trimesh, pyvista, open3d "
        "or meshio, a pair (vertices, faces) or an array of points"
    )


def _from_trimesh(source: Any) -> tuple[Floats, Ints, Fields]:
    if hasattr(source, "geometry") and hasattr(source, "graph"):  # a scene
        if not source.geometry:
            raise InputError("the scene of trimesh is empty")
        source = source.to_geometry() if hasattr(source, "to_geometry") else source.dump(concatenate=True)
    if not hasattr(source, "vertices") or hasattr(source, "entities"):
        raise InputError(f"a {type(source).__name__} of trimesh is neither a surface nor a cloud")
    data: dict[str, Any] = {}
    visual: Any = getattr(source, "visual", None)
    if getattr(visual, "kind", None) == "vertex":
        data["colors"] = visual.vertex_colors
    elif getattr(visual, "uv", None) is not None:
        data["uv"] = visual.uv
    elif visual is None and np.size(getattr(source, "colors", ())):
        data["colors"] = source.colors
    data.update(getattr(source, "vertex_attributes", {}))
    return _checked(source.vertices, getattr(source, "faces", None), data)


def _from_pyvista(source: Any) -> tuple[Floats, Ints, Fields]:
    names = {"Normals": "normals", "RGB": "colors", "RGBA": "colors"}
    data = {names.get(name, name): np.asarray(source.point_data[name]) for name in source.point_data}
    if hasattr(type(source), "n_strips"):  # PolyData
        if source.n_strips:
            source = source.triangulate()
        sizes, corners = _unpadded(np.asarray(source.faces))
    elif hasattr(type(source), "celltypes"):  # UnstructuredGrid
        polygons = {3: 0, 4: 0, 5: 3, 7: -1, 9: 4, 1: 0, 2: 0}  # vertices and lines are passed over
        others = set(np.unique(source.celltypes).tolist()) - set(polygons)
        if others:
            raise InputError(f"the grid has cells of VTK type {min(others)}, which are no polygons; take .extract_surface() of it")
        sizes, corners = _unpadded(np.asarray(source.cells))
        keep = np.isin(source.celltypes, (5, 7, 9))
        corners, sizes = corners[np.repeat(keep, sizes)], sizes[keep]
    elif type(source).__name__ == "PointSet":
        return _checked(source.points, None, data)
    else:
        raise InputError(f"a {type(source).__name__} of pyvista is no surface; take .extract_surface() of it")
    return _cut(source.points, sizes, corners, data)


def _unpadded(cells: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Sizes and corners of VTK's lists [n, corner, ... corner, n, ...]."""
    if len(cells) and len(cells) % (cells[0] + 1) == 0 and (cells[:: cells[0] + 1] == cells[0]).all():
        table = cells.reshape(-1, cells[0] + 1)
        return table[:, 0], table[:, 1:].ravel()
    sizes, at = [], 0
    heads = []
    while at < len(cells):
        heads.append(at)
        sizes.append(int(cells[at]))
        at += sizes[-1] + 1
    return np.array(sizes, np.int64), np.delete(cells, heads)


def _from_open3d(source: Any) -> tuple[Floats, Ints, Fields]:
    def table(value: Any) -> npt.NDArray[Any]:
        return np.asarray(value.numpy() if hasattr(value, "numpy") else value)

    if hasattr(source, "get_geometry_type") or not hasattr(source, "material"):  # open3d.geometry
        cloud = hasattr(source, "points")
        if hasattr(source, "lines") or not (cloud or hasattr(source, "triangles")):
            raise InputError(f"a {type(source).__name__} of open3d is neither a triangle mesh nor a point cloud")
        prefix = "" if cloud else "vertex_"
        data = {name: table(getattr(source, prefix + name)) for name in ("colors", "normals")}
        points, faces = (source.points, None) if cloud else (source.vertices, source.triangles)
        return _checked(table(points), None if faces is None else table(faces), {k: v for k, v in data.items() if len(v)})
    attributes = source.vertex if hasattr(source, "vertex") else getattr(source, "point", None)  # open3d.t.geometry
    if attributes is None or "positions" not in attributes or hasattr(source, "line"):
        raise InputError(f"a {type(source).__name__} of open3d is neither a triangle mesh nor a point cloud with positions")
    data = {str(name): table(attributes[name]) for name in attributes if name != "positions"}
    faces = table(source.triangle["indices"]) if hasattr(source, "triangle") and "indices" in source.triangle else None
    return _checked(table(attributes["positions"]), faces, data)


def _from_meshio(source: Any) -> tuple[Floats, Ints, Fields]:
    sizes, corners = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for block in source.cells:
        if block.type in ("triangle", "quad", "polygon"):
            for polygon in (block.data,) if isinstance(block.data, np.ndarray) and block.data.ndim == 2 else block.data:
                table = np.atleast_2d(np.asarray(polygon))
                sizes.append(np.full(len(table), table.shape[1]))
                corners.append(table.ravel())
        elif block.type not in ("vertex", "line"):
            raise InputError(f"the mesh has cells of type {block.type!r}; triangles, quads and polygons make a surface")
    return _cut(source.points, np.concatenate(sizes), np.concatenate(corners), source.point_data)


# ---- to other packages -----------------------------------------------------------------------------------------------------------------
def _in_space(points: Floats) -> Floats:
    if points.shape[1] > 3:
        raise InputError(f"the shape lies in R^{points.shape[1]}; choose three coordinates first")
    return np.pad(points, ((0, 0), (0, 3 - points.shape[1])))


def to_trimesh(shape: TriangleMesh | PointCloud) -> Any:
    """The shape as trimesh holds it: :meth:`TriangleMesh.to_trimesh`, :meth:`PointCloud.to_trimesh`."""
    trimesh = _trimesh("to_trimesh")
    vertices, faces, fields = _parts(shape)
    data = {name: np.array(array) for name, array in fields}
    colors = data.pop("colors", None)
    if isinstance(shape, PointCloud):
        return trimesh.PointCloud(_in_space(vertices), colors=colors)
    return trimesh.Trimesh(_in_space(vertices), np.array(faces), vertex_colors=colors, vertex_attributes=data, process=False)


def to_pyvista(shape: TriangleMesh | PointCloud) -> Any:
    """The shape as pyvista holds it: :meth:`TriangleMesh.to_pyvista`, :meth:`PointCloud.to_pyvista`."""
    try:
        import pyvista
    except ImportError:
        raise DependencyError("pyvista is missing; pip install 'beltrami[pyvista]'") from None
    vertices, faces, fields = _parts(shape)
    cells = np.column_stack([np.full(len(faces), 3, np.int32), faces]).ravel()
    result = pyvista.PolyData(_in_space(vertices), cells) if len(faces) else pyvista.PolyData(_in_space(vertices))
    for name, array in fields:
        if array.dtype.kind in "buif" and array.ndim <= 2:
            result.point_data[name] = np.array(array)
    return result

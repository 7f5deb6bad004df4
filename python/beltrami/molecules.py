"""Molecular trajectories as point clouds: reading, alignment, dihedral angles on their torus."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from . import arrays
from .arrays import Floats
from .errors import DependencyError, Error, FileError, InputError

__all__ = ["align", "dihedral_angles", "load", "on_torus", "pair_distances"]

Reader = Literal["auto", "MDAnalysis", "mdtraj"]


def load(
    topology: str | os.PathLike[str],
    trajectories: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    *,
    selection: str | None = None,
    stride: int = 1,
    reader: Reader = "auto",
) -> Floats:
    """Positions of the atoms of a trajectory.

    Parameters
    ----------
    topology : path
        A structure (PDB, GRO, PSF, PRMTOP ...), or a file that holds the trajectory as well.
    trajectories : path or list of paths
        DCD, XTC, TRR, NetCDF ...; several are concatenated. None: the frames of the topology.
    selection : str, optional
        In the reader's own language, such as ``"name N or name CA or name C"``; all atoms by default.
    stride : int
        Take only every ``stride``-th frame.
    reader : {"auto", "MDAnalysis", "mdtraj"}
        Which package reads the files; by default the first that is installed.

    Returns
    -------
    ndarray (frames, atoms, 3)
        In nm.

    Raises
    ------
    DependencyError
        Neither package is installed.
    FileError
        A file cannot be read.
    InputError
        The selection is empty or not understood.
    """
    top = os.fspath(arrays.file(topology, "topology"))
    if not isinstance(trajectories, str | os.PathLike | Sequence):
        raise InputError(f"trajectories is {trajectories!r}; a path or a list of paths is needed")
    files = [trajectories] if isinstance(trajectories, str | os.PathLike) else trajectories
    names, every = [os.fspath(arrays.file(file, "trajectories")) for file in files], arrays.whole(stride, "stride", 1)
    if not (selection is None or isinstance(selection, str)):
        raise InputError(f"selection is {selection!r}; a str is needed")
    arrays.word(reader, "reader", get_args(Reader))
    for name in [top, *names]:
        if not os.path.exists(name):
            raise FileError(f"{name}: no such file")
    readers = {"MDAnalysis": _mdanalysis, "mdtraj": _mdtraj}
    for package in readers if reader == "auto" else (reader,):
        try:
            found = readers[package](top, names, selection, every)
        except ImportError:
            continue
        except Error:
            raise
        except Exception as error:  # whatever the package raises on a file it cannot read
            raise FileError(f"{', '.join([top, *names])} cannot be read by {package}: {error}") from None
        return arrays.floats(found, "positions", (None, None, 3))
    wanted = "MDAnalysis or mdtraj" if reader == "auto" else reader
    raise DependencyError(f"trajectories are read by {wanted}, which is missing: pip install 'beltrami[molecules]' (or {wanted})")


def _mdanalysis(topology: str, trajectories: list[str], selection: str | None, stride: int) -> Any:
    import warnings

    import MDAnalysis

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of masses and elements that a file does not name, which nothing here needs
        universe = MDAnalysis.Universe(topology, *([trajectories] if trajectories else []))
        try:
            atoms = universe.atoms if selection is None else universe.select_atoms(selection)
        except MDAnalysis.exceptions.SelectionError as error:
            raise InputError(f"selection {selection!r} is not understood: {error}") from None
        if len(atoms) == 0:
            raise InputError(f"selection {selection!r} holds no atom")
        return np.array([atoms.positions.astype(float) / 10 for _ in universe.trajectory[::stride]])


def _mdtraj(topology: str, trajectories: list[str], selection: str | None, stride: int) -> Any:
    import mdtraj

    whole = mdtraj.load(trajectories, top=topology, stride=stride) if trajectories else mdtraj.load(topology, stride=stride)
    if selection is None:
        return whole.xyz.astype(float)
    try:
        atoms = whole.topology.select(selection)
    except ValueError as error:
        raise InputError(f"selection {selection!r} is not understood: {error}") from None
    if len(atoms) == 0:
        raise InputError(f"selection {selection!r} holds no atom")
    return whole.xyz[:, atoms].astype(float)


def align(positions: npt.ArrayLike, reference: npt.ArrayLike | None = None) -> Floats:
    """Superimpose frames on a reference, each by its least-squares rotation (Kabsch).

    Parameters
    ----------
    positions : array_like (frames, atoms, 3)
    reference : array_like (atoms, 3), optional
        By default the mean of all frames once they lie on the first, which is found in a few rounds.

    Returns
    -------
    ndarray (frames, atoms, 3)
        Centred on the reference; ``.reshape(frames, -1)`` are points of R^(3 atoms).

    Raises
    ------
    InputError
        Shapes do not fit or a number is not finite.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> frame = np.random.default_rng(0).normal(size=(5, 3))
    >>> turned = frame @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]) + 2
    >>> bool(np.ptp(bt.molecules.align([frame, turned]), axis=0).max() < 1e-12)
    True
    """
    frames, unit = _in_units(positions)
    if frames.shape[0] == 0 or frames.shape[1] == 0:
        raise InputError(f"positions has shape {frames.shape}; at least one frame of one atom is needed")
    wanted = None if reference is None else arrays.floats(reference, "reference", (frames.shape[1], 3))
    if wanted is not None and np.abs(wanted).max() > unit:
        larger = _in_units(wanted[None])[1]
        frames, unit = frames * (unit / larger), larger
    centred = frames - frames.mean(1, keepdims=True)
    if wanted is not None:
        return _turned(centred, wanted / unit) * unit
    found = _turned(centred, centred[0])
    for _ in range(5):
        found = _turned(centred, found.mean(0))
    return found * unit


def _in_units(positions: npt.ArrayLike) -> tuple[Floats, float]:
    """Positions as shares of their largest coordinate, and that: products of them neither overflow nor vanish."""
    frames = arrays.floats(positions, "positions", (None, None, 3))
    unit = float(np.abs(frames).max(initial=0.0)) or 1.0
    if unit > 1e300:
        raise InputError(f"positions reach {unit:.3g}, and distances between them could be beyond float64; take a larger unit of length")
    return frames / unit, unit


def _turned(centred: Floats, reference: Floats) -> Floats:
    middle = reference.mean(0)
    left, _, right = np.linalg.svd(np.einsum("fai,aj->fij", centred, reference - middle))
    sign = np.sign(np.linalg.det(left @ right))
    left[:, :, 2] *= np.where(sign == 0, 1.0, sign)[:, None]  # rotations only, no mirror images
    return np.asarray(np.matmul(centred, left @ right) + middle, float)


def dihedral_angles(positions: npt.ArrayLike, atoms: npt.ArrayLike) -> Floats:
    """Dihedral angles of quadruples of atoms, in radians from -π to π (sign of the IUPAC).

    Parameters
    ----------
    positions : array_like (frames, atoms, 3)
    atoms : array_like (k, 4) of int
        Four atoms in a chain for each angle.

    Returns
    -------
    ndarray (frames, k)

    Raises
    ------
    InputError
        A number of an atom is out of range, or three of four atoms lie in a line (the frame is named).

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.molecules.dihedral_angles([[[1, 0, 0], [0, 0, 0], [0, 0, 1], [0, 1, 1]]], [[0, 1, 2, 3]]).round(6).tolist()
    [[1.570796]]
    """
    frames = _in_units(positions)[0]
    chosen = arrays.anything(atoms, "atoms")
    if chosen.ndim != 2 or chosen.shape[1] != 4:
        raise InputError(f"atoms has shape {chosen.shape}, (k, 4) is needed")
    quads = arrays.indices(chosen.ravel(), "atoms", frames.shape[1]).reshape(-1, 4)
    a, b, c, d = (frames[:, quads[:, k]] for k in range(4))
    axis = c - b
    one, other = np.cross(b - a, axis), np.cross(axis, d - c)
    flat = (np.linalg.norm(one, axis=2) == 0) | (np.linalg.norm(other, axis=2) == 0)
    if flat.any():
        frame, angle = np.argwhere(flat)[0]
        raise InputError(f"frame {frame}: three of the atoms {quads[angle].tolist()} lie in a line; they make no dihedral angle")
    length = np.linalg.norm(axis, axis=2)
    up = np.einsum("fki,fki->fk", b - a, other) * length
    return np.asarray(np.arctan2(up, np.einsum("fki,fki->fk", one, other)), float)


def on_torus(angles: npt.ArrayLike) -> Floats:
    """Angles as points of the flat torus: k angles become the 2 k coordinates cos, sin, cos, sin ...

    Distances along the torus are those of the angles, and -π and π are the same place.

    Parameters
    ----------
    angles : array_like (n, k)
        In radians.

    Returns
    -------
    ndarray (n, 2 k)

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> bool(np.allclose(bt.molecules.on_torus([[np.pi, 0.0]]), [[-1, 0, 1, 0]]))
    True
    """
    table = arrays.floats(angles, "angles", (None, None))
    return np.stack([np.cos(table), np.sin(table)], 2).reshape(len(table), -1)


def pair_distances(positions: npt.ArrayLike) -> Floats:
    """Distances between all pairs of atoms, (frames, atoms (atoms - 1) / 2): coordinates that need no alignment.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.molecules.pair_distances([[[0, 0, 0], [3, 4, 0], [0, 0, 1]]]).round(3).tolist()
    [[5.0, 1.0, 5.099]]
    """
    frames, unit = _in_units(positions)
    a, b = np.triu_indices(frames.shape[1], 1)
    return np.asarray(np.linalg.norm(frames[:, a] - frames[:, b], axis=2), float) * unit

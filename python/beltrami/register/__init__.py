"""Near-isometric registration: eigenmaps, rotation-invariant sliced Wasserstein, functional maps (section 8.3.3, (8.30)-(8.32)).

Two surfaces that differ by a bending have the same Laplace-Beltrami eigenfunctions, up to signs and rotations of equal ones. So an
orthogonal matrix C between the eigenfunctions says where each point goes: to the nearest row. The matrix is found coarse to fine.
``method="rswd"`` is the chapter's way: rotation-invariant sliced Wasserstein between the embeddings. The default generates more
candidates, from what eigenfunctions' products tell, refines each, and lets the deformation energy decide.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from .. import _core, arrays
from ..arrays import Floats, Ints
from ..errors import InputError
from ..maps import coverage
from ..operators import Operators
from ..progress import Progress, part, reporter, teller
from ..shapes import PointCloud, Shape, TriangleMesh
from .candidates import Products, RegistrationCandidate, beam, distinct, grown, judge, listed, point_maps, products_of, with_constant
from .deformation import Rigid, low_passed, polish_map
from .eigenmaps import align_eigenmaps, eigenmap, settle
from .result import RegistrationResult, twins
from .sides import MODES, SAMPLES, Side, describe, readings, spectral_gap, with_curvature

__all__ = ["RegistrationCandidate", "RegistrationResult", "register"]

_TOP = 18  # where candidates are handed from triple products to upsampling
_LEADS = (
    ((0.5, 0.75), 1.0),
    ((0.5, 0.75), 0.3),
    ((0.25, 0.5), 1.0),
    ((0.25, 0.5), 0.1),
)  # powers of the frequency in both products, and the weight of the oriented one


@dataclass
class _Found:
    """What one of the two ways hands on: the matrix between the eigenfunctions, the point maps both ways, and how it came to them."""

    matrix: Floats
    forward: Ints
    backward: Ints
    positions: Floats | None
    candidates: list[RegistrationCandidate]
    history: dict[str, Floats]
    notes: list[str]


def _by_sliced_wasserstein(source: Side, target: Side, products: Products, seed: int, told: Callable[[float], None]) -> _Found:
    """The chapter's way: rotation-invariant sliced Wasserstein between the eigenmaps, coarse to fine; then nearest rows."""
    modes = min(source.modes, target.modes)
    levels = [level for level in (5, 8, 12, 16, 20, 25, 30) if level <= modes] or [modes]
    coarse, fine = ([eigenmap(side, count, levels[-1]) for side in (source, target)] for count in (300, SAMPLES))
    runs, distances = align_eigenmaps(coarse[0], coarse[1], levels, seed, finest=(fine[0], fine[1]))
    told(0.8)
    maps = np.array([run.rotation for run in runs])
    n = min(maps.shape[1], len(products.linear))
    _, scores = products.ascend(maps[:, :n, :n], (0.25, 0.5), 1.0, 0)
    candidates = listed(maps, np.array([run.value for run in runs]), scores, source, target)
    mirrored = candidates[0].energy > runs[0].value
    matrix = candidates[0].functional_map[1:, 1:]
    forward, backward = point_maps(matrix, source, target, 0.0)
    history = {"levels": np.array(levels, float), "distance": np.array(distances)}
    notes = ["a mirror image has the smaller distance; orientation decided"] if mirrored else []
    return _Found(matrix, forward, backward, None, candidates, history, notes)


def _by_triple_products(
    source: Side, target: Side, products: Products, seed: int, rigid: Rigid | None, polish: bool, most: int, told: Callable[[float], None]
) -> _Found:
    """Candidates by a beam search, upsampled; the least energy of deforming the source decides; upsampled further, and polished."""
    modes, oriented = min(source.modes, target.modes), source.faces is not None and target.faces is not None
    top = min(_TOP, modes)

    def upto(*levels: int) -> list[int]:
        return [level for level in levels if level <= modes]

    leads = _LEADS if oriented else [(powers, 0.0) for powers, weight in _LEADS if weight == 1.0]
    found = [beam(products, top, powers, weight, 32, 8) for powers, weight in leads]
    if not oriented:  # half of what tells maps apart is missing: the chapter's iteration finds others
        coarse = [eigenmap(side, 300, top) for side in (source, target)]
        runs, _ = align_eigenmaps(coarse[0], coarse[1], [*(level for level in (5, 10) if level < top), top], seed)
        found.append(np.array([run.rotation for run in runs]))
    maps = np.concatenate(found)
    maps = maps[distinct(maps, -np.arange(len(maps), dtype=float), len(maps), 0.98, len(maps))]
    told(0.3)
    maps = grown(maps, upto(24, 30), source, target, 0.3, SAMPLES // 2)
    _, scores = products.ascend(maps, (0.25, 0.5), 1.0, 0)
    maps = maps[distinct(maps, scores.sum(1), most, 0.95, len(maps))]
    told(0.4)
    maps = grown(maps, upto(36, 42, 48, 54, 60), source, target, 0.3)
    maps = maps[distinct(maps, -np.arange(len(maps), dtype=float), most, 0.95, len(maps))]
    candidates = judge(maps, products, source, target, rigid)
    told(0.6)
    matrix = grown(candidates[0].functional_map[None, 1:, 1:], upto(80, 100, 120), source, target, 0.6)[0]
    n = len(matrix)
    sides = [side.spectral(n, 0.6) for side in (source, target)]
    forward, backward = point_maps(matrix, source, target, 0.6)
    matrix = _core.orthogonal_functional_map(forward, backward, n, *sides)
    told(0.7)
    positions = None
    if rigid is not None and polish:
        forward, backward, positions = polish_map(low_passed(matrix, source, target), source, target, rigid)
        matrix = _core.orthogonal_functional_map(forward, backward, n, *sides)
    else:
        forward, backward = point_maps(matrix, source, target, 0.6)
    levels = [*range(min(4, top), top + 1), *upto(24, 30, 36, 42, 48, 54, 60, 80, 100, 120)]
    return _Found(matrix, forward, backward, positions, candidates, {"levels": np.array(levels, float)}, [])


def _doubts(source: Side, target: Side, there_and_back: float) -> list[str]:
    """What speaks against a bending between the two shapes."""
    found = []
    first, second = source.shape, target.shape
    if isinstance(first, TriangleMesh) and isinstance(second, TriangleMesh) and first.euler_characteristic != second.euler_characteristic:
        both = f"{first.euler_characteristic} and {second.euler_characteristic}"
        found.append(f"no bending takes one shape to the other as a whole: their Euler characteristics are {both}")
    spacing = 1 / np.sqrt(min(len(source.positions), len(target.positions)))  # of the coarser side, at area 1
    if there_and_back > max(0.015, 1.5 * spacing):  # good maps: below 0.006 at any spacing, a third of it where one side is coarse
        found.append(
            f"points come back {there_and_back:.2g} of the root of the area from where they began, which is much: the shapes may differ by "
            "more than a bending, or be mirror images"
        )
    return found


def match(source: Side, target: Side, *, method: str, polish: bool, most: int, rng: np.random.Generator, report: Any) -> RegistrationResult:
    """:func:`register` for two prepared sides."""
    seed = int(rng.integers(2**31))
    told = teller(report)
    oriented = source.faces is not None and target.faces is not None
    extrinsic = source.embedded and target.embedded and method == "auto"
    if extrinsic:
        source, target = with_curvature(source, oriented), with_curvature(target, oriented)
    products = products_of(source, target)
    if not oriented:
        products.source[1][:], products.target[1][:] = 0.0, 0.0
    notes: list[str] = []
    for side, name in ((source, "source"), (target, "target")):
        loose = int((side.mass == 0).sum())
        if loose:
            notes.append(f"{loose} points of the {name} hang loose of its largest part, and go along with the nearest of it")
        if isinstance(side.shape, PointCloud) and oriented:
            notes.append(f"left and right of the {name} are those of the closed surface through its points")
    told(0.05)
    if method == "rswd":
        found = _by_sliced_wasserstein(source, target, products, seed, told)
    else:
        found = _by_triple_products(source, target, products, seed, Rigid(source) if extrinsic else None, polish, most, told)
    notes += found.notes
    told(0.95)
    n = min(30, source.modes, target.modes)
    start = _core.polar(np.ascontiguousarray(found.matrix[:n, :n]))
    rotation, distance = settle(eigenmap(source, SAMPLES, n), eigenmap(target, SAMPLES, n), start, seed)
    if not oriented:
        how = "rest on the energies of the deformations alone" if extrinsic else "cannot be told apart"
        notes.append(f"no orientation: left and right {how}{twins(found.candidates)}")
    moved = source.positions[found.backward[found.forward]] - source.positions
    there_and_back = float((source.mass * np.linalg.norm(moved, axis=1)).sum())
    notes += _doubts(source, target, there_and_back)
    result = RegistrationResult(
        point_map=found.forward,
        inverse_map=found.backward,
        functional_map=with_constant(found.matrix),
        rotation=rotation,
        distance=distance,
        candidates=tuple(found.candidates),
        coverage=coverage(found.forward, target.mass),
        bijectivity=there_and_back,
        orientation=found.candidates[0].orientation,
        mirror_decided=oriented,
        extrinsic=extrinsic,
        positions=None if found.positions is None else found.positions * target.unit + target.centre,
        history=found.history,
        notes=tuple(notes),
        source=source.shape,
        target=target.shape,
        source_masses=source.mass,
    )
    told(1.0)
    return result


def register(
    source: Shape | Operators,
    target: Shape | Operators,
    *,
    method: Literal["auto", "rswd"] = "auto",
    landmarks: npt.ArrayLike | None = None,
    descriptors: Any = None,
    extrinsic: bool = True,
    polish: bool = True,
    modes: int = MODES,
    samples: int = SAMPLES,
    candidates: int = 8,
    rng: int | np.random.Generator | None = 0,
    progress: Progress = None,
) -> RegistrationResult:
    """Find the point map between two nearly isometric shapes (shapes that differ by bending), without landmarks.

    Shapes are scaled to unit area. Candidates for the orthogonal matrix between the eigenfunctions come from a beam search over
    signs and rotations that preserve the triple products ``∫ φ_i φ_j φ_k`` and the oriented ones ``∫ φ_i dφ_j ∧ dφ_k``, which detect
    mirror images. Each candidate is refined by upsampling in both directions. On surfaces in R^3 the energy of deforming the source
    onto the target decides between them, and such a deformation polishes the map. ``method="rswd"`` is the chapter's iteration alone:
    the rotation-invariant sliced Wasserstein distance between the eigenmaps ``λ_k^(-d/4) φ_k``, coarse to fine from all sign starts.

    Parameters
    ----------
    source, target : TriangleMesh, PointCloud or Operators
        Numbers of points may differ; position, size and numbering do not matter. Closed meshes are turned outward.
    method : {"auto", "rswd"}
        Candidates by triple products, or the iteration of the paper alone; see above.
    landmarks : (k, 2) int array, optional
        Pairs (source point, target point) that are known to match, at least roughly.
    descriptors : pair of arrays (n_source, p) and (n_target, p), "hks" or "wks", optional
        Functions that the map should preserve. They are scaled and appended to the eigenmaps.
    extrinsic : bool
        Whether to use positions if both shapes are surfaces in R^3. False: use only what bending does not change.
    polish : bool
        Whether to polish the map by a deformation, if extrinsic.
    modes : int
        How many eigenfunctions after the constant one.
    samples : int
        How many farthest points candidates are refined on.
    candidates : int
        How many candidates are fully refined and compared.
    rng : int or numpy Generator
        Seed or generator for the directions of the sliced distance.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    RegistrationResult

    Raises
    ------
    InputError
        A shape has too few points, landmarks or descriptors do not fit, or intrinsic dimensions differ.
    Cancelled
        If ``progress`` returned False.

    Notes
    -----
    Clouds are treated by their local mesh and, if they sample a closed surface in R^3, also by the triangles of that surface (from the
    Delaunay tetrahedra). The treatments whose spectra agree best are used, and inside and outside tell left from right. On open clouds
    only the energy of the deformation does so, and in other spaces than R^3 nothing does.
    Partial shapes give a map too; look at ``coverage``, ``bijectivity`` and ``notes``.

    References
    ----------
    Lai and Zhao, Multi-scale non-rigid point cloud registration using robust sliced-Wasserstein distance via Laplace-Beltrami
    eigenmap, 2017. Melzi, Ren, Rodolà, Sharma, Wonka and Ovsjanikov, ZoomOut, 2019. Ren, Poulenard, Wonka and Ovsjanikov, Continuous and
    orientation-preserving correspondences via functional maps, 2018. Sorkine and Alexa, As-rigid-as-possible surface modeling, 2007.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> shape = bt.shapes.ellipsoid(level=3)
    >>> found = bt.register(shape, bt.TriangleMesh(10 * shape.vertices[:, [1, 2, 0]], shape.faces))
    >>> found.mirror_decided, bool(found.coverage > 0.9)
    (True, True)
    """
    arrays.word(method, "method", ("auto", "rswd"))
    modes, samples = arrays.whole(modes, "modes", 3), arrays.whole(samples, "samples", 4)
    most = arrays.whole(candidates, "candidates", 1)
    generator = arrays.generator(rng)
    report = reporter(progress, "registration")
    sides = []
    for index, shape in enumerate((source, target)):
        sides.append(readings(shape, modes=modes, samples=samples, extrinsic=extrinsic))
        teller(report)(0.2 * (index + 1))
    a, b = min(itertools.product(*sides), key=lambda pair: spectral_gap(*pair))
    if a.dimension != b.dimension:
        raise InputError(f"the source has intrinsic dimension {a.dimension}, the target {b.dimension}; they must agree")
    describe(a, b, landmarks, descriptors)
    return match(a, b, method=method, polish=polish, most=most, rng=generator, report=part(report, 0.4, 1.0))

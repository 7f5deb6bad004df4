"""Everything against everything hostile: each public method on spoilt meshes and clouds gives finite answers or an error of the library.

500 cases in the ordinary run, 10,000 others in `make slow`. What once failed stands below as a case of its own."""

from __future__ import annotations

import copy
import dataclasses
import importlib
import pickle
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import beltrami as bt
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

CHECKS = Path(__file__).parents[3] / "shared" / "checks"
Arrays = tuple[np.ndarray, np.ndarray | None]


def _base(kind: str, size: int) -> bt.TriangleMesh:
    match kind:
        case "sphere":
            return bt.shapes.sphere(1 + size % 2)
        case "torus":
            return bt.shapes.torus(rows=6 + size, columns=5 + size)
        case "disc":
            return bt.shapes.disc(rings=2 + size)
        case "grid":
            return bt.shapes.grid(3 + size, 4 + size)
        case _:
            return bt.shapes.cylinder(rows=3 + size, columns=5 + size)


def _duplicate(v: np.ndarray, f: np.ndarray, rng: np.random.Generator) -> Arrays:
    v[rng.integers(len(v), size=3)] = v[rng.integers(len(v), size=3)]
    return v, f


def _sliver(v: np.ndarray, f: np.ndarray, rng: np.random.Generator) -> Arrays:
    some = rng.permutation(len(f))[:3]
    v[f[some, 0]] = v[f[some, 1]] + 10.0 ** -rng.integers(5, 18) * rng.normal(size=(len(some), v.shape[1]))
    return v, f


def _non_manifold(v: np.ndarray, f: np.ndarray, rng: np.random.Generator) -> Arrays:
    return np.vstack([v, rng.normal(size=(1, v.shape[1]))]), np.vstack([f, [0, 1, len(v)], [1, 0, len(v)], [0, len(v), 1]])


def _two_parts(v: np.ndarray, f: np.ndarray, rng: np.random.Generator) -> Arrays:
    return np.vstack([v, v * 10.0 ** rng.integers(-6, 7) + 5.0]), np.vstack([f, f + len(v)])


def _flipped(v: np.ndarray, f: np.ndarray, rng: np.random.Generator) -> Arrays:
    some = rng.permutation(len(f))[:3]
    f[some] = f[some][:, ::-1]
    return v, f


def _isolated(v: np.ndarray, f: np.ndarray, rng: np.random.Generator) -> Arrays:
    return np.vstack([v, rng.normal(size=(2, v.shape[1]))]), f


def _scaled(v: np.ndarray, f: np.ndarray, rng: np.random.Generator) -> Arrays:
    with np.errstate(over="ignore"):
        return v * 10.0 ** rng.choice([-300, -160, -100, -30, -6, 6, 30, 100, 150, 300]), f


def _far_away(v: np.ndarray, f: np.ndarray, rng: np.random.Generator) -> Arrays:
    return v + 10.0 ** rng.integers(2, 16), f


def _stretched(v: np.ndarray, f: np.ndarray, rng: np.random.Generator) -> Arrays:
    return v * 10.0 ** rng.integers(-4, 5, size=v.shape[1]), f


def _noisy(v: np.ndarray, f: np.ndarray, rng: np.random.Generator) -> Arrays:
    return v + 0.3 * rng.normal(size=v.shape), f


def _collapsed(v: np.ndarray, f: np.ndarray, rng: np.random.Generator) -> Arrays:
    return np.repeat(v[:1], len(v), axis=0) if rng.random() < 0.5 else np.outer(v[:, 0], np.ones(v.shape[1])), f


def _random_faces(v: np.ndarray, f: np.ndarray, rng: np.random.Generator) -> Arrays:
    return v, rng.integers(len(v), size=(rng.integers(1, 60), 3))


def _few(v: np.ndarray, f: np.ndarray, rng: np.random.Generator) -> Arrays:
    return v, f[: rng.integers(0, 4)]


def _renumbered(v: np.ndarray, f: np.ndarray, rng: np.random.Generator) -> Arrays:
    order = rng.permutation(len(v))
    return v[order], np.argsort(order)[f]


def _into_the_plane(v: np.ndarray, f: np.ndarray, rng: np.random.Generator) -> Arrays:
    return v[:, :2].copy(), f


def _into_six(v: np.ndarray, f: np.ndarray, rng: np.random.Generator) -> Arrays:
    return v @ np.linalg.qr(rng.normal(size=(6, 6)))[0][: v.shape[1]], f


SPOILS: dict[str, Callable[[np.ndarray, np.ndarray, np.random.Generator], Arrays]] = {
    spoil.__name__.strip("_"): spoil
    for spoil in (
        *(_duplicate, _sliver, _non_manifold, _two_parts, _flipped, _isolated, _scaled, _far_away, _stretched, _noisy, _collapsed),
        *(_random_faces, _few, _renumbered, _into_the_plane, _into_six),
    )
}


def _shape(case: Case) -> bt.TriangleMesh | bt.PointCloud:
    mesh, rng = _base(case.base, case.size), np.random.default_rng(case.seed)
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces, np.int64)
    for name in case.spoils:
        vertices, faces = SPOILS[name](vertices, faces, rng)
    return bt.PointCloud(vertices, dimension=2) if case.cloud else bt.TriangleMesh(vertices, faces)


def places(shape: Any) -> np.ndarray:
    return np.asarray(shape.vertices if isinstance(shape, bt.TriangleMesh) else shape.points)


def _two_densities(shape: Any, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    mass = bt.operators(shape).mass
    a, b = rng.random((2, len(mass))) ** 3
    return a / (mass * a).sum(), b / (mass * b).sum()  # not by BLAS, whose threads change the last digit


def _pair(shape: Any) -> tuple[Any, Any]:
    """A cloud beside a cloud, a mesh beside a mesh: a torus."""
    torus = bt.shapes.torus(rows=9, columns=7)
    return shape, bt.PointCloud(torus.vertices, dimension=2) if isinstance(shape, bt.PointCloud) else torus


def _read_again(shape: Any) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        bt.save(shape, Path(folder) / "shape.ply")
        return bt.load(Path(folder) / "shape.ply")


def _values(shape: Any, rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=len(places(shape)))


QUICK = {"intervals": 3, "max_iterations": 10}
METHODS: dict[str, Callable[[Any, np.random.Generator], Any]] = {
    "operators": lambda s, rng: bt.operators(s),
    "eigenpairs": lambda s, rng: bt.eigenpairs(s, int(rng.integers(1, 8))),
    "geodesic_distance": lambda s, rng: bt.geodesic_distance(s, int(rng.integers(max(len(places(s)), 1)))),
    "solve_poisson": lambda s, rng: bt.solve_poisson(s, _values(s, rng)),
    "segment": lambda s, rng: bt.segment(s, _values(s, rng), fidelity=5.0, max_iterations=30),
    "segment in three": lambda s, rng: bt.segment(s, _values(s, rng), fidelity=5.0, regions=3, max_iterations=30),
    "denoise": lambda s, rng: bt.denoise(s, _values(s, rng), max_iterations=30),
    "spherical_map": lambda s, rng: bt.spherical_map(s),
    "transport": lambda s, rng: bt.transport(s, *_two_densities(s, rng), **QUICK),
    "mean_field_game": lambda s, rng: bt.mean_field_game(
        s, _two_densities(s, rng)[0], running_cost=bt.costs.congestion(0.1), terminal_cost=bt.costs.potential(_values(s, rng)), **QUICK
    ),
    "wasserstein_barycenter": lambda s, rng: bt.wasserstein_barycenter(s, _two_densities(s, rng), **QUICK),
    "skeleton": lambda s, rng: bt.skeleton(s),
    "register": lambda s, rng: bt.register(s, bt.shapes.torus(rows=9, columns=7), modes=12, samples=40, polish=False),
    "register_conformal": lambda s, rng: bt.register_conformal(
        s, bt.shapes.sphere(1), k=6, refine=None, landmarks=[[0, 0], [4, 5]], sweeps=1
    ),
    "committor": lambda s, rng: bt.committor(s, _values(s, rng), [0], [len(places(s)) - 1], beta=1.0),
    "hks": lambda s, rng: bt.hks(s, k=8),
    "wks": lambda s, rng: bt.wks(s, k=8),
    "shape_dna": lambda s, rng: bt.shape_dna(s, k=8),
    "match_spectrum": lambda s, rng: bt.match_spectrum(s, np.array([0.0, 1.0, 2.0, 3.0]), max_iterations=2),
    "conformal_eigenpairs": lambda s, rng: bt.conformal_eigenpairs(s, 3 * _values(s, rng), 4),
    "rotation_invariant_sliced_wasserstein": lambda s, rng: bt.rotation_invariant_sliced_wasserstein(
        places(s), rng.normal(size=(30, places(s).shape[1])), directions=8, max_iterations=5
    ),
    "sliced_wasserstein": lambda s, rng: bt.sliced_wasserstein(places(s), rng.normal(size=(30, places(s).shape[1])), directions=8),
    "contours": lambda s, rng: bt.contours(s, _values(s, rng)),
    "normals": lambda s, rng: bt.normals(places(s)),
    "farthest_points": lambda s, rng: bt.farthest_points(s, 5),
    "poisson_disc": lambda s, rng: bt.poisson_disc(s, 0.5),
    "nearest_neighbors": lambda s, rng: bt.nearest_neighbors(s, s, 4),
    "closest_points": lambda s, rng: bt.closest_points(s, rng.normal(size=(9, places(s).shape[1]))),
    "intersect_rays": lambda s, rng: bt.intersect_rays(s, rng.normal(size=(9, 3)), rng.normal(size=(9, 3))),
    "sample_density": lambda s, rng: bt.sample_density(s),
    "segment_path": lambda s, rng: bt.segment_path(s, _values(s, rng), fidelities=[3.0, 10.0], max_iterations=20),
    "spherical_map, Cayley": lambda s, rng: bt.spherical_map(s, method="cayley", max_iterations=20),
    "transport, projected gradient": lambda s, rng: bt.transport(s, *_two_densities(s, rng), method="projected_gradient", **QUICK),
    "register, alike": lambda s, rng: bt.register(*_pair(s), modes=12, samples=40),
    "register, rswd": lambda s, rng: bt.register(*_pair(s), method="rswd", modes=12, samples=40, polish=False),
    "committor, strong": lambda s, rng: bt.committor(s, _values(s, rng), [0], [len(places(s)) - 1], beta=1.0, method="strong"),
    "committor, circulation": lambda s, rng: bt.committor(
        s, _values(s, rng), [0], [len(places(s)) - 1], beta=1.0, circulation=rng.normal(size=places(s).shape)
    ),
    "reweight": lambda s, rng: bt.reweight(places(s)[:, 0], np.where(np.arange(len(places(s))) % 2, 1.0, 2.0), 1.5),
    "neighbors_within": lambda s, rng: bt.neighbors_within(s, s, 0.7),
    "functional_map_of": lambda s, rng: bt.functional_map_of(rng.integers(63, size=len(places(s))), *_pair(s), k=6),
    "point_map_of": lambda s, rng: bt.point_map_of(rng.normal(size=(6, 6)), *_pair(s)),
    "evaluate_map": lambda s, rng: bt.evaluate_map(rng.integers(63, size=len(places(s))), *_pair(s), truth=np.zeros(len(places(s)), int)),
    "transfer": lambda s, rng: bt.transfer(
        rng.integers(63, size=len(places(s))), _values(s, rng), direction="to_target", target=_pair(s)[1]
    ),
    "save and load": lambda s, rng: _read_again(s),
    "distance_matrix": lambda s, rng: bt.distance_matrix([s, bt.shapes.sphere(1)], method="shape_dna"),
    "plot": lambda s, rng: bt.plot(s, _values(s, rng), size=(40, 30), samples=1),
}
ON_SPHERES = {"spherical_map", "spherical_map, Cayley", "register_conformal"}
ON_CLOUDS = {"sample_density", "register, alike", "committor, strong"}
INFINITE = {"geodesic_distance", "intersect_rays"}  # distance to what no source reaches; to what a ray does not hit
UNBOUNDED = frozenset(  # fields that may be infinite, but never not a number
    {
        "stability",  # of a skeleton: loops that bands of no width remove
        "dilatation",  # of a map: triangles without an area, or whose image has none
        "exploitability",  # of a game that is far from converged: what no potential bounds
    }
)
NOT_A_NUMBER = {"distance_matrix"}  # the row of a shape that could not be described; the report says why


@dataclasses.dataclass(frozen=True)
class Case:
    method: str
    base: str
    size: int
    spoils: tuple[str, ...]
    cloud: bool
    seed: int


def arrays_of(result: Any, without: frozenset[str] = frozenset(), depth: int = 0) -> list[np.ndarray]:
    """All arrays of numbers that are in a result, however deep, but in fields of these names."""
    if isinstance(result, np.ndarray):
        return [result] if result.dtype.kind == "f" else []
    if isinstance(result, float):
        return [np.array(result)]
    if depth > 3 or isinstance(result, str | bytes | int | None):
        return []
    if hasattr(result, "data") and hasattr(result, "nnz"):
        return [np.asarray(result.data)]
    if isinstance(result, dict):
        return [a for part in result.values() for a in arrays_of(part, without, depth + 1)]
    if isinstance(result, list | tuple):
        return [a for part in result for a in arrays_of(part, without, depth + 1)]
    if dataclasses.is_dataclass(result):
        fields = [field.name for field in dataclasses.fields(result) if field.name not in without]
        return [a for name in fields for a in arrays_of(getattr(result, name), without, depth + 1)]
    return []


def attempt(case: Case) -> bool:
    """Whether there was an answer; a refusal must say something."""
    return answers_or_refuses(case.method, lambda: _shape(case), case.seed)


def answers_or_refuses(method: str, make: Callable[[], Any], seed: int) -> bool:
    """The same of one method on what is made here."""
    start = time.process_time()
    try:
        shape = make()
        before = places(shape).tobytes()
        result = METHODS[method](shape, np.random.default_rng(seed))
    except bt.InternalError:
        raise
    except bt.Error as error:
        if len(str(error)) < 10:  # it must say what and where
            raise
        answered = False
    else:
        answered = True
        assert places(shape).tobytes() == before
        if method not in NOT_A_NUMBER:
            assert not any(np.isnan(array).any() for array in arrays_of(result))
        if method not in INFINITE | NOT_A_NUMBER:
            assert all(np.isfinite(array).all() for array in arrays_of(result, UNBOUNDED))
        history = getattr(result, "history", {})
        if {"lower_bound", "objective"} <= set(history):  # a certificate that lies is worse than none
            size = np.abs(history["objective"]).max()
            assert (np.max(history["lower_bound"]) <= history["objective"] + 1e-9 * size).all()
        if dataclasses.is_dataclass(result):
            for one, other in zip(arrays_of(result), arrays_of(pickle.loads(pickle.dumps(result))), strict=True):
                np.testing.assert_array_equal(one, other)
    assert time.process_time() - start < 20
    return answered


def test_every_method_takes_part() -> None:
    """What is public and takes a shape or its points."""
    others = {"num_threads", "set_num_threads", "load_values", "load", "save"}  # "save and load"
    functions = {name for name in bt.__all__ if name[0].islower() and callable(getattr(bt, name))} - others
    assert sorted(functions - {name.split(",")[0] for name in METHODS}) == []


cases = st.builds(
    Case,
    method=st.sampled_from(sorted(METHODS)),
    base=st.sampled_from(["sphere", "torus", "disc", "grid", "cylinder"]),
    size=st.integers(0, 5),
    spoils=st.lists(st.sampled_from(sorted(SPOILS)), max_size=3).map(tuple),
    cloud=st.booleans(),
    seed=st.integers(0, 1 << 30),
)
SETTINGS = settings(deadline=None, suppress_health_check=list(HealthCheck), print_blob=True)


FAILED = [
    # steep slopes on slivers overflow the repaired potential, and infinities counted as 0 in the lower bound: it lay above the objective
    Case("register_conformal", "grid", 0, ("duplicate",), False, 19),
    Case("register_conformal", "grid", 0, ("duplicate",), False, 0),
    Case("mean_field_game", "sphere", 5, ("sliver",), False, 318214282),
    Case("mean_field_game", "cylinder", 5, ("sliver",), True, 766373974),
    Case("transport", "cylinder", 1, ("two_parts", "scaled", "stretched"), True, 609941811),
    # gradients on intrinsic triangles have two components, not three
    Case("committor", "torus", 0, ("two_parts", "random_faces"), False, 505104587),
    Case("committor", "torus", 1, ("non_manifold", "sliver"), False, 210096572),
    # sizes of 1e30 and more beside radii of zero, and powers of them
    Case("skeleton", "sphere", 0, ("duplicate", "random_faces", "collapsed"), False, 1073741823),
    Case("skeleton", "sphere", 0, ("scaled", "random_faces"), False, 1073741823),
    Case("skeleton", "sphere", 0, ("scaled", "random_faces"), False, 1073741821),
    Case("skeleton", "sphere", 0, ("scaled", "non_manifold"), False, 1073741824),
    Case("skeleton", "sphere", 0, ("scaled",), True, 0),
    Case("denoise", "sphere", 0, ("scaled", "collapsed"), False, 1073741822),
    Case("committor", "sphere", 0, ("scaled",), True, 0),
    Case("plot", "disc", 2, ("scaled", "flipped", "renumbered"), False, 386209481),
    # no potential bounds what players could gain
    Case("mean_field_game", "sphere", 0, ("scaled",), False, 268435455),
    # volumes of 1e-320, whose inverse no double holds; bows of no size
    Case("sample_density", "disc", 4, ("scaled", "into_six"), True, 257015984),
    Case("committor", "grid", 1, ("scaled",), True, 254520003),
    # with normals, neighbours of the other side that fill up are nearer than those before them
    Case("skeleton", "sphere", 0, ("noisy", "noisy"), True, 0),
    # a current of 1e308 and more
    Case("committor", "sphere", 0, ("scaled", "scaled"), True, 3),
    # all of the area in the holes that are filled
    Case("register_conformal", "cylinder", 5, ("into_the_plane",), False, 402756024),
    # squares of coordinates of 1e300 in the fits of planes
    Case("skeleton", "cylinder", 5, ("noisy", "scaled"), True, 947450446),
    # edges whose median length is 0
    Case("skeleton", "sphere", 0, ("collapsed", "collapsed", "non_manifold"), False, 0),
]


@pytest.mark.parametrize("case", FAILED, ids=lambda case: f"{case.method} {case.seed}")
def test_what_once_failed(case: Case) -> None:
    attempt(case)


@given(case=cases)
@settings(SETTINGS, max_examples=500)
def test_finite_or_refused(case: Case) -> None:
    attempt(case)


@pytest.mark.slow
@given(case=cases)
@settings(SETTINGS, max_examples=10_000)
def test_finite_or_refused_often(case: Case) -> None:
    attempt(case)


@pytest.mark.slow
@pytest.mark.skipif(not (CHECKS / "adversarial.py").is_file(), reason="the acceptance checks do not lie beside the project")
@pytest.mark.parametrize("method", METHODS)
def test_the_hostile_shapes_of_the_acceptance_checks(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every method on one shape of each kind of `adversarial.py`, whichever other tests draw."""
    monkeypatch.syspath_prepend(CHECKS)
    adversarial = importlib.import_module("adversarial")
    seed = int(np.random.default_rng([ord(letter) for letter in method]).integers(1000))
    for number in range(len(adversarial.MESHES + adversarial.CLOUDS)):
        kind, (first, second), _ = adversarial.make(number, seed)

        def make(first: Any = first, second: Any = second, cloud: bool = kind in adversarial.CLOUDS) -> Any:
            return bt.PointCloud(first, **{"dimension": 2, **second}) if cloud else bt.TriangleMesh(first, second)

        try:
            answers_or_refuses(method, make, seed)
        except Exception as fault:
            raise AssertionError(f"{method} on case {number} of seed {seed}, {kind}") from fault


@pytest.mark.parametrize("method", METHODS)
def test_each_method_answers_on_a_sound_mesh(method: str) -> None:
    """So that the sweep above does not pass because everything is refused."""
    base = "sphere" if method in ON_SPHERES else "torus"
    assert attempt(Case(method, base, 3, (), method in ON_CLOUDS, 1))


@pytest.mark.slow
@pytest.mark.parametrize("way", ["pickle", "copy.copy", "copy.deepcopy", "cloudpickle"])
@pytest.mark.parametrize("method", METHODS)
def test_every_result_is_copied_whole(method: str, way: str) -> None:
    copied: Callable[[Any], Any] = {
        "pickle": lambda it: pickle.loads(pickle.dumps(it)),
        "copy.copy": copy.copy,
        "copy.deepcopy": copy.deepcopy,
        "cloudpickle": lambda it: pickle.loads(pytest.importorskip("cloudpickle").dumps(it)),
    }[way]
    case = Case(method, "sphere" if method in ON_SPHERES else "torus", 3, (), method in ON_CLOUDS, 1)
    result = METHODS[method](_shape(case), np.random.default_rng(1))
    again = copied(result)
    assert type(again) is type(result)
    for one, other in zip(arrays_of(result), arrays_of(again), strict=True):
        np.testing.assert_array_equal(one, other)


def larger(method: str, count: int = 3840) -> Any:
    """About so many points: by default enough for the kernels to share the work among threads."""
    if method in {*ON_SPHERES, "plot"}:
        return bt.shapes.ellipsoid(1.0, 0.8, 0.6, level=4 if count < 5000 else 6)
    columns = round((count / 2.4) ** 0.5)
    mesh = bt.shapes.torus(rows=count // columns, columns=columns)
    return bt.PointCloud(mesh.vertices, dimension=2) if method in ON_CLOUDS else mesh


def answer(method: str) -> list[bytes]:
    """All bits of what a method answers on that."""
    return [array.tobytes() for array in arrays_of(METHODS[method](larger(method), np.random.default_rng(3)))]


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_the_same_bits_on_any_number_of_threads(method: str) -> None:
    before = bt.num_threads()
    try:
        answers = []
        for threads in (1, 2, 4, 8):
            bt.set_num_threads(threads)
            answers.append(answer(method))
    finally:
        bt.set_num_threads(before)
    assert all(answer == answers[0] for answer in answers)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_eight_calls_at_once_answer_as_one(method: str) -> None:
    alone = answer(method)
    with ThreadPoolExecutor(8) as pool:
        assert all(answer == alone for answer in pool.map(answer, [method] * 8))


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_memory_does_not_grow(method: str) -> None:
    """Over 1,000 calls (fewer of what takes long) after a warm-up: in all, less than a few copies of the shape."""
    resource = pytest.importorskip("resource")
    case = Case(method, "sphere" if method in ON_SPHERES else "torus", 3, (), method in ON_CLOUDS, 1)

    def calls(count: int, seconds: float) -> None:
        start = time.monotonic()
        for _ in range(count):
            METHODS[method](_shape(case), np.random.default_rng(1))
            if time.monotonic() - start > seconds:
                break

    calls(300, 10)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    calls(1000, 30)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 20_000  # KiB on Linux

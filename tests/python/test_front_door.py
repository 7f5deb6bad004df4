"""What a user meets: names, signatures, docstrings, errors and results follow one pattern over the whole library."""

import dataclasses
import inspect
import pickle
import re
from typing import Any

import beltrami as bt
import numpy as np
import pytest

SPHERE = bt.shapes.sphere(1)
COUNT = len(SPHERE.vertices)
HEIGHT = SPHERE.vertices[:, 2]
DENSITIES = np.exp(HEIGHT) / (bt.operators(SPHERE).mass @ np.exp(HEIGHT)), np.exp(-HEIGHT) / (bt.operators(SPHERE).mass @ np.exp(-HEIGHT))
TORUS = bt.shapes.torus(rows=16, columns=8)
PLANE = np.random.default_rng(0).uniform([-1.6, -1], [1.6, 1], (200, 2))
WELLS = (PLANE[:, 0] ** 2 - 1) ** 2 + PLANE[:, 1] ** 2 / 2
SAMPLES = bt.PointCloud(PLANE)
PAIRS = np.arange(COUNT)
# A call of each function that works, as short as can be.
CALLS: dict[str, tuple[tuple[Any, ...], dict[str, Any]]] = {
    "closest_points": ((SPHERE, SPHERE.vertices), {}),
    "committor": ((SAMPLES, WELLS, PLANE[:, 0] < -0.9, PLANE[:, 0] > 0.9), {"beta": 2.0, "refine": 0}),
    "conformal_eigenpairs": ((SPHERE, 0 * HEIGHT, 3), {}),
    "contours": ((SPHERE, HEIGHT), {}),
    "denoise": ((SPHERE, HEIGHT), {}),
    "distance_matrix": (([SPHERE, TORUS],), {"method": "shape_dna"}),
    "eigenpairs": ((SPHERE, 3), {}),
    "evaluate_map": ((PAIRS, SPHERE, SPHERE), {"truth": PAIRS}),
    "farthest_points": ((SPHERE, 3), {}),
    "functional_map_of": ((PAIRS, SPHERE, SPHERE), {"k": 4}),
    "geodesic_distance": ((SPHERE, 0), {}),
    "hks": ((SPHERE,), {"k": 10}),
    "intersect_rays": ((SPHERE, SPHERE.vertices * 2, -SPHERE.vertices), {}),
    "load": (((SPHERE.vertices, SPHERE.faces),), {}),
    "load_values": (("values.txt",), {}),
    "match_spectrum": ((SPHERE, np.arange(4.0) * 3), {"max_iterations": 1}),
    "mean_field_game": ((SPHERE, DENSITIES[0]), {"intervals": 2, "terminal_cost": bt.costs.quadratic(DENSITIES[1]), "max_iterations": 5}),
    "nearest_neighbors": ((SPHERE, SPHERE, 2), {}),
    "neighbors_within": ((SPHERE, SPHERE, 0.5), {}),
    "normals": ((SPHERE.vertices,), {}),
    "operators": ((SPHERE,), {}),
    "plot": ((SPHERE, HEIGHT), {"size": (40, 30), "samples": 1}),
    "point_map_of": ((np.eye(4), SPHERE, SPHERE), {}),
    "poisson_disc": ((SPHERE, 0.5), {}),
    "register": ((SPHERE, SPHERE), {"modes": 10, "samples": 40, "candidates": 1, "polish": False, "extrinsic": False}),
    "register_conformal": ((SPHERE, SPHERE), {"k": 4, "refine": None, "landmarks": [[0, 0], [5, 5], [9, 9]], "sweeps": 1}),
    "reweight": ((WELLS, np.ones(len(WELLS)), 2.0), {}),
    "rotation_invariant_sliced_wasserstein": ((SPHERE.vertices, TORUS.vertices), {"max_iterations": 1, "directions": 5}),
    "sample_density": ((SAMPLES,), {}),
    "segment": ((SPHERE, HEIGHT), {}),
    "segment_path": ((SPHERE, HEIGHT), {"fidelities": [10]}),
    "shape_dna": ((SPHERE,), {"k": 4}),
    "skeleton": ((TORUS,), {}),
    "sliced_wasserstein": ((SPHERE.vertices, TORUS.vertices), {"directions": 5}),
    "solve_poisson": ((SPHERE, HEIGHT), {}),
    "spherical_map": ((SPHERE,), {}),
    "transfer": ((PAIRS, HEIGHT), {}),
    "transport": ((SPHERE, *DENSITIES), {"intervals": 2, "max_iterations": 5}),
    "wasserstein_barycenter": ((SPHERE, DENSITIES), {"intervals": 2, "max_iterations": 5}),
    "wks": ((SPHERE,), {"k": 10}),
}
NO_CALL = {"num_threads", "save", "set_num_threads"}
WRONG: list[Any] = ["a", float("nan"), -1, [], {}, object(), [1, "x"], np.array([[np.nan]])]


def functions() -> list[str]:
    return [name for name in bt.__all__ if inspect.isfunction(getattr(bt, name))]


def test_every_function_is_called_here() -> None:
    assert set(functions()) == set(CALLS) | NO_CALL


@pytest.mark.parametrize("name", CALLS)
def test_wrong_arguments_are_refused_in_words(name: str, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever an argument is, it does or it raises an error of beltrami that says something."""
    monkeypatch.chdir(tmp_path)  # "a" is a path where one is wanted
    np.savetxt("values.txt", SPHERE.vertices)
    function = getattr(bt, name)
    arguments, options = CALLS[name]
    parameters = inspect.signature(function).parameters
    for at, (parameter, what) in enumerate(parameters.items()):
        if what.kind is what.VAR_KEYWORD or parameter in ("progress", "executor", "memory"):
            continue
        for wrong in WRONG:
            given, named, words = list(arguments), dict(options), "it works"
            if at < len(given):
                given[at] = wrong
            else:
                named[parameter] = wrong
            try:
                function(*given, **named)
            except bt.InternalError as error:
                pytest.fail(f"{name}({parameter}={wrong!r}): {error}")
            except bt.Error as error:
                words = str(error)
            except Exception as error:
                pytest.fail(f"{name}({parameter}={wrong!r}) raised {type(error).__name__}: {error}")
            assert words.strip(), f"{name}({parameter}={wrong!r}) is refused without a word"


@pytest.mark.parametrize("name", functions())
def test_signature_and_docstring(name: str) -> None:
    """Options have names and no letters of their own; each parameter, what is returned and what is raised is said."""
    function = getattr(bt, name)
    text = inspect.getdoc(function) or ""
    sections = re.findall(r"^([A-Z][A-Za-z ]+)\n-{3,}$", text, re.M)
    for parameter, what in inspect.signature(function).parameters.items():
        assert not parameter.startswith("_")
        data = what.default is what.empty or (name, parameter) in (("plot", "values"), ("mean_field_game", "density1"))
        assert data or what.kind is not what.POSITIONAL_OR_KEYWORD, f"{name}: {parameter} is an option, let it have a name"
        assert re.search(rf"\b{parameter}\b", text), f"{name}: {parameter} is not described"
    if inspect.signature(function).parameters:
        assert "Parameters" in sections
        assert "Raises" in sections
    if function.__annotations__.get("return") != "None":
        assert "Returns" in sections
    assert "Examples" in sections
    assert len(text.split("\n\n")[0]) < 250  # what it does, in a sentence


def test_what_is_no_shape_is_named_with_a_remedy(tmp_path: Any) -> None:
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(1)
    for wrong, words in (
        (ball, r"trimesh.Trimesh.*bt.load\(shape\)"),
        ("scan.ply", r"str.*bt.load\('scan.ply'\)"),
        (tmp_path / "scan.ply", r"bt.load\('.*scan.ply'\)"),
        ((SPHERE.vertices, SPHERE.faces), r"tuple.*bt.load\(shape\)"),
        (SPHERE.vertices, r"numpy.ndarray.*bt.PointCloud\(shape\)"),
        (bt.eigenpairs(SPHERE, 2), "is a Eigenpairs"),
    ):
        for call in (lambda it: bt.operators(it), lambda it: bt.geodesic_distance(it, 0), bt.spherical_map, bt.skeleton):
            with pytest.raises(bt.InputError, match=words):
                call(wrong)
    with pytest.raises(bt.InputError, match="mesh is a PointCloud; a TriangleMesh is needed"):
        bt.closest_points(bt.PointCloud(SPHERE.vertices), SPHERE.vertices)  # type: ignore[arg-type]
    assert isinstance(bt.load(ball.vertices), bt.PointCloud)  # an array of trimesh's own kind


def results() -> dict[str, Any]:
    """One of each result, as small as can be."""
    made = {name: getattr(bt, name)(*arguments, **options) for name, (arguments, options) in CALLS.items() if name in WITH_RESULTS}
    return {type(result).__name__: result for result in made.values()}


WITH_RESULTS = {
    "closest_points", "committor", "denoise", "distance_matrix", "eigenpairs", "evaluate_map", "intersect_rays", "match_spectrum",
    "mean_field_game", "register", "register_conformal", "rotation_invariant_sliced_wasserstein", "segment", "skeleton", "spherical_map",
    "transport", "wasserstein_barycenter",
}  # fmt: skip
SMALL = {"ClosestPointsResult", "MapEvaluation", "RayHitsResult", "RotationInvariantSlicedWassersteinResult", "SpectrumMatch"}


def test_results_follow_one_pattern(tmp_path: Any) -> None:
    """Frozen, told in a line, pickled; those of methods are painted and saved, and say so in words when they cannot be."""
    for name, result in results().items():
        assert dataclasses.is_dataclass(result), name
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(result, dataclasses.fields(result)[0].name, None)
        assert len(repr(result)) < 200, repr(result)
        assert "array(" not in repr(result)
        assert type(pickle.loads(pickle.dumps(result))) is type(result)
        described = " ".join(inspect.getdoc(base) or "" for base in type(result).__mro__ if base.__module__.startswith("beltrami"))
        for field in dataclasses.fields(result):
            assert field.name.startswith("_") or re.search(rf"\b{field.name}\b", described), f"{name}.{field.name} is not described"
        history = getattr(result, "history", {})
        assert isinstance(history, dict), name
        assert all(isinstance(column, np.ndarray) for column in history.values()), name
        if name in SMALL:
            continue
        file = tmp_path / f"{name}.npz"
        assert result.save(file) == file
        with np.load(file) as archive:
            kept = dict(archive)
        if name != "DistanceMatrix":  # its archive is for other programs: distances and labels
            for field in dataclasses.fields(result):
                value = getattr(result, field.name)
                if not field.name.startswith("_") and isinstance(value, np.ndarray | float | int | str):
                    np.testing.assert_array_equal(kept.pop(field.name), value, f"{name}.{field.name}")
                elif field.name == "notes":
                    assert tuple(kept.pop("notes")) == value
            for column, numbers in history.items():
                np.testing.assert_array_equal(kept.pop(f"history_{column}"), numbers, f"{name}.history")
            for lists in {key.removesuffix("_starts") for key in kept if key.endswith("_starts")}:
                ends, values = kept.pop(f"{lists}_starts"), kept.pop(f"{lists}s")
                for at, array in enumerate(getattr(result, f"{lists}s")):
                    np.testing.assert_array_equal(values[ends[at] : ends[at + 1]], array, f"{name}.{lists}s")
            assert set(kept) <= {"points", "critical", "stability"}, name
        if name != "DistanceMatrix":
            picture = tmp_path / f"{name}.png"
            assert result.plot(path=picture, size=(64, 48)).path == picture
        with pytest.raises(bt.InputError, match=r"what\.xyz"):
            result.save(tmp_path / "what.xyz")
        with pytest.raises(bt.FileError, match="cannot be written"):
            result.save(file / "below_a_file.npz")
        assert result.save(tmp_path / "new" / "folder" / file.name).exists()
        for wrong in (None, 3, ["a.npz"]):
            with pytest.raises(bt.InputError, match=r"path is .* a str or PathLike is needed"):
                result.save(wrong)


def test_members_refuse_in_words() -> None:
    ball, flow = bt.spherical_map(SPHERE), bt.transport(SPHERE, *DENSITIES, intervals=2, max_iterations=5)
    for call in (
        lambda wrong: bt.TriangleMesh(SPHERE.vertices, SPHERE.faces, data=wrong),
        lambda wrong: bt.PointCloud(SPHERE.vertices, data=wrong),
        bt.Moebius,
        ball.map_to,
        ball.aligned_to,
        ball.moved,
        lambda wrong: flow.plot(times=wrong, size=(40, 30)),
        lambda wrong: flow.plot(path=wrong, size=(40, 30)),
        flow.interpolate,
    ):
        for wrong in (object(), "a", [1, "x"]):
            if wrong == "a" and call is not bt.Moebius:
                continue  # a path
            with pytest.raises(bt.InputError):
                call(wrong)


def test_saved_maps_and_modes_come_back(tmp_path: Any) -> None:
    modes = bt.eigenpairs(SPHERE, 4)
    for name in ("modes.ply", "modes.npz", "modes.csv"):
        modes.save(tmp_path / name)
    assert (bt.load(tmp_path / "modes.ply").data["functions_3"] == modes.functions[:, 3]).all()
    assert (np.load(tmp_path / "modes.npz")["functions"] == modes.functions).all()
    assert (np.loadtxt(tmp_path / "modes.csv", delimiter=",", skiprows=1)[:, 0] == modes.values).all()
    with pytest.raises(bt.InputError, match="eigenpairs are written"):
        bt.eigenpairs(bt.operators(SPHERE).stiffness, 2).save(tmp_path / "matrix.ply")
    ball = bt.spherical_map(SPHERE)
    ball.save(tmp_path / "ball.ply")
    assert (bt.load(tmp_path / "ball.ply").data["positions_1"] == ball.positions[:, 1]).all()
    distances = bt.distance_matrix([SPHERE, TORUS], method="shape_dna", labels=["sphere", "torus"])
    distances.save(tmp_path / "distances.csv")
    assert (tmp_path / "distances.csv").read_text().splitlines()[0] == "sphere,torus"


def test_a_tab_shows_what_there_is() -> None:
    assert dir(bt) == sorted(bt.__all__)


def test_costs_are_told_in_a_line() -> None:
    cost = 2.0 * bt.costs.quadratic(DENSITIES[0], weight=3.0) + bt.costs.congestion(0.5)
    assert repr(bt.costs.quadratic(DENSITIES[0], weight=3.0)) == f"Quadratic(target = {COUNT} numbers, weight = 3)"
    assert len(repr(cost)) < 200
    assert repr(bt.costs.power(1.5)) == "Lagrangian(exponent = 1.5, weight = 1)"


def test_a_seed_is_0_by_default_and_repeats() -> None:
    """Whatever draws random numbers takes a seed, a Generator or None for seed 0, and answers the same bits to the same seed."""
    drawing = [name for name in CALLS if "rng" in inspect.signature(getattr(bt, name)).parameters]
    assert len(drawing) >= 8
    for name in drawing:
        function, (arguments, options) = getattr(bt, name), CALLS[name]
        if name == "poisson_disc":  # None: points in the order of their numbers
            assert inspect.signature(function).parameters["rng"].default is None
            continue
        assert inspect.signature(function).parameters["rng"].default == 0, name
        seeds = [{}, {"rng": 0}, {"rng": None}] + ([] if name == "distance_matrix" else [{"rng": np.random.default_rng(0)}])
        assert len({bits(function(*arguments, **options, **seed)) for seed in seeds}) == 1, name


def bits(result: Any) -> bytes:
    """Of all arrays in a result, and of a number."""
    parts = [getattr(result, field.name) for field in dataclasses.fields(result)] if dataclasses.is_dataclass(result) else [result]
    return b"|".join(part.tobytes() for part in map(np.asarray, parts) if part.dtype.kind in "fiu")

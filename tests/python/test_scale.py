"""What is too large is refused before it is tried, with the reason; what is large is done within a stated time and memory."""

from __future__ import annotations

import importlib.util
import os
import re
from pathlib import Path

import beltrami as bt
import numpy as np
import pytest

_spec = importlib.util.spec_from_file_location("methods", Path(__file__).parents[2] / "benches" / "methods.py")
assert _spec is not None
assert _spec.loader is not None
methods = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(methods)

SECONDS, MEMORY = 300.0, 16.0  # of the processor; GiB
# These take more than that at a million vertices, up to half an hour; Ctrl-C stops them.
LONGER = {"register", "register, cloud", "register_conformal", "spherical_map, Cayley", "rotation_invariant_sliced_wasserstein"}

SPHERE = bt.shapes.sphere(2)
HEIGHT = SPHERE.vertices[:, 2]
CLOUD = bt.PointCloud(SPHERE.vertices)
MANY = 10**12


@pytest.fixture(scope="module")
def points():
    return np.random.default_rng(0).random((100_000, 3))


@pytest.fixture
def small_machine(monkeypatch):
    """Memory for a mebibyte: what is refused then is refused by its size, whatever the machine."""
    monkeypatch.setattr("beltrami.arrays.memory", lambda: 1 << 20)


def flow(**options):
    return bt.transport(SPHERE, HEIGHT + 2, np.ones(162), normalize=True, max_iterations=2, **options)


INTEGERS = {
    "transport": lambda n: flow(intervals=n),
    "transport, projected gradient": lambda n: flow(intervals=n, method="projected_gradient"),
    "mean_field_game": lambda n: bt.mean_field_game(SPHERE, HEIGHT + 2, np.ones(162), normalize=True, intervals=n),
    "wasserstein_barycenter": lambda n: bt.wasserstein_barycenter(SPHERE, [HEIGHT + 2, np.ones(162)], normalize=True, intervals=n),
    "flow in pictures": lambda n: flow(intervals=2).plot(times=n),
    "paths of particles": lambda n: flow(intervals=2).particle_paths(SPHERE.vertices[:3], substeps=n),
    "hks": lambda n: bt.hks(SPHERE, times=n, k=5),
    "wks": lambda n: bt.wks(SPHERE, energies=n, k=5),
    "sliced_wasserstein": lambda n: bt.sliced_wasserstein(SPHERE.vertices, SPHERE.vertices, directions=n),
    "rotation_invariant": lambda n: bt.rotation_invariant_sliced_wasserstein(SPHERE.vertices, SPHERE.vertices, directions=n),
    "directions": lambda n: bt.sliced.orthonormal_directions(3, n),
    "space of the directions": lambda n: bt.sliced.orthonormal_directions(n, 1),
    "embedding": lambda n: bt.DistanceMatrix(1 - np.eye(3), {}, ("a", "b", "c"), "").embed(n),
    "threads of tasks": lambda n: bt.distance_matrix([SPHERE], threads=n),
    "grid of the sphere": lambda n: bt.spherical_map(SPHERE).image(HEIGHT, rows=n, columns=n),
    "polylines": lambda n: bt.skeleton(bt.shapes.torus()).polylines(n),
    "regions": lambda n: bt.segment(SPHERE, HEIGHT, regions=n),
    "rows": lambda n: bt.shapes.torus(rows=n),
    "frequency": lambda n: bt.shapes.sphere(frequency=n),
    "size of a picture": lambda n: bt.plot(SPHERE, size=(n, n)),
    "samples of a picture": lambda n: bt.plot(SPHERE, samples=n),
    "contours of a picture": lambda n: bt.plot(SPHERE, HEIGHT, contours=n),
}


@pytest.mark.parametrize("name", INTEGERS)
def test_a_number_that_no_memory_holds_is_refused(name):
    with pytest.raises(bt.InputError, match=r"GiB of memory and there are|must be from|at most"):
        INTEGERS[name](MANY)


SIZES = {
    "neighbours": lambda p: bt.nearest_neighbors(p, p, 90_000),
    "neighbours within": lambda p: bt.neighbors_within(p, p, 10.0),
    "normals": lambda p: bt.normals(p, neighbors=90_000),
    "local mesh": lambda p: bt.operators(bt.PointCloud(p), neighbors=90_000),
    "moving least squares": lambda p: bt.operators(bt.PointCloud(p), laplacian="mls", neighbors=90_000),
    "eigenpairs": lambda p: bt.eigenpairs(bt.shapes.sphere(4), 2500),
    "regions": lambda p: bt.segment(SPHERE, HEIGHT, regions=100),
    "committor": lambda p: bt.committor(SPHERE, HEIGHT, [0], [1], beta=1.0, refine=3),
    "committor of a cloud": lambda p: bt.committor(CLOUD, HEIGHT, [0], [1], beta=1.0, refine=2),
    "makers": lambda p: [bt.shapes.sphere(6)],
    "torus": lambda p: bt.shapes.torus(rows=300, columns=300),
    "flat torus": lambda p: bt.shapes.flat_torus(rows=300, columns=300),
    "grid": lambda p: bt.shapes.grid(300, 300),
    "cylinder": lambda p: bt.shapes.cylinder(rows=300, columns=300),
    "disc": lambda p: bt.shapes.disc(rings=300),
    "knot": lambda p: bt.shapes.knot(rows=3000, columns=30),
}


@pytest.mark.parametrize("name", SIZES)
def test_what_memory_does_not_hold_is_refused(name, points, small_machine):
    with pytest.raises(bt.InputError, match="memory"):
        SIZES[name](points)


def test_the_refusal_says_what_fits(monkeypatch):
    """As many intervals as it names do fit, by its own count."""
    monkeypatch.setattr("beltrami.arrays.memory", lambda: 10_000_000)
    with pytest.raises(bt.InputError) as refused:
        flow(intervals=1000)
    (most,) = map(int, re.findall(r"take (\d+) intervals or fewer", str(refused.value)))
    assert 1 < most < 1000
    assert flow(intervals=most).intervals == most


@pytest.mark.skipif(os.name != "posix", reason="limits of a process")
def test_the_limit_of_a_container_counts(tmp_path, monkeypatch):
    told = tmp_path / "memory.max"
    monkeypatch.setattr("beltrami.arrays._GROUPS", (tmp_path / "absent", told))
    told.write_text("max\n")
    most = bt.arrays.memory()
    told.write_text("9223372036854771712\n")
    assert bt.arrays.memory() == most
    told.write_text("1048576\n")
    assert bt.arrays.memory() == 1 << 20


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="limits of a process")
@pytest.mark.parametrize("name", [name for name in methods.METHODS if name not in LONGER])
def test_a_million_vertices(name):
    """An answer within the stated time and memory, or a refusal that says why."""
    row = methods.measure(name, 1_000_000, SECONDS, MEMORY)
    kind = row["outcome"].split(":")[0]
    assert kind == "answer" or issubclass(getattr(bt, kind, type(None)), bt.InputError), row


def test_every_method_is_measured():
    """What is public and works on shapes has its row."""
    measured = {name.split(",")[0] for name in methods.METHODS}
    others = {"num_threads", "set_num_threads", "reweight", "load_values"}  # no work on a shape
    others |= {"load", "save", "point_map_of", "functional_map_of"}  # "save and load", "functional_map_of and back"
    makers = {name for name in bt.__all__ if name[0].islower() and callable(getattr(bt, name))} - others
    assert [name for name in sorted(makers) if name not in measured] == []

"""Distances over collections."""

import concurrent.futures
import os
import shutil
import signal
import subprocess
import sys
import time

import beltrami as bt
import numpy as np
import pytest


def members():
    """Three classes: bent strips (isometric to one another), ellipsoids of two kinds."""
    flat = bt.shapes.grid(13, 33, width=2.6, height=1.0)
    x, y, _ = flat.vertices.T if flat.vertices.shape[1] == 3 else (*flat.vertices.T, None)
    rolled = [bt.TriangleMesh(np.stack([r * np.cos(x / r), r * np.sin(x / r), y], 1), flat.faces) for r in (0.6, 1.0, 5.0)]
    long = [bt.shapes.ellipsoid(1.0, 0.8, c, level=3) for c in (2.0, 2.05)]
    flatter = [bt.TriangleMesh(7 * bt.shapes.ellipsoid(1.0, 0.8, c, level=3).vertices + 1, bt.shapes.sphere(3).faces) for c in (0.5, 0.48)]
    return [*rolled, *long, *flatter], [0, 0, 0, 1, 1, 2, 2]


@pytest.fixture(scope="module")
def shapes():
    return members()[0]


@pytest.fixture(scope="module")
def matrix(shapes):
    return bt.distance_matrix(shapes)


class Counting(concurrent.futures.Executor):
    def __init__(self):
        self.tasks = 0

    def submit(self, fn, /, *args, **kwargs):
        self.tasks += 1
        future = concurrent.futures.Future()
        future.set_result(fn(*args, **kwargs))
        return future


def area_difference(first, second):
    return abs(first.area - second.area)


def test_the_nearest_shape_is_of_the_same_class(matrix):
    kinds = np.array(members()[1])
    assert (kinds[matrix.nearest()[:, 0]] == kinds).all()
    d = np.asarray(matrix)
    assert (d == d.T).all()
    assert not np.diag(d).any()
    assert d[:3, :3].max() < 0.1 * d[0, 3]  # a strip does not know that it is rolled; samples differ


def test_a_pair_depends_on_nothing_else(shapes, matrix):
    part = bt.distance_matrix([shapes[5], shapes[0], shapes[3]])
    assert (np.asarray(part) == np.asarray(matrix)[np.ix_([5, 0, 3], [5, 0, 3])]).all()


def test_processes_and_threads_give_the_same_bits(shapes, matrix):
    few = shapes[2:5]
    want = np.asarray(matrix)[2:5, 2:5]
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        assert (np.asarray(bt.distance_matrix(few, executor=pool)) == want).all()
    with concurrent.futures.ProcessPoolExecutor(2) as pool:
        assert (np.asarray(bt.distance_matrix(few, executor=pool)) == want).all()
        areas = bt.distance_matrix(few, method=area_difference, executor=pool)
    assert np.isclose(areas[1, 2], abs(few[1].area - few[2].area))


def test_an_interrupted_run_goes_on(shapes, matrix, tmp_path):
    shapes, want = shapes[2:6], np.asarray(matrix)[2:6, 2:6]
    whole, first, rest, again = Counting(), Counting(), Counting(), Counting()
    bt.distance_matrix(shapes, executor=whole)
    seen = []
    with pytest.raises(bt.Cancelled):
        bt.distance_matrix(shapes, executor=first, checkpoint=tmp_path, progress=lambda share: seen.append(share) or len(seen) < 7)
    found = bt.distance_matrix(shapes, executor=rest, checkpoint=tmp_path)
    assert (np.asarray(found) == want).all()
    assert rest.tasks < whole.tasks
    bt.distance_matrix(shapes, executor=again, checkpoint=tmp_path)
    assert again.tasks == 0
    for file in (tmp_path / "tiles").iterdir():  # a file cut short is made again
        file.write_bytes(file.read_bytes()[:40])
    assert (np.asarray(bt.distance_matrix(shapes, checkpoint=tmp_path)) == want).all()


def test_clouds_are_remembered_with_their_normals(tmp_path):
    sheet = bt.shapes.grid(9, 25, width=3.0, height=1.0).vertices
    sheet = np.c_[sheet, np.zeros(len(sheet))][:, :3]
    normals = np.where(sheet[:, :1] > sheet[:, 0].mean(), [[0.0, 0, 1]], [[0.0, 0, -1]])  # cut in two where they oppose each other
    near, apart = bt.PointCloud(sheet, dimension=2), bt.PointCloud(sheet, dimension=2, normals=normals)
    other = bt.PointCloud(bt.shapes.ellipsoid(level=2).vertices, dimension=2)
    first = bt.distance_matrix([near, other], checkpoint=tmp_path)
    second = bt.distance_matrix([apart, other], checkpoint=tmp_path)
    assert second[0, 1] == bt.distance_matrix([apart, other])[0, 1] != first[0, 1]


def test_a_bad_shape_is_a_row_of_the_report(shapes, tmp_path):
    bad = tmp_path / "bad.off"
    bad.write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n")
    good = tmp_path / "good.off"
    bt.save(shapes[3], good)
    found = bt.distance_matrix([shapes[4], bad, good, tmp_path / "absent.ply"], labels=list("abcd"))
    assert sorted(found.failures) == [1, 3]
    assert np.isinf(found[0, 1])
    assert found[1, 1] == 0
    assert np.isfinite(found[0, 2])
    assert found.nearest().tolist() == [[2], [-1], [0], [-1]]
    assert (found.embed()[1] == 0).all()


def test_a_method_that_fails_is_reported_and_not_kept(shapes, tmp_path):
    def broken(first, second):
        raise ArithmeticError("no")

    found = bt.distance_matrix(shapes[:2], method=broken, checkpoint=tmp_path)
    assert "ArithmeticError: no" in found.failures[0]
    assert not (tmp_path / "tiles").exists()


def test_embedding_keeps_the_distances_of_points_in_the_plane(shapes):
    places = np.random.default_rng(0).normal(size=(6, 2))
    flat = np.linalg.norm(places[:, None] - places[None], axis=2)
    found = bt.DistanceMatrix(flat, {}, tuple("abcdef"), "plane").embed(2)
    assert np.allclose(np.linalg.norm(found[:, None] - found[None], axis=2), flat)


def test_shape_dna_sees_no_size(shapes):
    big = bt.TriangleMesh(100 * shapes[3].vertices, shapes[3].faces)
    found = bt.distance_matrix([shapes[3], big, shapes[4]], method="shape_dna")
    assert found[0, 1] < 1e-6 * found[0, 2]


@pytest.mark.parametrize("kind", ["map", "matrix", "dendrogram", "nearest"])
def test_plots_are_written(matrix, tmp_path, kind):
    pytest.importorskip("matplotlib")
    matrix.plot(kind, path=tmp_path / "plot.png", classes=members()[1])
    assert os.path.getsize(tmp_path / "plot.png") > 5000


def test_options_that_do_not_fit_are_refused(shapes, matrix):
    calls = [
        lambda: bt.distance_matrix([shapes[0], 3]),
        lambda: bt.distance_matrix({"one": shapes[0], "two": shapes[1]}),  # the names were taken for files
        lambda: bt.distance_matrix(shapes, method="hausdorff"),
        lambda: bt.distance_matrix(shapes, executor="fast"),
        lambda: bt.distance_matrix(shapes, labels=["one"]),
        lambda: matrix.plot("pie"),
        lambda: matrix.plot(classes=[1]),
        lambda: bt.DistanceMatrix(np.zeros((1, 1)), {}, ("a",), "x").embed(),
    ]
    for call in calls:
        with pytest.raises(bt.InputError):
            call()


@pytest.mark.slow
def test_dask_gives_the_same_bits(shapes, matrix):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        assert (np.asarray(bt.distance_matrix(shapes[2:5], executor=client)) == np.asarray(matrix)[2:5, 2:5]).all()


def lump(index):
    """One of many closed surfaces of 300 to 900 vertices, no two alike."""
    rng = np.random.default_rng(index)
    sphere = bt.shapes.sphere(frequency=int(rng.integers(6, 10)))
    x, y, z = sphere.vertices.T
    swell = np.stack([x * y, z * x, np.sin(2 * y), x**3, np.cos(3 * z), x * y * z]).T @ (0.25 * rng.normal(size=6))
    return bt.TriangleMesh(sphere.vertices * np.exp(swell)[:, None] * [1.0, 0.8, 0.6], sphere.faces)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="kills a process")
@pytest.mark.parametrize(("method", "count", "when"), [("shape_dna", 200, 0.2), ("shape_dna", 200, 0.8), ("rswd", 10, 0.6)])
def test_a_cluster_that_loses_a_worker_gives_the_same_bits(method, count, when):
    """19,900 pairs of 200 shapes; killed among the eigenproblems, or among the tiles of pairs."""
    distributed = pytest.importorskip("distributed")
    lumps = [lump(index) for index in range(count)]
    killed = []
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):

        def kill_one(share):
            if share >= when and not killed:
                killed.append(next(iter(client.run(os.getpid).values())))
                os.kill(killed[0], signal.SIGKILL)

        found = bt.distance_matrix(lumps, method=method, executor=client, progress=kill_one)
        assert killed[0] not in client.run(os.getpid).values()  # it is gone, another may have come in its place
    assert not found.failures
    assert np.asarray(found).tobytes() == np.asarray(bt.distance_matrix(lumps, method=method)).tobytes()


OVER_MPI = """
import sys
import numpy as np
import beltrami as bt
from mpi4py.futures import MPIPoolExecutor

if __name__ == "__main__":
    with MPIPoolExecutor() as pool:
        found = bt.distance_matrix(sys.argv[2:], executor=pool, checkpoint=sys.argv[1] + "/run")
    np.save(sys.argv[1] + "/found.npy", found.matrix)
    assert not found.failures, found.failures
"""


@pytest.mark.slow
def test_mpi_gives_the_same_bits(shapes, tmp_path):
    pytest.importorskip("mpi4py")
    if shutil.which("mpiexec") is None:
        pytest.skip("mpiexec is missing")
    paths = [tmp_path / f"{index}.ply" for index in range(3)]
    for shape, path in zip(shapes[2:5], paths, strict=True):
        bt.save(shape, path)
    script = tmp_path / "over_mpi.py"
    script.write_text(OVER_MPI)
    more = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}  # containers; more ranks than cores, in Open MPI 4 and 5
    more |= {"OMPI_MCA_rmaps_base_oversubscribe": "1", "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe"}
    command = ["mpiexec", "-n", "3", sys.executable, "-m", "mpi4py.futures", str(script), str(tmp_path), *map(str, paths)]
    done = subprocess.run(command, env={**os.environ, **more}, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert (np.load(tmp_path / "found.npy") == np.asarray(bt.distance_matrix(paths))).all()


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="kills a process")
def test_a_killed_run_goes_on(shapes, matrix, tmp_path):
    paths = [tmp_path / f"{index}.npz" for index in range(len(shapes))]
    for shape, path in zip(shapes, paths, strict=True):
        np.savez(path, V=shape.vertices, F=shape.faces)
    code = (
        "import sys, numpy as np, beltrami as bt; files = [np.load(p) for p in sys.argv[2:]]; "
        "bt.distance_matrix([bt.TriangleMesh(f['V'], f['F']) for f in files], checkpoint=sys.argv[1])"
    )
    run = subprocess.Popen([sys.executable, "-c", code, str(tmp_path / "run"), *map(str, paths)])
    while run.poll() is None and len(list((tmp_path / "run").glob("tiles/*.npz"))) < 3:
        time.sleep(0.01)
    run.kill()
    assert run.wait() == -signal.SIGKILL  # it did not end by itself
    rest = Counting()
    found = bt.distance_matrix(shapes, executor=rest, checkpoint=tmp_path / "run")
    assert (np.asarray(found) == np.asarray(matrix)).all()
    pairs = len(shapes) * (len(shapes) - 1) // 2
    assert rest.tasks <= pairs - 3  # no eigenmap, and not the tiles that were done

"""What every call owes the process it runs in: Ctrl-C, forks, threads, pickles, import time, inputs left alone."""

from __future__ import annotations

import concurrent.futures
import copy
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
import time

import beltrami as bt
import numpy as np
import pytest
import test_sweep


def run(code: str, seconds: float = 120, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=seconds, env={**os.environ, **environment}, check=False
    )


def values(level: int = 3) -> bytes:
    return bt.eigenpairs(bt.shapes.sphere(level), 5).values.tobytes()


def few_and_all(few, but=()):
    """Some methods in every run, the whole table of the sweep in `make slow`."""
    return [method if method in few else pytest.param(method, marks=pytest.mark.slow) for method in test_sweep.METHODS if method not in but]


@pytest.mark.parametrize("start", [m for m in ("fork", "forkserver", "spawn") if m in multiprocessing.get_all_start_methods()])
@pytest.mark.parametrize(
    "methods", [["eigenpairs", "normals", "sample_density"], pytest.param(list(test_sweep.METHODS), marks=pytest.mark.slow)], ids=len
)
def test_child_processes_answer_as_their_parent(start, methods):
    code = f"""
import multiprocessing, test_sweep
if __name__ == "__main__":
    here = [test_sweep.answer(method) for method in {methods}]  # the parent's threads are running when the child starts
    with multiprocessing.get_context({start!r}).Pool(2) as pool:
        there = pool.map(test_sweep.answer, {methods}, chunksize=1)
    print([method for method, one, other in zip({methods}, here, there) if one != other])
"""
    done = run(code, seconds=60 * len(methods), PYTHONPATH=os.path.dirname(__file__))
    assert done.stdout.strip() == "[]", done.stderr


@pytest.mark.skipif(not os.path.exists("/proc/self/task"), reason="threads, as Linux lists them")
def test_no_threads_but_the_librarys():
    """Those of rayon's own pool are not there any more in forked children, which then waited for them for ever."""
    code = """
import os, test_sweep
def others():
    return sum(not open(f"/proc/self/task/{t}/comm").read().startswith("beltrami-") for t in os.listdir("/proc/self/task"))
before = others()
for method in test_sweep.METHODS:
    test_sweep.answer(method)
    if others() != before:
        raise SystemExit(method)
"""
    done = run(code, PYTHONPATH=os.path.dirname(__file__), OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1", OMP_NUM_THREADS="1")
    assert done.returncode == 0, done.stderr


LONG = {
    "eigenpairs": "bt.eigenpairs(bt.shapes.sphere(frequency=120), 400)",
    "all eigenpairs": "bt.eigenpairs(bt.shapes.sphere(frequency=20), 4002)",
    "Cholesky": "a = bt.operators(bt.shapes.sphere(8)); bt.Cholesky(a.stiffness + sparse.diags_array(a.mass))",
    "Cholesky without coordinates": """
side = 1000
line = sparse.diags_array([-np.ones(side - 1), 2 * np.ones(side), -np.ones(side - 1)], offsets=[-1, 0, 1])
bt.Cholesky(sparse.kron(line, sparse.eye_array(side)) + sparse.kron(sparse.eye_array(side), line))
""",
}
IMPORTS = "import signal, time, numpy as np, scipy.sparse as sparse, beltrami as bt\n"


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_control_c():
    # A job started in the background ignores SIGINT, and its children inherit that.
    code = f"{IMPORTS}signal.signal(signal.SIGINT, signal.default_int_handler)\nprint('go', flush=True)\nwhile True: {LONG['eigenpairs']}"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline().strip() == "go"
            time.sleep(1.0)
            process.send_signal(signal.SIGINT)
            assert "KeyboardInterrupt" in process.communicate(timeout=120)[1]
        finally:
            process.kill()


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="timers of POSIX")
@pytest.mark.parametrize("after", [0.4, pytest.param(1.5, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", LONG)
def test_interruptions_are_served_soon(name, after):
    """By the CPU time from the signal until it is served, which a busy machine does not lengthen: up to .4 s on two threads."""
    code = f"""{IMPORTS}
signal.signal(signal.SIGPROF, signal.default_int_handler)
due = time.process_time() + {after}
signal.setitimer(signal.ITIMER_PROF, {after})
try:
    exec({LONG[name]!r})
    print("the call had come to its end")
except KeyboardInterrupt:
    print(time.process_time() - due)
"""
    done = run(code, BELTRAMI_NUM_THREADS="2")
    assert float(done.stdout) < 2.0, done.stderr


@pytest.mark.skipif(not os.path.exists("/proc/self/stat"), reason="the CPU time of another process, as Linux tells it")
@pytest.mark.parametrize("method", few_and_all(["register", "plot"]))
def test_every_method_is_interrupted_soon_and_works_on(method):
    """Half a second of CPU time at most from the signal until it is served, wherever in the method it falls.

    It comes from outside and is timed there: timers within count ticks, seconds too early on a busy machine.
    """
    code = f"""
import signal, time, numpy as np, beltrami as bt, test_sweep
before = test_sweep.answer({method!r})
shape = test_sweep.larger({method!r}, 40_000)
signal.signal(signal.SIGINT, signal.default_int_handler)
for _ in range(5):
    print("go", flush=True)
    try:
        while True:
            test_sweep.METHODS[{method!r}](shape, np.random.default_rng(3))
    except KeyboardInterrupt:
        print(time.process_time(), flush=True)
print(test_sweep.answer({method!r}) == before)
"""
    environment = {**os.environ, "PYTHONPATH": os.path.dirname(__file__), "BELTRAMI_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    late = []
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=environment) as process:
        try:
            assert process.stdout is not None
            for moment in (0.1, 0.4, 0.7, 1.1, 1.9):
                assert process.stdout.readline().strip() == "go"
                due = spent(process.pid) + moment
                while spent(process.pid) < due:
                    time.sleep(0.005)
                sent = spent(process.pid)
                process.send_signal(signal.SIGINT)
                late.append(float(process.stdout.readline()) - sent)
            assert process.stdout.readline().strip() == "True"
        finally:
            process.kill()
    assert max(late) < 0.5


def spent(number):
    """CPU time of a process, in all threads that it has or had."""
    with open(f"/proc/{number}/stat") as file:
        user, system = file.read().rsplit(")", 1)[1].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def test_other_python_threads_run_meanwhile():
    ticks, done = [], threading.Event()

    def tick():
        while not done.is_set():
            ticks.append(time.monotonic())
            time.sleep(0.005)

    thread = threading.Thread(target=tick)
    thread.start()
    try:
        bt.eigenpairs(bt.shapes.sphere(5), 40)
    finally:
        done.set()
        thread.join()
    assert len(ticks) > 5
    assert max(np.diff(ticks)) < 0.5 * (ticks[-1] - ticks[0])  # all of it, were the GIL held


def test_eight_python_threads_at_once():
    with concurrent.futures.ThreadPoolExecutor(8) as pool:
        assert len(set(pool.map(values, [3] * 16))) == 1


def test_threads_setting():
    before = bt.num_threads()
    bt.set_num_threads(3)
    assert bt.num_threads() == 3
    bt.set_num_threads(before)
    for bad in (0, -1, 10**6):
        with pytest.raises((bt.InputError, OverflowError)):
            bt.set_num_threads(bad)
    code = "import beltrami as bt; print(bt.num_threads())"
    assert run(code, BELTRAMI_NUM_THREADS="1").stdout.strip() == "1"
    assert 'BELTRAMI_NUM_THREADS is "many"' in run(code, BELTRAMI_NUM_THREADS="many").stderr


def test_same_bits_in_another_process_with_other_threads():
    code = "import beltrami as bt, sys; sys.stdout.buffer.write(bt.eigenpairs(bt.shapes.sphere(3), 5).values.tobytes().hex().encode())"
    assert {run(code, BELTRAMI_NUM_THREADS=t).stdout for t in "124"} == {values().hex()}


# conformal registration has singular value decompositions and products of whole bases, which stay with BLAS
@pytest.mark.parametrize("method", few_and_all(["hks", "denoise"], but=["register_conformal"]))
def test_same_bits_on_other_threads_of_blas(method):
    """Which adds up in parts from 10,000 numbers on; numpy takes it for ``@``."""
    code = f"""
import hashlib, numpy as np, test_sweep
found = test_sweep.METHODS[{method!r}](test_sweep.larger({method!r}, 40_000), np.random.default_rng(3))
print(hashlib.sha256(b"".join(array.tobytes() for array in test_sweep.arrays_of(found))).hexdigest())
"""
    variables = {"PYTHONPATH": os.path.dirname(__file__)}
    done = [run(code, 300, **variables, OPENBLAS_NUM_THREADS=threads, MKL_NUM_THREADS=threads) for threads in "12"]
    assert len(done[0].stdout) == 65, done[0].stderr
    assert done[0].stdout == done[1].stdout


@pytest.mark.parametrize(
    "make",
    [
        lambda: bt.shapes.sphere(1),
        lambda: bt.PointCloud(np.eye(3), weights=[1, 2, 3]),
        lambda: bt.operators(bt.shapes.sphere(1)),
        lambda: bt.operators(bt.shapes.sphere(1), laplacian="intrinsic_delaunay"),
        lambda: bt.operators(bt.shapes.sphere(1), laplacian="tufted"),
        lambda: bt.operators(bt.PointCloud(bt.shapes.sphere(2).vertices, dimension=2)),
        lambda: bt.operators(bt.PointCloud(bt.shapes.sphere(2).vertices, dimension=2), laplacian="mls"),
        lambda: bt.spherical_map(bt.shapes.ellipsoid(1.0, 0.8, 0.6, level=1)),
        lambda: bt.spherical_map(bt.shapes.ellipsoid(1.0, 0.8, 0.6, level=1)).harmonics(3),
        lambda: bt.costs.congestion(0.1),
        lambda: bt.costs.power(1.5),
        lambda: bt.plot(bt.shapes.sphere(1), size=(20, 20), samples=1),
        lambda: bt.eigenpairs(bt.shapes.sphere(1), 3),
        lambda: bt.HeatMethod(bt.shapes.sphere(1)),
        lambda: bt.PoissonSolver(bt.shapes.sphere(1)),
        lambda: bt.Cholesky(np.eye(3)),
    ],
)
def test_everything_pickles(make):
    made = make()
    for again in (pickle.loads(pickle.dumps(made)), copy.deepcopy(made), copy.copy(made)):
        assert type(again) is type(made)
        assert str(again) == str(made) or " at 0x" in str(made)


def test_errors_are_builtins_too():
    assert issubclass(bt.InputError, ValueError)
    assert issubclass(bt.FileError, OSError)
    assert issubclass(bt.NumericalError, ArithmeticError)
    assert issubclass(bt.ConvergenceError, RuntimeError)
    assert issubclass(bt.DependencyError, ImportError)
    error = pickle.loads(pickle.dumps(bt.InputError("what, where, the value, and what to do")))
    assert str(error) == "what, where, the value, and what to do"


def test_import_is_quick():
    """In CPU time, against the import of scipy.sparse with numpy (measured .7 of that), so on whatever machine."""

    def cost(module: str) -> float:
        code = f"import time; start = time.process_time(); import {module}; print(time.process_time() - start)"
        return float(run(code, PYTHONDONTWRITEBYTECODE="").stdout)  # a package that is installed has its bytecode

    assert min(cost("beltrami") for _ in range(3)) < min(cost("scipy.sparse") for _ in range(3))


def test_heavy_packages_stay_out():
    heavy = "trimesh matplotlib pyvista nibabel networkx scipy.linalg scipy.optimize scipy.sparse scipy.spatial scipy.special"
    code = "import sys, scipy; before = set(sys.modules); import beltrami; "  # what scipy itself takes differs by version
    code += f"print([m for m in {heavy.split()} if m in sys.modules and m not in before])"
    assert run(code).stdout.strip() == "[]"


ORDERS = {
    "Fortran": np.asfortranarray,
    "strided": lambda a: np.repeat(a, 2, axis=0)[::2],
    "reversed twice": lambda a: a[::-1].copy()[::-1],
    "big-endian": lambda a: a.astype(a.dtype.newbyteorder(">")),
    "misaligned": lambda a: np.frombuffer(b"x" + a.tobytes(), np.uint8)[1:].view(a.dtype).reshape(a.shape),
    "read-only": lambda a: np.frombuffer(a.tobytes(), a.dtype).reshape(a.shape),
    "a list": lambda a: a.tolist(),
}


@pytest.mark.parametrize("name", ORDERS)
def test_arrays_of_any_make(name):
    mesh = bt.shapes.torus(rows=9, columns=7)
    vertices, faces = ORDERS[name](np.array(mesh.vertices)), ORDERS[name](np.array(mesh.faces, np.int64))
    before = [np.array(vertices), np.array(faces)]
    made = bt.TriangleMesh(vertices, faces)
    assert bt.operators(made).stiffness.data.tobytes() == bt.operators(mesh).stiffness.data.tobytes()
    assert np.array_equal(before[0], np.array(vertices))
    assert np.array_equal(before[1], np.array(faces))


def test_a_frozen_mesh_does_not_follow_its_input():
    vertices = np.array([[0.0, 0], [1, 0], [0, 1]])
    mesh = bt.TriangleMesh(vertices, [[0, 1, 2]])
    vertices[:] = np.nan
    assert mesh.area == 0.5
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices[0] = 1


@pytest.mark.parametrize("kind", ["i2", "u2", "i4", "u4", "i8", "u8", "f8"])
def test_integers_of_any_width(kind):
    mesh = bt.shapes.sphere(1)
    assert np.array_equal(bt.TriangleMesh(mesh.vertices, mesh.faces.astype(kind)).faces, mesh.faces)

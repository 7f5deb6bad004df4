"""Tries a wheel as a stranger gets it: `try_wheel.py WHEEL [INTERPRETER ...]`.

Into an empty environment of each interpreter (this one, if none is named) goes the wheel with nothing but its dependencies, once with
the oldest releases it promises to work with, where that interpreter has them, and once with the newest. There it must import, compute
and paint, and name the extra of what is absent. The wheel must be small, its symbols those of the stable ABI, on Linux those of its
platform tag; where there is no lock for all threads, importing it brings none back."""

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

LARGEST = 15e6  # bytes
PROGRAMS = "Scripts" if os.name == "nt" else "bin"
OLDEST = ["numpy==1.26.*", "scipy==1.15.0", "trimesh==4.0.*"]  # pyproject.toml's bounds; they have wheels up to Python 3.12

TRIAL = """
import sys, tempfile, pathlib
import numpy, scipy
import beltrami as bt
mesh = bt.shapes.sphere(4)
values = bt.eigenpairs(mesh, 9).values
assert abs(values[1:4] - 2).max() < 0.01 and abs(values[4:] - 6).max() < 0.05, values
assert abs(bt.geodesic_distance(mesh, 0).max() - numpy.pi) < 0.05
assert bt.segment(mesh, mesh.vertices[:, 2], fidelity=10.0).gap < 1e-3
folder = pathlib.Path(tempfile.mkdtemp())
mesh.plot(mesh.vertices[:, 0], path=folder / "sphere.png")
bt.save(mesh, folder / "sphere.ply")
assert (bt.load(folder / "sphere.ply").faces == mesh.faces).all()
try:
    bt.examples.cortex()
except bt.DependencyError as error:
    assert "examples" in str(error), error
else:
    raise AssertionError("the environment is not empty: nilearn is there")
if "free-threading" in sys.version:
    assert not sys._is_gil_enabled(), "importing beltrami, numpy or scipy brought the GIL back"
print("Python", sys.version.split()[0], "numpy", numpy.__version__, "scipy", scipy.__version__, "ok")
"""


def run(*command: str) -> None:
    subprocess.run(command, check=True)


def minor(interpreter: str) -> int:
    code = "import sys; print(sys.version_info[1])"
    return int(subprocess.run([interpreter, "-c", code], check=True, capture_output=True, text=True).stdout)


def main(wheel: Path, interpreters: list[str]) -> None:
    size = wheel.stat().st_size
    if size > LARGEST:
        raise SystemExit(f"{wheel.name} has {size:,} bytes, {LARGEST:,.0f} are allowed")
    print(f"{wheel.name}: {size:,} bytes")
    with tempfile.TemporaryDirectory() as folder:
        tools = Path(folder, "tools")
        run(sys.executable, "-m", "venv", str(tools))
        run(str(tools / PROGRAMS / "pip"), "install", "-q", "abi3audit", "auditwheel")
        if "abi3" in wheel.name:
            run(str(tools / PROGRAMS / "abi3audit"), "--strict", str(wheel))
        if "linux" in wheel.name:
            shown = subprocess.run([tools / PROGRAMS / "auditwheel", "show", wheel], check=True, capture_output=True, text=True).stdout
            tag = re.search(r'platform tag:\s+"(\S+)"', " ".join(shown.split()))
            if tag is None or not tag[1].startswith(("manylinux", "musllinux")):
                raise SystemExit(f"auditwheel: {shown}")
            print("auditwheel:", tag[1])
        for at, interpreter in enumerate(interpreters):
            for pins in [OLDEST, []] if minor(interpreter) <= 12 else [[]]:
                place = Path(folder, f"{at}-{len(pins)}")
                run(interpreter, "-m", "venv", str(place))
                run(str(place / PROGRAMS / "pip"), "install", "-q", "--disable-pip-version-check", *pins, str(wheel))
                run(str(place / PROGRAMS / "python"), "-c", TRIAL)
                run(str(place / PROGRAMS / "beltrami"), "doctor")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]), sys.argv[2:] or [sys.executable])

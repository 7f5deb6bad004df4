"""Runs every comparison under benches/peers and writes what they print, with machine and versions, to benches/RESULTS.md.

python benches/results.py [name ...]
"""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
PEERS = (
    *("numpy", "scipy", "libigl", "lapy", "pynanoflann", "open3d", "open3d-cpu", "scikit-sparse", "POT", "PyMaxflow"),
    *("robust-laplacian", "pcdiff", "potpourri3d", "pyfmaps"),
)
# Threads of BLAS that only wait count as processor time, tenfold in eigsh.
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", **os.environ}


def processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def versions() -> str:
    installed = {(found.metadata["Name"] or "").lower(): found.version for found in importlib.metadata.distributions()}
    return ", ".join(f"{name} {installed[name.lower()]}" for name in PEERS if name.lower() in installed)


def main() -> None:
    wanted = sys.argv[1:]
    scripts = [path for path in sorted((HERE / "peers").glob("*.py")) if not wanted or path.stem in wanted]
    parts = [
        "# Side by side\n",
        "Written by `python benches/results.py`: each block is one run of one script, both sides in it; medians where it says so.\n",
        f"Machine: {processor()}, {os.cpu_count()} cores, {platform.system()}. Python {platform.python_version()}, {versions()}.",
        f"Load when it began: {os.getloadavg()[0]:.1f}.\n",
    ]
    for path in scripts:
        print(f"== {path.name}", flush=True)
        told = subprocess.run([sys.executable, path], capture_output=True, text=True, check=False, env=ONE_THREAD)
        text = told.stdout.strip() or "no output"
        if told.returncode:
            text += f"\nended with {told.returncode}: {told.stderr.strip().splitlines()[-1:]}"
        print(text)
        heading = (path.read_text().split('"""')[1].strip().splitlines() or [path.stem])[0]
        parts += [f"## {path.stem}\n", heading + "\n", f"```text\n{text}\n```\n"]
    if not wanted:
        (HERE / "RESULTS.md").write_text("\n".join(parts))


if __name__ == "__main__":
    main()

"""Runs every comparison under benches/peers and writes what they print, with machine and versions, to benches/RESULTS.md.
With names, only those blocks are written anew.

python benches/results.py [name ...]
"""

from __future__ import annotations

import datetime
import importlib.metadata
import os
import platform
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).parent
RESULTS = HERE / "RESULTS.md"
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


def block(path: Path) -> str:
    """One script run by itself: its heading, when and under what load, and what it printed."""
    load, start = os.getloadavg()[0], time.perf_counter()
    told = subprocess.run([sys.executable, path], capture_output=True, text=True, check=False, env=ONE_THREAD)
    text = told.stdout.strip() or "no output"
    if told.returncode:
        text += f"\nended with {told.returncode}: {told.stderr.strip().splitlines()[-1:]}"
    print(text)
    heading = path.read_text().split('"""')[1].strip().split("\n\n")[0].replace("\n", " ")
    when = f"{datetime.date.today()}, {time.perf_counter() - start:.0f} s, load before it {load:.1f}."
    return f"## {path.stem}\n\n{heading}\n\n{when}\n\n```text\n{text}\n```\n"


def main() -> None:
    wanted = sys.argv[1:]
    # scripts that are not run keep what their last run said
    kept = {part.split("\n", 1)[0]: f"## {part}" for part in RESULTS.read_text().split("\n## ")[1:]} if RESULTS.exists() else {}
    for path in sorted((HERE / "peers").glob("*.py")):
        if not wanted or path.stem in wanted:
            print(f"== {path.name}", flush=True)
            kept[path.stem] = block(path)
            head = (
                "# Side by side\n\n"
                "Written by `python benches/results.py [name ...]`: each block is one run of one script, both sides in it, "
                "medians where it says so.\n\n"
                f"Machine: {processor()}, {os.cpu_count()} cores, {platform.system()}. Python {platform.python_version()}, {versions()}.\n"
            )
            RESULTS.write_text("\n".join([head, *(text.strip() + "\n" for _, text in sorted(kept.items()))]))


if __name__ == "__main__":
    main()

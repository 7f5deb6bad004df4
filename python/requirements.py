"""Prints the requirements of pyproject.toml, extras included, one per line: what `make build` installs before the wheel itself.

Readers of trajectories are left out: they are large, and their licences are not those of the rest. So is MPI, which a system must have."""

import sys
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

project = tomllib.loads((Path(__file__).parent.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]
extras = [extra for name, extra in project["optional-dependencies"].items() if name not in ("molecules", "mpi")]
for requirement in [*project["dependencies"], *(r for extra in extras for r in extra)]:
    print(f"'{requirement}'")

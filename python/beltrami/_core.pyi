"""The compiled core. Users call it through the modules of beltrami; stubtest holds this file against the real thing."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from .arrays import CsrArrays as CsrArrays
from .arrays import Floats as Floats
from .arrays import Ints as Ints

# near
def nearest_neighbors(
    points: Floats, queries: Floats, wanted: int, progress: Callable[[float], object] | None = None
) -> tuple[Ints, Floats]: ...
def neighbors_within(
    points: Floats, queries: Floats, radius: float, progress: Callable[[float], object] | None = None
) -> tuple[npt.NDArray[np.int64], Ints, Floats]: ...

# shape
def check_mesh(mesh: tuple[Floats, Ints]) -> None: ...
def face_areas(mesh: tuple[Floats, Ints]) -> Floats: ...

# threads
def num_threads() -> int: ...
def set_num_threads(count: int) -> None: ...

"""The compiled core. Users call it through the modules of beltrami; stubtest holds this file against the real thing."""

import numpy as np
import numpy.typing as npt

from .arrays import CsrArrays as CsrArrays
from .arrays import Floats as Floats
from .arrays import Ints as Ints

# shape
def face_areas(mesh: tuple[Floats, Ints]) -> Floats: ...

# threads
def num_threads() -> int: ...
def set_num_threads(count: int) -> None: ...

"""Sums over points whose bits depend on nothing but the numbers: BLAS adds up in parts as its threads have it."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from .arrays import Floats

ALONE = 1 << 18  # multiplications up to which OpenBLAS takes one thread


def weighted_sum(values: Floats, weights: Floats) -> Floats:
    """``values @ weights``: (..., n) and (n,)."""
    found: Floats = np.einsum("...n,n->...", values, weights)
    return found


def rows_times(rows: Floats, matrix: Floats) -> Floats:
    """``rows @ matrix``: (n, k) and (k, m), of many rows."""
    found = np.empty((len(rows), matrix.shape[1]))
    step = max(2, ALONE // max(matrix.size, 1))
    for start in range(0, len(rows), step):
        found[start : start + step] = rows[start : start + step] @ matrix
    return found


def gathered(owner: npt.NDArray[Any], weights: Floats, count: int) -> Floats:
    """Sums of weights by owner."""
    sums: Floats = np.bincount(owner, weights=weights, minlength=count).astype(np.float64)
    return sums

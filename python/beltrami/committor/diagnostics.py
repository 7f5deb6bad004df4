"""Diagnostics: how far a committor can be trusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Floats
from ..clouds import CloudOperators
from .solve import System


@dataclass(frozen=True)
class CommittorDiagnostics:
    """How far a committor can be trusted.

    Attributes
    ----------
    outside : float
        Share of the points whose q was outside [0, 1] before it was clipped; 0 for the weak form.
    pieces : int
        Connected pieces of the shape.
    certified : float or None
        Share of certified stars; None for meshes.
    agreed : float
        Share of the area in simplices that all their corners' stars hold; 1 for meshes.
    transition_points : int
        Points with 0.1 < q < 0.9.
    effective_sample_size : float
        (Σ g)² / Σ g² of the Gibbs weights g of the points.
    transition_sample_size : float
        The same of g q (1 - q): how many points carry the transition.
    steepest : float
        Greatest β |ΔU| along an edge where the current flows (mean over the current).
    mended : int
        Triangles whose conduction was changed for 0 <= q <= 1.
    rate_mismatch : float
        Relative difference of the two estimates of the rate.
    """

    outside: float
    pieces: int
    certified: float | None
    agreed: float
    transition_points: int
    effective_sample_size: float
    transition_sample_size: float
    steepest: float
    mended: int
    rate_mismatch: float

    @property
    def concerns(self) -> tuple[str, ...]:
        """What speaks against the answer, in words; empty if nothing does."""
        found = []
        if self.outside > 0.01:
            found.append(f"q leaves [0, 1] at {100 * self.outside:.2g} % of the points")
        if self.transition_sample_size < 30:
            found.append(f"only {self.transition_sample_size:.0f} points effectively carry the transition: sample there")
        if self.steepest > 3:
            found.append(f"beta U changes by {self.steepest:.2g} along the edges that carry the current: take more points there")
        if self.certified is not None and self.certified < 0.99:
            found.append(f"{100 * (1 - self.certified):.2g} % of the stars are not certified")
        if self.agreed < 0.8:
            found.append(
                f"the stars disagree about {100 * (1 - self.agreed):.0f} % of the area: the surface is sampled too sparsely there, or in "
                "cells far longer than wide"
            )
        if self.rate_mismatch > 0.1:
            found.append(f"the two estimates of the rate differ by {100 * self.rate_mismatch:.2g} %")
        return tuple(found)

    @property
    def verdict(self) -> str:
        """One line: sound, or what is wrong."""
        return "sound" if not self.concerns else "doubtful: " + "; ".join(self.concerns)


def diagnosed(system: System, outside: float, mismatch: float) -> CommittorDiagnostics:
    mesh, ops = system.mesh, system.ops
    gibbs, q = system.restrict(system.gibbs), system.q[: system.count]
    transition = gibbs * q * (1 - q)
    used = system.conductance * np.square(system.q[mesh.first] - system.q[mesh.second])
    used = np.maximum(used, 0)
    length = 2.0 ** len(system.parents)  # steps of U along the edges of the shape itself
    change = np.abs(mesh.potential[mesh.first] - mesh.potential[mesh.second])
    steep = length * float((used * change).sum() / used.sum()) if used.sum() > 0 else 0.0

    def effective(weights: Floats) -> float:
        top = float(weights.max())
        scaled = weights / top if top > 0 else weights
        return float(scaled.sum() ** 2 / np.square(scaled).sum()) if top > 0 else 0.0

    return CommittorDiagnostics(
        outside=outside,
        pieces=int(ops.component_labels.max()) + 1,
        certified=ops.certified if isinstance(ops, CloudOperators) else None,
        agreed=float(mesh.volumes[mesh.share > 0.999].sum() / mesh.volumes.sum()),
        transition_points=int(((q > 0.1) & (q < 0.9)).sum()),
        effective_sample_size=effective(gibbs),
        transition_sample_size=effective(transition),
        steepest=steep,
        mended=int(mesh.mended.sum()),
        rate_mismatch=abs(mismatch),
    )

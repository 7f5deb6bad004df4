"""Dynamic transport beside Lavenant's ADMM in numpy: the same sphere, the same two zonal densities, one run, one thread.

The peer is the iteration of Lavenant, Claici, Chien and Solomon (Dynamical optimal transport on discrete surfaces, 2018) as the
paper states it: a potential at vertices and times; its time derivative and a copy of its gradient for each corner of each
triangle and either end of an interval as the split variables; a space-time Poisson equation, which is solved here by one sparse
factor a mode of time; the projection of each vertex and interval on the paraboloid (one cubic); multipliers, and a penalty that
balances the residuals. No Python loop over vertices.

It has no certificate, so it is stopped by the known answer (monotone rearrangement of the polar angle): when its W2² comes as
near to that as ours is, or nearer, and stays there. Both are timed by processor time.

    python benches/peers/transport.py [--level 3] [--intervals 16] [--most 600]
"""

from __future__ import annotations

import argparse
import time

import beltrami as bt
import numpy as np
import scipy.linalg
import scipy.sparse as sparse
from scipy.sparse.linalg import splu

CASES = {
    "smooth, positive everywhere": ((lambda z: np.exp(3 * (z - 1)) + 0.08), (lambda z: np.exp(-6 * (z + 0.3) ** 2) + 0.06)),
    "compact, zero elsewhere": ((lambda z: np.maximum(z - 0.4, 0) ** 2), (lambda z: np.maximum(0.3 - np.abs(z + 0.2), 0))),
}


def exact(profiles: tuple) -> float:
    """∫ (Q0 - Q1)² dq over the quantile functions of the polar angle."""
    angle, q, found = np.linspace(0, np.pi, 200_001), (np.arange(200_000) + 0.5) / 200_000, []
    for f in profiles:
        g = f(np.cos(angle)) * np.sin(angle)
        mass = np.r_[0, np.cumsum((g[1:] + g[:-1]) / 2)]
        found.append(np.interp(q, mass / mass[-1], angle))
    return float(np.mean((found[0] - found[1]) ** 2))


def lavenant(mesh: bt.TriangleMesh, start: np.ndarray, end: np.ndarray, n: int, most: int) -> list[tuple[float, float]]:
    """(seconds, W2²) after each iteration."""
    begin = time.process_time()
    p, faces = mesh.vertices[mesh.faces], mesh.faces
    edge = p[:, [2, 0, 1]] - p[:, [1, 2, 0]]
    normal = np.cross(edge[:, 0], edge[:, 1])
    areas = 0.5 * np.linalg.norm(normal, axis=1)
    hats = np.cross(normal[:, None], edge) / (4 * areas**2)[:, None, None]
    count, m = len(mesh.vertices), len(faces)
    mass = np.bincount(faces.ravel(), np.repeat(areas / 3, 3), count)
    rows = np.repeat(np.arange(3 * m).reshape(m, 3), 3, axis=0).reshape(m, 3, 3)
    columns = np.broadcast_to(faces[:, :, None], (m, 3, 3))
    gradient = sparse.csr_matrix((hats.ravel(), (rows.ravel(), columns.ravel())), shape=(3 * m, count))
    adjoint = sparse.csr_matrix(gradient.T.multiply(np.repeat(areas, 3)[None]))
    stiffness = (adjoint @ gradient).tocsc()
    gather = sparse.csr_matrix((np.repeat(areas / 6, 3), (faces.ravel(), np.arange(3 * m))), shape=(count, 3 * m))
    dt = 1 / n
    # Time: second differences at n + 1 times, the gradient's weight halved at both ends (each end belongs to one interval).
    second = np.diag(np.r_[1.0, np.full(n - 1, 2.0), 1.0]) - np.diag(np.ones(n), 1) - np.diag(np.ones(n), -1)
    weight = np.r_[0.5, np.ones(n - 1), 0.5] * dt
    shifts, modes = scipy.linalg.eigh(second / dt, np.diag(weight))
    solvers = [splu((s * sparse.diags(mass) + stiffness + (1e-10 * sparse.diags(mass) if s < 1e-9 else 0)).tocsc()) for s in shifts]
    phi, r = np.zeros((n + 1, count)), 1.0
    a, mu = np.zeros((n, count)), np.repeat(0.5 * (start + end)[None], n, axis=0)
    b, momentum = np.zeros((n, 2, m, 3, 3)), np.zeros((n, 2, m, 3, 3))  # interval, end, triangle, corner, coordinate
    boundary = np.zeros((n + 1, count))
    boundary[0], boundary[-1] = -mass * start, mass * end
    measure = np.broadcast_to((dt * areas / 6)[None, None, :, None, None], b.shape)
    course = []
    for iteration in range(1, most + 1):
        # the potential: r (A^T A) φ = boundary + A^T (r z - multipliers)
        right = boundary.copy()
        flow = mass * (r * a - mu)
        right[1:] += flow
        right[:-1] -= flow
        field = ((r * b - momentum) / 3).sum(3) / 2 * dt
        at_times = np.zeros((n + 1, m, 3))
        at_times[:-1] += field[:, 0]
        at_times[1:] += field[:, 1]
        right += np.stack([adjoint @ x.ravel() for x in at_times])
        spectral = modes.T @ right
        phi = modes @ np.stack([solver.solve(x) for solver, x in zip(solvers, spectral, strict=True)]) / r
        # the projection
        rate, slope = np.diff(phi, axis=0) / dt, np.stack([(gradient @ x).reshape(m, 3) for x in phi])
        slopes = np.stack([slope[:-1], slope[1:]], axis=1)[:, :, :, None, :]
        alpha, beta = rate + mu / r, slopes + momentum / r
        square = 0.5 * np.stack([gather @ x.ravel() for x in (beta**2).sum(4).sum(1)]) / mass
        excess = np.zeros_like(alpha)
        outside = alpha + square > 0
        x, c, s = np.maximum(alpha[outside], 0.0), alpha[outside], square[outside]
        for _ in range(25):
            value, derivative = c - x + s / (1 + x) ** 2, -1 - 2 * s / (1 + x) ** 3
            x = np.maximum(x - value / derivative, 0.0)
        excess[outside] = x
        a_new, b_new = alpha - excess, beta / (1 + excess[:, faces])[:, None, :, :, None]
        # multipliers and the penalty
        missed = np.sqrt(dt * (mass * (rate - a_new) ** 2).sum() + (measure * (slopes - b_new) ** 2).sum())
        moved = r * np.sqrt(dt * (mass * (a_new - a) ** 2).sum() + (measure * (b_new - b) ** 2).sum())
        a, b = a_new, b_new
        mu += r * (rate - a)
        momentum += r * (slopes - b)
        course.append((time.process_time() - begin, 2 * float((boundary * phi).sum())))
        if iteration % 10 == 0:
            r *= 2.0 if missed > 10 * moved else 0.5 if moved > 10 * missed else 1.0
    return course


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--level", type=int, default=3, help="of the sphere: 10 * 4^level + 2 vertices (3)")
    options.add_argument("--intervals", type=int, default=16)
    options.add_argument("--most", type=int, default=600, help="iterations of the peer")
    chosen = options.parse_args()
    bt.set_num_threads(1)
    mesh, n = bt.shapes.sphere(chosen.level), chosen.intervals
    z, mass = mesh.vertices @ np.array([1, -2, 0.5]) / np.sqrt(5.25), bt.operators(mesh).mass
    for name, profiles in CASES.items():
        answer = exact(profiles)
        start, end = (f(z) / (mass @ f(z)) for f in profiles)
        spent = np.inf
        for _ in range(3):
            begin = time.process_time()
            r = bt.transport(mesh, start, end, intervals=n)
            spent = min(spent, time.process_time() - begin)
        error = abs(r.distance**2 / answer - 1)
        print(f"{name}: {len(mesh.vertices)} vertices, {n} intervals; W2² = {answer:.6f}")
        print(f"  beltrami: {spent:.2f} s, {r.iterations} iterations, error {100 * error:.2f} %, gap {r.gap:.1e} proved")
        course = lavenant(mesh, start, end, n, chosen.most)
        errors = np.abs(np.array([value for _, value in course]) / answer - 1)
        for wanted in (0.05, 0.02, 0.01, error):
            outside = np.flatnonzero(errors > wanted)
            at = int(outside[-1]) + 1 if len(outside) else 0
            seconds, _ = course[min(at, len(course) - 1)]
            reached = (
                f"after {at + 1} iterations, {seconds:.1f} s:"
                if at < len(course)
                else f"not after {at} iterations, {seconds:.1f} s: more than"
            )
            print(f"  Lavenant's ADMM: within {100 * wanted:.2f} % {reached} {seconds / spent:.0f} times")
        print(f"  {1000 * course[-1][0] / len(course):.0f} ms an iteration, error {100 * errors[-1]:.2f} % at the end, no certificate")


if __name__ == "__main__":
    main()

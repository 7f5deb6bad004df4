"""Committors and reaction rates."""

from __future__ import annotations

import time

import numpy as np

import beltrami as bt
from beltrami.arrays import Floats

from . import Sheet, research_data, section

RING, TUBE = 2.0, 0.8
WELLS = ((6.0, 0.0, 0.3), (4.5, 2.0, 1.5), (5.5, -1.9, -0.6))  # depth and both angles of each


def on_torus(angle: Floats, turn: Floats) -> Floats:
    """Points of the torus by their two angles."""
    far = RING + TUBE * np.cos(turn)
    return np.stack([far * np.cos(angle), far * np.sin(angle), TUBE * np.sin(turn)], -1)


def three_wells(x: Floats) -> Floats:
    """Energy on the torus, in units of kT."""
    angle, turn = _angles(x).T
    wells = [depth * np.exp(2.5 * (np.cos(angle - a) - 1) + 1.5 * (np.cos(turn - t) - 1)) for depth, a, t in WELLS]
    return np.asarray(-np.sum(wells, axis=0))


def samples(count: int, temperature: float, seed: int) -> Floats:
    """Exact samples of exp(-U / temperature) by area, by rejection; inf: uniform ones."""
    rng = np.random.default_rng(seed)
    found = np.empty((0, 3))
    while len(found) < count:
        angle, turn = rng.uniform(-np.pi, np.pi, (2, 20 * count))
        x = on_torus(angle, turn)
        chance = (RING + TUBE * np.cos(turn)) / (RING + TUBE)
        if np.isfinite(temperature):
            chance = chance * np.exp(-(three_wells(x) + 6.3) / temperature)
        found = np.concatenate([found, x[rng.random(len(x)) < chance]])
    return found[:count]


def three_holes(x: Floats) -> Floats:
    """Two deep wells, joined directly and by way of a shallow third one (Metzner, Schütte and Vanden-Eijnden 2006)."""

    def hole(depth: float, p: float, q: float) -> Floats:
        return np.asarray(depth * np.exp(-((x[:, 0] - p) ** 2) - (x[:, 1] - q) ** 2))

    wells = hole(3, 0, 1 / 3) + hole(-3, 0, 5 / 3) + hole(-5, 1, 0) + hole(-5, -1, 0)
    return np.asarray(wells + 0.2 * x[:, 0] ** 4 + 0.2 * (x[:, 1] - 1 / 3) ** 4)


@section("Committors: three wells on a torus")
def torus(sheet: Sheet) -> None:
    sheet.text(
        "The committor q is the probability of reaching a set B before a set A for dX = -grad U dt + sqrt(2/β) dW (section 8.4). It is "
        "solved for on points alone, of any density: here uniform ones, samples of a hotter and of the same temperature on one torus. "
        "The local mesh carries the area, so no density of samples is estimated, and the rates agree. Each comes with a second "
        "estimate with another discretization, the flux through the surfaces q = 0.1 to 0.9."
    )
    a_place, b_place = (on_torus(np.array(WELLS[k][1]), np.array(WELLS[k][2])) for k in (0, 2))
    rows, shown = [], None
    for name, temperature in (("uniform", np.inf), ("2.5 times as hot", 2.5), ("of the same temperature", 1.0)):
        x = samples(8000, temperature, 3)
        inside = [np.linalg.norm(x - place, axis=1) < 0.3 for place in (a_place, b_place)]
        start = time.perf_counter()
        r = bt.committor(bt.PointCloud(x), three_wells(x), *inside, beta=1.0)
        seconds = time.perf_counter() - start
        forth, back = r.mean_first_passage_times
        rows.append((name, r.rate, r.rate_flux, r.rate_flux_error, forth, back, r.diagnostics.transition_points, r.verdict, seconds))
        shown = shown or r
    assert shown is not None
    header = ("samples", "rate", "by flux", "±", "time A to B", "B to A", "points with 0.1 < q < 0.9", "verdict", "seconds")
    sheet.table(header, rows, caption="8,000 points each.")
    sheet.code(
        "r = bt.committor(bt.PointCloud(x), U, A, B, beta=1.0)\nr.q, r.rate, r.rate_constant, r.mean_first_passage_times\n"
        "r.streamlines(40), r.path(), r.transition_states(), r.verdict"
    )
    surface = bt.shapes.torus(RING, TUBE, rows=150, columns=60)
    towards = [(np.cos(angle), np.sin(angle), height) for angle, height in ((-0.95, 0.35), (2.1, 0.7))]
    sheet.picture(
        surface,
        _carried(shown, surface.vertices),
        label="committor",
        limits=(0.0, 1.0),
        contours=[k / 10 for k in range(1, 10)],
        views={"A to the right, B to the left": towards[0], "from behind, over the third well": towards[1]},
        up="z",
        lines=shown.streamlines(30),
        line_color="#ffffff",
        points=np.stack([a_place, b_place, on_torus(np.array(WELLS[1][1]), np.array(WELLS[1][2]))]),
        point_color=["#c72e29", "#016392", "#9aa3ad"],
        title="The probability of reaching B before A",
        caption="Red: A, blue: B, grey: the third well. White: lines of the mean reactive current, started in proportion to the flux. They "
        "part around the torus; some pass by the third well.",
        interactive=True,
        size=(1600, 820),
    )


def _carried(r: bt.CommittorResult, places: Floats) -> Floats:
    """q at other places of the torus: linear functions of both angles, fitted to the nearest points."""
    assert isinstance(r.shape, bt.PointCloud)
    near, distance = bt.nearest_neighbors(r.shape.points, places, 12)
    weight = np.exp(-((distance / (0.6 * distance[:, -1:])) ** 2))
    away = _angles(r.shape.points)[near] - _angles(places)[:, None]
    away = (away + np.pi) % (2 * np.pi) - np.pi
    rows = np.concatenate([np.ones((*near.shape, 1)), away], axis=2)
    normal = np.einsum("pk,pka,pkb->pab", weight, rows, rows) + 1e-12 * np.eye(3)
    right = np.einsum("pk,pka,pk->pa", weight, rows, r.q[near])
    return np.clip(np.linalg.solve(normal, right[:, :, None])[:, 0, 0], 0, 1)


def _angles(x: Floats) -> Floats:
    """Both angles of points of the torus."""
    return np.stack([np.arctan2(x[:, 1], x[:, 0]), np.arctan2(x[:, 2], np.hypot(x[:, 0], x[:, 1]) - RING)], -1)


@section("Committors: three holes in the plane")
def plane(sheet: Sheet) -> None:
    sheet.text(
        "Two deep wells with two ways between them: directly over a high pass, and through a shallow third well over two lower ones. Which "
        "one reactions take depends on the temperature. Hot, most cross directly; cold, most take the detour."
    )
    rng = np.random.default_rng(5)
    x = rng.uniform([-2.6, -2.2], [2.6, 2.9], (60_000, 2))
    x = x[three_holes(x) <= 2.5][:12_000]
    energy = three_holes(x)
    rows = []
    around = np.linspace(0, 2 * np.pi, 60)
    rims = [np.column_stack([at + 0.3 * np.cos(around), -0.042 + 0.3 * np.sin(around)]) for at in (-1.048, 1.048)]
    for beta in (1.67, 6.67):
        r = bt.committor(
            bt.PointCloud(x),
            three_holes,
            lambda p: np.hypot(p[:, 0] + 1.048, p[:, 1] + 0.042) - 0.3,
            lambda p: np.hypot(p[:, 0] - 1.048, p[:, 1] + 0.042) - 0.3,
            beta=beta,
        )
        cut = r.isocommittor(0.5)
        detour = float(cut.flux[cut.points[:, 1] > 1.0].sum())
        rows.append(
            (beta, r.rate, r.rate_flux, r.rate_flux_error, 100 * detour, float(np.ptp(energy[r.transition_states(0.05)])), r.verdict)
        )
        sheet.picture(
            bt.TriangleMesh(x, bt.operators(bt.PointCloud(x)).simplices),  # type: ignore[attr-defined]
            r.q,
            label="committor",
            limits=(0.0, 1.0),
            contours=[k / 10 for k in range(1, 10)],
            lines=[*r.streamlines(24), r.path(), *rims],
            line_color=["#ffffff"] * 24 + ["#ff5a36", "#c72e29", "#016392"],
            title=f"β = {beta:g}: {100 * detour:.0f} % of the reactions pass by the upper well",
            caption="Circles: A (red), B (blue). White: the reactive current. Orange: the path of the greatest flux, along edges.",
            size=(1600, 1000),
        )
    header = ("β", "rate", "by flux", "±", "by the upper well, %", "range of U where q is about 1/2", "verdict")
    sheet.table(header, rows, caption="12,000 uniform points, the potential as a function, A and B as level functions.")


@section("Committors: alanine dipeptide")
def dipeptide(sheet: Sheet) -> None:
    files = research_data("committor/ala2_900K.npz")
    if files is None:
        sheet.text(
            "The trajectory for this section does not come with the package: set `BELTRAMI_DATA` to a folder with "
            "`committor/ala2_900K.npz` (arrays phi_rad, psi_rad). The torus above is the same problem with a made potential."
        )
        return
    with np.load(files[0]) as data:
        angles = np.stack([data["phi_rad"], data["psi_rad"]], 1).astype(float)[::2]
    sheet.text(
        "The two backbone angles of alanine dipeptide, simulated in vacuum at 900 K, as points of the flat torus in R^4. The potential is "
        "not known there; the density of the samples stands for it (`sampling='gibbs'`, in units of kT). A is the basin of C7eq, B that of "
        "C7ax. Diffusion along the angles is not known either, so the rate has no absolute unit, but q does not depend on it."
    )

    def near(phi: float, psi: float) -> Floats:
        return np.asarray(np.linalg.norm((angles - [phi, psi] + np.pi) % (2 * np.pi) - np.pi, axis=1))

    start = time.perf_counter()
    cloud = bt.PointCloud(bt.molecules.on_torus(angles))
    r = bt.committor(cloud, None, near(-1.4, 1.2) < 0.5, near(1.2, -0.8) < 0.5, beta=1.0, sampling="gibbs")
    seconds = time.perf_counter() - start
    found = r.diagnostics
    sheet.figures(
        {
            "frames": len(angles),
            "points with 0.1 < q < 0.9": found.transition_points,
            "effective samples of the transition": found.transition_sample_size,
            "seconds": seconds,
        }
    )
    sheet.text(f"Verdict: {r.verdict}. {r.assumption.capitalize()}.")
    sheet.code(
        "angles = bt.molecules.dihedral_angles(positions, [[1, 3, 4, 6], [3, 4, 6, 8]])\n"
        'cloud = bt.PointCloud(bt.molecules.on_torus(angles))\nr = bt.committor(cloud, None, A, B, beta=1.0, sampling="gibbs")'
    )
    ends = np.pi * np.linspace(-1, 1, 5)
    grid = [np.array([[at, -np.pi], [at, np.pi]]) for at in ends] + [np.array([[-np.pi, at], [np.pi, at]]) for at in ends]
    sheet.picture(
        bt.PointCloud(angles),
        {"committor": r.q, "free energy (kT)": np.minimum(r.potential, 8.0)},
        lines=grid,
        line_color="#c9cfd8",
        line_width=1.5,
        radius=0.022,
        title="Alanine dipeptide: committor and free energy over φ (to the right) and ψ (upwards)",
        caption="One point per frame; both angles run from -π to π, with lines at -π, -π/2, 0, π/2, π. Opposite sides are the same.",
        size=(1600, 900),
    )

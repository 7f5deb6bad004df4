"""Closest points and rays on a mesh: beltrami (double precision) and open3d (single), tree included, in turn, in one process.

python benches/peers/closest.py [queries]
"""

import sys

import beltrami as bt
import numpy as np
from neighbors import compare


def main():
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    mesh = bt.shapes.torus(rows=1000, columns=500)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    rng = np.random.default_rng(0)
    low, high = vertices.min(0), vertices.max(0)
    near = vertices[rng.integers(0, len(vertices), count)] + 0.005 * np.linalg.norm(high - low) * rng.normal(size=(count, 3))
    wide = rng.uniform(low - 0.2 * (high - low), high + 0.2 * (high - low), (count, 3))
    towards = rng.normal(size=(count, 3))
    try:
        import open3d
    except (ImportError, OSError):
        open3d = None

    def scene():
        made = open3d.t.geometry.RaycastingScene()
        made.add_triangles(open3d.core.Tensor(vertices.astype(np.float32)), open3d.core.Tensor(faces.astype(np.uint32)))
        return made

    for name, queries in (("near the surface", near), ("in its box", wide)):
        runners = {"beltrami": lambda queries=queries: bt.closest_points(mesh, queries)}
        if open3d:
            runners["open3d"] = lambda queries=queries: scene().compute_closest_points(open3d.core.Tensor(queries.astype(np.float32)))
        compare(f"{count} closest, {len(faces)} faces, {name}", runners)
    runners = {"beltrami": lambda: bt.intersect_rays(mesh, wide, towards)}
    if open3d:
        runners["open3d"] = lambda: scene().cast_rays(open3d.core.Tensor(np.hstack([wide, towards]).astype(np.float32)))
    compare(f"{count} rays, {len(faces)} faces", runners)


if __name__ == "__main__":
    main()

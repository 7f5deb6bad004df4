"""Cotangent stiffness and lumped mass: beltrami, numpy with scipy.sparse, and libigl on the same sphere, in turn, in one process.

python benches/peers/assembly.py [frequency of the sphere]
"""

import sys

import beltrami as bt
import numpy as np
import scipy.sparse as sparse
from neighbors import compare


def with_numpy(vertices, faces):
    """The usual vectorized assembly: half cotangents of each corner, summed up by a COO matrix."""
    n = len(vertices)
    corners = [vertices[faces[:, k]] for k in range(3)]
    rows, columns, values = [], [], []
    for k in range(3):
        a, b = corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]
        cross = np.linalg.norm(np.cross(a, b), axis=1)
        half = 0.5 * np.einsum("ij,ij->i", a, b) / cross
        i, j = faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        rows += [i, j, i, j]
        columns += [j, i, i, j]
        values += [-half, -half, half, half]
    parts = (np.concatenate(rows), np.concatenate(columns))
    stiffness = sparse.coo_array((np.concatenate(values), parts), shape=(n, n)).tocsr()
    return stiffness, np.bincount(faces.ravel(), np.repeat(cross / 6, 3), n)


def main():
    mesh = bt.shapes.sphere(frequency=int(sys.argv[1]) if len(sys.argv) > 1 else 316)
    vertices, faces = mesh.vertices, mesh.faces

    def own():
        ops = bt.operators(bt.TriangleMesh(vertices, faces), laplacian="cotangent")
        return ops.stiffness, ops.mass

    runners = {"beltrami": own, "numpy": lambda: with_numpy(vertices, faces)}
    try:
        import igl

        runners["libigl"] = lambda: (
            igl.cotmatrix(vertices, faces),
            igl.massmatrix(vertices, faces, igl.MASSMATRIX_TYPE_BARYCENTRIC),
        )
    except ImportError:
        print("libigl is not installed")
    compare(f"stiffness and mass, {len(vertices)}", runners)


if __name__ == "__main__":
    main()

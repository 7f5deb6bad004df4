"""The 50 smallest eigenpairs of a mesh: beltrami, LaPy and scipy's eigsh on the same sphere, in turn, in one process.

python benches/peers/eigenpairs.py [level of the icosphere]
"""

import sys

import beltrami as bt
import numpy as np
import scipy.sparse as sparse
import scipy.sparse.linalg as linalg
from neighbors import compare


def main():
    mesh = bt.shapes.sphere(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
    ops = bt.operators(mesh, laplacian="cotangent")
    matrix, mass = sparse.csc_array(ops.stiffness), sparse.diags_array(ops.mass).tocsc()
    runners = {
        "beltrami": lambda: bt.eigenpairs(bt.TriangleMesh(mesh.vertices, mesh.faces), 50),
        "eigsh": lambda: linalg.eigsh(matrix, 50, mass, sigma=-0.01, v0=np.ones(len(ops.mass))),
    }
    try:
        import lapy

        runners["LaPy"] = lambda: lapy.Solver(lapy.TriaMesh(mesh.vertices, mesh.faces)).eigs(50)
    except ImportError:
        print("LaPy is not installed")
    compare(f"50 eigenpairs, {len(ops.mass)}", runners)


if __name__ == "__main__":
    main()

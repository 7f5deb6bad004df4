"""Trajectories, alignment, dihedral angles."""

import sys
from pathlib import Path

import beltrami as bt
import numpy as np
import pytest
from beltrami import molecules

FRAMES = np.random.default_rng(0).normal(size=(4, 6, 3)).round(3)


def pdb(path: Path) -> Path:
    """Four models of six atoms, in Ångström with three decimals, as the format has it."""
    lines = []
    for number, frame in enumerate(FRAMES):
        lines.append(f"MODEL     {number + 1:>4}")
        lines += [
            f"ATOM  {k + 1:>5}  {'CA' if k < 2 else 'CB'}  ALA A{k + 1:>4}    {x:8.3f}{y:8.3f}{z:8.3f}  1.00  0.00           C"
            for k, (x, y, z) in enumerate(frame)
        ]
        lines.append("ENDMDL")
    path.write_text("\n".join([*lines, "END", ""]))
    return path


@pytest.mark.parametrize("reader", ["MDAnalysis", "mdtraj"])
def test_trajectories_are_read(reader: molecules.Reader, tmp_path: Path) -> None:
    pytest.importorskip(reader)
    path = pdb(tmp_path / "a.pdb")
    np.testing.assert_allclose(molecules.load(path, reader=reader), FRAMES / 10, atol=1e-6)  # nm; single precision
    chosen = molecules.load(path, selection="name CA", stride=2, reader=reader)
    np.testing.assert_allclose(chosen, FRAMES[::2, :2] / 10, atol=1e-6)
    with pytest.raises(bt.InputError, match="no atom"):
        molecules.load(path, selection="name XX", reader=reader)
    with pytest.raises(bt.FileError):
        molecules.load(tmp_path / "absent.pdb", reader=reader)
    (tmp_path / "broken.dcd").write_bytes(b"nothing")
    with pytest.raises(bt.FileError, match="broken"):
        molecules.load(path, tmp_path / "broken.dcd", reader=reader)


def test_missing_readers_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for package in ("MDAnalysis", "mdtraj"):
        monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(bt.DependencyError, match=r"beltrami\[molecules\]"):
        molecules.load(pdb(tmp_path / "a.pdb"))


def test_alignment_takes_motions_off() -> None:
    rng = np.random.default_rng(1)
    turns = np.linalg.qr(rng.normal(size=(20, 3, 3)))[0]
    turns[:, :, 0] *= np.linalg.det(turns)[:, None]
    moved = FRAMES[0] @ turns + rng.normal(size=(20, 1, 3))
    np.testing.assert_allclose(molecules.align(moved, FRAMES[0]), np.repeat(FRAMES[:1], 20, 0), atol=1e-12)
    mean = molecules.align(moved)
    assert np.ptp(mean, axis=0).max() < 1e-12
    np.testing.assert_allclose(molecules.pair_distances(moved), molecules.pair_distances(mean), atol=1e-12)
    mirrored = molecules.align(-FRAMES[:1], FRAMES[0])  # a rotation cannot make it the same
    assert np.abs(mirrored - FRAMES[0]).max() > 0.1


def test_dihedral_angles_turn_with_the_last_atom() -> None:
    angles = np.linspace(-np.pi + 0.01, np.pi, 50)
    chain = np.array([[1.0, 0, 0], [0, 0, 0], [0, 0, 1]])
    # seen along the axis, from the second atom, the turn from x to y is clockwise: that counts as positive
    last = np.stack([np.cos(angles), np.sin(angles), np.full(50, 1.0)], 1)
    frames = np.concatenate([np.repeat(chain[None], 50, 0), last[:, None]], 1)
    found = molecules.dihedral_angles(frames, [[0, 1, 2, 3]])[:, 0]
    np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * angles), atol=1e-12)
    torus = molecules.on_torus(found[:, None])
    np.testing.assert_allclose(np.linalg.norm(torus, axis=1), 1)
    with pytest.raises(bt.InputError, match="in a line"):
        molecules.dihedral_angles([[[0, 0, 0], [0, 0, 1], [0, 0, 2], [0, 1, 2]]], [[0, 1, 2, 3]])
    with pytest.raises(bt.InputError, match="atoms"):
        molecules.dihedral_angles(frames, [[0, 1, 2, 9]])


@pytest.mark.parametrize("scale", [1e-300, 1e-100, 1e100, 1e299])
def test_any_unit_of_length_will_do(scale: float) -> None:
    np.testing.assert_allclose(molecules.align(FRAMES * scale) / scale, molecules.align(FRAMES), atol=1e-12)
    turned = molecules.align(FRAMES * scale, FRAMES[0])
    assert np.isfinite(turned).all()
    np.testing.assert_allclose(molecules.pair_distances(FRAMES * scale) / scale, molecules.pair_distances(FRAMES), rtol=1e-12)
    angles = molecules.dihedral_angles(FRAMES, [[0, 1, 2, 3]])
    np.testing.assert_allclose(molecules.dihedral_angles(FRAMES * scale, [[0, 1, 2, 3]]), angles, atol=1e-10)


def test_faults_are_named() -> None:
    with pytest.raises(bt.InputError, match="larger unit"):
        molecules.pair_distances(FRAMES * 1e307)
    with pytest.raises(bt.InputError, match="atoms cannot be read as an array"):
        molecules.dihedral_angles(FRAMES, [[0, 1], [2]])
    for topology, trajectories in ((None, ()), (5, ()), ("a.pdb", 5), ("a.pdb", None), ("a.pdb", [None])):
        with pytest.raises(bt.InputError, match=r"topology is|trajectories is"):
            molecules.load(topology, trajectories)  # type: ignore[arg-type]
    with pytest.raises(bt.InputError, match="selection is 5"):
        molecules.load("a.pdb", selection=5)  # type: ignore[arg-type]

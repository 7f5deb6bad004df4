"""The command line: what it prints, what it writes, with which exit code it ends."""

from __future__ import annotations

import argparse
import subprocess
import sys

import beltrami as bt
import numpy as np
import pytest
from beltrami.__main__ import main, parser
from beltrami.commands import COMMANDS, command, load_commands


def test_info_prints_the_topology(capsys):
    assert main(["info", "example:bob"]) == 0
    printed = capsys.readouterr().out
    assert "334 in R^3" in printed
    assert any(line.split() == ["genus", "1"] for line in printed.splitlines())


def test_info_of_a_cloud(tmp_path, capsys):
    np.savetxt(tmp_path / "cloud.xyz", np.random.default_rng(0).normal(size=(20, 3)))
    assert main(["info", str(tmp_path / "cloud.xyz")]) == 0
    assert "20 in R^3" in capsys.readouterr().out


def test_convert_loses_nothing(tmp_path):
    assert main(["convert", "example:spot", str(tmp_path / "spot.ply")]) == 0
    spot, again = bt.examples.spot(), bt.load(tmp_path / "spot.ply")
    assert np.array_equal(again.vertices, spot.vertices)
    assert np.array_equal(again.faces, spot.faces)
    assert np.array_equal(again.data["colors"], spot.data["colors"])


def test_plot_paints_and_makes_pages(tmp_path, capsys):
    spot = bt.examples.spot()
    np.save(tmp_path / "height.npy", spot.vertices[:, 1])
    (tmp_path / "height.csv").write_text("height\n" + "\n".join(map(repr, spot.vertices[:, 1].tolist())))
    outs = [str(tmp_path / name) for name in ("a.png", "b.html")]
    assert main(["plot", "example:spot", "--values", str(tmp_path / "height.npy"), "--size", "200x150", "-o", outs[0], "-o", outs[1]]) == 0
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    assert "<canvas" in (tmp_path / "b.html").read_text(encoding="utf-8")
    assert f"wrote {outs[1]}" in capsys.readouterr().out
    more = ["--values", str(tmp_path / "height.csv"), "--size", "200x150", "-o", str(tmp_path / "c.png")]
    assert main(["plot", "example:spot", *more]) == 0
    wanted = bt.plot(spot, spot.vertices[:, 1], label="height", size=(200, 150))
    assert wanted.png() == (tmp_path / "c.png").read_bytes() == (tmp_path / "a.png").read_bytes()


def test_eigen_prints_and_writes(tmp_path, capsys):
    bt.save(bt.shapes.sphere(3), tmp_path / "sphere.ply")
    outs = [arg for name in ("a.npz", "a.csv", "a.ply", "a.png") for arg in ("-o", str(tmp_path / name))]
    assert main(["eigen", str(tmp_path / "sphere.ply"), "-k", "9", "--size", "300x200", *outs]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["eigenvalue", "residual"]
    printed = np.array([[float(cell) for cell in line.split()] for line in lines[1:10]])
    # 0, 2 three times, 6 five times; the triangles of this sphere are 2 % off at most
    assert printed[1:, 1] == pytest.approx([2] * 3 + [6] * 5, rel=0.02)
    assert printed[:, 2].max() < 1e-6
    with np.load(tmp_path / "a.npz") as archive:
        assert archive["functions"].shape == (642, 9)
        assert archive["values"] == pytest.approx(printed[:, 1], rel=1e-5, abs=1e-10)
        saved = bt.load(tmp_path / "a.ply")
        assert np.array_equal(saved.data["functions_3"], archive["functions"][:, 3])
        rows = (tmp_path / "a.csv").read_text().splitlines()
        assert rows[0] == ",".join(f"functions_{k}" for k in range(9))
        assert np.array_equal(np.loadtxt(rows[1:], delimiter=","), archive["functions"])
    assert (tmp_path / "a.png").exists()


def test_sphere_prints_and_writes(tmp_path, capsys):
    outs = [arg for name in ("a.npz", "a.csv", "a.png") for arg in ("-o", str(tmp_path / name))]
    assert main(["sphere", "example:spot", "--size", "300x200", *outs]) == 0
    printed = dict(line.split("  ", 1) for line in capsys.readouterr().out.splitlines() if "  " in line)
    assert printed["flipped triangles"].strip() == "0"
    with np.load(tmp_path / "a.npz") as archive:
        found = bt.spherical_map(bt.examples.spot())
        assert np.array_equal(archive["positions"], found.positions)
    assert (tmp_path / "a.csv").read_text().startswith("positions_0,positions_1,positions_2,conformal_factor\n")
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    assert main(["sphere", "example:bob"]) == 2  # genus 1
    assert "Euler characteristic 0" in capsys.readouterr().err


def test_geodesic_prints_and_writes(tmp_path, capsys):
    bt.save(bt.shapes.sphere(4), tmp_path / "sphere.ply")
    assert (
        main(["geodesic", str(tmp_path / "sphere.ply"), "--source", "5", "-o", str(tmp_path / "d.npz"), "-o", str(tmp_path / "d.html")])
        == 0
    )
    table = dict(line.rsplit(maxsplit=1) for line in capsys.readouterr().out.splitlines() if "wrote" not in line)
    assert float(table["greatest distance"]) == pytest.approx(np.pi, rel=0.05)
    with np.load(tmp_path / "d.npz") as archive:
        distance = archive["distance"]
    exact = np.arccos(np.clip(bt.shapes.sphere(4).vertices @ bt.shapes.sphere(4).vertices[5], -1, 1))
    assert np.abs(distance - exact).mean() < 0.03  # some 1 % of the diameter, the heat method's own error at this size


def test_doctor_is_content(capsys):
    assert main(["doctor"]) == 0
    printed = capsys.readouterr().out
    assert "residual" in printed
    assert bt.__version__ in printed


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["info", "nowhere.ply"], "nowhere.ply"),
        (["info", "example:dragon"], "spot, bob, cortex"),
        (["plot", "example:bob", "-o", "a.jpg"], ".png"),
        (["plot", "example:bob", "-o", "a.png", "--values", "weight"], "no such file"),
        (["plot", "example:bob", "-o", "a.png", "--size", "large"], "1600x1000"),
        (["plot", "example:bob", "-o", "a.png", "--view", "moon"], "three-quarter"),
        (["convert", "example:bob", "bob.doc"], "bob.doc"),
        (["eigen", "example:bob", "-k", "0"], "-k"),
        (["eigen", "example:bob", "-o", "a.doc"], ".npz"),
        (["geodesic", "example:bob", "--source", "334"], "334"),
        (["gallery", "--only", "cookery"], "cookery"),
        (["info", "example:bob", "--threads", "0"], "--threads"),
        (["transport", "example:bob", "--from", "vertex:3"], "--to"),
        (["transport", "example:bob", "--from", "vertex:x", "--to", "uniform"], "vertex:120"),
        (["transport", "example:bob", "--from", "vertex:999", "--to", "uniform"], "999"),
        (["game", "example:bob", "--from", "uniform", "--to", "vertex:3", "--target", "vertex:4"], "leave one out"),
        (["game", "example:bob", "--from", "uniform", "--power", "3"], "1.05 to 2"),
    ],
)
def test_bad_input_ends_with_2_and_one_line(arguments, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert words in captured.err
    assert captured.err.count("\n") == 1
    assert "Traceback" not in captured.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("arguments", [[], ["no-such-command"], ["info"], ["info", "a", "--no-such-option"]])
def test_misuse_ends_with_2_and_one_line(arguments, capsys):
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert said.startswith("beltrami")
    assert "--help" in said
    assert said.count("\n") == 1


def test_convert_takes_its_file_either_way(tmp_path, capsys):
    first, second = tmp_path / "first.stl", tmp_path / "second.off"
    assert main(["convert", "example:spot", str(first)]) == 0
    said = capsys.readouterr()
    assert "note: " in said.err  # STL has no place for colours: a line of its own, without a place in the source
    assert ".py" not in said.err
    assert main(["convert", str(first), "-o", str(second)]) == 0
    assert len(bt.load(second).faces) == len(bt.examples.spot().faces)
    for wrong in ([], [str(second), "-o", str(second)]):
        assert main(["convert", str(first), *wrong]) == 2
        assert "name one file" in capsys.readouterr().err


def test_distances_know_the_examples_and_say_where_nothing_can_be_written(tmp_path, capsys):
    out = tmp_path / "folder" / "distances.csv"
    assert main(["distances", "example:spot", "example:bob", "--method", "shape_dna", "-o", str(out)]) == 0
    assert out.read_text().splitlines()[0] == "spot,bob"
    out = tmp_path / "folder" / "distances.csv" / "below_a_file.npz"
    assert main(["distances", "example:spot", "example:bob", "--method", "shape_dna", "-o", str(out)]) == 2
    assert capsys.readouterr().err.count("cannot be written") == 1
    assert main(["distances", "example:spot"]) == 2
    assert "two files" in capsys.readouterr().err


def test_clouds_of_other_dimensions(tmp_path, capsys):
    angles = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    circle = tmp_path / "circle.csv"
    np.savetxt(circle, np.column_stack([np.cos(angles), np.sin(angles)]), delimiter=",", header="x,y", comments="")
    assert main(["eigen", str(circle), "--dimension", "1", "-k", "5"]) == 0
    printed = [line.split() for line in capsys.readouterr().out.splitlines()]
    values = [float(words[1]) for words in printed if len(words) == 3 and words[0].isdigit()]
    assert np.allclose(values, [0, 1, 1, 4, 4], atol=0.01)


@pytest.mark.parametrize("name", sorted(load_commands()))
def test_every_command_explains_itself(name, capsys):
    assert main([name, "--help"]) == 0
    assert COMMANDS[name].summary[1:] in " ".join(capsys.readouterr().out.split())


def test_other_ends(monkeypatch, capsys):
    for error, code, words in ((bt.ConvergenceError("gap 0.3"), 1, "not converged: gap 0.3"), (KeyboardInterrupt(), 130, "stopped")):

        def fail(options, error=error):
            raise error

        with monkeypatch.context() as patch:
            patch.setitem(COMMANDS, "fail", command("fail", "fails", lambda parser: None)(fail) and COMMANDS["fail"])
            assert main(["fail"]) == code
        assert words in capsys.readouterr().err
    COMMANDS.pop("fail", None)


def test_it_runs_as_a_module():
    ran = subprocess.run([sys.executable, "-m", "beltrami", "--version"], capture_output=True, text=True, timeout=60, check=False)
    assert (ran.returncode, ran.stdout.strip()) == (0, f"beltrami {bt.__version__}")


def test_transport_and_games(tmp_path, capsys):
    bob = ["example:bob", "--intervals", "4"]
    flow, film, strip = (str(tmp_path / name) for name in ("flow.npz", "flow.html", "game.png"))
    ends = ["--from", "vertex:3:0.2", "--to", "uniform", "--tolerance", "0.02"]
    assert main(["transport", *bob, *ends, "-o", flow, "-o", film, "--times", "2", "--size", "120x90"]) == 0
    printed = capsys.readouterr().out
    assert "proved lower bound" in printed
    with np.load(flow) as kept:
        assert kept["density"].shape == (5, 334)
        assert kept["density"].min() >= 0
        cost, bound, gap = kept["cost"], kept["lower_bound"], kept["gap"]
        assert bound <= cost <= bound * 1.03
        assert gap <= 0.02
    assert "<input" in (tmp_path / "flow.html").read_text(encoding="utf-8")
    game = ["--from", "vertex:3:0.3", "--target", "vertex:200:0.3", "--congestion", "0.2", "--entropy", "0.1", "--tolerance", "0.02"]
    assert main(["game", *bob, *game, "-o", strip, "--times", "2", "--size", "200x120"]) == 0
    assert "exploitability" in capsys.readouterr().out
    assert main(["transport", *bob, *ends[:4], "--tolerance", "1e-9", "--max-iterations", "2"]) == 1
    assert "not converged" in capsys.readouterr().out


def test_committor_prints_and_writes(tmp_path, capsys):
    x = np.random.default_rng(0).uniform([-1.5, -0.5], [1.5, 0.5], (800, 2))
    energy, a, b = (x[:, 0] ** 2 - 1) ** 2, x[:, 0] < -0.8, x[:, 0] > 0.8
    np.savez(tmp_path / "in.npz", points=x, potential=energy, A=a, B=b)
    np.savetxt(tmp_path / "in.csv", np.c_[x, energy, a, b], delimiter=",", header="x,y,potential,A,B", comments="", fmt="%.17g")
    outs = [item for name in ("q.npz", "q.csv", "q.png") for item in ("-o", str(tmp_path / name))]
    assert main(["committor", str(tmp_path / "in.npz"), "--beta", "4", "--size", "300x200", *outs]) == 0
    assert "verdict" in capsys.readouterr().out
    exact = bt.committor(bt.PointCloud(x), energy, a, b, beta=4.0)
    with np.load(tmp_path / "q.npz") as written:
        assert np.array_equal(written["q"], exact.q)
        assert float(written["rate"]) == exact.rate
    assert main(["committor", str(tmp_path / "in.csv"), "--beta", "4", "-o", str(tmp_path / "again.npz")]) == 0
    with np.load(tmp_path / "again.npz") as written:
        assert np.array_equal(written["q"], exact.q)
    ball = ["--A", "ball:-1,0,0.3", "--B", "ball:1,0,0.3"]
    assert main(["committor", str(tmp_path / "in.npz"), "--beta", "4", *ball]) == 0
    for wrong in (
        ["--beta", "-1"],
        ["--beta", "4", "--A", "absent"],
        ["--beta", "4", "--A", "ball:1"],
        ["--beta", "4", "--potential", "no"],
    ):
        assert main(["committor", str(tmp_path / "in.npz"), *wrong]) == 2


ARCHIVES = {
    "eigen": (["-k", "4"], lambda s: bt.eigenpairs(s, 4)),
    "segment": (["--values", "height", "--fidelity", "100"], lambda s: bt.segment(s, s.data["height"])),
    "denoise": (["--values", "height", "--fidelity", "100"], lambda s: bt.denoise(s, s.data["height"])),
    "sphere": ([], lambda s: bt.spherical_map(s)),
    "skeleton": ([], lambda s: bt.skeleton(s)),
    "transport": (["--from", "height", "--to", "uniform", "--intervals", "2", "--tolerance", "0.5"],
                  lambda s: bt.transport(s, s.data["height"], np.ones(162), normalize=True, intervals=2, tolerance=0.5)),
    "game": (["--from", "height", "--to", "uniform", "--intervals", "2", "--tolerance", "0.5", "--congestion", "1"],
             lambda s: bt.mean_field_game(s, s.data["height"], np.ones(162), normalize=True, intervals=2, tolerance=0.5,
                                          running_cost=bt.costs.congestion(1.0))),
    "committor": (["--beta", "2", "--potential", "height", "--A", "A", "--B", "B"],
                  lambda s: bt.committor(s, s.data["height"], s.data["A"] != 0, s.data["B"] != 0, beta=2.0)),
}  # fmt: skip


@pytest.mark.parametrize("name", ARCHIVES)
def test_archives_hold_what_save_writes(name, tmp_path, capsys):
    mesh = bt.shapes.ellipsoid(1.0, 0.8, 1.3, level=2)
    z = mesh.vertices[:, 2]
    data = {"height": z + 2.0, "A": (z < -1).astype(float), "B": (z > 1).astype(float)}
    bt.save(bt.TriangleMesh(mesh.vertices, mesh.faces, data=data), tmp_path / "in.ply")
    options, method = ARCHIVES[name]
    assert main([name, str(tmp_path / "in.ply"), *options, "-o", str(tmp_path / "deep" / "a.npz")]) in (0, 1)
    saved = method(bt.load(tmp_path / "in.ply")).save(tmp_path / "b.npz")
    with np.load(tmp_path / "deep" / "a.npz") as one, np.load(saved) as other:
        assert one.files == other.files
        lasting = [key for key in one.files if not key.startswith("history")]  # steps depend on options that differ
        assert {key: one[key].shape for key in lasting} == {key: other[key].shape for key in lasting}


def test_a_missing_folder_is_made_for_shapes_too(tmp_path, capsys):
    bt.save(bt.shapes.sphere(1), tmp_path / "new" / "sphere.ply")
    assert len(bt.load(tmp_path / "new" / "sphere.ply").vertices) == 42
    with pytest.raises(bt.FileError, match="cannot be written"):
        bt.save(bt.shapes.sphere(1), tmp_path / "new" / "sphere.ply" / "below.ply")
    for name in ("a\0/sphere.ply", "a\0.ply"):
        with pytest.raises(bt.FileError, match="cannot be written"):
            bt.save(bt.shapes.sphere(1), name)
    for name in ("a\0/sphere.npz", "a\0.npz"):
        with pytest.raises(bt.FileError, match="cannot be written"):
            bt.eigenpairs(bt.shapes.sphere(1), 3).save(name)


def test_a_refused_file_leaves_no_folders(tmp_path):
    sphere = bt.shapes.sphere(1)
    for name in ("sphere.what", "sphere.xyz"):  # no format; one that would lose the faces
        with pytest.raises(bt.FileError):
            bt.save(sphere, tmp_path / "new" / "deep" / name)
        assert not list(tmp_path.iterdir())
    (tmp_path / "new").mkdir()
    with pytest.raises(bt.FileError):
        bt.save(sphere, tmp_path / "new" / "deep" / "sphere.what")
    assert [path.name for path in tmp_path.rglob("*")] == ["new"]


@pytest.mark.parametrize("role", ["values", "landmarks"])
def test_arrays_are_told_by_their_content(role, tmp_path, capsys):
    """A .npy file that is an archive: its only array, or a refusal; what the reader says is said once."""
    sphere = bt.shapes.sphere(1)
    bt.save(sphere, tmp_path / "s.ply")
    given = str(tmp_path / "z.npy")
    array = sphere.vertices[:, 2] if role == "values" else np.array([[0, 0], [5, 5], [9, 9]])
    shape = str(tmp_path / "s.ply")
    call = ["plot", shape, "--values", given] if role == "values" else ["register-conformal", shape, shape, "--landmarks", given]
    call += ["--size", "60x40", "-o", str(tmp_path / "out.png")]
    with open(given, "wb") as stream:
        np.savez(stream, other=array)
    assert main(call) in (0, 1)
    with open(given, "wb") as stream:
        np.savez(stream, one=array, other=array)
    assert main(call) == 2
    assert "holds 2 arrays (one, other)" in capsys.readouterr().err
    np.save(given, np.array([{}]))
    assert main(call) == 2
    assert capsys.readouterr().err.count("cannot be read") == 1


def test_segment_without_a_fidelity_leaves_no_region_empty(tmp_path, capsys):
    sphere = bt.shapes.sphere(4)
    image = (np.abs(sphere.vertices) > 0.97).any(axis=1).astype(float)  # six small caps: 7.5 over the variance makes them vanish
    np.savetxt(tmp_path / "image.txt", image)
    bt.save(sphere, tmp_path / "ball.ply")
    call = ["segment", str(tmp_path / "ball.ply"), "--values", str(tmp_path / "image.txt"), "-o", str(tmp_path / "r.npz")]
    assert main(call) == 0
    assert "is empty" not in capsys.readouterr().out
    with np.load(tmp_path / "r.npz") as found:
        assert len(np.unique(found["labels"])) == 2
    assert main([*call, "--fidelity", "0.1"]) == 0  # what was asked for is kept, and said
    assert "is empty" in capsys.readouterr().out


def test_committor_takes_its_arrays_from_files_of_their_own(tmp_path, capsys):
    x = np.random.default_rng(0).uniform([-1.6, -1.0], [1.6, 1.0], (900, 2))
    energy, a, b = (x[:, 0] ** 2 - 1) ** 2 + x[:, 1] ** 2 / 2, x[:, 0] < -0.9, x[:, 0] > 0.9
    np.save(tmp_path / "x.npy", x)
    np.savetxt(tmp_path / "x.xyz", x, fmt="%.17g")
    np.savetxt(tmp_path / "U.txt", energy, fmt="%.17g")
    np.savetxt(tmp_path / "A.txt", np.flatnonzero(a), fmt="%d")  # numbers of points
    np.save(tmp_path / "B.npy", b)  # a mask
    exact = bt.committor(bt.PointCloud(x), energy, a, b, beta=4.0)
    rest = ["--beta", "4", "--potential", str(tmp_path / "U.txt"), "--A", str(tmp_path / "A.txt"), "--B", str(tmp_path / "B.npy")]
    for points in ("x.npy", "x.xyz"):
        assert main(["committor", str(tmp_path / points), *rest, "-o", str(tmp_path / "q.npz")]) == 0
        with np.load(tmp_path / "q.npz") as found:
            assert np.allclose(found["q"], exact.q, atol=1e-9)
    assert main(["committor", str(tmp_path / "x.npy"), "--beta", "4", "--A", "nowhere", "-o", str(tmp_path / "q.npz")]) == 2
    assert "no such array or file" in capsys.readouterr().err


def test_every_option_of_every_command_is_described():
    (commands,) = (action for action in parser()._actions if isinstance(action, argparse._SubParsersAction))
    bare = [(name, action.dest) for name, one in commands.choices.items() for action in one._actions if not action.help]
    assert bare == []


def test_errors_name_the_options_of_the_command(tmp_path, capsys):
    bt.save(bt.shapes.disc(), tmp_path / "disc.ply")
    assert main(["sphere", str(tmp_path / "disc.ply")]) == 2
    assert "--fill-holes" in capsys.readouterr().err
    for option in ("--from", "--to"):
        ends = {"--from": "uniform", "--to": "uniform", option: "nowhere.npy"}
        assert main(["transport", "example:bob", *(word for pair in ends.items() for word in pair)]) == 2
        assert f"{option} nowhere.npy" in capsys.readouterr().err

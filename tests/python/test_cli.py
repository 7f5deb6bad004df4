"""The command line: what it prints, what it writes, with which exit code it ends."""

from __future__ import annotations

import subprocess
import sys

import beltrami as bt
import numpy as np
import pytest
from beltrami.__main__ import COMMANDS, command, main


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
        (["gallery", "--only", "cookery"], "cookery"),
        (["info", "example:bob", "--threads", "0"], "--threads"),
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
def test_misuse_ends_with_2(arguments, capsys):
    assert main(arguments) == 2
    assert "usage: beltrami" in capsys.readouterr().err


@pytest.mark.parametrize("name", sorted(COMMANDS))
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

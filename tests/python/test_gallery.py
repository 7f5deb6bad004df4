"""The gallery: one page, everything beside it, and a failure that stops nothing but is seen."""

from __future__ import annotations

import re

import beltrami as bt
import numpy as np
import pytest
from beltrami import gallery
from beltrami.__main__ import main


@pytest.fixture
def sections(monkeypatch):
    """A gallery of sections made up here."""
    made = {}
    monkeypatch.setattr(gallery, "SECTIONS", made)
    monkeypatch.setattr(gallery, "_MODULES", ())
    return made


def good(sheet):
    mesh = bt.shapes.torus(rows=12, columns=8)
    sheet.text("A torus with `code` & <tags>.")
    sheet.figures({"residual": 3.25e-13, "vertices": 12345, "closed": True})
    sheet.table(("name", "number"), [("one", 1.5), ("two", -2)], "Numbers")
    sheet.code("x < 1")
    sheet.picture(mesh, mesh.vertices[:, 0], caption="A torus", interactive=True, size=(160, 100))


def bad(sheet):
    sheet.text("Before the fall.")
    raise bt.NumericalError("the <matrix> broke")


def test_the_page_opens_from_disk(sections, tmp_path):
    sections["A good one"] = good
    (outcome,) = gallery.run(tmp_path / "new" / "gallery")
    assert outcome.error is None
    page = (tmp_path / "new" / "gallery" / "index.html").read_text(encoding="utf-8")
    assert not re.search(r"https?:|//[a-z]", page)
    used = re.findall(r'(?:src|href)="([^"#]+)"', page)
    assert len(used) == 3
    assert all((tmp_path / "new" / "gallery" / name).is_file() for name in used)
    assert {path.name for path in outcome.files} == set(used)
    for image in re.findall(r"<img[^>]*>", page):
        assert re.search(r'alt="[^"]{10,}"', image)
    for text in ("<code>code</code> &amp; &lt;tags&gt;", "3.25·10⁻¹³", "12,345", "x &lt; 1", "−2", 'id="a-good-one"', 'href="#a-good-one"'):
        assert text in page


def test_a_failing_section_is_shown_and_stops_nothing(sections, tmp_path, capsys):
    sections["First"], sections["Second"] = bad, good
    outcomes = gallery.run(tmp_path)
    assert [outcome.error for outcome in outcomes] == ["NumericalError: the <matrix> broke", None]
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "Before the fall." in page
    assert "the &lt;matrix&gt; broke" in page
    assert "1 failed" in page
    assert "A torus" in page
    assert main(["gallery", "-o", str(tmp_path)]) == 1
    assert "NumericalError" in capsys.readouterr().out


def test_sections_side_by_side_keep_their_order_and_what_progress_raises_is_heard(sections, tmp_path):
    sections.update({f"Section {number}": good for number in range(6)})
    told: list[str] = []
    outcomes = gallery.run(tmp_path, progress=told.append)
    assert [outcome.title for outcome in outcomes] == list(sections)
    assert sorted(line.split(":")[0].removesuffix(" ...") for line in told) == sorted(2 * list(sections))
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert [int(number) for number in re.findall(r"<h2>Section (\d)", page)] == list(range(6))

    def broken(text: str) -> None:
        raise BrokenPipeError(text)

    with pytest.raises(BrokenPipeError, match="Section"):
        gallery.run(tmp_path, progress=broken)


def test_sections_can_be_chosen(sections, tmp_path):
    sections["First"], sections["Second"] = bad, good
    assert [outcome.title for outcome in gallery.run(tmp_path, only=["sec"])] == ["Second"]
    with pytest.raises(bt.InputError, match="First; Second"):
        gallery.run(tmp_path, only=["third"])


def test_a_folder_that_cannot_be_made(sections, tmp_path):
    sections["Second"] = good
    (tmp_path / "file").write_text("")
    with pytest.raises(bt.FileError, match="cannot be made"):
        gallery.run(tmp_path / "file" / "gallery")


def test_titles_have_names_of_their_own():
    titles = gallery.titles()
    assert len({gallery._slug(title) for title in titles}) == len(titles) >= 2


def test_the_first_real_section(tmp_path):
    pytest.importorskip("nilearn", reason="nilearn, whose cortex is shown, is absent")
    (outcome,) = gallery.run(tmp_path, only=[gallery.titles()[0]])
    assert outcome.error is None
    assert sum(path.suffix == ".png" for path in outcome.files) == 2


def test_example_shapes():
    spot, bob = bt.examples.spot(), bt.examples.bob()
    assert (spot.genus, spot.is_closed, bob.genus, bob.is_closed) == (0, True, 1, True)
    assert spot.data["colors"].shape == (2930, 3)
    pytest.importorskip("nilearn", reason="nilearn, whose cortex is loaded, is absent")
    for surface in ("pial", "white"):
        for hemisphere in ("left", "right"):
            cortex = bt.examples.cortex(surface, hemisphere=hemisphere)
            assert (len(cortex.vertices), cortex.genus, cortex.components) == (10242, 0, 1)
            assert (np.sign(np.median(cortex.vertices[:, 0])) < 0) == (hemisphere == "left")
            # Depth and curvature belong to the surface: gyri lie outside, so both are negative there (FreeSurfer's signs).
            assert np.corrcoef(cortex.data["depth"], cortex.data["curvature"])[0, 1] > 0.4

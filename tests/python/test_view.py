"""Pictures: what is where, in which colour, in front of what."""

from __future__ import annotations

import base64
import json
import re
import struct
import zlib

import beltrami as bt
import numpy as np
import pytest
from beltrami import _core
from beltrami.progress import Bar, reporter
from beltrami.view import colors, lettering
from beltrami.view.fields import MISSING
from hypothesis import given, settings
from hypothesis import strategies as st

SQUARE = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
WHITE = np.array([255, 255, 255])


def linear(pixels: np.ndarray) -> np.ndarray:
    """Brightness of sRGB bytes."""
    x = pixels / 255
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def square_at(z: float) -> np.ndarray:
    return SQUARE + np.array([0, 0, z])


def flat(shape, values=None, **options):
    """Pixels seen straight from the front: no light, no words, parallel projection."""
    defaults = {"views": "front", "shading": False, "perspective": False, "color_bar": False, "size": (200, 200)}
    return bt.plot(shape, values, **{**defaults, **options}).pixels


def surface(vertices, faces, colour=(0.0, 0.0, 0.0), **options):
    base = {
        "vertices": np.ascontiguousarray(vertices, float),
        "faces": np.ascontiguousarray(faces, np.int32),
        "kind": "uniform",
        "scalars": np.zeros(0),
        "span": (0.0, 1.0),
        "labels": np.zeros(0, np.int64),
        "colours": np.array([[*colour, 1]], np.float32),
        "missing": (0.5, 0.5, 0.5),
        "levels": np.zeros(0),
        "level_colour": (0.0, 0.0, 0.0, 1.0),
        "level_width": 1.0,
        "edge_colour": (0.0, 0.0, 0.0, 1.0),
        "edge_width": 0.0,
        "transparency": 0.0,
        "smooth": True,
    }
    return {**base, **options}


def paint(scene, *, scale=100.0, distance=np.inf, size=300, lines=None, balls=(), lit=False, samples=4):
    frame = {"width": size, "height": size, "samples": samples, "background": (1.0, 1.0, 1.0), "lit": lit, "hollows": 0.0}
    camera = {"axes": np.eye(3).tolist(), "centre": [0.0] * 3, "middle": [size / 2, size / 2], "scale": scale, "distance": distance}
    return _core.paint(frame, camera, scene, list(balls), lines)


# --- analytic ---------------------------------------------------------------------------------------------------------------------


def test_the_outline_of_a_sphere_has_the_area_of_a_disc():
    sphere = bt.shapes.sphere(6)
    image = paint(surface(sphere.vertices, sphere.faces))
    # Black on white, so each pixel's cover is one less its brightness. The inscribed polyhedron's outline lacks about h^2 / 6 = 3e-4.
    area = float((1 - linear(image[..., 0])).sum())
    assert area == pytest.approx(np.pi * 100**2, rel=1.5e-3)


def test_perspective_shows_a_disc_of_radius_r_over_the_cosine():
    # A sphere of radius 1 seen from distance d fills the angle asin(1 / d): its outline on the plane through the centre has radius
    # d tan(asin(1 / d)).
    sphere = bt.shapes.sphere(6)
    distance = 3.0
    image = paint(surface(sphere.vertices, sphere.faces), distance=distance, size=400)
    radius = 100 * distance * np.tan(np.arcsin(1 / distance))
    assert float((1 - linear(image[..., 0])).sum()) == pytest.approx(np.pi * radius**2, rel=2e-3)


def test_a_square_covers_exactly_its_pixels():
    image = paint(surface(SQUARE, HALVES), scale=50.0, size=200)
    black = (image == 0).all(axis=2)
    assert black[50:150, 50:150].all()
    assert black.sum() == 100 * 100
    assert (image[~black] == 255).all()


def test_colours_are_those_of_the_table():
    table = colors.table("viridis")
    for node in (0, 37, 128, 255):
        pixels = flat((SQUARE, HALVES), np.full(4, node / 255), limits=(0, 1), colormap="viridis")
        assert np.array_equal(pixels[100, 100], np.round(255 * table[node]))


def test_numbers_are_interpolated_before_the_colour_is_looked_up():
    # From the first to the last colour of a table that is far from straight in between: mixing the end colours would be wrong by up to 100.
    pixels = flat((SQUARE, HALVES), SQUARE[:, 0], limits=(-1, 1), colormap="phase", samples=4)
    row = pixels[100].astype(float)
    inside = np.flatnonzero((row != 255).any(axis=1))[2:-2]
    left, right = inside[0] - 2, inside[-1] + 2
    share = (inside + 0.5 - left) / (right + 1 - left)
    table = 255 * colors.table("phase")
    wanted = np.column_stack([np.interp(share, np.linspace(0, 1, 256), table[:, axis]) for axis in range(3)])
    assert np.abs(row[inside] - wanted).max() <= 4  # the ends are known to a pixel, one of some 170


def test_what_is_behind_is_hidden_whatever_the_order():
    both = np.concatenate([square_at(0.0), square_at(0.5)])
    values = np.array([0, 0, 0, 0, 1, 1, 1, 1])
    red_green = ["#ff0000", "#00ff00"]
    for faces in (np.concatenate([HALVES, HALVES + 4]), np.concatenate([HALVES + 4, HALVES])):
        assert np.array_equal(flat((both, faces), values, colormap=red_green)[100, 100], [0, 255, 0])
        assert np.array_equal(flat((both, faces), values, colormap=red_green, views="back")[100, 100], [255, 0, 0])


def test_a_line_is_seen_in_front_of_a_surface_and_hidden_behind_it():
    rope = lambda z: (np.array([[-1.4, 0, z], [1.4, 0, z]]), [0, 2], [6.0], [(1.0, 0.0, 0.0, 1.0)])  # noqa: E731
    square = surface(SQUARE, HALVES, (0.0, 0.0, 1.0))
    front, back = paint(square, lines=rope(0.5)), paint(square, lines=rope(-0.5))
    assert np.array_equal(front[150, 150], [255, 0, 0])
    assert np.array_equal(back[150, 150], [0, 0, 255])
    assert np.array_equal(back[150, 20], [255, 0, 0])  # beside the square both are seen
    on = paint(square, lines=rope(0.0))
    assert np.array_equal(on[150, 150], [255, 0, 0])  # drawn on the surface: above it


def test_the_nearer_of_two_lines_is_in_front():
    points = np.array([[-1.0, 0, 0.3], [1, 0, 0.3], [0, -1, 0], [0, 1, 0]])
    for first in (True, False):
        order = points if first else points[[2, 3, 0, 1]]
        tints = [(1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 1.0)]
        image = paint(None, lines=(order, [0, 2, 4], [8.0, 8.0], tints if first else tints[::-1]))
        assert np.array_equal(image[150, 150], [255, 0, 0])


def test_balls_hide_each_other_by_depth():
    centres, radii = np.array([[0.0, 0, 0], [0, 0, 0.5]]), np.array([0.8, 0.4])
    tints = np.array([[1, 0, 0, 1], [0, 0, 1, 1]], np.float32)
    image = paint(None, balls=[(centres, radii, tints, np.zeros((0, 3)))])
    assert np.array_equal(image[150, 150], [0, 0, 255])
    assert np.array_equal(image[150, 150 + 60], [255, 0, 0])
    assert float((image[..., 1] < 128).sum()) == pytest.approx(np.pi * 80**2, rel=0.02)  # to a pixel of its circumference


def test_glass_mixes_light_with_what_is_behind():
    # Seen straight on, a transparency t lets the share t through; light is mixed, not bytes.
    image = paint(surface(SQUARE, HALVES, (0.0, 0.0, 0.0), transparency=0.6))
    assert linear(image[150, 150]) == pytest.approx([0.6] * 3, abs=0.01)
    twice = surface(np.concatenate([square_at(0.0), square_at(0.5)]), np.concatenate([HALVES, HALVES + 4]), transparency=0.6)
    assert linear(paint(twice)[150, 150]) == pytest.approx([0.36] * 3, abs=0.01)


def test_a_line_inside_glass_shows_through():
    rope = (np.array([[-1.4, 0, -0.5], [1.4, 0, -0.5]]), [0, 2], [6.0], [(1.0, 0.0, 0.0, 1.0)])
    pixel = paint(surface(SQUARE, HALVES, (0.0, 0.0, 0.0), transparency=0.6), lines=rope)[150, 150]
    assert linear(pixel) == pytest.approx([0.6, 0, 0], abs=0.01)


def test_labels_meet_half_way():
    pixels = flat((SQUARE, HALVES), np.array([0, 1, 1, 0]), colormap=["#ff0000", "#0000ff"])
    assert np.array_equal(pixels[100, 90], [255, 0, 0])
    assert np.array_equal(pixels[100, 110], [0, 0, 255])
    row = pixels[60:140]
    assert ((row == [255, 0, 0]).all(axis=2).sum(), (row == [0, 0, 255]).all(axis=2).sum()) == pytest.approx((6800, 6800), rel=0.2)


def test_contours_lie_where_the_level_is():
    pixels = flat((SQUARE, HALVES), SQUARE[:, 0], limits=(-1, 1), contours=[0.5], colormap=["#ffffff", "#ffffff"])
    dark = np.flatnonzero(pixels[100, :, 0] < 200)
    plain = flat((SQUARE, HALVES), None, color="#000000")
    inside = np.flatnonzero(plain[100, :, 0] == 0)
    wanted = inside[0] + 0.75 * (inside[-1] + 1 - inside[0])
    assert len(dark) in (1, 2, 3)
    assert dark.mean() + 0.5 == pytest.approx(wanted, abs=1.5)


def test_faces_have_colours_of_their_own():
    pixels = flat((SQUARE, HALVES), np.array([[1.0, 0, 0], [0, 0, 1.0]]))
    assert np.array_equal(pixels[130, 130], [255, 0, 0])
    assert np.array_equal(pixels[70, 70], [0, 0, 255])
    numbers = flat((SQUARE, HALVES), np.array([0.0, 1.0]), limits=(0, 1), colormap=["#ff0000", "#0000ff"])
    assert np.array_equal(numbers, pixels)


def test_bytes_and_shares_are_the_same_colours():
    shares = np.array([[1.0, 0.2, 0.4]] * 4)
    assert np.array_equal(flat((SQUARE, HALVES), shares), flat((SQUARE, HALVES), (255 * shares).astype(np.uint8)))


def test_light_comes_from_above_and_faces_the_eye():
    sphere = bt.shapes.sphere(5)
    image = paint(surface(sphere.vertices, sphere.faces, (0.7, 0.7, 0.7)), lit=True).astype(int)
    assert image[90, 130, 0] > image[150, 150, 0] > image[230, 170, 0]
    inside_out = paint(surface(sphere.vertices, sphere.faces[:, ::-1], (0.7, 0.7, 0.7)), lit=True)
    assert np.abs(image - inside_out).max() <= 1  # both sides of a surface are lit alike


@pytest.mark.parametrize(
    ("view", "up", "axis"),
    [
        ("front", "y", [0, 0, 1]),
        ("right", "y", [1, 0, 0]),
        ("top", "y", [0, 1, 0]),
        ("front", "z", [0, -1, 0]),
        ("left", "z", [-1, 0, 0]),
        ("top", "z", [0, 0, 1]),
    ],
)
def test_views_look_along_their_axis(view, up, axis):
    # Six small squares around the origin, each a colour of its own: the one towards the eye is seen in the middle.
    sides = [np.array(a, float) for a in ([1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1])]
    points, faces, tints = [], [], []
    for at, side in enumerate(sides):
        u = np.roll(np.abs(side), 1)
        v = np.cross(side, u)
        points += [side - u - v, side + u - v, side + u + v, side - u + v]
        faces.append(HALVES + 4 * at)
        tints += [at] * 4
    cube = (np.array(points), np.concatenate(faces))
    palette = ["#ff0000", "#00ff00", "#0000ff", "#ffff00", "#ff00ff", "#00ffff"]
    seen = flat(cube, np.array(tints), colormap=palette, views=view, up=up)[100, 100]
    at = next(k for k, side in enumerate(sides) if np.array_equal(side, axis))
    assert np.array_equal(seen, np.round(255 * np.array(colors.color(palette[at]))))
    assert np.array_equal(seen, flat(cube, np.array(tints), colormap=palette, views=[axis], up=up)[100, 100])


def test_two_dimensions_are_drawn_flat_and_more_are_projected():
    assert np.array_equal(flat((SQUARE[:, :2], HALVES), color="#000000"), flat((SQUARE, HALVES), color="#000000"))
    torus = bt.shapes.flat_torus()
    picture = bt.plot(torus, size=(200, 200))
    assert "R^4" in picture.description
    turned = np.linalg.qr(np.random.default_rng(0).normal(size=(5, 5)))[0]
    in_five = np.pad(SQUARE * [2, 1, 1], ((0, 0), (0, 2))) @ turned  # a square in R^5 is seen as the square it is
    pixels = bt.plot((in_five, HALVES), color="#000000", views="front", shading=False, perspective=False, size=(300, 200)).pixels
    columns, rows = (np.flatnonzero((pixels[:160] == 0).all(axis=2).any(axis=axis)) for axis in (0, 1))
    assert np.ptp(columns) / np.ptp(rows) == pytest.approx(2, rel=0.03)


def test_png_holds_the_pixels():
    generator = np.random.default_rng(3)
    smooth = np.add.outer(np.arange(41), np.arange(67))[..., None] * [1, 2, 3]
    for pixels in (generator.integers(0, 256, (41, 67, 3)).astype(np.uint8), smooth.astype(np.uint8)):
        data = bt.Picture(pixels).png()
        assert data[:8] == b"\x89PNG\r\n\x1a\n"
        chunks, at = {}, 8
        while at < len(data):
            length, kind = struct.unpack(">I4s", data[at : at + 8])
            body = data[at + 8 : at + 8 + length]
            assert struct.unpack(">I", data[at + 8 + length : at + 12 + length])[0] == zlib.crc32(kind + body)
            chunks[kind] = body
            at += 12 + length
        assert struct.unpack(">IIBBBBB", chunks[b"IHDR"]) == (67, 41, 8, 2, 0, 0, 0)
        raw = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(41, 1 + 3 * 67)
        above = np.zeros(3 * 67, int)
        for row, line in enumerate(raw):
            back = np.zeros(3 * 67, int)
            for x in range(3 * 67):
                a, c = (back[x - 3], above[x - 3]) if x >= 3 else (0, 0)
                guess = {1: a, 2: above[x]}.get(int(line[0]))
                if guess is None:
                    guess = min((a, above[x], c), key=lambda v: abs(a + above[x] - c - v))
                back[x] = (int(line[1 + x]) + guess) % 256
            assert np.array_equal(back, pixels[row].ravel())
            above = back


def test_png_reads_elsewhere(tmp_path):
    image = pytest.importorskip("PIL.Image", reason="Pillow is absent")
    picture = bt.plot(bt.shapes.torus(), path=tmp_path / "new folder" / "torus.png", size=(320, 200))
    assert np.array_equal(np.asarray(image.open(picture.path)), picture.pixels)


# --- properties -------------------------------------------------------------------------------------------------------------------


def test_the_same_bits_on_any_number_of_threads():
    torus = bt.shapes.torus()
    threads = bt.num_threads()
    try:
        pictures = []
        for count in (1, 2, 3):
            bt.set_num_threads(count)
            made = [
                bt.plot(
                    torus, torus.vertices[:, 2], contours=8, lines=torus.vertices[:40], points=[3, 5], transparency=clear, size=(400, 300)
                ).pixels
                for clear in (0.0, 0.7)
            ]
            pictures.append(np.concatenate(made))
    finally:
        bt.set_num_threads(threads)
    assert np.array_equal(pictures[0], pictures[1])
    assert np.array_equal(pictures[0], pictures[2])


@pytest.mark.parametrize("factor", [2.0**-60, 2.0**70, 1e-12])
def test_units_do_not_matter(factor):
    torus = bt.shapes.torus(rows=40, columns=20)
    first = bt.plot(torus, torus.vertices[:, 0], size=(200, 150), limits=(-2, 2)).pixels.astype(int)
    second = bt.plot((torus.vertices * factor, torus.faces), torus.vertices[:, 0], size=(200, 150), limits=(-2, 2)).pixels
    assert (np.abs(first - second).max(axis=2) > 2).mean() < (0.0 if factor != 1e-12 else 2e-3) + 1e-9


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 30), st.integers(2, 5))
def test_any_soup_is_painted(seed, count, dimension):
    generator = np.random.default_rng(seed)
    points = generator.normal(size=(count, dimension)) * 10.0 ** generator.integers(-8, 9)
    faces = generator.integers(0, count, (generator.integers(0, 40), 3))
    values = np.where(generator.random(count) < 0.2, np.nan, generator.normal(size=count))
    picture = bt.plot((points, faces), values, size=(120, 80), samples=2, contours=3, edges=True, transparency=generator.choice([0, 0.5]))
    assert picture.pixels.shape == (80, 120, 3)
    assert np.array_equal(picture.pixels[0, 0], WHITE)  # the margin stays clean


def test_the_input_is_left_alone():
    values = np.array([0.0, np.nan, 2.0, 3.0])
    points, faces = SQUARE.copy(), HALVES.copy()
    bt.plot((points, faces), values, size=(100, 80))
    assert np.array_equal(points, SQUARE)
    assert np.array_equal(faces, HALVES)
    assert np.array_equal(values, [0.0, np.nan, 2.0, 3.0], equal_nan=True)


# --- words and colours ------------------------------------------------------------------------------------------------------------


def test_every_printable_character_has_a_glyph():
    box = lettering.strokes("漢", 0, 0, 10)[0]
    for letter in [chr(code) for code in range(33, 127) if chr(code) not in "$^`"] + list("λφπμσ²°×−–·…≤≥±"):
        points, starts = lettering.strokes(letter, 0, 0, 10)
        assert len(points)
        assert starts[-1] == len(points)
        assert not (points.shape == box.shape and np.allclose(points, box)), letter


def test_text_is_as_wide_as_it_says():
    for text in ("Geodesic distance", "λ = 2.5·10⁻³"):
        points, _ = lettering.strokes(text, 100, 50, 20, "middle")
        assert np.ptp(points[:, 0]) == pytest.approx(lettering.width(text, 20), abs=3)
        assert 0.5 * (points[:, 0].min() + points[:, 0].max()) == pytest.approx(100, abs=2)


def test_viridis_is_matplotlibs():
    mpl = pytest.importorskip("matplotlib", reason="matplotlib is absent")
    for name in ("viridis", "magma"):
        wanted = mpl.colormaps[name](np.linspace(0, 1, 256))[:, :3]
        assert np.abs(colors.table(name) - wanted).max() < 6 / 255  # 17 of 256 colours are kept


def test_tables_are_what_they_are_for():
    brightness = lambda table: linear(255 * table) @ [0.2126, 0.7152, 0.0722]  # noqa: E731
    assert (np.diff(brightness(colors.table("viridis"))) > 0).all()
    balance = brightness(colors.table("balance", 255))
    assert balance.argmax() == 127
    assert balance == pytest.approx(balance[::-1], abs=0.06)  # both signs equally dark
    phase = colors.table("phase")
    assert phase[0] == pytest.approx(phase[-1], abs=1e-9)
    kinds = colors.categories(30)
    apart = np.linalg.norm(kinds[:, None] - kinds, axis=2) + 9 * np.eye(30)
    assert apart[:12, :12].min() > 0.15
    assert apart.min() > 0.03
    assert np.array_equal(colors.table("viridis_r"), colors.table("viridis")[::-1])


# --- faults -----------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("nothing", [np.nan, np.inf, -np.inf])
def test_no_data_is_grey_and_is_said(nothing):
    values = np.array([nothing, nothing, nothing, 1.0])
    pixels = flat((SQUARE, HALVES), values)
    assert np.array_equal(pixels[120, 120], np.round(255 * np.array(MISSING)))
    foot = slice(-30, None), slice(0, 150)  # beside the square, where the note stands
    assert (bt.plot((SQUARE, HALVES), values, views="front", size=(900, 300)).pixels[foot] < 200).any()
    assert not (bt.plot((SQUARE, HALVES), np.ones(4), views="front", size=(900, 300)).pixels[foot] < 200).any()


def test_negative_labels_are_no_label():
    pixels = flat((SQUARE, HALVES), np.array([-1, -1, -1, 4]))
    assert np.array_equal(pixels[120, 120], np.round(255 * np.array(MISSING)))


TORUS = bt.shapes.torus(rows=12, columns=8)


@pytest.mark.parametrize(
    ("arguments", "options", "words"),
    [
        ((np.zeros((0, 3)),), {}, "no vertices"),
        ((TORUS, np.zeros(5)), {}, r"shape \(5,\)"),
        ((TORUS, np.zeros((96, 7))), {}, "choose a column"),
        ((TORUS, np.full((96, 3), 2.0)), {}, r"values\[0\]"),
        ((TORUS, ["a"] * 96), {}, "dtype"),
        ((TORUS, np.zeros(96)), {"colormap": "no such map"}, "viridis"),
        ((TORUS, np.zeros(96)), {"limits": (1, 0)}, "first must be less"),
        ((TORUS, np.zeros(96)), {"limits": 3}, "limits"),
        ((TORUS, {}), {}, "empty"),
        ((TORUS,), {"views": "from the moon"}, "three-quarter"),
        ((TORUS,), {"views": [[0.0, 0, 0]]}, "direction"),
        ((TORUS,), {"up": "w"}, "'x', 'y' or 'z'"),
        ((TORUS,), {"transparency": 2}, "from 0 to 1"),
        ((TORUS,), {"samples": 0}, "samples"),
        ((TORUS,), {"size": (4, 4)}, "size"),
        ((TORUS,), {"path": "picture.jpg"}, r"\.png"),
        ((TORUS,), {"lines": np.zeros((3, 2))}, "coordinates"),
        ((TORUS,), {"lines": [[[0, 0, np.nan]]]}, r"lines\[0\]"),
        ((TORUS,), {"points": [96]}, "96 vertices"),
        ((TORUS,), {"color": "reddish"}, "no colour"),
        ((np.array([[0.0, 0, np.inf]]),), {}, "inf"),
        (("torus.ply",), {}, "str"),
    ],
)
def test_bad_input_is_refused(arguments, options, words):
    with pytest.raises(bt.InputError, match=words):
        bt.plot(*arguments, **options)


def test_a_path_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(bt.FileError, match="cannot be written"):
        bt.plot(TORUS, path=tmp_path / "file" / "picture.png", size=(64, 64))


def test_the_core_refuses_what_does_not_fit():
    with pytest.raises(bt.InputError, match="face 0"):
        paint(surface(SQUARE, [[0, 1, 9]]))
    with pytest.raises(bt.InputError, match="row 0"):
        paint(surface(np.full((4, 3), np.nan), HALVES))
    with pytest.raises(bt.InputError, match="values"):
        paint(surface(SQUARE, HALVES, kind="scalars"))


@pytest.mark.parametrize("points", [np.zeros((1, 3)), np.zeros((5, 3)), np.eye(2), np.array([[0.0, 0, 0], [1e-300, 0, 0]])])
def test_poor_clouds_are_painted(points):
    assert (bt.plot(points, size=(100, 80), color="#000000").pixels[40, 50] < 255).any() or len(points) == 2


def test_progress_stops_and_reports():
    with pytest.raises(bt.Cancelled):
        bt.plot(bt.shapes.sphere(6), size=(3000, 3000), progress=lambda share: False)
    shares = []
    bt.plot(TORUS, size=(100, 80), views=["front", "back"], progress=shares.append)
    assert shares[-1] == 1.0
    assert shares == sorted(shares)
    with pytest.raises(bt.InputError, match="progress"):
        bt.plot(TORUS, progress="yes")


def test_the_bar_is_a_bar(capsys):
    bar = Bar("work", patience=0.0)
    for share in (0.0, 0.5, 1.0):
        bar(share)
    written = capsys.readouterr().err
    assert "100 %" in written
    assert "work [" in written
    assert isinstance(reporter(True), Bar)


# --- interactive pages ------------------------------------------------------------------------------------------------------------


def test_a_page_holds_the_shape_and_needs_no_network(tmp_path):
    sphere = bt.shapes.sphere(2)
    heights = sphere.vertices[:, 2].copy()
    heights[5] = np.nan
    page = bt.plot(
        sphere,
        {"height": heights, "sign": (heights > 0)},
        path=tmp_path / "a.html",
        title="<b> & co",
        lines=sphere.vertices[:7],
        points=[1],
    )
    assert isinstance(page, bt.Page)
    text = page.path.read_text(encoding="utf-8")
    assert text == page.html
    assert not re.search(r"(src|href)\s*=|https?:|@import|url\(", text)
    assert "<b> & co" not in text
    assert "&lt;b&gt; &amp; co" in text
    assert 'aria-label="' in text
    data = json.loads(re.search(r'id="data">(.*?)</script>', text, re.S)[1])
    read = lambda name, kind: np.frombuffer(base64.b64decode(name), kind)  # noqa: E731
    assert read(data["vertices"], "<f4").reshape(-1, 3) == pytest.approx(sphere.vertices, abs=1e-6)
    assert np.array_equal(read(data["faces"], "<u4").reshape(-1, 3), sphere.faces)
    first, second = data["fields"]
    assert read(first["values"], "<f4") == pytest.approx(heights, abs=1e-6, nan_ok=True)
    assert (first["name"], first["missing"], second["legend"]) == ("height", 1, ["False", "True"])
    assert [text for _, text in first["ticks"]] == ["−1.0", "−0.5", "0", "0.5", "1.0"]
    assert data["lineStarts"] == [0, 7]


def test_shapes_and_operators_plot_themselves(tmp_path):
    assert TORUS.plot(TORUS.vertices[:, 2], path=tmp_path / "a.png", size=(64, 48)).path.exists()
    assert bt.PointCloud(TORUS.vertices).plot(size=(64, 48)).pixels.shape == (48, 64, 3)
    assert np.array_equal(bt.plot(bt.operators(TORUS), size=(64, 48)).pixels, bt.plot(TORUS, size=(64, 48)).pixels)
    assert "<iframe" in TORUS.plot(path=tmp_path / "a.html")._repr_html_()


def test_pages_draw_the_contours_that_were_asked_for(tmp_path):
    mesh = bt.shapes.sphere(1)

    def levels(contours):
        page = bt.plot(mesh, mesh.vertices[:, 2], contours=contours, limits=(-1, 1), path=tmp_path / "a.html")
        [found] = re.findall(r'"levels":(\[[^\]]*\])', page.html)
        return json.loads(found)

    assert levels([0.0, 0.3, -0.9, 7.0]) == [-0.9, 0.0, 0.3]  # not as many as an even spacing would give
    assert levels(None) == []
    assert len(levels(500)) == 64  # what the viewer has room for


def test_views_go_by_the_names_that_are_given():
    picture = bt.plot(TORUS, views={"lateral": "left", "from above": (0.0, 1.5)}, size=(300, 200))
    assert "seen from lateral and from above" in picture.description
    assert np.array_equal(flat(TORUS, views={"": "left"}), flat(TORUS, views="left"))
    for wrong, said in (({}, "empty"), ({1: "left"}, "str"), ({"a": "nowhere"}, "nowhere")):
        with pytest.raises(bt.InputError, match=said):
            bt.plot(TORUS, views=wrong)

"""Interactive pages and the gallery in a real browser: nothing goes wrong in its console, the canvas is painted, keys do what they say.

Skipped where there is no Chromium (Debian: `apt-get install chromium`)."""

import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import beltrami as bt
import numpy as np
import pytest
from beltrami import gallery

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
BROWSER = next((found for found in map(shutil.which, NAMES) if found), None)
pytestmark = pytest.mark.skipif(BROWSER is None, reason=f"none of {', '.join(NAMES)} is installed")
WATCH = """<script>
window.problems = [];
addEventListener("error", e => problems.push(String(e.message || (e.target && e.target.src) || e)), true);
addEventListener("unhandledrejection", e => problems.push(String(e.reason)));
requestAnimationFrame = paint => setTimeout(() => paint(performance.now()), 5);  // the browser's own clock stands still while it is watched
console.error = console.warn = (...words) => problems.push(words.join(" "));
</script>"""
TOOLS = """
const wait = milliseconds => new Promise(done => setTimeout(done, milliseconds));
const frame = () => wait(60);
const key = async name => {
  document.body.dispatchEvent(new KeyboardEvent("keydown", { key: name, bubbles: true, cancelable: true })); await frame();
};
const colours = canvas => {
  const copy = document.createElement("canvas"); copy.width = canvas.width; copy.height = canvas.height;
  const context = copy.getContext("2d"); context.drawImage(canvas, 0, 0);
  const seen = new Set(new Uint32Array(context.getImageData(0, 0, copy.width, copy.height).data.buffer)); return seen.size;
};
"""


def visited(page: Path, script: str) -> dict[str, Any]:
    """What a script finds on a page: its outcome, and what went wrong."""
    text = page.read_text(encoding="utf-8")
    text = re.sub(r"(<head[^>]*>)", lambda found: found[1] + WATCH, text, count=1)
    ending = f"""<script>addEventListener("load", async () => {{ {TOOLS}
      let outcome = {{}};
      try {{ outcome = await (async () => {{ {script} }})(); }} catch (error) {{ problems.push(String(error)); }}
      const note = document.createElement("pre"); note.id = "outcome"; note.textContent = JSON.stringify({{ ...outcome, problems }});
      document.body.append(note);
    }});</script>"""
    watched = page.with_name("watched_" + page.name)
    watched.write_text(text.replace("</body>", ending + "</body>") if "</body>" in text else text + ending, encoding="utf-8")
    call = [str(BROWSER), "--headless", "--no-sandbox", "--disable-gpu", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    call += ["--window-size=700,500", f"--user-data-dir={page.parent / 'profile'}", "--virtual-time-budget=20000", "--dump-dom"]
    ran = subprocess.run([*call, watched.as_uri()], capture_output=True, text=True, timeout=120, check=False)
    found = re.search(r'<pre id="outcome">(.*?)</pre>', ran.stdout, re.S)
    assert found, f"the page never came to its end: {ran.stderr[-500:]}"
    outcome: dict[str, Any] = json.loads(html.unescape(found[1]))
    return outcome


KEYS = """
const canvas = document.getElementById("canvas"), course = [];
await frame();
const look = () => canvas.toDataURL(), first = look();
for (const name of ["ArrowRight", "ArrowUp", "+", "c", "e", "n"]) {
  const before = look(); await key(name); course.push([name, look() !== before]);
}
const field = document.getElementById("field").selectedOptions[0].textContent;
await key("p"); await key("e"); await key("c"); await key("r");
return { colours: colours(canvas), course, field, back: look() === first, said: canvas.getAttribute("aria-label"),
         pressed: document.getElementById("edges").getAttribute("aria-pressed") };
"""


@pytest.mark.parametrize("kind", ["mesh", "plane", "cloud"])
def test_interactive_page(kind: str, tmp_path: Path) -> None:
    mesh = bt.shapes.grid(9, 9) if kind == "plane" else bt.shapes.torus(rows=24, columns=12)
    shape: Any = bt.PointCloud(mesh.vertices) if kind == "cloud" else mesh
    fields = {"height": mesh.vertices[:, 0], "side": mesh.vertices[:, 1] ** 2}
    page = tmp_path / "page.html"
    bt.plot(shape, fields, path=page, description="A shape with two fields")
    seen = visited(page, KEYS)
    assert seen["problems"] == []
    assert seen["colours"] > 20  # neither empty nor of one colour
    changed = dict(seen["course"])
    idle = {"mesh": set(), "plane": {"ArrowRight", "ArrowUp"}, "cloud": {"c", "e"}}[kind]  # a plane is not turned; a cloud has no lines
    assert {name for name, did in changed.items() if not did} <= idle
    assert seen["field"] == "side"
    assert seen["back"]  # R undoes what the keys did to the view
    assert seen["pressed"] == "false"
    assert seen["said"] == "A shape with two fields"


def test_film_plays(tmp_path: Path) -> None:
    sphere = bt.shapes.sphere(2)
    ends = [np.exp(3 * sphere.vertices[:, axis]) for axis in (0, 2)]
    flow = bt.transport(sphere, *ends, intervals=4, normalize=True, tolerance=0.1)
    page = tmp_path / "flow.html"
    flow.plot(times=5, size=(120, 90), path=page)
    seen = visited(
        page,
        """
        const slider = document.querySelector("input[type=range]"), image = document.querySelector("img");
        const play = document.getElementById("play");
        const first = image.src; slider.value = slider.max; slider.dispatchEvent(new Event("input")); await wait(50);
        const last = image.src; play.click(); const playing = play.getAttribute("aria-pressed"); await wait(3000); play.click();
        const label = slider.getAttribute("aria-label");
        return { moved: first !== last, playing, alt: image.alt.length, label, wide: image.naturalWidth };
        """,
    )
    assert seen["problems"] == []
    assert seen["moved"]
    assert seen["playing"] == "true"
    assert seen["alt"] > 10
    assert seen["label"]
    assert seen["wide"] > 0


def test_gallery_opens(tmp_path: Path) -> None:
    gallery.run(tmp_path, only=["Spectrum of the sphere"])
    seen = visited(
        tmp_path / "index.html",
        """
        const images = [...document.images];
        for (const image of images) image.loading = "eager";
        await Promise.all(images.map(image => image.complete || new Promise(done => { image.onload = image.onerror = done; })));
        const inside = [...document.querySelectorAll("a[href^='#']")];
        return { images: images.filter(image => image.naturalWidth > 0).length, named: images.length,
                 alt: images.map(image => image.alt.length), headings: document.querySelectorAll("h2").length,
                 dead: inside.filter(a => !document.getElementById(a.hash.slice(1))).length };
        """,
    )
    assert seen["problems"] == []
    assert seen["images"] == seen["named"] >= 1
    assert min(seen["alt"]) > 10
    assert seen["headings"] >= 1
    assert seen["dead"] == 0

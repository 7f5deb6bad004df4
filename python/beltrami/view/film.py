"""Pictures one after another in one HTML file, with a slider and a button to play them: it opens from disk and needs no network."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence

from ..errors import InputError
from . import Page, Picture

__all__ = ["film"]

_TEMPLATE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1"><title>__TITLE__</title>
<style>
body { margin: 0; font: 16px/1.5 system-ui, sans-serif; background: #fff; color: #1b1e23; color-scheme: light; }
main { max-width: 70rem; margin: 0 auto; padding: 1rem; }
img { display: block; width: 100%; height: auto; }
.bar { display: flex; gap: 1rem; align-items: center; padding: .8rem 0; }
input { flex: 1; min-width: 6rem; }
button { font: inherit; padding: .35rem 1.1rem; border-radius: 8px; border: 1px solid #8a94a3; background: #eef1f5; color: inherit; }
output { min-width: 6rem; font-variant-numeric: tabular-nums; }
</style></head><body><main>
<img id="frame" src="data:image/png;base64,__FIRST__" alt="__TITLE__">
<div class="bar"><button id="play" type="button" aria-pressed="false">Play</button>
<input id="time" type="range" min="0" max="__LAST__" value="0" step="1" aria-label="__LABEL__">
<output id="caption" for="time">__CAPTION__</output></div>
<noscript>The slider needs JavaScript.</noscript>
</main><script>
const frames = __FRAMES__, captions = __CAPTIONS__;
const image = document.getElementById("frame"), slider = document.getElementById("time"), button = document.getElementById("play");
const caption = document.getElementById("caption");
let timer = null, step = 1;
function show(k) { slider.value = k; image.src = "data:image/png;base64," + frames[k]; caption.textContent = captions[k]; }
function stop() { clearInterval(timer); timer = null; button.textContent = "Play"; button.setAttribute("aria-pressed", "false"); }
slider.addEventListener("input", () => { stop(); show(+slider.value); });
button.addEventListener("click", () => {
  if (timer !== null) { stop(); return; }
  button.textContent = "Pause"; button.setAttribute("aria-pressed", "true");
  timer = setInterval(() => {
    if (+slider.value + step > frames.length - 1) step = -1; else if (+slider.value + step < 0) step = 1;
    if (frames.length > 1) show(+slider.value + step);
  }, 120);
});
</script></body></html>
"""


def film(pictures: Sequence[Picture], captions: Sequence[str], *, title: str = "", label: str = "time") -> Page:
    """One page that shows a picture at a time.

    Parameters
    ----------
    pictures : sequence of Picture
        Of one size.
    captions : sequence of str
        One each.
    title, label : str
        Of the page, and what the slider changes.

    Returns
    -------
    Page

    Raises
    ------
    InputError
        There are no pictures, or not as many captions.

    Examples
    --------
    >>> import beltrami as bt
    >>> from beltrami.view.film import film
    >>> frames = [bt.plot(bt.shapes.sphere(1), size=(80, 80), color=c) for c in ("#aa0000", "#00aa00")]
    >>> "<input" in film(frames, ["red", "green"]).html
    True
    """
    if not pictures or len(pictures) != len(captions):
        raise InputError(f"{len(pictures)} pictures come with {len(captions)} captions; give at least one, and as many")
    frames = [base64.b64encode(picture.png()).decode() for picture in pictures]
    parts = {
        "__TITLE__": html.escape(title or pictures[0].description),
        "__LABEL__": html.escape(label),
        "__LAST__": str(len(frames) - 1),
        "__CAPTION__": html.escape(captions[0]),
        "__CAPTIONS__": json.dumps(list(captions)).replace("</", "<\\/"),
        "__FIRST__": frames[0],
        "__FRAMES__": json.dumps(frames),
    }
    page = _TEMPLATE
    for mark, text in parts.items():
        page = page.replace(mark, text)
    return Page(page, title or pictures[0].description)
